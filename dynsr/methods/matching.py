"""Trajectory matching: refine the constants of a whole system on the states themselves.

The found equations are integrated over windows of the data (multiple shooting; Bock 1981) and
every float constant is fitted by robust nonlinear least squares, which removes the bias that
differences put into slopes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy
from scipy.interpolate import make_interp_spline

from dynsr.derivatives import estimate_noise
from dynsr.errors import InputError
from dynsr.expression import compile_numpy, parse
from dynsr.methods.flow import Flow, Windows, cut_windows, free_constants
from dynsr.methods.shooting import Shooting
from dynsr.trajectory import Trajectory

_MOST_WINDOWS = 400
# Plain first, then ever more robust.
_ROUNDS = ("linear", "soft_l1", "cauchy")


@dataclass(frozen=True, eq=False)
class Match:
    """Equations whose constants fit the states.

    ``errors`` gives for every state its constants in order of appearance as (value, standard
    error); ``loss`` is the median absolute residual at the ends of steps in units of each state's
    spread; ``success`` says whether the fit could be done at all.
    """

    exprs: dict[str, sympy.Expr]
    errors: dict[str, tuple[tuple[float, float], ...]]
    loss: float
    success: bool


def match_trajectories(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
    window: int | None = None,
    max_seconds: float = 10.0,
) -> Match:
    """Refine every float constant of ``exprs`` so that the integrated states fit the data.

    Parameters
    ----------
    exprs : state -> right-hand side in the states, the inputs and ``t``. States without one are
        read from the data like inputs.
    trajectories : one or many, of the same columns.
    inputs : input name -> expression in ``t``, where it is known; other inputs are interpolated.
    window : intervals a window; by default 10 for clean data, and for noisy data, where the start
        of each window is fitted too, a tenth of the longest trajectory but 20 to 100.
    max_seconds : the best constants found by then are given.

    Integers and rationals are structure and stay. Raises InputError when a state is unknown.

    >>> t = np.linspace(0, 1, 51)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None], ("x",))
    >>> match = match_trajectories({"x": sympy.Float(-1.9) * sympy.Symbol("x")}, decay)
    >>> round(match.errors["x"][0][0], 6)
    -2.0
    """
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    flow, values, owners = _prepare(exprs, runs, inputs or {})
    untouched = Match(dict(exprs), {s: () for s in exprs}, np.inf, False)
    shortest = min(len(run) for run in runs)
    if shortest < 3 or not (len(values) or is_noisy(runs)):
        return replace(untouched, success=not len(values))
    spread = np.std(np.concatenate([run.x for run in runs]), axis=0)
    columns = [runs[0].index(state) for state in flow.rhs]
    free = is_noisy(runs)
    length = window or (min(100, max(20, max(map(len, runs)) // 10)) if free else 10)
    shooting = Shooting(
        flow,
        _cut(flow, runs, inputs or {}, length),
        np.maximum(spread[columns], 1e-300),
        free,
    )
    fitted = _fit(shooting, np.array(values), time.monotonic() + max_seconds)
    return untouched if fitted is None else _match(flow, owners, *fitted)


def is_noisy(runs: Sequence[Trajectory]) -> bool:
    """Say whether measurement noise of a state is above 1e-5 of its spread."""
    long = [run for run in runs if len(run) > 4]
    if not long:
        return False
    noise = np.mean([estimate_noise(run) for run in long], axis=0)
    return bool(np.any(noise > 1e-5 * np.std(np.concatenate([run.x for run in runs]), axis=0)))


def read_inputs(
    exprs: Mapping[str, str | sympy.Expr], names: Sequence[str]
) -> dict[str, sympy.Expr]:
    """Read expressions in ``names``, one a key; raises InputError where one cannot be read."""
    return {key: parse(expr, names) for key, expr in exprs.items()}


def _prepare(
    exprs: Mapping[str, sympy.Expr], runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr]
) -> tuple[Flow, list[float], list[str]]:
    if not runs or any(run.names != runs[0].names for run in runs):
        raise InputError("the trajectories have different columns; give all the same columns")
    rhs: dict[str, sympy.Expr] = {}
    constants: list[sympy.Symbol] = []
    values: list[float] = []
    owners: list[str] = []
    for state, expr in exprs.items():
        runs[0].index(state)
        # The space keeps these names apart from any name of a column.
        template, found = free_constants(expr, f"constant {state} ")
        rhs[state] = template
        constants += found
        values += found.values()
        owners += [state] * len(found)
    others = [n for n in (*runs[0].names, *inputs) if n not in rhs]
    used = {str(s) for expr in rhs.values() for s in expr.free_symbols}
    driven = tuple(dict.fromkeys(n for n in others if n in used))
    return Flow(rhs, driven, tuple(constants)), values, owners


def _cut(
    flow: Flow,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    length: int,
) -> Windows:
    states = [runs[0].index(state) for state in flow.rhs]
    drives = drives_of(flow.driven, runs, inputs)
    parts = [r.x[:, states] for r in runs]
    return cut_windows([r.t for r in runs], parts, drives, length, _MOST_WINDOWS)


def drives_of(
    driven: Sequence[str], runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr]
) -> list[Callable[[np.ndarray], np.ndarray]]:
    """Give for every trajectory its driven columns and the time, (d + 1, n), at any n times."""
    return [_drive(driven, run, inputs) for run in runs]


def _drive(
    driven: Sequence[str], run: Trajectory, inputs: Mapping[str, sympy.Expr]
) -> Callable[[np.ndarray], np.ndarray]:
    """Give the driven columns and the time, (d + 1, n), at any n times."""
    known = [name for name in driven if name in inputs]
    exact = compile_numpy([inputs[name] for name in known], ["t"])
    data = [name for name in driven if name not in inputs]
    position = [run.names.index(name) for name in data]
    degree = min(5, (len(run) - 1) // 2 * 2 - 1) if len(run) > 3 else 1
    spline = make_interp_spline(run.t, run.columns[:, position], k=degree) if data else None
    order = [(*known, *data).index(name) for name in driven]

    def drive(t: np.ndarray) -> np.ndarray:
        rows = list(exact(t[None])) + (list(spline(t).T) if spline is not None else [])
        return np.array([*(rows[i] for i in order), t])

    return drive


def _fit(
    shooting: Shooting, constants: np.ndarray, deadline: float
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Give the constants, their errors and the median miss; None when the start diverges."""
    starts = shooting.windows.x[0]
    with np.errstate(all="ignore"):
        shooting = replace(shooting, substeps=_choose_substeps(shooting, constants, starts))
        if not np.all(np.isfinite(shooting.unit(shooting.misses(constants, starts)))):
            return None
        for loss in _ROUNDS:
            constants, starts = shooting.minimise(constants, starts, loss, deadline)
        level = float(np.median(np.abs(shooting.misses(constants, starts))))
        if not len(constants):
            return constants, constants, level
        try:
            errors = shooting.standard_errors(constants, starts)
        except (np.linalg.LinAlgError, FloatingPointError):
            errors = np.full(len(constants), np.inf)
    return constants, errors, level


def _choose_substeps(shooting: Shooting, constants: np.ndarray, starts: np.ndarray) -> int:
    """Halve the step until that moves the states less than rounding or than their misses."""
    coarse = shooting.misses(constants, starts)
    for substeps in (2, 4, 8, 16):
        fine = replace(shooting, substeps=substeps).misses(constants, starts)
        moved = np.nanmax(np.abs(fine - coarse), initial=0.0)
        if moved < 1e-9 or moved < 0.01 * np.nanmedian(np.abs(fine)):
            return substeps // 2
        coarse = fine
    return 16


def _match(
    flow: Flow, owners: Sequence[str], values: np.ndarray, errors: np.ndarray, loss: float
) -> Match:
    put = {c: sympy.Float(float(v)) for c, v in zip(flow.constants, values, strict=True)}
    exprs = {state: expr.xreplace(put) for state, expr in flow.rhs.items()}
    pairs = list(zip(owners, values.tolist(), errors.tolist(), strict=True))
    ordered = {
        state: _in_order(expr, {v: e for owner, v, e in pairs if owner == state})
        for state, expr in exprs.items()
    }
    return Match(exprs, ordered, loss, True)


def _in_order(expr: sympy.Expr, errors: Mapping[float, float]) -> tuple[tuple[float, float], ...]:
    """Pair constants with their errors as they now appear: SymPy sorts terms by their numbers."""
    _, found = free_constants(expr, "constant ")
    return tuple((value, errors.get(value, np.inf)) for value in found.values())


def forecast_miss(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
    window: int = 50,
) -> float:
    """Give the median miss of forecasts over ``window`` intervals, in units of the spread.

    Each window starts at its first measurement; states without an expression are read from the
    data. inf when most forecasts diverge.

    >>> t = np.linspace(0, 1, 51)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None], ("x",))
    >>> forecast_miss({"x": -2 * sympy.Symbol("x")}, decay) < 1e-6
    True
    """
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    flow, values, _ = _prepare(exprs, runs, inputs or {})
    columns = [runs[0].index(state) for state in flow.rhs]
    spread = np.std(np.concatenate([run.x for run in runs]), axis=0)[columns]
    windows = _cut(flow, runs, inputs or {}, window)
    shooting = Shooting(flow, windows, np.maximum(spread, 1e-300), False)
    with np.errstate(all="ignore"):
        starts, constants = windows.x[0], np.array(values)
        substeps = _choose_substeps(shooting, constants, starts)
        misses = np.abs(replace(shooting, substeps=substeps).misses(constants, starts))
    return float(np.median(np.nan_to_num(misses, nan=np.inf)))
