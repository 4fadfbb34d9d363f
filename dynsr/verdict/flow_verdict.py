"""Verdict: whether found equations are a law of the data, an approximation, or not found at all.

The trajectory decides. The equations are integrated from fitted starts, and the residuals are
compared with the noise of each measurement; constants refitted to the first part of the data
forecast the rest; every term must be needed; and no different formula may do as well.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy
from scipy.special import chdtrc

from dynsr.data import (
    Samples,
    Trajectory,
    carry,
    choose_samples,
    diagnose,
    is_still,
    robust_scale,
    solver_errors,
)
from dynsr.errors import InputError, one_line
from dynsr.expression import evaluate, has_pole, shown
from dynsr.fit import (
    FLOOR,
    ROUNDING,
    STABLE,
    Flow,
    ParetoFront,
    Shooting,
    invert_normal,
    noise_and_spread,
    unit_columns,
    use_bits_together,
)
from dynsr.selection import is_left_open
from dynsr.verdict.alternatives import compare_alternatives
from dynsr.verdict.completing import complete_cells
from dynsr.verdict.drift import Drift
from dynsr.verdict.drift_along import Along
from dynsr.verdict.drift_exact import drift_of_slopes, same_in_time
from dynsr.verdict.following import (
    ENOUGH_ROWS,
    FAR,
    Course,
    Followed,
    Place,
    first_rows,
    follow,
    open_constants,
)
from dynsr.verdict.layers import cross_layers
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
    doubt,
    doubt_terms,
    followed_r2,
    follows_to,
    is_probable,
    join_words,
    least_r2,
    likely_cause,
    most_by_chance,
    open_terms,
    percent,
    round_off,
    summarise,
)

# Causes of what looks like noise between neighbouring rows and is none.
_JUMPING = ("map", "sampling too coarse")
_UNSEEN = "was not measured, and shows in the states that were"


def give_verdict(
    equations: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr] | None = None,
    *,
    noise: Sequence[np.ndarray] | None = None,
    front: Mapping[str, ParetoFront] | None = None,
    alternatives: Mapping[str, Sequence[tuple[sympy.Expr, float]]] | None = None,
    causes: Mapping[str, str] | None = None,
    settings: VerdictSettings = VERDICT,
    fixed: Collection[sympy.Expr] = (),
    curves: Sequence[np.ndarray] = (),
    by_run: Collection[str] = (),
) -> Verdict:
    """Say of every equation whether it is a law of the data, an approximation, or not found.

    Parameters
    ----------
    equations : state -> right-hand side.
    runs : the trajectories that they were found on.
    inputs : input name -> expression in ``t`` where it is known.
    noise : for each run (n, k) standard deviations of the noise of its states, inf where they were
        not measured; by default one for each state, estimated.
    front : state -> other formulas that were found, of which the closest are compared.
    alternatives : state -> (formula, bits above the equation) where they were compared before.
    causes : state -> a sentence that says what its data lack; by default what they show.
    settings : the numbers that decide.
    fixed : terms whose factors are known.
    curves : for each run (n, k) values of the states, in the order of the equations, from which the
        fits of starts begin; by default they begin at the measurements.
    by_run : inputs that are constants, each with its own value in every run.

    Cells of which only a limit is known are drawn from what the equations say of them, beyond the
    limit; a curve on its wrong side misses them.

    >>> t = np.linspace(0, 3, 61)
    >>> decay = Trajectory(t, np.exp(-0.5 * t)[:, None], ("x",))
    >>> give_verdict({"x": -0.5 * sympy.Symbol("x")}, [decay]).level
    'law'
    """
    try:
        with np.errstate(all="ignore"):
            runs, noise = complete_cells(equations, runs, inputs or {}, noise, settings.rows)
            given = equations, runs, inputs or {}, noise, settings, fixed, curves, by_run
            bench = _Bench.of(*given)
            verdict = _give_verdict(bench, front or {}, alternatives, causes or {})
            # Noise is no more than what the equations leave.
            if exact := bench.shown_exact(verdict):
                bench = _Bench.of(*given, exact=exact)
                verdict = _give_verdict(bench, front or {}, alternatives, causes or {})
            return verdict
    except (ArithmeticError, np.linalg.LinAlgError, InputError) as error:
        # What cannot be followed at all is no fault of the search.
        reason = f"the equations cannot be followed along the data ({one_line(error)})."
        own = StateVerdict(NOT_FOUND, reason, -math.inf)
        return Verdict(NOT_FOUND, reason, dict.fromkeys(equations, own))


def _give_verdict(
    bench: _Bench,
    front: Mapping[str, ParetoFront],
    alternatives: Mapping[str, Sequence[tuple[sympy.Expr, float]]] | None,
    causes: Mapping[str, str],
) -> Verdict:
    followed = bench.follow_longest()
    crossed = None if followed.finite else bench.cross_layers()
    if crossed is not None:
        return summarise(crossed, float(max(np.ptp(run.t) for run in bench.course.runs)))
    evidence = bench.gather(followed) if followed.finite else None
    close = alternatives or {}
    if alternatives is None and evidence is not None and front:
        close = bench.compare(front, followed)
    states = {
        state: bench.test_state(place, followed, evidence, close.get(state, ()), causes.get(state))
        for place, state in enumerate(bench.equations)
    }
    states = bench.check_drift(bench.weigh_systems(states), followed)
    return summarise(_doubt_together(states, bench.equations), bench.span(followed))


def _doubt_together(
    states: dict[str, StateVerdict], equations: Mapping[str, sympy.Expr]
) -> dict[str, StateVerdict]:
    """Take for an approximation what was a law only together with a state without one.

    Both are fitted and followed together, so that one equation may compensate for the other. One
    that is a bare column, such as x' = v, compensates for nothing.
    """
    weak = {s for s, own in states.items() if own.level != LAW}
    found = dict(states)
    for state, own in states.items():
        expr = equations[state]
        beside = sorted(weak & {str(symbol) for symbol in expr.free_symbols})
        if own.level == LAW and beside and not expr.is_Symbol:
            found[state] = doubt(
                own, f"only together with {join_words(beside)}, whose own equation is no law."
            )
    return found


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What the linearised fit gives: R2, chi-square, correlation of residuals, forecasts."""

    chi_square: np.ndarray
    correlation: np.ndarray
    systematic: np.ndarray
    ratios: dict[str, list[tuple[sympy.Expr | None, float]]]
    forecast: np.ndarray
    surprise: np.ndarray
    allowed: np.ndarray


@dataclass(frozen=True, eq=False)
class _Bench:
    """One judgement: the equations with open constants, and the data with their noise."""

    equations: dict[str, sympy.Expr]
    opened: dict[str, sympy.Expr]
    places: dict[sympy.Symbol, Place]
    course: Course
    spread: np.ndarray
    noise: np.ndarray
    clean: np.ndarray
    settings: VerdictSettings
    runs: Sequence[Trajectory]
    fixed: Collection[sympy.Expr]
    by_run: Collection[str]
    off: np.ndarray

    @classmethod
    def of(
        cls,
        equations: Mapping[str, sympy.Expr],
        runs: Sequence[Trajectory],
        inputs: Mapping[str, sympy.Expr],
        noise: Sequence[np.ndarray] | None,
        settings: VerdictSettings,
        fixed: Collection[sympy.Expr] = (),
        curves: Sequence[np.ndarray] = (),
        by_run: Collection[str] = (),
        exact: Collection[str] = (),
    ) -> _Bench:
        runs = carry(runs)
        columns = [runs[0].index(state) for state in equations]
        plain, spread = noise_and_spread(runs)
        whole = [np.broadcast_to(plain, r.x.shape) for r in runs] if noise is None else noise
        none = [state in exact for state in runs[0].states]
        whole = [np.where(none, 0.0, own) for own in whole]
        whole = [np.where(r.measured, own, np.inf) for r, own in zip(runs, whole, strict=True)]
        spread = spread[columns]
        every = np.concatenate([level[:, columns] for level in whole])
        there = np.isfinite(every)
        squares = np.sum(np.where(there, every, 0.0) ** 2, axis=0)
        typical = np.sqrt(squares / np.maximum(np.sum(there, axis=0), 1))
        clean = there.any(axis=0) & (typical < settings.exact * spread)
        # A slope that errs by so much moves a state by no more than this over a run.
        far = [solver_errors(run.t, run.x[:, columns]) * np.ptp(run.t) for run in runs]
        off = np.where(clean, np.max(far, axis=0) / spread, 0.0)
        least = np.where(clean, np.maximum(settings.solver, off), settings.finest) * spread
        own = [np.sqrt(level[:, columns] ** 2 + least**2) for level in whole]
        opened, places = open_constants(equations, fixed)
        return cls(
            dict(equations),
            opened,
            places,
            Course.of(runs, own, tuple(equations), inputs, settings.rows, curves),
            spread,
            typical / spread,
            clean,
            settings,
            runs,
            fixed,
            by_run,
            off,
        )

    def shown_exact(self, verdict: Verdict) -> list[str]:
        """Name the states whose residuals show that they are clean, though their noise did not.

        Neighbours of few rows, far apart, differ as if there were noise.
        """
        return [
            state
            for (state, own), clean in zip(verdict.states.items(), self.clean, strict=True)
            if not clean and own.noise * math.sqrt(own.chi_square) < self.settings.exact
        ]

    @property
    def values(self) -> np.ndarray:
        """(P,) constants as they are in the equations."""
        return np.array([place.value for place in self.places.values()])

    def shoot(self, length: int) -> list[Shooting]:
        """Give the residuals of the equations over windows of a length."""
        return self.course.shoot(self.flow, length, self.settings.windows)

    @cached_property
    def flow(self) -> Flow:
        """The equations with open constants, compiled once."""
        return self.course.flow(self.opened, tuple(self.places))

    def follow_longest(self) -> Followed:
        """Follow whole runs; where errors grow too far for that, the longest windows that can be.

        Without such a growth a run that is not followed as a whole is not followed.
        """
        length = self.course.longest
        tried = []
        while True:
            usual, greatest = self._growth(self.shoot(length))
            # One window next to a saddle may have the wrong start where all others are followed.
            last = length < 32 or greatest < self.settings.growth
            if last or usual < self.settings.hopeless:
                tried.append(follow(self.shoot(length), self.values))
            if last or (tried and self._follows(tried[-1])):
                break
            length //= 2
        # Where nothing is followed well, the shortest windows that the growth asks for say how far.
        return max(tried, key=lambda one: (self._follows(one), one.finite, -one.length))

    def _follows(self, followed: Followed) -> bool:
        return (
            followed.finite
            and bool(np.all(self.r2(followed) >= followed_r2(self.noise, self.settings)))
            and bool(np.all(followed.sizes() < self.settings.excess))
        )

    def _growth(self, shootings: Sequence[Shooting]) -> tuple[float, float]:
        """Give by how much an error of the start grows over a window: median and greatest."""
        found = []
        for shooting in shootings:
            starts = shooting.starts
            with np.errstate(all="ignore"):
                _, reached = shooting.flow.run_sensitive(shooting.windows, starts, self.values)
            unit = self.spread[:, None] / self.spread
            size = np.abs(reached[:, :, len(self.values) :] / unit[:, :, None])
            found += list(np.max(np.nan_to_num(size, nan=np.inf), axis=(0, 1, 2)))
        return float(np.median(found)), float(np.max(found))

    def r2(self, followed: Followed) -> np.ndarray:
        """(k,) share of the variance of each state that is explained; -inf on divergence."""
        missed, total = np.zeros(len(self.spread)), np.zeros(len(self.spread))
        for shooting, z in zip(followed.shootings, followed.misses, strict=True):
            missed += np.sum(shooting.missed(z) ** 2, axis=(0, 2))
            off = (shooting.windows.x - self._means[:, None]) ** 2
            total += np.sum(off, axis=(0, 2), where=shooting.told)
        with np.errstate(all="ignore"):
            return np.nan_to_num(1 - missed / np.maximum(total, 1e-300), nan=-np.inf)

    @property
    def _means(self) -> np.ndarray:
        columns = [self.course.runs[0].index(state) for state in self.equations]
        observed = np.concatenate([r.observed for r in self.course.runs])[:, columns]
        there = np.isfinite(observed)
        found: np.ndarray = np.sum(np.where(there, observed, 0.0), axis=0)
        return found / np.maximum(np.sum(there, axis=0), 1)

    def span(self, followed: Followed) -> float:
        """Time over which the equations were followed in one piece."""
        return float(max(np.max(np.ptp(s.windows.t, axis=0)) for s in followed.shootings))

    def cut(self, followed: Followed) -> bool:
        """Say whether only windows of the runs could be followed."""
        return followed.length < self.course.longest

    def gather(self, followed: Followed) -> _Evidence | None:
        """Linearise at the fit: degrees of freedom, ratios of terms, forecast of the end."""
        with np.errstate(all="ignore"):
            z, slopes, owners = followed.linearise()
        if not np.all(np.isfinite(slopes)):
            return None
        k = len(self.spread)
        lanes = sum(s.shape[1] for s in followed.starts)
        of_state = np.array([[p.state == s for p in self.places.values()] for s in self.equations])
        rows = np.array([np.count_nonzero(owners == i) for i in range(k)])
        # The constants were fitted too, each to the misses of its own state above all.
        freedom = np.maximum(rows - lanes - of_state.sum(axis=1) / self.course.thinned, 1.0)
        squares = np.array([np.sum(_tame(z[owners == i]) ** 2) for i in range(k)])
        chi = squares / freedom
        correlation, systematic = zip(
            *(_correlate(followed.lanes(i)) for i in range(k)), strict=True
        )
        # Clean data are no surer than their solver, however well they are followed: any curve may
        # be. Only simple numbers that the data find to many digits are no chance.
        sharp = np.maximum(chi, FLOOR)
        level = np.where(self.clean, np.maximum(chi, 1.0), sharp)
        ratios = self._ratios(slopes / np.sqrt(level)[owners][:, None])
        if self.clean.any():
            each = sharp * rows / np.maximum(followed.independent, 1.0)
            bits = self._simplicity(z, slopes, each[owners])
            of_each = {s: bits[of_state[i]] for i, s in enumerate(self.equations)}
            simple = [float(b.sum()) >= self.settings.alternative_bits for b in of_each.values()]
            level = np.where(simple, sharp, level)
            surer = self._ratios(slopes / np.sqrt(level)[owners][:, None])
            # A number that is no simple one shows nothing but what the residuals do.
            ratios |= {
                s: [
                    sure if own > 0 else rough
                    for rough, sure, own in zip(ratios[s], surer[s], of_each[s], strict=True)
                ]
                for s, all_told in zip(self.equations, simple, strict=True)
                if all_told
            }
        forecast, surprise, allowed = self._forecast(followed)
        return _Evidence(
            chi, np.array(correlation), np.array(systematic), ratios, forecast, surprise, allowed
        )

    def _simplicity(self, z: np.ndarray, slopes: np.ndarray, squares: np.ndarray) -> np.ndarray:
        """(P,) bits by which each constant is a simple number and none by chance.

        The constants are those of a linear fit to the residuals (N,), which have these mean squares
        for each independent row.
        """
        count = len(self.places)
        weight = 1 / np.sqrt(squares)
        weighed = slopes * weight[:, None]
        covariance = _covariance(weighed)
        shift = -(covariance @ (weighed.T @ (weight * z)))[:count]
        fitted, covariance = self.values + shift, covariance[:count, :count]
        return use_bits_together(fitted, covariance, self.values)

    def _ratios(self, slopes: np.ndarray) -> dict[str, list[tuple[sympy.Expr | None, float]]]:
        """State -> (term, size of its coefficient over the standard error), inner numbers too."""
        errors = np.sqrt(np.maximum(np.diag(_covariance(slopes)), 0))
        found: dict[str, list[tuple[sympy.Expr | None, float]]] = {s: [] for s in self.equations}
        for place, error in zip(self.places.values(), errors, strict=False):
            ratio = abs(place.value) / max(error, 1e-300) * math.sqrt(self.course.thinned)
            found[place.state].append((place.term, float(ratio)))
        return found

    def _forecast(self, followed: Followed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Per state: rms miss of the forecast end by spread, its surprise, and what is allowed.

        Constants and starts are fitted to the first part of each window. The surprise is the mean
        squared error of the rest in units of noise and of what the fitted constants leave open.
        """
        k = len(self.spread)
        failed = np.full(k, np.inf), np.full(k, np.inf), np.ones(k)
        known = [max(2, round((1 - self.settings.held_back) * len(z))) for z in followed.misses]
        first = [first_rows(s, n) for s, n in zip(followed.shootings, known, strict=True)]
        if len(self.places) + k > sum(int(np.sum(s.told[:, :, 0])) for s in first):
            return failed
        fitted = follow(first, followed.constants, starts=followed.starts, free=True)
        if not fitted.finite:
            return failed
        with np.errstate(all="ignore"):
            z, by, owners = fitted.linearise()
            sizes = [np.sum(_tame(z[owners == i]) ** 2) for i in range(k)]
            level = np.maximum(np.array(sizes) / np.maximum(fitted.counts, 1), 1.0)
            covariance = _covariance(by / np.sqrt(level)[owners][:, None])
            whole = replace(
                fitted,
                shootings=followed.shootings,
                misses=tuple(
                    s.misses(fitted.constants, at)
                    for s, at in zip(followed.shootings, fitted.starts, strict=True)
                ),
            )
            z, by, owners = whole.linearise()
        if not (np.all(np.isfinite(by)) and np.all(np.isfinite(covariance))):
            return failed
        later = np.concatenate(
            [
                np.tile(np.repeat(np.arange(len(m)) >= n, k), m.shape[2])
                for m, n in zip(whole.misses, known, strict=True)
            ]
        )[whole.told]
        unit = np.concatenate([s.spread.transpose(2, 0, 1).reshape(-1) for s in whole.shootings])
        unit = unit[whole.told]
        missed, surprise, allowed = np.full(k, np.inf), np.zeros(k), np.ones(k)
        for i in range(k):
            mine = np.flatnonzero(later & (owners == i))
            if not len(mine):
                # Nothing of it was measured there.
                continue
            missed[i] = np.sqrt(np.mean((z * unit)[mine] ** 2)) / self.spread[i]
            mine = mine[:: max(1, len(mine) // ENOUGH_ROWS)]
            joint = by[mine] @ covariance @ by[mine].T + level[i] * np.eye(len(mine))
            surprise[i] = float(z[mine] @ np.linalg.solve(joint, z[mine])) / len(mine)
            allowed[i] = most_by_chance(len(mine))
        return missed, surprise, allowed

    def test_state(
        self,
        place: int,
        followed: Followed,
        evidence: _Evidence | None,
        close: Sequence[tuple[sympy.Expr, float]],
        cause: str | None,
    ) -> StateVerdict:
        """Weigh all that is known of one state."""
        state = list(self.equations)[place]
        hidden, every = followed.counts == 0, self.r2(followed)
        # What was never measured shows in the others alone.
        expr = self.equations[state]
        r2 = round_off(float(np.min(every[~hidden])) if hidden[place] else every[place])
        noise = round_off(self.noise[place])
        found = StateVerdict(NOT_FOUND, "", r2, noise=noise)
        if evidence is not None:
            found = replace(
                found,
                chi_square=round_off(evidence.chi_square[place]),
                forecast=_finite(round_off(evidence.forecast[place])),
                rows=round_off(float(followed.independent[place]) * self.course.thinned),
                terms=self._terms(state, evidence, followed),
                alternatives=tuple(
                    OtherFormula.of(e, bits) for e, bits in sorted(close, key=lambda pair: pair[1])
                ),
            )
        rows = self._rows(followed, place)
        if expr == 0 and self._rests(place, evidence, found, rows):
            return replace(found, level=LAW, reason=f"{state} does not change.")
        lacking = self._lacking(place, expr, r2, evidence)
        if lacking:
            return replace(found, reason=lacking + self._because(state, cause))
        assert evidence is not None
        explained = self._leaves_noise(place, evidence, found, rows)
        doubts = self._doubts(place, state, followed, evidence, found, explained)
        if doubts and (idle := self._idle(expr, found, explained)):
            said = f"{state} moves, and {idle}."
            return replace(found, reason=said + self._because(state, cause))
        if doubts:
            how = _UNSEEN if hidden[place] else follows_to(r2) + self._while(followed)
            said = f"{how}, but {'; '.join(doubts)}."
            because = self._because(state, cause, explained)
            return replace(found, level=APPROXIMATION, reason=said + because)
        praise = self._praise(place, noise, followed)
        if hidden[place]:
            praise = f"{_UNSEEN}, and the data need each of its terms."
        return replace(found, level=LAW, reason=praise)

    def weigh_systems(self, states: Mapping[str, StateVerdict]) -> dict[str, StateVerdict]:
        """Take for no law what is improbable together: the system, not each equation, is the law.

        Each formula that may be in the place of an equation makes another system. One that changes
        two equations at once is named with both.
        """
        found, others = dict(states), dict[float, tuple[str, OtherFormula]]()
        for (state, own), clean in zip(states.items(), self.clean, strict=True):
            if own.level == LAW and not clean:
                others |= {other.bits: (state, other) for other in own.alternatives}
        nearest = sorted(others)
        while nearest and not is_probable(nearest, self.settings):
            state, other = others[nearest.pop(0)]
            if found[state].level == LAW:
                why = f"the data cannot distinguish it from {other.equation}."
                found[state] = doubt(found[state], why)
        return found

    def check_drift(
        self, states: dict[str, StateVerdict], followed: Followed
    ) -> dict[str, StateVerdict]:
        """Take for no law what the time, or a term that is left out, explains in fewer bits.

        What is no law for other reasons reports it too, where the formula would be one itself.
        """
        drifts = self._find_drifts(states, followed)
        if not drifts:
            return states
        doubtful = {s for s, own in states.items() if own.level != LAW}
        lawful: set[str] = set()
        if doubtful & set(drifts):
            lawful = self._are_laws(drifts)
        found = dict(states)
        # What is followed beside an equation that drifts is none the worse for that.
        told_of = [f"{s}: {d.said}." for s, d in drifts.items() if d.timed and s in lawful]
        for state, own in states.items():
            drift = drifts.get(state)
            if drift is None:
                if state in lawful & doubtful and told_of:
                    found[state] = replace(own, reason=f"{own.reason} Besides, {told_of[0]}")
                continue
            if own.level == LAW:
                told = doubt(own, f"{drift.said}.")
            elif state in lawful and drift.timed:
                told = replace(own, reason=f"{own.reason} Besides, {drift.said}.")
            else:
                continue
            if drift.timed:
                alternative = OtherFormula.of(drift.expr, drift.bits)
                told = replace(told, alternatives=(alternative, *own.alternatives))
            found[state] = told
        return found

    def _find_drifts(
        self, states: Mapping[str, StateVerdict], followed: Followed
    ) -> dict[str, Drift]:
        weak = {s for s, own in states.items() if own.level != LAW}
        # Names of slopes stand for nothing else, nor does what rests.
        asked = {
            s
            for s, e in self.equations.items()
            if not e.is_Symbol and (e.free_symbols or s in weak)
        }
        weak &= asked
        found: dict[str, Drift | None] = {}
        noisy = [s for s, exact in zip(self.equations, self.clean, strict=True) if not exact]
        if followed.finite:
            found |= self._along.look(asked & set(noisy))
        found |= {s: self._drift_of_law(s) for s in asked - weak - set(noisy)}
        found |= {s: self._drift_of_slopes(s) for s in weak - set(noisy)}
        return {s: drift for s, drift in found.items() if drift is not None}

    @cached_property
    def _along(self) -> Along:
        exact = [s for s, clean in zip(self.equations, self.clean, strict=True) if clean]
        return Along(self.equations, self.course, self.settings.drift, self.fixed, exact)

    def _drift_of_slopes(self, state: str) -> Drift | None:
        """Give the formula with the time that the slopes of clean data follow."""
        rows = choose_samples(self.runs, state)
        return drift_of_slopes(self.equations[state], rows, self.settings.drift)

    def _drift_of_law(self, state: str) -> Drift | None:
        """Give the shorter formula that an exact law is the same as along the data."""
        runs, expr = self.course.runs, self.equations[state]
        names = runs[0].names
        columns = dict(zip(names, np.concatenate([r.columns for r in runs]).T, strict=True))
        t = np.concatenate([run.t for run in runs])
        columns |= {n: evaluate(e, {"t": t}) for n, e in self.course.inputs.items()}
        y = np.broadcast_to(evaluate(expr, {**columns, "t": t}), len(t))
        rows = Samples(
            np.column_stack(list(columns.values())), y, tuple(columns), state, "given", t
        )
        return same_in_time(state, expr, rows, self.settings.drift)

    def _are_laws(self, drifts: Mapping[str, Drift]) -> set[str]:
        """Name the states whose equation would be a law if these were the equations."""
        changed = {**self.equations, **{s: drift.expr for s, drift in drifts.items()}}
        # The other equations had been fitted beside one that is wrong.
        changed = self._along.refit(changed)
        opened, places = open_constants(changed, self.fixed)
        other = replace(self, equations=changed, opened=opened, places=places)
        again = other.follow_longest()
        evidence = other.gather(again) if again.finite else None
        judged = {s: other.test_state(i, again, evidence, (), "") for i, s in enumerate(changed)}
        return {s for s, own in judged.items() if own.level == LAW}

    def _because(self, state: str, cause: str | None, explained: bool = False) -> str:
        """Give the most probable cause, by default what the data themselves show."""
        cause = likely_cause(self.course.runs, state, explained) if cause is None else cause
        # A sentence, unless it begins with the name of a state.
        begins = cause and cause.partition(" ")[0] not in self.equations
        return f" {cause[0].upper() + cause[1:] if begins else cause}" if cause else ""

    def _rests(
        self, place: int, evidence: _Evidence | None, found: StateVerdict, rows: float
    ) -> bool:
        """Say whether a state does nothing but carry noise."""
        state = list(self.equations)[place]
        if all(is_still(run.x[:, run.index(state)], ROUNDING) for run in self.runs):
            return True
        if evidence is None or not self._leaves_noise(place, evidence, found, rows):
            return False
        # What jumps from row to row looks like noise to its neighbours, and may follow a map.
        causes = diagnose(self.course.runs, state)
        return bool(self.noise[place] > 0.7 and not any(c.kind in _JUMPING for c in causes))

    def _lacking(self, place: int, expr: sympy.Expr, r2: float, evidence: _Evidence | None) -> str:
        if expr == 0:
            return "the data move, but no equation for that was found."
        if evidence is None or not math.isfinite(r2):
            state = list(self.equations)[place]
            if any(cause.kind == "stiff" for cause in diagnose(self.course.runs, state)):
                return "the equations cannot be followed across the fast layers of the data."
            return "integrated, the equations diverge from the data."
        if r2 < least_r2(self.noise[place], self.settings):
            return f"integrated, the equations do not reproduce the data (R2 {r2:.2g})."
        return ""

    def _idle(self, expr: sympy.Expr, found: StateVerdict, explained: bool) -> str:
        """Say why an equation says nothing of a motion; nothing where it says something.

        Parameters
        ----------
        expr, found : the equation of a state, and what is known of it.
        explained : whether its residuals are noise.
        """
        if not expr.free_symbols:
            return "a constant slope does not reproduce it"
        terms = found.terms
        if not explained and terms and len(open_terms(terms, self.settings)) == len(terms):
            return "the data need no term of its equation"
        return ""

    def _while(self, followed: Followed) -> str:
        return f" over time windows of {self.span(followed):.3g}" if self.cut(followed) else ""

    def _doubts(
        self,
        place: int,
        state: str,
        followed: Followed,
        evidence: _Evidence,
        found: StateVerdict,
        explained: bool,
    ) -> list[str]:
        """Give what keeps an equation that follows the data from being a law."""
        settings, doubts = self.settings, []
        # A denominator passes through 0 along a run, as no solution can.
        if any(has_pole(self.equations[state], run.by_name) for run in self.course.runs):
            doubts.append("it divides by 0 between the data")
        if self.clean[place] and self._is_open(state):
            doubts.append(
                "its columns satisfy a relation along the data, so that other forms are equal "
                "there; a run from another start decides"
            )
        if not explained:
            doubts.append(f"the residuals are not noise{_where(followed, place)}")
        if self.off[place] and (times := self._misses_slopes(state)) > settings.within_solver:
            doubts.append(f"it misses the slopes by {times:.2g} times the errors of their solver")
        share = found.forecast
        # The errors of a solver add up over the forecast; they are no chance.
        settled = self.clean[place] and share is not None and share < 6 * settings.solver
        if not (settled or evidence.surprise[place] <= evidence.allowed[place]):
            by = "diverges" if share is None else f"has an error of {percent(share)} of the spread"
            doubts.append(f"a forecast of the last {settings.held_back:.0%} of the data {by}")
        doubts += doubt_terms(found.terms, settings)
        near = self._doubted_for(found.alternatives, self.clean[place])
        if near and near[0].bits < -settings.alternative_bits:
            doubts.append(f"{near[0].equation} fits them better")
        elif near:
            doubts.append(f"the data cannot distinguish it from {near[0].equation}")
        rows = self._rows(followed, place)
        if rows < settings.fewest * max(1, len(found.terms)):
            doubts.append(f"{rows:.0f} rows are too few to be sure")
        return doubts

    def _misses_slopes(self, state: str) -> float:
        """Median error of an equation in slopes of interpolated rows, in units of that of these."""
        rows = choose_samples(self.runs, state)
        missed = np.abs(rows.y - evaluate(self.equations[state], rows.timed))
        return float(np.median(missed)) / max(float(rows.noise or 0.0), np.finfo(float).tiny)

    def _doubted_for(self, alternatives: Sequence[OtherFormula], clean: bool) -> list[OtherFormula]:
        """Give the different formulas that leave a doubt, the closest first; none if none does."""
        closest = sorted(alternatives, key=lambda r: r.bits)
        if clean:
            return [r for r in closest if r.bits < self.settings.alternative_bits]
        return [] if is_probable([r.bits for r in closest], self.settings) else closest

    def _rows(self, followed: Followed, place: int) -> float:
        """Rows that were followed in which a state was measured, or any where it never was."""
        counts = followed.counts
        return float(counts[place] or np.sum(counts)) * self.course.thinned

    def _leaves_noise(
        self, place: int, evidence: _Evidence, found: StateVerdict, rows: float
    ) -> bool:
        """Say whether what the equations miss of a state is nothing but its noise."""
        chi, settings = found.chi_square, self.settings
        if self.clean[place]:
            return chi <= 4.0 / max(1.0, len(found.terms) / 3) ** 2
        correlation = float(evidence.correlation[place])
        loose = settings.excess + 4 * math.sqrt(2 / max(rows, 1))
        white = not evidence.systematic[place] or correlation < settings.correlated
        return white and chi <= (4 * loose if correlation < 0.1 else loose)

    def _is_open(self, state: str) -> bool:
        """Whether an equation is one of many that are the same along every run."""
        rows = np.concatenate([[*run.by_name.values()] for run in self.course.runs], axis=1)
        columns = dict(zip(self.course.runs[0].by_name, rows, strict=True))
        # A constant of each run takes few values, but none of them is a value of a column.
        own = {sympy.Symbol(n): sympy.Float(columns.pop(n)[0]) for n in self.by_run if n in columns}
        return is_left_open(self.equations[state].xreplace(own), columns)

    def _praise(self, place: int, noise: float, followed: Followed) -> str:
        exact = "exactly" if self.clean[place] else f"within their noise of {percent(noise)}"
        if self.off[place] > self.settings.solver:
            exact = "within the errors of the solver that made them"
        return (
            f"reproduces the data {exact}{self._while(followed)}, forecasts their last "
            f"{self.settings.held_back:.0%}, and needs each of its terms."
        )

    def _stiffness(self, shooting: Shooting) -> float:
        return shooting.flow.stiffness(shooting.windows, self.values)

    def cross_layers(self) -> dict[str, StateVerdict] | None:
        """Test stiff equations of clean data by one implicit integration from the first rows.

        None where the data are noisy, lack values or have no layers, and where that does not
        reproduce them.
        """
        if not np.all(self.clean) or any(run.unmeasured.size for run in self.runs):
            return None
        causes = [diagnose(self.course.runs, state) for state in self.equations]
        stiff = any(cause.kind == "stiff" for told in causes for cause in told)
        # A solver's own rows are as close in the layers as these are thin.
        if not stiff and max(map(self._stiffness, self.shoot(self.course.longest))) < STABLE:
            return None
        found = cross_layers(self.equations, self.course.runs, self.course.inputs)
        if found is None or np.min(found.r2) < self.settings.r2:
            return None
        exact = bool(np.max(found.missed) < 2 * self.settings.solver)
        verdicts = {}
        for place, state in enumerate(self.equations):
            idle = None if found.idle is None else found.idle[state]
            said = "across the fast layers of the data, integrated implicitly from their first row"
            level = LAW if exact and idle == [] else APPROXIMATION
            if level == LAW:
                reason = f"reproduces the data exactly {said}, and needs each of its terms."
            else:
                much = f"follows the data to {percent(float(found.missed[place]))} of the spread"
                why = "its terms are too many to be tried one by one"
                if not exact:
                    why = "the residuals are not noise"
                elif idle:
                    why = f"the data do not need {join_words([shown(t) for t in idle])}"
                reason = f"{much} {said}, but {why}."
            verdicts[state] = StateVerdict(
                level,
                reason,
                round_off(float(found.r2[place])),
                round_off(float(found.missed[place] / self.settings.solver) ** 2),
                forecast=_finite(round_off(float(found.late[place]))),
                noise=round_off(self.noise[place]),
            )
        return verdicts

    def _terms(
        self, state: str, evidence: _Evidence, followed: Followed
    ) -> tuple[TermCertainty, ...]:
        rows, found = self._rows(followed, list(self.equations).index(state)), []
        for term, ratio in evidence.ratios[state]:
            found.append(TermCertainty.of(term, ratio, rows))
        return tuple(found)

    def compare(
        self, front: Mapping[str, ParetoFront], followed: Followed
    ) -> dict[str, list[tuple[sympy.Expr, float]]]:
        """Compare the formulas of the front that come closest."""
        settings = self.settings
        return compare_alternatives(
            self.equations,
            front,
            followed,
            self.places,
            self.course,
            settings.alternatives,
            settings.different,
            settings.rows,
        )


def _covariance(slopes: np.ndarray) -> np.ndarray:
    """Invert the normal matrix of slopes (N, P) with columns of like size; inf for empty ones."""
    if not np.all(np.isfinite(slopes)):
        return np.full((slopes.shape[1],) * 2, np.inf)
    unit, size = unit_columns(slopes)
    normal = unit.T @ unit
    inverse = invert_normal(normal) / np.outer(size, size)
    # What the data do not depend on, they do not tell.
    unknown = ~(np.diag(normal) > 0)
    inverse[unknown, unknown] = np.inf
    return inverse


def _tame(z: np.ndarray) -> np.ndarray:
    """Leave rare outliers out of a sum of squares: those beyond six robust sizes."""
    if not len(z):
        return z
    out = np.abs(z) > FAR * robust_scale(z)
    return np.where(out, 0.0, z) if 0 < np.mean(out) < 0.02 else z


def _correlate(lanes: Sequence[np.ndarray]) -> tuple[float, bool]:
    """Correlation of neighbouring misses (rows, W), and whether Ljung and Box (1978) see any.

    >>> _correlate([np.sin(np.arange(50.0))[:, None]])[1]
    True
    """
    rows = sum(z.size for z in lanes)
    most = max(1, min(10, min((len(z) for z in lanes), default=0) // 5))
    total = sum(float(np.sum(z**2)) for z in lanes)
    if total == 0 or rows < 8:
        return 0.0, False
    found = [
        sum(float(np.sum(z[lag:] * z[:-lag])) for z in lanes) / total for lag in range(1, most + 1)
    ]
    statistic = sum(r**2 / (rows - lag) for lag, r in enumerate(found, 1)) * rows * (rows + 2)
    return found[0], bool(chdtrc(most, statistic) < 0.01)


def _where(followed: Followed, place: int) -> str:
    """Say where along the first run the residuals are largest, where that is clear."""
    z = followed.misses[0][:, place, :]
    t = followed.shootings[0].windows.t
    parts = np.array_split(np.arange(z.shape[0]), min(8, max(1, len(z) // 3)))
    told = followed.shootings[0].told[:, place]
    sizes = np.array(
        [
            [float(np.sum(z[p, lane] ** 2)) / max(np.sum(told[p, lane]), 1) for p in parts]
            for lane in range(z.shape[1])
        ]
    )
    lane, part = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    if sizes[lane, part] < 2.5 * float(np.mean(sizes)):
        return ""
    rows = parts[int(part)]
    begin, end = float(t[rows[0], lane]), float(t[rows[-1], lane])
    # Years need more digits than seconds from 0.
    digits = 3 + max(0, math.ceil(math.log10(max(abs(end), 1e-300) / np.ptp(t[:, lane]))))
    return f", mostly from t = {begin:.{digits}g} to {end:.{digits}g}"


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
