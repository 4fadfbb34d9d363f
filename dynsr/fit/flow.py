"""Flow: integrate a system with free constants over many windows of data at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from dynsr.expression import compile_numpy


def runge_kutta_step(
    slope: Callable[[Any, Any], Any], state: Any, h: Any, at: tuple[Any, Any, Any], k1: Any = None
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


@dataclass(frozen=True, eq=False)
class Windows:
    """Pieces of trajectories, all of m intervals, as lanes.

    ``t`` (m + 1, W) times; ``x`` (m + 1, k, W) states measured there; ``drive`` gives the driven
    columns, (d, W), at times (W,). They are read once for all flows over the windows.
    """

    t: np.ndarray
    x: np.ndarray
    drive: Callable[[np.ndarray], np.ndarray]
    _driven: dict[int, np.ndarray] = field(default_factory=dict, repr=False)

    def driven_at(self, substeps: int) -> np.ndarray:
        """Driven columns (m * 2 substeps + 1, d, W) at every node and midpoint of the steps."""
        if substeps not in self._driven:
            parts = np.arange(2 * substeps) / (2 * substeps)
            steps = np.diff(self.t, axis=0)
            nodes = (self.t[:-1, None, :] + parts[None, :, None] * steps[:, None, :]).reshape(
                -1, self.t.shape[1]
            )
            self._driven[substeps] = np.stack([self.drive(row) for row in (*nodes, self.t[-1])])
        return self._driven[substeps]


@dataclass(frozen=True, eq=False)
class Flow:
    """The system dx/dt = f(x, driven, t, constants), ready to integrate.

    Parameters
    ----------
    rhs : state -> expression in the k states, the driven columns, ``t`` and the constants.
    driven : names of the driven columns.
    constants : the P symbols whose values are given when the flow is run; those of the probes last.
    stride : rows a step where one substep is asked for; rows between are read off the cubic through
        two states with their slopes. Only for times that are even.
    probes : (place of a state, term) of terms that the flow does not have but whose sensitivities
        are wanted; each has a constant, which is 0.

    >>> flow = Flow({"x": -sympy.Symbol("x")}, (), (), stride=5)
    >>> t = np.linspace(0, 1, 101)[:, None]
    >>> windows = Windows(t, t[:, None], lambda times: times[None])
    >>> found = flow.run(windows, np.ones((1, 1)), np.empty(0), 1)
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

    @cached_property
    def _slope(self) -> Callable[[np.ndarray], np.ndarray]:
        return compile_numpy(list(self.rhs.values()), self.names)

    @cached_property
    def _partial(self) -> tuple[list[tuple[int, int]], Callable[[np.ndarray], np.ndarray]]:
        """Non-zero entries (i, j) of the Jacobian to states, then constants; and their values."""
        if self.probes:
            return self._partial_of_probes()
        real = {sympy.Symbol(n): sympy.Symbol(n, real=True) for n in self.names}
        back = {v: k for k, v in real.items()}
        columns = [sympy.Symbol(n, real=True) for n in (*self.rhs, *map(str, self.constants))]
        entries, found = [], []
        for i, expr in enumerate(self.rhs.values()):
            for j, column in enumerate(columns):
                slope = sympy.diff(expr.xreplace(real), column)
                # A jump has no slope to follow; the step itself stays in the states.
                slope = slope.replace(sympy.DiracDelta, lambda *_: sympy.S.Zero)
                if slope != 0:
                    entries.append((i, j))
                    found.append(slope.xreplace(back))
        return entries, compile_numpy([*self.rhs.values(), *found], self.names)

    def _partial_of_probes(
        self,
    ) -> tuple[list[tuple[int, int]], Callable[[np.ndarray], np.ndarray]]:
        """Entries of the flow itself, and for each probe the value of its term."""
        own = self.constants[: len(self.constants) - len(self.probes)]
        plain = replace(self, constants=own, probes=())
        entries, evaluate = plain._partial  # noqa: SLF001 (another flow)
        first = len(self.rhs) + len(own)
        used = len(plain.names)
        terms = compile_numpy([term for _, term in self.probes], plain.names)
        entries = [*entries, *((row, first + i) for i, (row, _) in enumerate(self.probes))]

        def together(values: np.ndarray) -> np.ndarray:
            mine = values[:used]
            return np.concatenate([evaluate(mine), terms(mine)])

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
        k, steps, worst = len(self.rhs), np.diff(windows.t, axis=0), 0.0
        fixed = np.broadcast_to(constants[:, None], (len(constants), windows.t.shape[1]))
        for row in np.unique(np.linspace(0, len(steps) - 1, rows).round().astype(int)):
            at = np.concatenate([windows.x[row], windows.drive(windows.t[row]), fixed])
            jacobian = np.zeros((windows.t.shape[1], k, k))
            for (i, j), value in zip(entries, evaluate(at)[k:], strict=True):
                if j < k:
                    jacobian[:, i, j] = value
            finite = np.isfinite(jacobian).all(axis=(1, 2))
            sizes = np.abs(np.linalg.eigvals(jacobian[finite])).max(axis=1, initial=0.0)
            worst = max(worst, float(np.max(sizes * steps[row, finite], initial=0.0)))
        return worst

    def run(
        self, windows: Windows, start: np.ndarray, constants: np.ndarray, substeps: int
    ) -> np.ndarray:
        """Integrate from ``start`` (k, W); gives states (m + 1, k, W). Divergence gives NaN."""
        stages = self._stages(windows, constants, substeps)
        return np.stack(list(self._march(windows, start, substeps, self._slope_only, stages)))

    def run_sensitive(
        self, windows: Windows, start: np.ndarray, constants: np.ndarray, substeps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Integrate with sensitivities (m + 1, k, P + k, W) to the constants, then the start."""
        k, lanes = start.shape
        count = len(constants)
        sensitivity = np.zeros((k, count + k, lanes))
        sensitivity[np.arange(k), count + np.arange(k)] = 1.0
        joint = np.concatenate([start[:, None, :], sensitivity], axis=1)
        stages = self._stages(windows, constants, substeps)
        found = np.stack(list(self._march(windows, joint, substeps, self._slope_joint, stages)))
        return found[:, :, 0, :], found[:, :, 1:, :]

    def _stages(self, windows: Windows, constants: np.ndarray, substeps: int) -> np.ndarray:
        """Arguments after the states (d + 1 + P, W) at every node and midpoint."""
        driven = windows.driven_at(substeps)
        lanes = windows.t.shape[1]
        fixed = np.broadcast_to(constants[None, :, None], (len(driven), len(constants), lanes))
        return np.concatenate([driven, fixed], axis=1)

    def _march(
        self,
        windows: Windows,
        state: np.ndarray,
        substeps: int,
        slope: Callable[[np.ndarray, np.ndarray], np.ndarray],
        stages: np.ndarray,
    ) -> Iterator[np.ndarray]:
        yield state
        if self.stride > 1 and substeps == 1:
            yield from self._stride(windows, state, slope, stages)
            return
        node = 0
        with np.errstate(all="ignore"):
            for interval in np.diff(windows.t, axis=0):
                h = interval / substeps
                for _ in range(substeps):
                    state = runge_kutta_step(slope, state, h, tuple(stages[node : node + 3]))
                    node += 2
                yield state

    def _stride(
        self,
        windows: Windows,
        state: np.ndarray,
        slope: Callable[[np.ndarray, np.ndarray], np.ndarray],
        stages: np.ndarray,
    ) -> Iterator[np.ndarray]:
        last, row = len(windows.t) - 1, 0
        with np.errstate(all="ignore"):
            k1 = slope(state, stages[0])
            while row < last:
                rows = min(self.stride, last - row)
                h = windows.t[row + rows] - windows.t[row]
                at = stages[2 * row], stages[2 * row + rows], stages[2 * (row + rows)]
                after = runge_kutta_step(slope, state, h, at, k1)
                slope_after = slope(after, at[2])
                yield from _between(rows, state, after, h * k1, h * slope_after)
                yield after
                state, k1, row = after, slope_after, row + rows

    def _slope_only(self, x: np.ndarray, rest: np.ndarray) -> np.ndarray:
        return self._slope(np.concatenate([x, rest]))

    def _slope_joint(self, joint: np.ndarray, rest: np.ndarray) -> np.ndarray:
        entries, evaluate = self._partial
        x, sensitivity = joint[:, 0, :], joint[:, 1:, :]
        values = evaluate(np.concatenate([x, rest]))
        k = len(x)
        out = np.zeros_like(joint)
        out[:, 0, :] = values[:k]
        for (i, j), value in zip(entries, values[k:], strict=True):
            if j < k:
                out[i, 1:, :] += value * sensitivity[j]
            else:
                out[i, 1 + j - k, :] += value
        return out


def cut_windows(
    t: Sequence[np.ndarray],
    x: Sequence[np.ndarray],
    drive: Sequence[Callable[[np.ndarray], np.ndarray]],
    length: int,
    most: int,
) -> Windows:
    """Cut trajectories into windows of ``length`` intervals, evenly thinned to ``most`` lanes.

    The last window of a trajectory overlaps its neighbour when the rows do not divide evenly.
    ``drive[i]`` gives the driven columns (d + 1, n), the time last, of trajectory i at n times.
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

    def driven(times: np.ndarray) -> np.ndarray:
        parts = [drive[run](times[owner == run]) for run in range(len(t))]
        out = np.empty((len(parts[0]), len(times)))
        for run, part in enumerate(parts):
            out[:, owner == run] = part
        return out

    return Windows(
        np.stack([t[run][start + rows] for run, start in lanes], axis=1),
        np.stack([x[run][start + rows].T for run, start in lanes], axis=2).transpose(1, 0, 2),
        driven,
    )


def _between(
    rows: int, before: np.ndarray, after: np.ndarray, rise: np.ndarray, rise_after: np.ndarray
) -> np.ndarray:
    """Read the inner rows off the cubic through two values with two slopes (by the whole step)."""
    s = (np.arange(1, rows) / rows).reshape(-1, *[1] * before.ndim)
    value = before + s**2 * (3 - 2 * s) * (after - before)
    found: np.ndarray = value + s * (1 - s) ** 2 * rise - s**2 * (1 - s) * rise_after
    return found
