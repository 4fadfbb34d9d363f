"""Judging: whole systems fitted to the measured states, and the bits that they take there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import sympy

from dynsr.expression import complexity
from dynsr.methods.constants import free_constants
from dynsr.methods.flow import Windows, cut_windows
from dynsr.methods.matching import drives_of
from dynsr.methods.shooting import Shooting
from dynsr.methods.striding import KeptWindows, ProbedFlow
from dynsr.trajectory import Trajectory

Equations = dict[str, sympy.Expr]
Probes = Sequence[tuple[int, sympy.Expr]]

_MOST_LANES = 40
_STEPS = 8
_GAIN = 1e-4
# Misses beyond this many units count as this many: a few bad rows do not decide.
_CAP = 6.0
_FOREVER = math.inf


@dataclass(frozen=True, eq=False)
class Fit:
    """A system fitted to the states: its equations, their misses (rows, k, W) and its bits."""

    exprs: Equations
    shooting: Shooting
    constants: np.ndarray
    starts: np.ndarray
    misses: np.ndarray
    bits: float = _FOREVER

    @property
    def level(self) -> np.ndarray:
        """(k,) mean squared miss of every state, in units of its noise."""
        mean: np.ndarray = np.mean(np.minimum(self.misses**2, _CAP**2), axis=(0, 2))
        return np.maximum(mean, 1e-12)


@dataclass(frozen=True, eq=False)
class Judge:
    """Fits systems to the states and counts their bits.

    ``noise`` (k,) is the standard deviation of each state's measurement noise; ``rows`` (k,) how
    many independent rows it has, None until a first fit has shown it.
    """

    runs: Sequence[Trajectory]
    inputs: Mapping[str, sympy.Expr]
    noise: np.ndarray
    length: int
    stride: int = 1
    rows: np.ndarray | None = None
    _cache: dict[str, Fit | None] = field(default_factory=dict)

    @cached_property
    def windows(self) -> Windows:
        """The pieces of the data, as lanes."""
        driven = self.runs[0].input_names
        plain = cut_windows(
            [run.t for run in self.runs],
            [run.x for run in self.runs],
            drives_of(driven, self.runs, self.inputs),
            self.length,
            _MOST_LANES,
        )
        return KeptWindows(plain.t, plain.x, plain.drive)

    def with_rows(self, rows: np.ndarray) -> Judge:
        """Judge the same data by other independent rows."""
        judge = replace(self, rows=rows, _cache={})
        judge.__dict__["windows"] = self.windows
        return judge

    def fit(self, exprs: Equations, near: Fit | None = None) -> Fit | None:
        """Fit every constant and start; None where the system cannot be followed."""
        key = str({s: form_of(e) for s, e in exprs.items()})
        if key not in self._cache:
            self._cache[key] = self._fit(exprs, near)
        return self._cache[key]

    def _fit(self, exprs: Equations, near: Fit | None) -> Fit | None:
        shooting, constants = self.shoot(exprs)
        starts = shooting.windows.x[0]
        if near is not None and near.starts.shape == starts.shape:
            starts = near.starts
        with np.errstate(all="ignore"):
            if not np.all(np.isfinite(shooting.misses(constants, starts))):
                return None
            constants, starts = shooting.minimise(
                constants, starts, "linear", _FOREVER, _STEPS, _GAIN
            )
            misses = shooting.misses(constants, starts)
        put = dict(zip(shooting.flow.constants, map(sympy.Float, constants), strict=True))
        fitted = {s: e.xreplace(put) for s, e in shooting.flow.rhs.items()}
        fit = Fit(fitted, shooting, constants, starts, misses)
        return replace(fit, bits=self.bits(fit))

    def shoot(self, exprs: Equations, probes: Probes = ()) -> tuple[Shooting, np.ndarray]:
        """Give the boundary value problem of a system with ``probes``, and its constants."""
        rhs: Equations = {}
        values: dict[sympy.Symbol, float] = {}
        for state, expr in exprs.items():
            rhs[state], found = free_constants(expr, f"constant {state} ")
            values.update(found)
        numbered = [sympy.Symbol(f"probe {i}") for i in range(len(probes))]
        flow = ProbedFlow(
            rhs, self.runs[0].input_names, (*values, *numbered), self.stride, tuple(probes)
        )
        constants = np.array([*values.values(), *[0.0] * len(probes)])
        return Shooting(flow, self.windows, self.noise, True), constants

    def rows_of(self, fit: Fit) -> np.ndarray:
        """(k,) independent rows that count."""
        return self.rows if self.rows is not None else independent_rows(fit.misses)

    def price_of(self, fit: Fit) -> float:
        """Bits of one constant."""
        return math.log2(max(float(np.max(self.rows_of(fit))), 2.0)) / 2

    def bits(self, fit: Fit) -> float:
        """Bits of misses, terms and constants."""
        data = float(np.sum(self.rows_of(fit) / 2 * np.log2(fit.level)))
        terms = sum(map(term_bits, fit.exprs.values()))
        return data + terms + self.price_of(fit) * len(fit.constants)


def independent_rows(misses: np.ndarray) -> np.ndarray:
    """(k,) independent rows among misses (rows, k, W): two a run of one sign, as in white noise."""
    runs = misses.shape[2] + np.count_nonzero(np.diff(np.signbit(misses), axis=0), axis=(0, 2))
    return np.minimum(2.0 * runs, misses.shape[0] * misses.shape[2])


def term_bits(expr: sympy.Expr) -> float:
    """Bits of a formula without its constants.

    >>> x = sympy.Symbol("x")
    >>> term_bits(2.5 * x) == term_bits(-0.1 * x)
    True
    """
    template, values = free_constants(expr, "constant ")
    one = sympy.Symbol("constant")
    distinct = {s: one * sympy.Integer(1) for s in values}
    # Equal placeholders would merge like terms; a term count does not.
    return complexity(template.xreplace(distinct))


def form_of(expr: sympy.Expr) -> str:
    """Text of a formula that is the same whatever its constants are."""
    return str(free_constants(expr, "c")[0])
