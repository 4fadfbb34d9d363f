"""Striding: a flow that is integrated over several rows at a time and read off between them.

Noisy data are sampled far more densely than their equations need. One Runge-Kutta step over a
stride of rows and the cubic Hermite polynomial through its ends give the rows inside; states and
sensitivities alike. Long windows then cost what short ones did.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import sympy

from dynsr.expression import compile_numpy
from dynsr.methods.flow import Flow, Windows


@dataclass(frozen=True, eq=False)
class StridingFlow(Flow):
    """A flow that takes ``stride`` rows a step, for times that are even.

    >>> import sympy
    >>> flow = StridingFlow({"x": -sympy.Symbol("x")}, (), (), 5)
    >>> t = np.linspace(0, 1, 101)[:, None]
    >>> windows = Windows(t, t[:, None], lambda times: times[None])
    >>> found = flow.run(windows, np.ones((1, 1)), np.empty(0), 1)
    >>> bool(np.allclose(found[:, 0], np.exp(-t), atol=1e-6))
    True
    """

    stride: int = 1

    def _march(
        self,
        windows: Windows,
        state: np.ndarray,
        substeps: int,
        slope: Callable[[np.ndarray, np.ndarray], np.ndarray],
        stages: np.ndarray,
    ) -> Iterator[np.ndarray]:
        if self.stride == 1 or substeps != 1:
            yield from super()._march(windows, state, substeps, slope, stages)
            return
        yield state
        last, row = len(windows.t) - 1, 0
        with np.errstate(all="ignore"):
            k1 = slope(state, stages[0])
            while row < last:
                rows = min(self.stride, last - row)
                h = windows.t[row + rows] - windows.t[row]
                middle, end = stages[2 * row + rows], stages[2 * (row + rows)]
                k2 = slope(state + h / 2 * k1, middle)
                k3 = slope(state + h / 2 * k2, middle)
                k4 = slope(state + h * k3, end)
                after = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                slope_after = slope(after, end)
                yield from _between(rows, state, after, h * k1, h * slope_after)
                yield after
                state, k1, row = after, slope_after, row + rows


@dataclass(frozen=True, eq=False)
class ProbedFlow(StridingFlow):
    """A flow with sensitivities to terms that it does not have.

    ``probes`` are (place of the state, term); each has a constant, after the flow's own, which is
    0: the states are those of the flow, and their slope by that constant comes from the term.
    """

    probes: tuple[tuple[int, sympy.Expr], ...] = ()

    @cached_property
    def _partial(self) -> tuple[list[tuple[int, int]], Callable[[np.ndarray], np.ndarray]]:
        own = self.constants[: len(self.constants) - len(self.probes)]
        plain = StridingFlow(self.rhs, self.driven, own, self.stride)
        entries, evaluate = plain._partial
        first = len(self.rhs) + len(own)
        used = len(plain.names)
        terms = compile_numpy([term for _, term in self.probes], plain.names)
        entries = [*entries, *((row, first + i) for i, (row, _) in enumerate(self.probes))]

        def together(values: np.ndarray) -> np.ndarray:
            mine = values[:used]
            return np.concatenate([evaluate(mine), terms(mine)])

        return entries, together


def _between(
    rows: int, before: np.ndarray, after: np.ndarray, rise: np.ndarray, rise_after: np.ndarray
) -> np.ndarray:
    """Read the inner rows off the cubic through two values with two slopes (by the whole step)."""
    s = (np.arange(1, rows) / rows).reshape(-1, *[1] * before.ndim)
    value = before + s**2 * (3 - 2 * s) * (after - before)
    found: np.ndarray = value + s * (1 - s) ** 2 * rise - s**2 * (1 - s) * rise_after
    return found


@dataclass(frozen=True, eq=False)
class KeptWindows(Windows):
    """Windows whose driven columns are read once for all flows over them."""

    _kept: dict[int, np.ndarray] = field(default_factory=dict)

    def driven_at(self, substeps: int) -> np.ndarray:
        """Driven columns at every node and midpoint of the steps."""
        if substeps not in self._kept:
            self._kept[substeps] = super().driven_at(substeps)
        return self._kept[substeps]
