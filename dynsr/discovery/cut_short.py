"""Cut short: discoveries made again of what was kept when a search, or what used it, was ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from dynsr import __version__
from dynsr.data import Trajectory
from dynsr.discovery.orders import Order, form_of, read_form
from dynsr.discovery.problem import with_velocities
from dynsr.discovery.provenance import with_provenance
from dynsr.discovery.result import Discovery
from dynsr.engines import DEFAULT_ENGINE
from dynsr.fit import ParetoFront

if TYPE_CHECKING:
    import sympy


def keep_formulas(
    formulas: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    order: Order = 1,
    explicit_time: bool = False,
    discrete: bool = False,
    **record: Any,
) -> Discovery:
    """Make a discovery of the formulas that a search had when it was ended by force.

    Parameters
    ----------
    formulas : state -> the formula that was sought for it; of second order, that of its velocity.
    runs : the data.
    order, explicit_time, discrete : as :func:`dynsr.discover` had them.
    record : what else of its settings the record gets.

    The result is not complete, and has no verdict.

    >>> t = [0.0, 1.0, 2.0]
    >>> import sympy
    >>> run = Trajectory(t, [[1.0], [2.0], [4.0]], ("x",))
    >>> found = keep_formulas({"x": 2 * sympy.Symbol("x")}, [run], discrete=True)
    >>> found.complete, found.verdict.tested, found.is_map
    (False, False, True)
    """
    form = read_form(order, explicit_time, discrete, runs, runs[0].states)
    sought = form.searched(runs[0].states)
    formulas = {state: formulas[state] for state in sought if state in formulas}
    why = " The best so far when the search was ended."
    found = Discovery(
        formulas,
        dict.fromkeys(formulas, ()),
        dict.fromkeys(formulas, ParetoFront([])),
        dict.fromkeys(formulas, why),
        settings={
            "method": "auto",
            "methods": [],
            "preset": "",
            "seed": 0,
            **form.record,
            **record,
            "engine": DEFAULT_ENGINE,
            "version": __version__,
        },
        complete=False,
    )
    return with_provenance(next_to_data(with_velocities(found, form), runs), runs)


def next_to_data(found: Discovery, runs: Sequence[Trajectory]) -> Discovery:
    """Give a discovery that was loaded with the data that it was made from.

    Parameters
    ----------
    found : the discovery.
    runs : the data as :func:`dynsr.discover` had them; velocities are made again.
    """
    return replace(found, trajectories=tuple(form_of(found.settings).prepare(runs)))
