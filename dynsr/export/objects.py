"""Objects: equations as things of CasADi, python-control and do-mpc, to compute with at once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import sympy

from dynsr.errors import need
from dynsr.export.models import CasadiPrinter
from dynsr.export.source import Source
from dynsr.expression import compile_numpy

_EXTRA = "control"
_WITH_DELAYS = ("python", "matlab", "r", "julia", "modelica")


def make_casadi(source: Source) -> Any:
    """Give a ``casadi.Function`` (t, x, u, p) -> slopes, or the next state of a map.

    Parameters
    ----------
    source : the equations; ``p`` are its parameters and ``u`` the inputs that were measured.

    Raises MissingExtra when CasADi is not installed.
    """
    source.refuse_delays("CasADi", _WITH_DELAYS)
    need("casadi", _EXTRA, "a function of CasADi")
    import casadi

    t = casadi.SX.sym("t")
    groups = [source.states, source.measured, list(source.parameters)]
    columns = [[casadi.SX.sym(name) for name in group] for group in groups]
    known = {"t": t}
    for group, own in zip(groups, columns, strict=True):
        known.update(zip(group, own, strict=True))
    slopes = _with_casadi(source, known)
    given = [t, *(casadi.vertcat(*own) for own in columns)]
    return casadi.Function(
        "rhs", given, [casadi.vertcat(*slopes)], ["t", "x", "u", "p"], ["slopes"]
    )


def _with_casadi(source: Source, known: dict[str, Any]) -> list[Any]:
    """Give the right-hand sides in symbols of CasADi: ``known`` is name -> symbol."""
    import casadi

    def compute(exprs: Iterable[sympy.Expr]) -> list[Any]:
        # A state may have the name of what the function calls.
        own = {sympy.Symbol(name): sympy.Dummy(f"own{place}") for place, name in enumerate(known)}
        swapped = [expr.xreplace(own) for expr in exprs]
        modules = [{"casadi": casadi}]
        function = sympy.lambdify([*own.values()], swapped, modules, printer=CasadiPrinter)
        return list(function(*known.values()))

    for name, expr in source.known.items():
        (known[name],) = compute([expr])
    return compute(source.equations.values())


def make_control(source: Source) -> Any:
    """Give a ``control.NonlinearIOSystem``: its inputs are those that were measured.

    Parameters
    ----------
    source : the equations; its outputs are the states.

    Raises MissingExtra when python-control is not installed.
    """
    source.refuse_delays("python-control", _WITH_DELAYS)
    need("control", _EXTRA, "a system of python-control")
    import control

    put = {sympy.Symbol(name): expr for name, expr in source.known.items()}
    names = ["t", *source.states, *source.measured, *source.parameters]
    rows = compile_numpy([e.xreplace(put) for e in source.equations.values()], names)

    def update(t: float, state: Any, inputs: Any, params: dict[str, float]) -> Any:
        values = [t, *state, *np.atleast_1d(inputs)[: len(source.measured)]]
        return rows(np.array([*values, *(params[name] for name in source.parameters)]))

    return control.nlsys(
        update,
        None,
        inputs=source.measured,
        states=source.states,
        outputs=source.states,
        params=dict(source.parameters),
        name="found",
        **({"dt": source.system.step} if source.system.discrete else {}),
    )


def make_do_mpc(source: Source) -> Any:
    """Give a ``do_mpc.model.Model`` that is set up.

    Parameters
    ----------
    source : the equations; where they contain the time, it is one more state, ``t``.

    Raises MissingExtra when do-mpc is not installed.
    """
    source.refuse_delays("do-mpc", _WITH_DELAYS)
    need("do_mpc", _EXTRA, "a model of do-mpc")
    import casadi
    import do_mpc

    model = do_mpc.model.Model("discrete" if source.system.discrete else "continuous")
    kinds = {"_x": source.states, "_u": source.measured, "_p": list(source.parameters)}
    known = {n: model.set_variable(kind, n) for kind, names in kinds.items() for n in names}
    if source.timed:
        known["t"] = model.set_variable("_x", "t")
        later = known["t"] + source.system.step
        model.set_rhs("t", later if source.system.discrete else casadi.SX(1))
    slopes = _with_casadi(source, known)
    for state, slope in zip(source.states, slopes, strict=True):
        model.set_rhs(state, casadi.SX(slope))
    model.setup()
    return model
