"""Every row: what was found on windows of long records is fitted to all of their rows, and tested.

The searches see the most informative windows. The constants, their intervals and the test whether
one law holds everywhere are those of all rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import sympy

from dynsr.data import (
    Trajectory,
    Window,
    WindowSettings,
    choose_windows,
    cut_to_windows,
    estimate_noise,
)
from dynsr.discovery.problem import DiscoverySettings
from dynsr.discovery.result import Discovery, with_words
from dynsr.expression import differentiate, evaluate, free_constants
from dynsr.fit import (
    FitSettings,
    RowsFit,
    confirm,
    fit_blocks,
    interval_reach,
    is_noisy,
    loosen_all,
    tidy,
)
from dynsr.verdict import APPROXIMATION, LAW, NOT_FOUND, Verdict, summarise


def take_windows(
    runs: Sequence[Trajectory],
    settings: WindowSettings,
    slopes: Mapping[str, Any] | None,
    most: float,
    discrete: bool = False,
) -> tuple[list[Trajectory], list[Window], dict[str, Any] | None]:
    """Give the rows that are searched: all of them, or the windows of long records.

    Parameters
    ----------
    runs : the trajectories.
    settings : which rows of long records are searched.
    slopes : state -> the user's own, one array or one for each trajectory.
    most : rows up to which all are searched.
    discrete : whether a map is sought, which leaves out no row.

    Gives the trajectories; the windows that they are, none where all rows are searched; and the
    slopes at their rows.
    """
    if sum(map(len, runs)) <= most:
        return list(runs), [], None if slopes is None else dict(slopes)
    windows = choose_windows(runs, settings, thinned=not discrete)
    own = {s: [_of_run(all_, w.run)[w.rows] for w in windows] for s, all_ in (slopes or {}).items()}
    return cut_to_windows(runs, windows), windows, own or None


def _of_run(slopes: Any, run: int) -> np.ndarray:
    """Give the slopes of one trajectory."""
    return np.asarray(slopes[run] if are_apart(slopes) else slopes, dtype=float)


def are_apart(slopes: Any) -> bool:
    """Whether the user's slopes of a state are one array for each trajectory, and not one in all.

    Parameters
    ----------
    slopes : of one state.
    """
    return isinstance(slopes, (list, tuple)) and any(np.ndim(part) for part in slopes)


def on_every_row(
    found: Discovery,
    runs: Sequence[Trajectory],
    windows: Sequence[Window],
    settings: DiscoverySettings,
) -> Discovery:
    """Fit the constants to all rows in one pass, and test whether the equations hold in all.

    Where nothing was found, or equations have delays or are maps, the constants stay those of the
    windows. ``settings["windows"]`` of the result says which rows they are, and what all rows say.
    """
    if not windows:
        return found
    total = sum(map(len, runs))
    record: dict[str, Any] = {
        "rows": total,
        "searched": [[w.run + 1, w.first + 1, w.last, w.stride] for w in windows],
    }
    said = f" Found on {name_windows({'windows': record})}"
    try:
        fit = None if _stays(found) else _fit(found, runs, settings)
    except KeyboardInterrupt:
        # The search is over, and what it found is not lost.
        fit = None
    if fit is None:
        record["fitted"] = False
        return with_words(found, f"{said}; the constants are those of the windows.", windows=record)
    differing = fit.differing(settings.selection.fit.joint)
    record |= {
        "fitted": True,
        "blocks": len(fit.blocks) + len(fit.failed),
        "differing": [[run + 1, first + 1, last] for run, first, last in differing],
    }
    if differing:
        where = _name(differing, len(runs))
        found = replace(found, verdict=_doubt(found.verdict, where))
        return with_words(
            found, f"{said}; it does not hold in all of them: {where}.", windows=record
        )
    found = _with_constants(found, fit, settings.selection.fit)
    return with_words(found, f"{said}, and fitted to all of them, which agree.", windows=record)


def name_windows(settings: Mapping[str, Any]) -> str:
    """Say on which windows of long records a discovery was found; "" where all rows were searched.

    Parameters
    ----------
    settings : those of the discovery.

    >>> name_windows({"windows": {"rows": 30_000, "searched": [[1, 1, 200, 1], [1, 901, 1100, 1]]}})
    '2 windows of 30,000 rows'
    """
    record = settings.get("windows")
    return f"{len(record['searched'])} windows of {record['rows']:,} rows" if record else ""


def _stays(found: Discovery) -> bool:
    """Whether no equation is fitted again: it has a delay, is a map, was given, or not found."""
    judged = found.verdict.tested and found.verdict.level != NOT_FOUND
    apart = bool(found.delays or found.free.parts)
    return apart or found.is_map or not (found.complete and judged)


def _fit(
    found: Discovery, runs: Sequence[Trajectory], settings: DiscoverySettings
) -> RowsFit | None:
    fit, inputs = settings.selection.fit, found.inputs
    searched, exprs = found.trajectories, loosen_all(found.equations)
    noisy = is_noisy(searched) and confirm(exprs, searched, inputs, fit) is None
    noise = estimate_noise(searched) if noisy else None
    return fit_blocks(exprs, runs, inputs, noise, fit.confirmed, settings.windows.block, fit)


def _with_constants(found: Discovery, fit: RowsFit, settings: FitSettings) -> Discovery:
    """Put the constants of all rows, with their errors, in the place of those of the windows."""
    written = [pair for state in fit.exprs for pair in found.errors.get(state, ())]
    if len(written) != len(fit.constants):
        return found
    numbers = fit.choose_numbers(written, settings)
    equations = {s: tidy(e) for s, e in fit.put(numbers).items()}
    errors, fitted, first = {}, {}, 0
    for state, opened in fit.exprs.items():
        loose = loosen_all({state: equations[state]})[state]
        values = list(free_constants(loose, "constant ")[1].values())
        places = _places(opened, loose)
        if places is None:
            return found
        own = [first + place for place in places]
        errors[state] = tuple(
            (value, float(fit.errors[i])) for value, i in zip(values, own, strict=True)
        )
        fitted[state] = tuple(float(fit.constants[i]) for i in own)
        first += len(places)
    return replace(
        found, equations=equations, errors=errors, fitted=fitted, reach=interval_reach(math.inf)
    )


def _places(one: sympy.Expr, other: sympy.Expr) -> list[int] | None:
    """Give for each constant of a formula its place in another order of the same terms.

    SymPy sorts terms by their numbers. Two constants are one where the formula has the same slope
    by them. None where the constants are not the same.
    """
    slopes = []
    for expr in (one, other):
        template, values = free_constants(expr, "constant ")
        # Numbers by which constants of either order differ are near, so that slopes are too.
        put = {symbol: sympy.Float(value) for symbol, value in values.items()}
        names = sorted(map(str, expr.free_symbols))
        columns = {name: 0.5 + np.cos(i + np.arange(4)) ** 2 for i, name in enumerate(names)}
        columns["t"] = columns.get("t", np.ones(4))
        with np.errstate(all="ignore"):
            slopes.append(
                [evaluate(differentiate(template, c).xreplace(put), columns) for c in values]
            )
    before, after = slopes
    if len(before) != len(after):
        return None
    left, found = list(range(len(before))), []
    for slope in after:
        place = min(left, key=lambda i: float(np.nansum(np.abs(before[i] - slope))))
        left.remove(place)
        found.append(place)
    return found


def _doubt(verdict: Verdict, where: str) -> Verdict:
    """Take a law for an approximation where other rows follow another one."""
    states = {
        s: replace(
            own,
            level=APPROXIMATION,
            reason=f"{own.reason.removesuffix('.')} in the windows that were searched, but not in "
            f"{where}.",
        )
        if own.level == LAW
        else own
        for s, own in verdict.states.items()
    }
    return summarise(states, verdict.span)


def _name(places: Sequence[tuple[int, int, int]], runs: int) -> str:
    """Name stretches of rows."""
    words = [
        f"rows {first + 1} to {last}" + (f" of trajectory {run + 1}" if runs > 1 else "")
        for run, first, last in places[:3]
    ]
    more = len(places) - 3
    return ", ".join(words) + (f" and {more} more" if more > 0 else "")
