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
from dynsr.methods.constants import free_constants
from dynsr.methods.flow import Flow, Windows, cut_windows
from dynsr.methods.shooting import Shooting
from dynsr.trajectory import Trajectory

_MOST_WINDOWS = 400
# Plain first, then ever more robust.
_ROUNDS = ("linear", "soft_l1", "cauchy")


@dataclass(frozen=True, eq=False)
class Match:
    """Equations whose constants fit the states.

    ``errors`` gives for every state its constants in order of appearance as (value, standard
    error); ``misses`` are those of the integrated states, window after window, in units of each
    state's spread, and ``loss`` is the median of their sizes; ``success`` says whether the fit
    could be done at all.
    """

    exprs: dict[str, sympy.Expr]
    errors: dict[str, tuple[tuple[float, float], ...]]
    misses: np.ndarray
    success: bool

    @property
    def loss(self) -> float:
        """Give the median size of the misses; inf where there are none."""
        return float(np.median(np.abs(self.misses))) if len(self.misses) else np.inf

    @classmethod
    def untouched(cls, exprs: Mapping[str, sympy.Expr], success: bool = False) -> Match:
        """Equations as they came, without a fit."""
        return cls(dict(exprs), {s: () for s in exprs}, np.empty(0), success)


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
    flow, values, owners = prepare(exprs, runs, inputs or {})
    free = is_noisy(runs)
    if min(map(len, runs)) < 3:
        return Match.untouched(exprs, success=not len(values))
    length = window or _window_length(runs, free)
    shooting = build_shooting(flow, runs, inputs or {}, length, free)
    fitted = _fit(shooting, np.array(values), time.monotonic() + max_seconds)
    return Match.untouched(exprs) if fitted is None else _match(flow, owners, *fitted)


def _window_length(runs: Sequence[Trajectory], free: bool) -> int:
    return min(100, max(20, max(map(len, runs)) // 10)) if free else 10


def build_shooting(
    flow: Flow,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    length: int,
    free: bool,
) -> Shooting:
    """Cut the runs into windows of ``length`` intervals, their starts ``free`` or measured."""
    columns = [runs[0].index(state) for state in flow.rhs]
    spread = np.std(np.concatenate([run.x for run in runs]), axis=0)[columns]
    windows = _cut(flow, runs, inputs, length)
    return Shooting(flow, windows, np.maximum(spread, 1e-300), free)


def measure_errors(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    max_seconds: float = 10.0,
) -> dict[str, tuple[tuple[float, float], ...]]:
    """Give (value, standard error) of every float of equations that stay as they are.

    The errors are those which the constants would have if they were fitted, so also a constant
    that was made a simple number has one; inf where the data do not tell.

    >>> t = np.linspace(0, 1, 51)
    >>> x = np.exp(-2 * t) + 1e-3 * np.cos(40 * t)
    >>> decay = Trajectory(t, x[:, None], ("x",))
    >>> measure_errors({"x": sympy.Float(-2.0) * sympy.Symbol("x")}, [decay], {})["x"][0][0]
    -2.0
    """
    flow, values, owners = prepare(exprs, runs, inputs)
    constants = np.array(values)
    errors = np.full(len(values), np.inf)
    if len(values) and min(map(len, runs)) >= 3:
        free = is_noisy(runs)
        shooting = build_shooting(flow, runs, inputs, _window_length(runs, free), free)
        put = dict(zip(flow.constants, map(sympy.Float, values), strict=True))
        rhs = {state: expr.xreplace(put) for state, expr in flow.rhs.items()}
        fixed = replace(shooting, flow=Flow(rhs, flow.driven, ()))
        with np.errstate(all="ignore"):
            starts = shooting.windows.x[0]
            fixed = replace(fixed, substeps=choose_substeps(fixed, np.empty(0), starts))
            _, starts = _minimise(fixed, np.empty(0), starts, time.monotonic() + max_seconds)
            shooting = replace(shooting, substeps=fixed.substeps)
            errors = _standard_errors(shooting, constants, starts)
    pairs = list(zip(owners, values, errors.tolist(), strict=True))
    return {s: tuple((v, e) for owner, v, e in pairs if owner == s) for s in exprs}


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


def prepare(
    exprs: Mapping[str, sympy.Expr], runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr]
) -> tuple[Flow, list[float], list[str]]:
    """Give the flow, its constants' values and the states that own these; raises InputError."""
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
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Give the constants, their errors and the misses; None when the start diverges."""
    starts = shooting.windows.x[0]
    with np.errstate(all="ignore"):
        shooting = replace(shooting, substeps=choose_substeps(shooting, constants, starts))
        if not np.all(np.isfinite(shooting.unit(shooting.misses(constants, starts)))):
            return None
        constants, starts = _minimise(shooting, constants, starts, deadline)
        # Along time, so that signs that stay show errors that hang together.
        misses = shooting.misses(constants, starts).transpose(2, 1, 0).ravel()
        return constants, _standard_errors(shooting, constants, starts), misses


def _minimise(
    shooting: Shooting, constants: np.ndarray, starts: np.ndarray, deadline: float
) -> tuple[np.ndarray, np.ndarray]:
    for loss in _ROUNDS if len(constants) or shooting.free else ():
        constants, starts = shooting.minimise(constants, starts, loss, deadline)
    return constants, starts


def _standard_errors(shooting: Shooting, constants: np.ndarray, starts: np.ndarray) -> np.ndarray:
    if not len(constants):
        return constants
    try:
        errors = shooting.standard_errors(constants, starts)
    except (np.linalg.LinAlgError, FloatingPointError):
        return np.full(len(constants), np.inf)
    return np.where(np.isfinite(errors), errors, np.inf)


def choose_substeps(shooting: Shooting, constants: np.ndarray, starts: np.ndarray) -> int:
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
    flow: Flow, owners: Sequence[str], values: np.ndarray, errors: np.ndarray, misses: np.ndarray
) -> Match:
    put = {c: sympy.Float(float(v)) for c, v in zip(flow.constants, values, strict=True)}
    exprs = {state: expr.xreplace(put) for state, expr in flow.rhs.items()}
    pairs = list(zip(owners, values.tolist(), errors.tolist(), strict=True))
    ordered = {
        state: _in_order(expr, {v: e for owner, v, e in pairs if owner == state})
        for state, expr in exprs.items()
    }
    return Match(exprs, ordered, misses, True)


def _in_order(expr: sympy.Expr, errors: Mapping[float, float]) -> tuple[tuple[float, float], ...]:
    """Pair constants with their errors as they now appear: SymPy sorts terms by their numbers."""
    _, found = free_constants(expr, "constant ")
    return tuple((value, errors.get(value, np.inf)) for value in found.values())
