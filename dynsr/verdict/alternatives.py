"""Alternatives: how much worse different formulas would follow the trajectories than the one found.

An alternative is first fitted to the slopes of the equation found, along the trajectory that this
gives: one that can be the same function does not count. What still differs is followed through the
system by its sensitivities, in one integration for all alternatives; constants and starts may
compensate for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import ByText, differentiate, evaluate, free_constants
from dynsr.fit import (
    Candidate,
    Shooting,
    constant_bits,
    independent_rows,
    loosen,
    orthogonal,
    refit,
    with_floats,
)
from dynsr.library import structure_in
from dynsr.verdict.following import LEAST_SQUARE, Course, Followed, Place

# Longer formulas are no alternatives of shorter ones: what they can do more, the misses tell.
MORE_CONSTANTS = 2


def compare_alternatives(
    equations: Mapping[str, sympy.Expr],
    front: Mapping[str, Iterable[Candidate]],
    followed: Followed,
    places: Mapping[sympy.Symbol, Place],
    course: Course,
    most: int,
    different: float,
    rows: int,
) -> dict[str, list[tuple[sympy.Expr, float]]]:
    """Give for every state (formula, bits that it takes more than the equation), fewest first.

    Parameters
    ----------
    equations : state -> right-hand side.
    front : state -> formulas that were found for it.
    followed : the equations, fitted to the trajectories.
    places : their open constants.
    course : the trajectories.
    most : formulas a state that are compared.
    different : rms difference, in shares of the slopes' spread, of formulas that are different.
    rows : rows on which formulas are compared with the equation; of more, evenly spaced ones.

    The bits are those of the residuals in the linearised fit, of the formula, and of its constants.
    """
    columns = _columns_along(followed.shootings, followed.misses)
    chosen = [
        (state, expr)
        for state in equations
        for expr in _closest(
            state, equations[state], front.get(state, ()), columns, most, different, rows
        )
    ]
    if not chosen:
        return {state: [] for state in equations}
    bits = _bits_above(equations, chosen, followed, places, course)
    written = {s: with_floats(expr) for s, expr in equations.items()}
    structure = structure_in(columns)
    said = structure(written)
    found: dict[str, list[tuple[sympy.Expr, float]]] = {state: [] for state in equations}
    for (state, expr), value in zip(chosen, bits, strict=True):
        more = count_constants(expr) - count_constants(equations[state])
        cost = structure({**written, state: with_floats(expr)}) - said
        measured = float(np.sum(followed.counts)) * course.thinned
        found[state].append((expr, float(value) + cost + more * constant_bits(measured)))
    return {state: sorted(pairs, key=lambda pair: pair[1]) for state, pairs in found.items()}


def _columns_along(
    shootings: Sequence[Shooting], misses: Sequence[np.ndarray]
) -> dict[str, np.ndarray]:
    """Give states, driven columns and times along fitted windows, (n,) each, by name.

    Parameters
    ----------
    shootings : the windows, with the flow that names their columns.
    misses : of each of them, in units of the noise.
    """
    parts = []
    for shooting, z in zip(shootings, misses, strict=True):
        x = shooting.windows.x + shooting.missed(z)
        driven = shooting.windows.driven_rows
        parts.append(
            np.concatenate([x, driven], axis=1)
            .transpose(1, 0, 2)
            .reshape(x.shape[1] + driven.shape[1], -1)
        )
    flow = shootings[0].flow
    names = [*flow.rhs, *flow.driven, "t"]
    return dict(zip(names, np.concatenate(parts, axis=1), strict=True))


def count_constants(expr: sympy.Expr) -> int:
    """Count the constants of a formula, coefficients of 1 included.

    Parameters
    ----------
    expr : the formula.
    """
    return len(free_constants(loosen(expr), "constant ")[1])


def _closest(
    state: str,
    own: sympy.Expr,
    front: Iterable[Candidate],
    columns: Mapping[str, np.ndarray],
    most: int,
    different: float,
    rows: int,
) -> list[sympy.Expr]:
    """Give different functions that come closest to the equation along its trajectory."""
    slopes = evaluate(own, columns)
    size = max(float(np.std(slopes)), 1e-3 * float(np.abs(np.mean(slopes))), 1e-300)
    names = tuple(n for n in columns if n != "t")
    every = max(1, len(slopes) // rows)
    samples = Samples(
        np.column_stack([columns[n][::every] for n in names]),
        slopes[::every],
        names,
        state,
        "given",
        columns["t"][::every],
    )
    allowed = count_constants(own) + MORE_CONSTANTS
    pool = [c for c in front if c.expr.free_symbols and count_constants(c.expr) <= allowed]
    found = []
    for candidate in sorted(pool, key=lambda c: c.loss)[: 2 * most]:
        if not {str(s) for s in candidate.expr.free_symbols} <= set(names):
            continue
        expr = refit(loosen(candidate.expr), samples)
        with np.errstate(all="ignore"):
            apart = float(np.sqrt(np.mean((evaluate(expr, columns) - slopes) ** 2))) / size
        if math.isfinite(apart) and apart > different:
            found.append((apart, expr))
    found.sort(key=lambda pair: (pair[0], ByText(pair[1])))
    return [expr for _, expr in found[:most]]


def _bits_above(
    equations: Mapping[str, sympy.Expr],
    chosen: Sequence[tuple[str, sympy.Expr]],
    followed: Followed,
    places: Mapping[sympy.Symbol, Place],
    course: Course,
) -> np.ndarray:
    """(R,) bits by which residuals of each alternative are larger, constants and starts adapted."""
    states, first = list(equations), len(followed.constants)
    probes, groups = _make_probes(equations, chosen, first)
    symbols = [sympy.Symbol(f"probe {i}") for i in range(len(probes))]
    flow = replace(followed.shootings[0].flow, constants=(*places, *symbols), probes=tuple(probes))
    probed = replace(
        followed,
        shootings=tuple(replace(s, flow=flow) for s in followed.shootings),
        constants=np.concatenate([followed.constants, np.zeros(len(probes))]),
    )
    with np.errstate(all="ignore"):
        z, slopes, owners = probed.linearise()
    mine = [owners == i for i in range(len(states))]
    level = np.array([max(np.mean(z[own] ** 2), LEAST_SQUARE) for own in mine])
    unit = np.sqrt(level)[owners]
    z, slopes = z / unit, slopes / unit[:, None]
    starts = np.arange(first + len(probes), slopes.shape[1])
    own = _left_over(z, slopes[:, [*range(first), *starts]])
    owner_of = [place.state for place in places.values()]
    shares = [_independent(own[rows]) for rows in mine]
    found = []
    for (state, _), (main, inner) in zip(chosen, groups, strict=True):
        others = [i for i in range(first) if owner_of[i] != state]
        left = _left_over(z + slopes[:, main], slopes[:, [*others, *inner, *starts]])
        # Misses with a pattern, as those of a solver are, say less than as many random ones.
        more = sum(
            float(left[rows] @ left[rows] - own[rows] @ own[rows])
            * max(_independent(left[rows]), share)
            for rows, share in zip(mine, shares, strict=True)
        )
        found.append(more * course.thinned / (2 * math.log(2)))
    return np.nan_to_num(np.array(found), nan=math.inf)


def _independent(misses: np.ndarray) -> float:
    """Share of residuals that are independent of each other."""
    return float(independent_rows(misses[:, None, None])[0]) / max(len(misses), 1)


def _make_probes(
    equations: Mapping[str, sympy.Expr], chosen: Sequence[tuple[str, sympy.Expr]], first: int
) -> tuple[list[tuple[int, sympy.Expr]], list[tuple[int, list[int]]]]:
    """Give a probe for each alternative's difference and for its slopes by its constants.

    And for each alternative the columns of these, which follow the ``first`` ones.
    """
    states = list(equations)
    probes: list[tuple[int, sympy.Expr]] = []
    groups = []
    for state, expr in chosen:
        row, main = states.index(state), first + len(probes)
        probes.append((row, expr - equations[state]))
        template, values = free_constants(expr, "inner ")
        numbers = {symbol: sympy.Float(value) for symbol, value in values.items()}
        by = [differentiate(template, symbol).xreplace(numbers) for symbol in values]
        groups.append((main, list(range(main + 1, main + 1 + len(by)))))
        probes += [(row, slope) for slope in by]
    return probes, groups


def _left_over(z: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """What the columns cannot take from ``z``; NaN where they are not finite."""
    if not (np.all(np.isfinite(columns)) and np.all(np.isfinite(z))):
        return np.full(len(z), np.nan)
    basis = orthogonal(columns)
    return np.asarray(z - basis @ (basis.T @ z))
