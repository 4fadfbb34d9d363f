"""Adaptive integration of slopes that are a Python function: measured inputs, networks, stiffness.

An engine integrates expressions in the states and ``t``. What is no such expression, or what its
explicit method cannot follow, is integrated here: by Tsit5 with steps that pass over no row and, as
soon as that needs too many steps, by Radau IIA of order 5 (Hairer and Wanner, Solving ODEs II,
section IV.8), SciPy's.
"""

from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import sympy

from dynsr.engines.base import InitialValueProblem, Integration
from dynsr.engines.drives import Drive, jumps_of
from dynsr.engines.tsit5.single import NO_REAL_VALUE, interpolate, take_steps
from dynsr.engines.tsit5.tableau import Slopes
from dynsr.errors import EngineError
from dynsr.expression import compile_numpy, compile_scalar

EXPLICIT, IMPLICIT = "Tsit5", "Tsit5, then Radau where it is stiff"
# Explicit steps, beside a few a row, after which the implicit method takes over.
_EXPLICIT_STEPS, _STEPS_A_ROW = 10_000, 20
# Counted, not timed: how far an integration comes may not depend on the machine.
_IMPLICIT_STEPS = 50_000
# Rows closer to a time than this share of their distance are that time.
_ROUNDING = 1e-6
# Rows for what moves in time alone: even ones, those a varying part, and times that are looked at.
_EVEN_ROWS, _VARYING_ROWS, _SCANNED = 200, 100, 50_000


@dataclass(frozen=True, eq=False)
class Motion:
    """dx/dt = slopes(*x, *u, t) of k states, with the (m,) times that no step may pass over.

    ``slopes`` gives k floats and may raise what an expression without a real value raises; u are
    the values of the ``drives``.
    """

    name: str
    states: tuple[str, ...]
    slopes: Slopes
    rows: np.ndarray
    drives: tuple[Drive, ...] = ()

    @cached_property
    def along(self) -> Slopes:
        """The slopes as a function of (*x, t)."""
        if not self.drives:
            return self.slopes
        slopes, drives = self.slopes, [drive.compile() for drive in self.drives]
        return lambda *at: slopes(*at[:-1], *[drive(at[-1]) for drive in drives], at[-1])

    def within(self, begin: float, end: float) -> Motion:
        """Give the motion between two times at which inputs jump, or none does."""
        rows = self.rows[(self.rows >= begin) & (self.rows <= end)]
        return replace(self, rows=rows, drives=tuple(d.within(begin, end) for d in self.drives))

    def longest(self) -> Callable[[float], float] | None:
        """Give the function of a time that says how far the next row is."""
        rows = np.unique(self.rows).tolist()
        if len(rows) < 2:
            return None

        def until_next(t: float) -> float:
            at = bisect_right(rows, t)
            if at >= len(rows):
                return float("inf")
            left = rows[at] - t
            if left > _ROUNDING * (rows[at] - rows[max(at - 1, 0)]) or at + 1 == len(rows):
                return left or float("inf")
            return rows[at + 1] - t

        return until_next

    def array_slopes(self, t: float, x: np.ndarray) -> np.ndarray:
        """Give the slopes (k,) at states (k,), NaN where they have no real value."""
        try:
            return np.array(self.along(*x.tolist(), t), dtype=float)
        except NO_REAL_VALUE:
            return np.full(len(x), np.nan)

    @classmethod
    def of(cls, name: str, problem: InitialValueProblem) -> Motion:
        """Give the motion that a problem poses, with its drives."""
        names = [drive.name for drive in problem.drives]
        slopes = compile_scalar(problem.rhs, [*problem.states, *names, "t"])
        return cls(name, problem.states, slopes, problem.stops, problem.drives)


@dataclass(frozen=True, eq=False)
class _Part:
    """A time between two jumps: its (m,) times with both ends, and places of the ``own`` of all."""

    t: np.ndarray
    own: np.ndarray
    places: np.ndarray

    def put(self, x: np.ndarray, found: np.ndarray) -> None:
        """Write states (m, k) at the times of the part among those (n, k) at all times."""
        found[self.own] = x[self.places]


def _parts(t: np.ndarray, drives: Sequence[Drive]) -> list[_Part]:
    """Cut the time at every jump of an input: a method of high order must not see one."""
    jumps = jumps_of(drives)
    edges = [t[0], *jumps[(jumps > t[0]) & (jumps < t[-1])], t[-1]]
    parts = []
    for begin, end in pairwise(edges):
        own = np.flatnonzero((t >= begin) & (t <= end))
        times = np.unique([begin, *t[own], end])
        parts.append(_Part(times, own, np.searchsorted(times, t[own])))
    return parts


def integrate_in_parts(
    problem: InitialValueProblem, solve: Callable[[InitialValueProblem], Integration]
) -> Integration:
    """Integrate from one jump of an input to the next, each part as a problem of its own.

    Parameters
    ----------
    problem : the problem with its drives.
    solve : integrates a problem whose inputs do not jump.
    """
    x = np.full((len(problem.t), len(problem.states)), np.nan)
    start, accepted, rejected, spent = problem.x0, 0, 0, 0.0
    for part in _parts(problem.t, problem.drives):
        begin, end = float(part.t[0]), float(part.t[-1])
        inside = (problem.stops >= begin) & (problem.stops <= end)
        began = time.monotonic()
        found = solve(
            replace(
                problem,
                x0=start,
                t=part.t,
                drives=tuple(drive.within(begin, end) for drive in problem.drives),
                stops=problem.stops[inside],
                max_steps=problem.max_steps - accepted - rejected,
                max_seconds=problem.max_seconds - spent,
            )
        )
        spent += time.monotonic() - began
        accepted, rejected = accepted + found.accepted, rejected + found.rejected
        part.put(found.x, x)
        if not found.success:
            return Integration(x, False, accepted, rejected, found.message)
        start = found.x[-1]
    return Integration(x, True, accepted, rejected)


def solve_driven(problem: InitialValueProblem) -> Integration:
    """Integrate a problem with measured inputs by Tsit5, whose steps pass over none of its stops.

    Parameters
    ----------
    problem : the problem.

    At a jump of an input it starts again.
    """
    return integrate_in_parts(problem, _solve_part)


def _solve_part(problem: InitialValueProblem) -> Integration:
    motion = Motion.of("the system", problem)
    steps = take_steps(
        motion.along,
        problem.x0.tolist(),
        (float(problem.t[0]), float(problem.t[-1])),
        problem.reltol,
        problem.abstol,
        problem.max_steps,
        problem.max_seconds,
        motion.longest(),
    )
    return Integration(
        interpolate(steps, problem.t),
        not steps.message,
        len(steps.t) - 1,
        steps.rejected,
        steps.message,
    )


def follow(
    motion: Motion,
    x0: Sequence[float] | np.ndarray,
    t: np.ndarray,
    reltol: float,
    abstol: float,
    explicit_steps: int = _EXPLICIT_STEPS,
) -> tuple[np.ndarray, str]:
    """Integrate from ``x0`` at ``t[0]``; gives the states (n, k) at ``t`` and what integrated.

    Parameters
    ----------
    motion : what moves.
    x0 : (k,) start state.
    t : (n,) increasing times in seconds.
    reltol, abstol : tolerances of a step.
    explicit_steps : how many steps the explicit method has, in addition to twenty for each
        row; with 0 there is none.

    Raises EngineError, with time and state, where the solution ends: it diverges, leaves the real
    numbers, or needs too many steps of both methods.

    >>> decay = Motion("decay", ("x",), lambda x, t: [-1e6 * (x - t)], np.empty(0))
    >>> x, how = follow(decay, [1.0], np.array([0.0, 10.0]), 1e-8, 1e-10)
    >>> bool(abs(x[-1, 0] - 10) < 1e-5), how
    (True, 'Tsit5, then Radau where it is stiff')
    """
    found, x, how = np.empty((len(t), len(x0))), np.asarray(x0, dtype=float), EXPLICIT
    for part in _parts(t, motion.drives):
        own = motion.within(float(part.t[0]), float(part.t[-1]))
        # What was too stiff for the explicit method stays so.
        most = explicit_steps if how == EXPLICIT else 0
        states, how = _follow_part(own, x, part.t, reltol, abstol, most)
        part.put(states, found)
        x = states[-1]
    return found, how


def _follow_part(
    motion: Motion,
    x0: np.ndarray,
    t: np.ndarray,
    reltol: float,
    abstol: float,
    explicit_steps: int,
) -> tuple[np.ndarray, str]:
    """Integrate over a time in which no input jumps."""
    limit, span = motion.longest(), (float(t[0]), float(t[-1]))
    most = explicit_steps and explicit_steps + _STEPS_A_ROW * len(motion.rows)
    steps = take_steps(motion.along, x0.tolist(), span, reltol, abstol, most, math.inf, limit)
    found = interpolate(steps, t)
    if not steps.message:
        return found, EXPLICIT
    reached = float(steps.t[-1])
    if len(steps.t) - 1 + steps.rejected < most:
        lost = float(t[np.argmax(t > reached)])
        raise EngineError(describe_end(motion, lost, reached, steps.x[-1], steps.message))
    late = t > reached
    found[late] = _implicit(motion, steps.x[-1], reached, t[late], reltol, abstol, limit)
    return found, IMPLICIT


def describe_end(motion: Motion, lost: float, t: float, x: np.ndarray, reason: str) -> str:
    """Say in one line from when on there is no solution, and the time and state it came to.

    >>> fall = Motion("fall", ("x",), lambda x, t: [-1 / x], np.empty(0))
    >>> describe_end(fall, 0.6, 0.5, np.array([1e-9]), "")
    'fall has no solution at t = 0.6; it ends at t = 0.5, x = 1e-09; shorten the time span'
    """
    state = ", ".join(f"{s} = {v:.4g}" for s, v in zip(motion.states, x, strict=True))
    why = f": {reason}" if reason else ""
    end = f"it ends at t = {t:.6g}, {state}"
    return f"{motion.name} has no solution at t = {lost:g}{why}; {end}; shorten the time span"


def _implicit(
    motion: Motion,
    x0: np.ndarray,
    begin: float,
    t: np.ndarray,
    reltol: float,
    abstol: float,
    limit: Callable[[float], float] | None,
) -> np.ndarray:
    """Integrate by Radau from ``x0`` at ``begin``; the states (n, k) at the later times ``t``."""
    from scipy.integrate import Radau

    out, done = np.empty((len(t), len(x0))), 0
    most = _IMPLICIT_STEPS + _STEPS_A_ROW * len(motion.rows)
    reached, x, reason = begin, x0, ""
    with np.errstate(all="ignore"):
        try:
            solver = Radau(motion.array_slopes, begin, x0, float(t[-1]), rtol=reltol, atol=abstol)
            for _ in range(most):
                solver.max_step = np.inf if limit is None else limit(solver.t)
                reason = solver.step() or ""
                if solver.status == "failed":
                    break
                reached, x = solver.t, solver.y
                upto = int(np.searchsorted(t, reached, side="right"))
                out[done:upto], done = solver.dense_output()(t[done:upto]).T, upto
                if solver.status == "finished":
                    break
        # SciPy factors a matrix of slopes that are not finite.
        except ValueError:
            reason = "a slope has no value"
    if done < len(t) or not np.all(np.isfinite(out)):
        reason = reason.rstrip(".").lower() or "too many steps were needed"
        raise EngineError(describe_end(motion, float(t[min(done, len(t) - 1)]), reached, x, reason))
    return out


def rows_of(exprs: Sequence[sympy.Expr], span: tuple[float, float]) -> np.ndarray:
    """Give times that no step may pass over, so that none steps over what moves in time alone.

    They are even over the span, and denser where a part of the expressions in ``t`` alone varies:
    no part moves by more than 1 % of its whole variation between two of them.

    >>> narrow = sympy.exp(-((sympy.Symbol("t") - 5) ** 2) * 10_000)
    >>> rows = rows_of([narrow], (0.0, 10.0))
    >>> bool(np.sum(abs(rows - 5) < 0.02) > 50)
    True
    """
    time_alone = {sympy.Symbol("t")}
    parts = {
        node
        for expr in exprs
        for node in sympy.preorder_traversal(expr)
        if node.free_symbols == time_alone and not node.is_Symbol
    }
    even = np.linspace(*span, _EVEN_ROWS + 1)
    grid = np.linspace(*span, _SCANNED + 1)
    values = compile_numpy(sorted(parts, key=str), ["t"])(grid[None])
    rows = [even]
    for value in values:
        steps = np.nan_to_num(np.abs(np.diff(value)), posinf=0.0)
        gone = np.concatenate([[0.0], np.cumsum(steps)])
        if gone[-1] > 0:
            rows.append(np.interp(np.linspace(0, gone[-1], _VARYING_ROWS + 1), gone, grid))
    # Rows that all but coincide would only make tiny steps.
    found = np.unique(np.concatenate(rows))
    return found[np.concatenate([[True], np.diff(found) > (span[1] - span[0]) / _SCANNED / 4])]
