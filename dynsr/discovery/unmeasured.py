"""Unmeasured: what can be said of a state that nobody measured, and what cannot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy
from scipy.interpolate import CubicSpline

from dynsr.data import FEWEST_SMOOTH, Trajectory, carry
from dynsr.errors import InputError
from dynsr.expression import expand_terms, shown
from dynsr.fit import Collocation, Measurements, tidy
from dynsr.selection import Coupling, first_curve, law_of

# In the origin of a run, which one it is.
_RUN = "run with a hidden state"


def coupling_of(name: str, term: sympy.Expr, equations: Mapping[str, sympy.Expr]) -> Coupling:
    """Give where a hidden state enters.

    Parameters
    ----------
    name : of the hidden state.
    term : the term with it, whose factor was chosen.
    equations : state -> right-hand side.

    Raises InputError where none has the term.
    """
    body = term.as_coeff_Mul()[1]
    for state, expr in equations.items():
        own = [t for t in sympy.Add.make_args(expand_terms(expr)) if t.as_coeff_Mul()[1] == body]
        if state != name and own:
            factor = own[0].as_coeff_Mul()[0]
            return Coupling(name, state, body / sympy.Symbol(name), factor)
    raise InputError(f"no equation has the term {body} with which {name} enters")


def describe_hidden(name: str, term: sympy.Expr, equations: Mapping[str, sympy.Expr]) -> str:
    """Say what cannot be known of a hidden state, and what the data determine without it.

    Parameters
    ----------
    name, term, equations : as in :func:`coupling_of`.

    >>> x, y = sympy.symbols("x y")
    >>> print(describe_hidden("y", y, {"x": y, "y": -4 * x}))
    Nobody measured y. Its scale and sign are chosen so that x' contains y. A function of x may be \
added to y, with other equations for the same data; this form takes the fewest bits. In all of \
them x'' = -4*x.
    """
    coupling = coupling_of(name, term, equations)
    state, law = coupling.state, law_of(equations, coupling)
    measured = " and ".join(s for s in equations if s != name)
    known = "" if law is None else f" In all of them {state}'' = {shown(tidy(law[name]), 4)}."
    return (
        f"Nobody measured {name}. Its scale and sign are chosen so that {state}' contains "
        f"{shown(coupling.term)}. A function of {measured} may be added to {name}, with other "
        f"equations for the same data; this form takes the fewest bits.{known}"
    )


def refuse_hidden(names: Iterable[str], what: str) -> None:
    """Raise InputError where a state was not measured: what it does not allow.

    Parameters
    ----------
    names : of the hidden states.
    what : is said first.
    """
    for name in names:
        raise InputError(f"{what} only where every state was measured, and {name} was not")


def number_runs(runs: Sequence[Trajectory]) -> list[Trajectory]:
    """Give runs that know which one each of them is, for :func:`with_columns`."""
    return [replace(r, origin={**r.origin, _RUN: number}) for number, r in enumerate(runs)]


def with_columns(runs: Sequence[Trajectory], data: Measurements, name: str) -> list[Trajectory]:
    """Give runs with the fitted curve of a hidden state, which counts as not measured.

    Parameters
    ----------
    runs : what :func:`number_runs` gave.
    data : the rows of these that were fitted, with the curve.
    name : of the hidden state.
    """
    found = []
    for number, run in enumerate(runs):
        pairs = zip(data.runs, data.smoothed, strict=True)
        own = [(some, curve) for some, curve in pairs if some.origin.get(_RUN) == number]
        if not own:
            raise InputError(
                f"a trajectory of {len(run)} rows is too short for {name}; leave it out"
            )
        t = np.concatenate([curve.t for _, curve in own])
        values = np.concatenate([curve.x[:, some.index(name)] for some, curve in own])
        x = np.column_stack([run.observed, CubicSpline(t, values)(run.t)])
        gaps = np.column_stack([~run.measured, np.ones(len(run), dtype=bool)])
        origin = {n: value for n, value in run.origin.items() if n != _RUN}
        states = (*run.states, name)
        found.append(replace(run, x=x, states=states, unmeasured=gaps, origin=origin))
    return found


def estimate_hidden(
    runs: Sequence[Trajectory],
    name: str,
    term: sympy.Expr,
    equations: Mapping[str, sympy.Expr],
    inputs: Mapping[str, sympy.Expr],
    rows: int,
) -> list[Trajectory]:
    """Give runs with the curve of a hidden state that follows from known equations.

    Parameters
    ----------
    runs : the measured states.
    name, term, equations : as in :func:`coupling_of`.
    inputs : input name -> expression in ``t`` where it is known.
    rows : rows of the data at most.

    Raises InputError where the equations cannot be followed along the runs.
    """
    numbered = number_runs(carry(runs))
    coupling = coupling_of(name, term, equations)
    data = _along(
        first_curve(Measurements.of(numbered, inputs, rows), coupling, equations), equations
    )
    if data is None:
        raise InputError(f"{name} cannot be fitted to these data; their slopes diverge")
    return with_columns(numbered, data, name)


def fit_starts(
    runs: Sequence[Trajectory],
    equations: Mapping[str, sympy.Expr],
    inputs: Mapping[str, sympy.Expr],
    derived: Mapping[str, sympy.Symbol],
    rows: int,
) -> list[Trajectory]:
    """Give runs whose first row, where a state was not measured, follows from known equations.

    A curve through the rows of the state alone may be far off there. What was measured stays, and
    so do runs that are too short to be smoothed.

    Parameters
    ----------
    runs : trajectories in which each state is on its curve where it was not measured.
    equations, inputs : right-hand sides, and input name -> expression in ``t`` where it is known.
    derived : state -> its slope that was made from it.
    rows : rows of the data at most.
    """
    found = []
    for run in runs:
        places = [run.index(state) for state in equations]
        if len(run) >= FEWEST_SMOOTH and not run.measured[0, places].all():
            data = _along(Measurements.of([run], inputs, rows, derived), equations)
            if data is not None:
                x = run.x.copy()
                x[0] = np.where(run.measured[0], x[0], data.smoothed[0].x[0])
                run = replace(run, x=x)
        found.append(run)
    return found


def _along(data: Measurements, equations: Mapping[str, sympy.Expr]) -> Measurements | None:
    """Give measurements whose curves follow equations with their constants; None if none do."""
    # What is no float is not fitted.
    exact = {
        s: e.xreplace({number: sympy.Rational(number) for number in e.atoms(sympy.Float)})
        for s, e in equations.items()
    }
    mesh = data.mesh(tuple(exact))
    fit = Collocation(exact, mesh).fit()
    return None if fit is None else data.along(fit.states, mesh.states)
