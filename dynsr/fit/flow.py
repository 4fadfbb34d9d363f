"""Flow: integrate a system with free constants over many windows of data at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from scipy.integrate import DOP853

from dynsr.expression import Rows, compile_rows, compile_scalar, differentiate

# Where the twelve stages of a step of order 8 are, as shares of it; the last one is its end.
_NODES = DOP853.C[: len(DOP853.B)]
# Lanes that are differentiated at once: as many as stay in a cache.
_LANES = 2048


def runge_kutta_step(
    slope: Callable[[Any, Any], Any], state: Any, h: Any, at: Sequence[Any], k1: Any = None
) -> Any:
    """Take one step of the classical Runge-Kutta method of order 4 (Kutta 1901).

    Parameters
    ----------
    slope : (state, at) -> slope; arrays of any kind and shape.
    state : where the step starts.
    h : its length.
    at : what the slope needs at the start, the middle and the end: times, or driven columns.
    k1 : the slope at the start, where it is known.

    >>> decay = lambda x, t: -x
    >>> round(runge_kutta_step(decay, 1.0, 0.1, (0.0, 0.05, 0.1)), 6)
    0.904837
    """
    start, middle, end = at
    k1 = slope(state, start) if k1 is None else k1
    k2 = slope(state + h / 2 * k1, middle)
    k3 = slope(state + h / 2 * k2, middle)
    k4 = slope(state + h * k3, end)
    return state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def eighth_order_step(
    slope: Callable[[Any, Any], Any], state: Any, h: Any, at: Sequence[Any], k1: Any = None
) -> Any:
    """Take one step of the method of order 8 of Dormand and Prince (Hairer and others 1993, II.5).

    Parameters
    ----------
    slope, state, h, k1 : as :func:`runge_kutta_step` takes them; states and slopes are arrays.
    at : what the slope needs at each of the twelve stages.

    >>> decay = lambda x, t: -x
    >>> found = eighth_order_step(decay, np.ones(1), 0.25, [None] * 12)
    >>> bool(abs(found[0] - np.exp(-0.25)) < 1e-12)
    True
    """
    slopes = np.empty((len(_NODES), *state.shape))
    flat = slopes.reshape(len(_NODES), -1)
    slopes[0] = slope(state, at[0]) if k1 is None else k1
    for i in range(1, len(_NODES)):
        rise = (DOP853.A[i, :i] @ flat[:i]).reshape(state.shape)
        slopes[i] = slope(state + h * rise, at[i])
    return state + h * (DOP853.B @ flat).reshape(state.shape)


@dataclass(frozen=True)
class Pace:
    """How an interval is crossed: in ``substeps`` of a method of order 4, or of one of order 8."""

    substeps: int = 1
    eighth: bool = False

    @property
    def nodes(self) -> np.ndarray:
        """Where in an interval slopes are needed, its end left out, as shares of it."""
        inner = _NODES[:-1] if self.eighth else np.array([0.0, 0.5])
        return ((np.arange(self.substeps)[:, None] + inner) / self.substeps).ravel()

    @property
    def step(self) -> Callable[..., Any]:
        """The function that takes one step."""
        return eighth_order_step if self.eighth else runge_kutta_step


PLAIN = Pace()


@dataclass(frozen=True, eq=False)
class Windows:
    """Pieces of trajectories, all of m intervals, as lanes.

    ``t`` (m + 1, W) times; ``x`` (m + 1, k, W) states measured there; ``drive`` gives the driven
    columns, (d, n, W), at times (n, W). They are read once for all flows over the windows. Where a
    column ``jumps`` at rows, ``drive(times, True)`` gives what it is before: no step sees a jump.
    """

    t: np.ndarray
    x: np.ndarray
    drive: Callable[..., np.ndarray]
    jumps: bool = False
    _driven: dict[Pace, np.ndarray] = field(default_factory=dict, repr=False)

    def driven_at(self, pace: Pace = PLAIN) -> np.ndarray:
        """Driven columns (m * nodes + 1, d, W) at every node of the steps and at their end.

        Where a column jumps, m others follow: what they are at the end of every interval.
        """
        if pace not in self._driven:
            steps = np.diff(self.t, axis=0)
            nodes = (self.t[:-1, None] + pace.nodes[None, :, None] * steps[:, None]).reshape(
                -1, self.t.shape[1]
            )
            times = np.concatenate([nodes, self.t[-1:]])
            found = self.drive(times)
            if self.jumps:
                found = np.concatenate([found, self.drive(self.t[1:], True)], axis=1)
            self._driven[pace] = np.ascontiguousarray(found.transpose(1, 0, 2))
        return self._driven[pace]

    @property
    def driven_rows(self) -> np.ndarray:
        """Driven columns (m + 1, d, W) at the rows; where one jumps, what it is after that."""
        every = len(PLAIN.nodes)
        return self.driven_at()[: every * len(self.t) : every]

    def stages(self, pace: Pace = PLAIN, driven: bool = True) -> np.ndarray:
        """Places (n, stages), among :meth:`driven_at`, of what each of n steps needs.

        Where nothing is ``driven`` the end of an interval is the begin of the next.
        """
        count = len(self.t) - 1
        inner = len(pace.nodes) // pace.substeps
        found = inner * np.arange(count * pace.substeps)[:, None] + np.arange(inner + 1)
        if self.jumps and driven:
            found[pace.substeps - 1 :: pace.substeps, -1] = (
                count * len(pace.nodes) + 1 + np.arange(count)
            )
        return found


@dataclass(frozen=True, eq=False)
class Track:
    """States ``nodes`` (n + 1, k, W) between the n steps of a march, ``rows`` (m + 1, k, W)."""

    nodes: np.ndarray
    rows: np.ndarray


@dataclass(frozen=True, eq=False)
class Flow:
    """The system dx/dt = f(x, driven, t, constants), ready to integrate.

    Parameters
    ----------
    rhs : state -> expression in the k states, the driven columns, ``t`` and the constants.
    driven : names of the driven columns.
    constants : the P symbols whose values are given when the flow is run; those of the probes last.
    stride : rows a step where one substep of order 4 is asked for; rows between are read from the
        cubic through two states with their slopes. Only for times that are even.
    probes : (place of a state, term) of terms that the flow does not have but whose sensitivities
        are wanted; each has a constant, which is 0.

    >>> flow = Flow({"x": -sympy.Symbol("x")}, (), (), stride=5)
    >>> t = np.linspace(0, 1, 101)[:, None]
    >>> windows = Windows(t, t[:, None], lambda times: times[None])
    >>> found = flow.run(windows, np.ones((1, 1)), np.empty(0))
    >>> bool(np.allclose(found[:, 0], np.exp(-t), atol=1e-6))
    True
    """

    rhs: Mapping[str, sympy.Expr]
    driven: tuple[str, ...]
    constants: tuple[sympy.Symbol, ...]
    stride: int = 1
    probes: tuple[tuple[int, sympy.Expr], ...] = ()

    @property
    def names(self) -> list[str]:
        """Arguments of the compiled right-hand sides, in order."""
        return [*self.rhs, *self.driven, "t", *(str(c) for c in self.constants)]

    def closed(self, values: Iterable[float]) -> Flow:
        """Give the flow with its constants' values in their places."""
        put = dict(zip(self.constants, map(sympy.Float, values), strict=True))
        return Flow({s: e.xreplace(put) for s, e in self.rhs.items()}, self.driven, ())

    @cached_property
    def _slope(self) -> Rows:
        return compile_rows(list(self.rhs.values()), self.names)

    @cached_property
    def _scalar(self) -> Callable[..., list[float]]:
        return compile_scalar(list(self.rhs.values()), self.names)

    @cached_property
    def _partial(self) -> tuple[list[tuple[int, int]], Rows]:
        """Non-zero entries (i, j) of the Jacobian to states, then constants; and their values."""
        if self.probes:
            return self._partial_of_probes()
        columns = [sympy.Symbol(n) for n in (*self.rhs, *map(str, self.constants))]
        entries, found = [], []
        for i, expr in enumerate(self.rhs.values()):
            own = expr.free_symbols
            for j, column in enumerate(columns):
                # The step itself of what jumps stays in the states.
                slope = differentiate(expr, column) if column in own else sympy.S.Zero
                if slope != 0:
                    entries.append((i, j))
                    found.append(slope)
        return entries, compile_rows([*self.rhs.values(), *found], self.names)

    def _partial_of_probes(self) -> tuple[list[tuple[int, int]], Rows]:
        """Entries of the flow itself, and for each probe the value of its term."""
        own = self.constants[: len(self.constants) - len(self.probes)]
        plain = replace(self, constants=own, probes=())
        entries, evaluate = plain._partial  # noqa: SLF001 (another flow)
        first = len(self.rhs) + len(own)
        used, split = len(plain.names), len(self.rhs) + len(entries)
        terms = compile_rows([term for _, term in self.probes], plain.names)
        entries = [*entries, *((row, first + i) for i, (row, _) in enumerate(self.probes))]

        def together(columns: Iterable[Any], out: np.ndarray) -> None:
            mine = tuple(columns)[:used]
            evaluate(mine, out[:split])
            terms(mine, out[split:])

        return entries, together

    def stiffness(self, windows: Windows, constants: np.ndarray, rows: int = 20) -> float:
        """Largest |eigenvalue| of the Jacobian times the interval, at measured states.

        Parameters
        ----------
        windows : where the states were measured.
        constants : (P,) values.
        rows : evenly spaced rows of every window that are looked at.

        An explicit step over an interval for which it is above 2.5 is unstable. 0 where no
        Jacobian is finite.
        """
        entries, evaluate = self._partial
        k, steps = len(self.rhs), np.diff(windows.t, axis=0)
        at = np.unique(np.linspace(0, len(steps) - 1, rows).round().astype(int))
        driven = windows.drive(windows.t[at]).reshape(len(self.driven) + 1, -1)
        values = np.empty((k + len(entries), driven.shape[1]))
        with np.errstate(all="ignore"):
            evaluate((*_flat(windows.x[at]), *driven, *constants), values)
        jacobian = np.zeros((driven.shape[1], k, k))
        for (i, j), value in zip(entries, values[k:], strict=True):
            if j < k:
                jacobian[:, i, j] = value
        finite = np.isfinite(jacobian).all(axis=(1, 2))
        sizes = np.abs(np.linalg.eigvals(jacobian[finite])).max(axis=1, initial=0.0)
        return float(np.max(sizes * steps[at].ravel()[finite], initial=0.0))

    def run(
        self,
        windows: Windows,
        start: np.ndarray,
        constants: np.ndarray,
        pace: Pace = PLAIN,
    ) -> np.ndarray:
        """Integrate from ``start`` (k, W); gives states (m + 1, k, W). Divergence gives NaN."""
        return self.track(windows, start, constants, pace).rows

    def track(
        self,
        windows: Windows,
        start: np.ndarray,
        constants: np.ndarray,
        pace: Pace = PLAIN,
    ) -> Track:
        """Integrate as :meth:`run` does, and keep where every step begins."""
        h, places = self._steps(windows, pace)
        at = self._columns(windows, constants, pace)
        nodes, slopes = (np.empty((len(h) + 1, *start.shape)) for _ in range(2))
        nodes[0] = start
        slope, states, rates = self._slope_only, nodes, slopes
        if start.shape[1] == 1:
            slope, states, rates = self._slope_alone, nodes[..., 0], slopes[..., 0]
        with np.errstate(all="ignore"):
            for n, stages in enumerate(places.tolist()):
                inner = [at[place] for place in stages]
                rates[n] = k1 = slope(states[n], inner[0])
                states[n + 1] = pace.step(slope, states[n], h[n], inner, k1)
            if not self._strides(pace):
                return Track(nodes, nodes[:: pace.substeps])
            rates[-1] = slope(states[-1], at[-1])
            found = np.empty((len(windows.t), *start.shape))
            found[0] = start
            for some, rows in self._groups(windows, pace, len(h)):
                rises = (h[some, None] * each[some] for each in (slopes[:-1], slopes[1:]))
                inner_rows = _between(rows, nodes[:-1][some], nodes[1:][some], *rises)
                pieces = np.concatenate([inner_rows, nodes[None, 1:][:, some]]).swapaxes(0, 1)
                first = 1 + some.start * self.stride
                found[first : first + rows * len(pieces)] = pieces.reshape(-1, *start.shape)
        return Track(nodes, found)

    def run_sensitive(
        self,
        windows: Windows,
        start: np.ndarray,
        constants: np.ndarray,
        pace: Pace = PLAIN,
        track: Track | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Integrate with sensitivities (m + 1, k, P + k, W) to the constants, then the start.

        ``track`` is what :meth:`track` gave for the same arguments. What a step makes of the
        sensitivities is linear in them and depends on nothing but the state where it begins, so
        that many steps are differentiated at once, and then joined.
        """
        track = track or self.track(windows, start, constants, pace)
        (k, lanes), count = start.shape, len(constants)
        found = np.zeros((len(windows.t), k, count + k, lanes))
        found[0, np.arange(k), count + np.arange(k)] = 1.0
        now, row, step = found[0], 0, 0
        with np.errstate(all="ignore"):
            for some, rows in self._groups(windows, pace, max(1, _LANES // lanes)):
                for pieces in self._differentiate(windows, track, constants, pace, some, rows):
                    joined = np.einsum("rijw,jpw->ripw", pieces[..., count:, :], now)
                    joined[:, :, :count] += pieces[..., :count, :]
                    now, step = joined[-1], step + 1
                    if self._strides(pace):
                        found[row + 1 : row + 1 + rows] = joined
                        row += rows
                    elif step % pace.substeps == 0:
                        row += 1
                        found[row] = now
        return track.rows, found

    def _differentiate(
        self,
        windows: Windows,
        track: Track,
        constants: np.ndarray,
        pace: Pace,
        some: slice,
        rows: int,
    ) -> np.ndarray:
        """Sensitivities (n, rows, k, P + k, W) along each of n steps to constants and its begin."""
        h, places = self._steps(windows, pace)
        states, h = track.nodes[:-1][some], h[some]
        (steps, k, lanes), count = states.shape, len(constants)
        joint = np.zeros((k, 1 + count + k, steps * lanes))
        joint[:, 0] = _flat(states)
        joint[np.arange(k), 1 + count + np.arange(k)] = 1.0
        stages = [
            (*self._driven_lanes(windows, pace, place), *constants) for place in places[some].T
        ]
        lengths, first = h.ravel(), self._slope_joint(joint, stages[0])
        after = pace.step(self._slope_joint, joint, lengths, stages, first)
        pieces = after[None]
        if self._strides(pace):
            rise_after = lengths * self._slope_joint(after, stages[-1])
            inner = _between(rows, joint, after, lengths * first, rise_after)
            pieces = np.concatenate([inner, pieces])
        return pieces[:, :, 1:].reshape(rows, k, count + k, steps, lanes).transpose(3, 0, 1, 2, 4)

    def _strides(self, pace: Pace) -> bool:
        return self.stride > 1 and pace == PLAIN

    def _steps(self, windows: Windows, pace: Pace) -> tuple[np.ndarray, np.ndarray]:
        """Lengths (n, W) of the steps, and places (n, stages) of what their stages need."""
        if self._strides(pace):
            last = len(windows.t) - 1
            begin = np.arange(0, last, self.stride)
            end = np.append(begin[1:], last)
            return windows.t[end] - windows.t[begin], np.stack([2 * begin, begin + end, 2 * end], 1)
        h = np.repeat(np.diff(windows.t, axis=0) / pace.substeps, pace.substeps, axis=0)
        return h, windows.stages(pace, self._is_driven)

    def _groups(self, windows: Windows, pace: Pace, most: int) -> Iterator[tuple[slice, int]]:
        """Steps, ``most`` at a time, that go over as many rows, 1 where they go over a part."""
        last = len(windows.t) - 1
        if not self._strides(pace):
            yield from ((slice(n, n + most), 1) for n in range(0, last * pace.substeps, most))
            return
        full = last // self.stride
        yield from ((slice(n, min(n + most, full)), self.stride) for n in range(0, full, most))
        if last % self.stride:
            yield slice(full, full + 1), last % self.stride

    @cached_property
    def _is_driven(self) -> bool:
        exprs = [*self.rhs.values(), *(term for _, term in self.probes)]
        used = {str(symbol) for expr in exprs for symbol in expr.free_symbols}
        return not used.isdisjoint((*self.driven, "t"))

    def _columns(
        self, windows: Windows, constants: np.ndarray, pace: Pace
    ) -> Sequence[tuple[Any, ...]]:
        """Arguments after the states at every node, and at the end; floats of a lane alone."""
        known = np.asarray(constants, dtype=float).tolist()
        if not self._is_driven:
            count = len(pace.nodes) * (len(windows.t) - 1) + 1
            return [(*self._unused, *known)] * count
        driven = windows.driven_at(pace)
        rows = driven[..., 0].tolist() if driven.shape[2] == 1 else driven
        return [(*row, *known) for row in rows]

    def _driven_lanes(self, windows: Windows, pace: Pace, places: np.ndarray) -> Iterable[Any]:
        """Driven columns (d, n W) at n nodes."""
        return _flat(windows.driven_at(pace)[places]) if self._is_driven else self._unused

    @property
    def _unused(self) -> list[float]:
        return [0.0] * (len(self.driven) + 1)

    def _slope_only(self, x: np.ndarray, rest: Sequence[Any]) -> np.ndarray:
        out = np.empty(x.shape)
        self._slope((*x, *rest), out)
        return out

    def _slope_alone(self, x: np.ndarray, rest: Sequence[float]) -> np.ndarray:
        """The slope (k,) of a lane alone: floats take a quarter of the time of arrays of one."""
        try:
            return np.array(self._scalar(*x.tolist(), *rest), dtype=float)
        except (ArithmeticError, ValueError, TypeError):
            # Beside its domain: NaN in what has no value there.
            return self._slope_only(x[:, None], rest)[:, 0]

    def _slope_joint(self, joint: np.ndarray, rest: Sequence[Any]) -> np.ndarray:
        entries, evaluate = self._partial
        x, sensitivity = joint[:, 0, :], joint[:, 1:, :]
        k = len(x)
        values = np.empty((k + len(entries), x.shape[1]))
        evaluate((*x, *rest), values)
        out = np.zeros_like(joint)
        out[:, 0, :] = values[:k]
        for (i, j), value in zip(entries, values[k:], strict=True):
            if j < k:
                out[i, 1:, :] += value * sensitivity[j]
            else:
                out[i, 1 + j - k, :] += value
        return out


def _flat(values: np.ndarray) -> np.ndarray:
    """(n, c, W) -> (c, n W): the lanes of n places side by side."""
    return values.transpose(1, 0, 2).reshape(values.shape[1], -1)


def cut_windows(
    t: Sequence[np.ndarray],
    x: Sequence[np.ndarray],
    drive: Sequence[Callable[..., np.ndarray]],
    length: int,
    most: int,
) -> Windows:
    """Cut trajectories into windows of ``length`` intervals, evenly thinned to ``most`` lanes.

    The last window of a trajectory overlaps its neighbour when the rows do not divide evenly.
    ``drive[i]`` gives the driven columns (d + 1, n), the time last, of trajectory i at n times;
    where it has ``jumps``, they are times of rows.
    """
    length = min(length, min(len(part) for part in t) - 1)
    lanes: list[tuple[int, int]] = []
    for run, part in enumerate(t):
        last = len(part) - 1 - length
        lanes += [(run, start) for start in {*range(0, last + 1, length), last}]
    lanes.sort()
    if len(lanes) > most:
        lanes = [lanes[i] for i in np.linspace(0, len(lanes) - 1, most).round().astype(int)]
    rows = np.arange(length + 1)
    owner = np.array([run for run, _ in lanes])

    def driven(times: np.ndarray, before: bool = False) -> np.ndarray:
        ends = (True,) if before else ()
        parts = [drive[run](times[:, owner == run].ravel(), *ends) for run in range(len(t))]
        out = np.empty((len(parts[0]), *times.shape))
        for run, part in enumerate(parts):
            out[:, :, owner == run] = part.reshape(len(out), len(times), -1)
        return out

    return Windows(
        np.stack([t[run][start + rows] for run, start in lanes], axis=1),
        np.stack([x[run][start + rows].T for run, start in lanes], axis=2).transpose(1, 0, 2),
        driven,
        any(len(getattr(one, "jumps", ())) for one in drive),
    )


def _between(
    rows: int, before: np.ndarray, after: np.ndarray, rise: np.ndarray, rise_after: np.ndarray
) -> np.ndarray:
    """Read the inner rows off the cubic through two values with two slopes (by the whole step)."""
    s = (np.arange(1, rows) / rows).reshape(-1, *[1] * before.ndim)
    value = before + s**2 * (3 - 2 * s) * (after - before)
    found: np.ndarray = value + s * (1 - s) ** 2 * rise - s**2 * (1 - s) * rise_after
    return found
