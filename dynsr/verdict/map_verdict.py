"""Verdict on maps: whether x[n+1] = f(x[n]) is a law of the data, an approximation, or not found.

Two tests decide: one step, from every measured row, and free runs of a few steps. Residuals of a
step may be chance, but may not depend on the row. Those of free runs may be what the residuals of
single steps add up to, and no more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from dynsr.data import Samples, Trajectory, near_rows_leave_open, scale_of
from dynsr.expression import (
    ByText,
    compile_numpy,
    evaluate,
)
from dynsr.fit import DEPENDENT, ParetoFront, constant_bits, structure_bits, unit_columns
from dynsr.library import textbooks
from dynsr.selection import STOCHASTIC_SEARCH
from dynsr.verdict.drift import Drift, drift_of_rows, place_among
from dynsr.verdict.drift_exact import same_in_time
from dynsr.verdict.following import Place, open_constants
from dynsr.verdict.levels import (
    APPROXIMATION,
    LAW,
    NOT_FOUND,
    VERDICT,
    OtherFormula,
    StateVerdict,
    TermCertainty,
    Verdict,
    VerdictSettings,
    doubt_terms,
    most_by_chance,
    percent,
    summarise,
)
from dynsr.verdict.maps import chance_of, linearise_constants, pair_rows, products_of

# Share of a state's size below which a miss is the rounding of numbers alone.
_ROUNDING = 1e-11
# Share of the variance of misses that near rows leave open where they are no chance: that leaves 1.
_OPEN = 0.5


def give_map_verdict(
    equations: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    front: Mapping[str, ParetoFront] | None = None,
    settings: VerdictSettings = VERDICT,
) -> Verdict:
    """Say of every equation of a map whether it is a law of the data.

    In the verdict of a state R2 is that of one step, the noise is the size of one step's residuals,
    the forecast the error of a step in the held-back end, and chi-square the squared residual of
    free runs in units of what the residuals of single steps add up to, both by medians.

    Parameters
    ----------
    equations : state -> its next value.
    runs : the trajectories that they were found on.
    front : state -> other formulas that were found, which are compared on one step.
    settings : the numbers that decide.

    >>> x = [0.3]
    >>> for _ in range(99):
    ...     x.append(3.8 * x[-1] * (1 - x[-1]))
    >>> run = Trajectory(np.arange(100.0), np.array(x)[:, None], ("x",))
    >>> own = sympy.Symbol("x")
    >>> give_map_verdict({"x": 3.8 * own * (1 - own)}, [run]).level
    'law'
    >>> give_map_verdict({"x": sympy.S.Zero}, [run]).level
    'not found'
    """
    with np.errstate(all="ignore"):
        steps = {s: _Step.of(s, e, runs, settings.held_back) for s, e in equations.items()}
        free = _compare_free_runs(equations, runs, steps, settings)
        states = {
            s: _test_state(step, free.get(s, math.inf), runs, (front or {}).get(s, ()), settings)
            for s, step in steps.items()
        }
    law = "every equation gives the next row within chance."
    span = settings.steps * float(np.median(np.diff(runs[0].t)))
    return summarise(states, span, law)


@dataclass(frozen=True, eq=False)
class _Step:
    """One step of one state from every row: what it misses, and how its constants move that."""

    state: str
    expr: sympy.Expr
    samples: Samples
    later: np.ndarray
    misses: np.ndarray
    jacobian: np.ndarray
    places: tuple[Place, ...]

    @classmethod
    def of(
        cls, state: str, expr: sympy.Expr, runs: Sequence[Trajectory], held_back: float
    ) -> _Step:
        samples = pair_rows(runs, state)
        opened, places = open_constants({state: expr})
        values = {symbol: place.value for symbol, place in places.items()}
        misses, jacobian = linearise_constants(opened[state], values, samples)
        later = np.arange(len(samples)) >= math.ceil((1 - held_back) * len(samples))
        return cls(state, expr, samples, later, misses, jacobian, tuple(places.values()))

    @property
    def spread(self) -> float:
        return scale_of(self.samples.y)

    @property
    def finest(self) -> float:
        """Misses below this are rounding."""
        return _ROUNDING * max(self.spread, float(np.max(np.abs(self.samples.y))))

    @property
    def size(self) -> float:
        """Standard deviation of the residuals of one step."""
        freedom = max(len(self.misses) - len(self.places), 1)
        return math.sqrt(float(self.misses @ self.misses) / freedom)

    @property
    def r2(self) -> float:
        found = 1 - float(np.mean(self.misses**2)) / self.spread**2
        return found if math.isfinite(found) else -math.inf

    def r2_of(self, expr: sympy.Expr) -> float:
        """R2 of one step of another formula."""
        misses = self.samples.y - evaluate(expr, self.samples.timed)
        return 1 - float(np.mean(misses**2)) / self.spread**2

    def _solve(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give the shift of the constants that fits these rows best, and its covariance."""
        unit, scale = unit_columns(self.jacobian[rows])
        inverse = np.linalg.pinv(unit, rcond=DEPENDENT)
        covariance = (inverse @ inverse.T) / np.outer(scale, scale) * self._level**2
        return inverse @ self.misses[rows] / scale, covariance

    @property
    def _level(self) -> float:
        return max(self.size, self.finest)

    def terms(self) -> tuple[TermCertainty, ...]:
        """Say how sure each term is, as for systems in continuous time."""
        if not self.places or not np.all(np.isfinite(self.jacobian)):
            return ()
        _, covariance = self._solve(np.ones(len(self.misses), dtype=bool))
        errors = np.sqrt(np.maximum(np.diag(covariance), 0))
        found = []
        for place, error in zip(self.places, errors, strict=True):
            ratio = abs(place.value) / max(float(error), 1e-300)
            found.append(TermCertainty.of(place.term, ratio, len(self.misses)))
        return tuple(found)

    def forecast(self) -> tuple[float, float]:
        """Give the rms miss of the end, and its square in units of what was to be expected.

        The constants are those that fit the rows before.
        """
        slopes = self.jacobian[self.later]
        shift, covariance = self._solve(~self.later)
        left = self.misses[self.later] - slopes @ shift
        expected = self._level**2 + np.einsum("ij,jk,ik->i", slopes, covariance, slopes)
        return math.sqrt(float(np.mean(left**2))), float(np.mean(left**2 / expected))

    def has_pattern(self) -> bool:
        """Say whether the residuals depend on the columns.

        Either near rows are missed by the same (see :func:`dynsr.data.near_rows_leave_open`), or
        products of the columns explain some of it (Fisher's test).
        """
        if self.size <= self.finest:
            return False
        left = near_rows_leave_open([self.samples.X], [self.misses])
        return left < _OPEN or self._follows_products()

    def is_odd(self) -> bool:
        """Say whether a wave of a column that is no angle, or the like, is in the equation."""
        return not textbooks().knows(self.expr, place_among(self.state, self.samples.columns))

    def _follows_products(self) -> bool:
        design = products_of(self.samples.X.T, STOCHASTIC_SEARCH.degrees[0])
        freedom = len(design) - design.shape[1]
        if freedom < 2 * design.shape[1]:
            return False
        return chance_of(design, self.misses, design.shape[1]) < STOCHASTIC_SEARCH.chance

    def moves_by(self) -> float:
        """Root mean square change of the state in one step."""
        own = self.samples.columns[self.state]
        return math.sqrt(float(np.mean((self.samples.y - own) ** 2)))


def _compare_free_runs(
    equations: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    steps: Mapping[str, _Step],
    settings: VerdictSettings,
) -> dict[str, float]:
    """Give the squared residual of free runs in units of what those of single steps add up to.

    For that the same runs are iterated with residuals drawn from those of single steps.
    """
    states = [runs[0].index(state) for state in equations]
    names = [n for n in runs[0].names if n not in equations]
    step = compile_numpy(list(equations.values()), [*equations, *names, "t"])
    places = [runs[0].names.index(name) for name in names]
    rng = np.random.default_rng(0)
    actual, expected = [], []
    for run in runs:
        first = np.arange(0, len(run) - settings.steps, max(1, len(run) // settings.rows))
        whole: np.ndarray = np.all(run.measured, axis=1)
        first = first[whole[first] & whole[first + settings.steps]]
        if not len(first):
            continue
        plain = run.x[first][:, states].T
        shaken = plain
        for later in range(settings.steps):
            driven = [*run.columns[first + later][:, places].T, run.t[first + later]]
            plain = step(np.array([*plain, *driven]))
            chance = [rng.choice(steps[s].misses, len(first)) for s in equations]
            shaken = step(np.array([*shaken, *driven])) + np.array(chance)
        actual.append(plain - run.x[first + settings.steps][:, states].T)
        expected.append(shaken - plain)
    if not actual:
        return {}
    missed, by_chance = (np.concatenate(found, axis=1) for found in (actual, expected))
    found = {}
    for place, state in enumerate(equations):
        size = np.median(np.nan_to_num(np.abs(missed[place]), nan=np.inf))
        usual = np.median(np.nan_to_num(np.abs(by_chance[place]), nan=np.inf))
        # Rounding grows too, over as many steps.
        floor = max(settings.exact * steps[state].spread, steps[state].finest)
        found[state] = float((size / max(float(usual), floor)) ** 2)
    return found


def _test_state(
    step: _Step,
    free: float,
    runs: Sequence[Trajectory],
    front: ParetoFront | Sequence[None],
    settings: VerdictSettings,
) -> StateVerdict:
    state, r2 = step.state, step.r2
    size = step.size / step.spread
    found = StateVerdict(NOT_FOUND, "", float(f"{r2:.6g}"), free, noise=float(f"{size:.6g}"))
    if (
        np.ptp([value for run in runs for value in run.x[run.own_rows(state), run.index(state)]])
        == 0
    ):
        return replace(found, level=LAW, reason=f"{state} does not change.")
    if not (math.isfinite(r2) and np.all(np.isfinite(step.jacobian))):
        return replace(found, reason="the equation has no value on some rows.")
    if not step.expr.free_symbols or step.expr == sympy.Symbol(state):
        said = f"{state} moves from row to row, and no equation for that was found."
        return replace(found, reason=said + _because(step, runs, settings))
    missed, surprise = step.forecast()
    found = replace(
        found,
        forecast=float(f"{missed / step.spread:.6g}"),
        terms=step.terms(),
        alternatives=_compare(step, front, settings),
    )
    drift = (
        drift_of_rows(state, step.expr, step.samples, step.finest, settings.drift, discrete=True)
        if step.size > step.finest
        else same_in_time(state, step.expr, step.samples, settings.drift, discrete=True)
    )
    if r2 < settings.r2:
        said = f"the equation does not give the next row (R2 of one step {r2:.2g})."
        found = replace(found, reason=said + _because(step, runs, settings))
        if drift is not None and drift.timed and step.r2_of(drift.expr) >= settings.r2:
            return _with_drift(found, drift)
        return found
    doubts = _doubts(step, found, free, surprise, settings)
    exact = step.size <= step.finest
    if drift is not None and (drift.timed or not doubts):
        doubts.insert(0, drift.said)
        found = _with_drift(found, drift) if drift.timed else found
    follows = f"gives the next row to {percent(size)} of the spread"
    follows = "gives the next row exactly" if exact else follows
    if doubts:
        said = f"{follows}, but {'; '.join(doubts)}."
        said += _because(step, runs, settings)
        return replace(found, level=APPROXIMATION, reason=said)
    runs_on = f"free runs of {settings.steps} steps miss by no more than these add up to"
    return replace(
        found, level=LAW, reason=f"{follows}; {runs_on}, and each of its terms is needed."
    )


def _with_drift(found: StateVerdict, drift: Drift) -> StateVerdict:
    """Put the formula with the time before others, and say so where something is said."""
    alternative = OtherFormula.of(drift.expr, drift.bits)
    more = f" Besides, {drift.said}." if found.reason else ""
    return replace(
        found, alternatives=(alternative, *found.alternatives), reason=found.reason + more
    )


def _doubts(
    step: _Step, found: StateVerdict, free: float, surprise: float, settings: VerdictSettings
) -> list[str]:
    """Give what keeps an equation that gives the next row from being a law."""
    doubts = []
    if step.size > step.moves_by() / 2:
        doubts.append("that is hardly better than to say that nothing changes")
    if step.has_pattern():
        doubts.append("the residuals of one step are not random: they depend on the columns")
    if step.size > step.finest and step.is_odd():
        doubts.append("it has functions that such columns seldom follow")
    if free > settings.free**2:
        doubts.append(f"free runs of {settings.steps} steps miss by more than that adds up to")
    if surprise > most_by_chance(int(np.count_nonzero(step.later))):
        doubts.append(f"the last {settings.held_back:.0%} of the data are missed by more")
    doubts += doubt_terms(found.terms, settings)
    near = [r for r in found.alternatives if r.bits < settings.alternative_bits]
    if near:
        how = "gives it better" if near[0].bits < -settings.alternative_bits else "gives it as well"
        doubts.append(f"{near[0].equation} {how}")
    if len(step.misses) < settings.fewest * max(1, len(found.terms)):
        doubts.append(f"{len(step.misses)} steps are too few to be sure")
    return doubts


def _because(step: _Step, runs: Sequence[Trajectory], settings: VerdictSettings) -> str:
    """Say what may keep the equation from being found: what near rows leave open."""
    if len(step.misses) < settings.fewest * (len(runs[0].names) + 1):
        return f" {len(step.misses)} steps are few for {len(runs[0].names)} columns."
    pieces = [pair_rows([run], step.state) for run in runs if len(run) > 2]
    left = near_rows_leave_open([piece.X for piece in pieces], [piece.y for piece in pieces])
    if not math.isfinite(left) or left <= 2 * settings.exact:
        return ""
    if left > 1 - settings.r2:
        return (
            " Rows that are near to each other in all columns are followed by different values of "
            f"{step.state}: a state or an input is missing, or chance is large."
        )
    if step.r2 < 1 - 3 * left:
        return " Near rows are followed by near values: there is an equation, of another form."
    return ""


def _compare(
    step: _Step, front: ParetoFront | Sequence[None], settings: VerdictSettings
) -> tuple[OtherFormula, ...]:
    """Give the closest different formulas of the front, by the bits of one step's misses."""
    columns = {**step.samples.columns, "t": step.samples.t}
    rows, floor = len(step.samples), max(step.finest, 1e-300) ** 2

    def length(expr: sympy.Expr, misses: np.ndarray) -> float:
        constants = sum(1 for _ in open_constants({step.state: expr})[1])
        bits = structure_bits(expr) + constants * constant_bits(rows)
        return bits + rows / 2 * math.log2(max(float(np.mean(misses**2)), floor))

    own, found = length(step.expr, step.misses), []
    for candidate in front:
        # What does not change with the rows is no alternative for a state that moves.
        if candidate is None or not candidate.expr.free_symbols:
            continue
        values = np.broadcast_to(evaluate(candidate.expr, columns), rows)
        apart = float(np.sqrt(np.mean((values - step.samples.y + step.misses) ** 2)))
        if math.isfinite(apart) and apart > max(settings.differs * step.spread, 2 * step.finest):
            found.append((length(candidate.expr, step.samples.y - values) - own, candidate.expr))
    found.sort(key=lambda pair: (pair[0], ByText(pair[1])))
    return tuple(OtherFormula.of(expr, bits) for bits, expr in found[: settings.alternatives])
