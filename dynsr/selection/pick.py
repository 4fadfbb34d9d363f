"""Selection: from all that was found for one state to one equation, with the reasons in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy

from dynsr.data import Samples, Trajectory
from dynsr.expression import evaluate, parse, shown, to_text
from dynsr.fit import (
    Candidate,
    Noise,
    build_shooting,
    choose_substeps,
    description_length,
    improve,
    noise_of,
    one_a_shape,
    prepare,
    score_candidate,
    score_snapped,
    tidy,
)


def forecast_misses(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
    window: int = 50,
) -> np.ndarray:
    """Give the sizes of the misses of W forecasts over ``window`` intervals, (window, k, W).

    Each starts at its first measurement; states without an expression are read from the data.
    In units of the spread; inf where a forecast diverges.

    >>> t = np.linspace(0, 1, 51)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None], ("x",))
    >>> forecast_misses({"x": -2 * sympy.Symbol("x")}, decay).shape
    (50, 1, 1)
    """
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    flow, values, _ = prepare(exprs, runs, inputs or {})
    shooting = build_shooting(flow, runs, inputs or {}, window, False)
    with np.errstate(all="ignore"):
        starts, constants = shooting.windows.x[0], np.array(values)
        substeps = choose_substeps(shooting, constants, starts)
        misses = np.abs(replace(shooting, substeps=substeps).misses(constants, starts))
    return np.nan_to_num(misses, nan=np.inf, posinf=np.inf)


def forecast_miss(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
) -> float:
    """Give the median of :func:`forecast_misses`; inf when most forecasts diverge."""
    return float(np.median(forecast_misses(exprs, trajectories, inputs=inputs)))


_MOST_SNAPPED = 6
_MOST_IMPROVED = 3
_MOST_COMPARED = 5
# The median of n sizes of Gaussian errors has a relative standard error of
# 1 / (2 q phi(q) 2 sqrt(n)), q = 0.6745 their quartile; that of two such medians' ratio is sqrt(2)
# times that, and medians within twice that are taken for equal: then fewer bits decide.
_MEDIAN_ERROR = 1.166
# Share of the spread below which no misses are told apart.
_FINEST = 1e-7


@dataclass(frozen=True)
class Rival:
    """A formula in the last round: its bits in all and its error on held-back data.

    ``held_back`` is the median miss of short forecasts in units of the state's spread; None where
    nothing was held back.
    """

    candidate: Candidate
    bits: float
    held_back: float | None


@dataclass(frozen=True)
class Pick:
    """The equation chosen for a state, the rivals (the winner first) and why it won."""

    state: str
    rivals: tuple[Rival, ...]
    noise: Noise

    @property
    def candidate(self) -> Candidate:
        """The winner."""
        return self.rivals[0].candidate

    @property
    def explanation(self) -> str:
        """Say in words why the winner won."""
        winner, *others = self.rivals
        formula = shown(tidy(winner.candidate.expr))
        words = [
            f"{self.state}' = {formula} takes {winner.bits:.0f} bits in all, "
            f"{winner.candidate.complexity:.0f} of them for the formula; found by "
            f"{winner.candidate.source or 'search'}."
        ]
        if winner.held_back is not None:
            words.append(f"On held-back data it misses by {winner.held_back:.2g} of the spread.")
        words += [self._compare(winner, other) for other in others[:1]]
        return " ".join(words)

    def as_record(self) -> dict[str, Any]:
        """Give the choice as plain values."""
        return {
            "target": self.state,
            "noise": [self.noise.floor, self.noise.effective_rows],
            "rivals": [
                {
                    "candidate": write_candidates([r.candidate])[0],
                    "bits": r.bits,
                    "held_back": r.held_back,
                }
                for r in self.rivals
            ],
        }

    @classmethod
    def from_record(cls, state: str, record: Mapping[str, Any]) -> Pick:
        """Read a choice back."""
        rivals = tuple(
            Rival(read_candidates([r["candidate"]])[0], r["bits"], r["held_back"])
            for r in record["rivals"]
        )
        return cls(state, rivals, Noise(*record["noise"]))

    def _compare(self, winner: Rival, other: Rival) -> str:
        formula = shown(tidy(other.candidate.expr), 4)
        formula = formula if len(formula) <= 80 else formula[:77] + "..."
        if other.bits >= winner.bits:
            return f"The next best, {formula}, takes {other.bits - winner.bits:.0f} bits more."
        return (
            f"{formula} takes {winner.bits - other.bits:.0f} bits less, but misses by "
            f"{other.held_back:.2g} on held-back data."
        )


def pick_equation(
    state: str,
    pool: Iterable[Candidate],
    samples: Samples,
    held_back: Sequence[Trajectory] = (),
    known: sympy.Expr = sympy.S.Zero,
) -> Pick:
    """Choose by description length among formulas that forecast held-back data equally well.

    The constants of the shortest formulas are fitted and snapped, the best are varied, and the
    rest are compared on ``held_back`` (never on test data). ``known`` is the given part of the
    equation that ``samples.y`` leaves out. Raises ValueError when the pool is empty.
    """
    candidates = _distinct(pool)
    if not candidates:
        raise ValueError(f"nothing was found for {state}")
    noise = noise_of(candidates, samples)
    ranked = one_a_shape(_rank(candidates, samples, noise))[:_MOST_SNAPPED]
    snapped = _rank(_distinct(score_snapped(c, samples, noise) for c in ranked), samples, noise)
    varied = [improve(c, samples, noise) for c in snapped[:_MOST_IMPROVED]]
    last = _rank(_distinct([*varied, *snapped]), samples, noise)[:_MOST_COMPARED]
    misses = {
        c.expr: forecast_misses({state: known + c.expr}, held_back) for c in last if held_back
    }
    rivals = [
        Rival(
            c,
            description_length(c, samples, noise),
            float(np.median(misses[c.expr])) if held_back else None,
        )
        for c in last
    ]
    # The misses of one forecast hang together: each counts once.
    forecasts = min((m.shape[-1] for m in misses.values()), default=1)
    return Pick(state, tuple(order_rivals(rivals, forecasts)), noise)


def order_rivals(rivals: list[Rival], forecasts: int) -> list[Rival]:
    """Order by bits, behind those whose held-back error is clearly above the least."""
    misses = [r.held_back for r in rivals if r.held_back is not None and np.isfinite(r.held_back)]
    equal = 1 + 2 * math.sqrt(2 / forecasts) * _MEDIAN_ERROR
    bound = equal * min(misses) + _FINEST if misses else np.inf
    return sorted(rivals, key=lambda r: ((r.held_back or 0.0) > bound, r.bits))


def _distinct(pool: Iterable[Candidate]) -> list[Candidate]:
    return list({c.expr: c for c in pool}.values())


def _rank(pool: list[Candidate], samples: Samples, noise: Noise) -> list[Candidate]:
    bits = {c.expr: description_length(c, samples, noise) for c in pool}
    finite = [c for c in pool if np.isfinite(bits[c.expr])]
    return sorted(finite or pool, key=lambda c: (bits[c.expr], str(c.expr)))


def trivial_candidates(samples: Samples) -> list[Candidate]:
    """Give 0, the mean slope and every column as candidates: q' = v is found without a search."""
    exprs = [sympy.S.Zero, sympy.Float(float(np.mean(samples.y)))]
    exprs += [sympy.Symbol(name) for name in samples.names]
    return [score_candidate(expr, samples, "a column") for expr in exprs]


def explains_all(candidate: Candidate, samples: Samples) -> bool:
    """Say whether a formula leaves nothing: misses below a thousandth of the slopes, or the noise.

    >>> t = np.arange(9.0)
    >>> s = Samples(t[:, None], t, ("v",), "q", "given", t)
    >>> explains_all(score_candidate(sympy.Symbol("v"), s), s)
    True
    """
    misses = np.abs(samples.y - evaluate(candidate.expr, samples.columns))
    size = float(np.sqrt(np.mean(samples.y**2)))
    return bool(np.median(misses) <= 5e-4 * size)


def write_candidates(candidates: Iterable[Candidate]) -> list[dict[str, Any]]:
    """Write candidates as plain records."""
    return [
        {
            "expr": to_text(c.expr),
            "loss": c.loss,
            "complexity": c.complexity,
            "source": c.source,
        }
        for c in candidates
    ]


def read_candidates(records: Iterable[Mapping[str, Any]]) -> list[Candidate]:
    """Read candidates back, parsed without ever being evaluated as Python."""
    return [
        Candidate(parse(r["expr"]), float(r["loss"]), float(r["complexity"]), str(r["source"]))
        for r in records
    ]
