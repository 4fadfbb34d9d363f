"""Drift along noisy trajectories: formulas with the time compared with equations that follow.

What a term would change is integrated along the fitted trajectories, all terms of all states at
once; the most probable formulas are then fitted to the trajectories with all constants and starts.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy
from scipy.integrate import cumulative_trapezoid

from dynsr.data import robust_scale
from dynsr.expression import evaluate
from dynsr.fit import DEPENDENT, Flow, Shooting, cauchy_weights, orthogonal, same_form, unit_columns
from dynsr.library import Place
from dynsr.methods import recalled
from dynsr.verdict.alternatives import columns_along
from dynsr.verdict.drift import (
    DRIFT,
    TIME,
    Drift,
    DriftSettings,
    Lines,
    TermsInTime,
    formula_bits,
    is_timed,
    say,
)
from dynsr.verdict.following import FAR, LEAST_SQUARE, Course, Followed, open_constants

# Shares of a step that are tried, and the share by which a fit that goes on becomes better.
_SHARES, _GAIN = (1.0, 0.5, 0.1), 1e-4


@dataclass(frozen=True)
class _Compared:
    """A formula with its fitted constants, the bits it takes more, and those that data save."""

    expr: sympy.Expr
    bits: float
    gain: float


@dataclass(frozen=True, eq=False)
class Along:
    """Equations that were followed along trajectories, against which others are tried.

    Parameters
    ----------
    equations : state -> right-hand side.
    followed : these equations, fitted to the trajectories.
    course : the trajectories.
    windows : windows that a run is cut into, at most.
    settings : which terms are tried.
    fixed : terms whose factors are known.
    """

    equations: Mapping[str, sympy.Expr]
    followed: Followed
    course: Course
    windows: int
    settings: DriftSettings = DRIFT
    fixed: Collection[sympy.Expr] = ()

    def look(self, states: Collection[str], weak: Collection[str] = ()) -> dict[str, Drift]:
        """Give for states the formula that takes fewer bits than the equation, where one does.

        Parameters
        ----------
        states : those that are looked at.
        weak : those of them whose equation is so far off that slopes along it say little.
        """
        found: dict[str, Drift] = {}
        asked = [state for state in self.equations if state in states]
        here = self
        # One equation that drifts is missed by all others: what they want beside it is their own.
        while asked:
            best = here._best(asked, weak)
            if not best:
                break
            first = min(best, key=lambda state: best[state].bits)
            found[first] = best[first]
            here = replace(here, equations={**here.equations, first: best[first].expr})
            asked = [state for state in best if state != first]
        return found

    def _best(self, states: Collection[str], weak: Collection[str]) -> dict[str, Drift]:
        now = self.fit(self.equations)
        if now is None:
            return {}
        columns = self._columns()
        libraries = {
            s: TermsInTime.of(s, self.equations[s], columns, self.settings) for s in states
        }
        found = {}
        for state, lines in self._lines(libraries, now).items():
            library, expr = libraries[state], self.equations[state]
            others = lines.propose(expr, library)
            if state in weak:
                others += self._integrals(state, library).propose(expr, library)
            tried = [self._compare(library.place, one, now) for one in others]
            best = min(filter(None, tried), key=lambda one: one.bits, default=None)
            if best is not None and best.bits < 0:
                found[state] = self._say(state, self._prune(library.place, best, now))
        return found

    def _compare(self, place: Place, expr: sympy.Expr, now: Followed) -> _Compared | None:
        """Fit a formula of a state; None where it is of the equation's form or does not follow."""
        state, own = place.state, self.equations[place.state]
        if same_form(expr, own):
            return None
        fitted = self.fit({**self.equations, state: expr})
        if fitted is None:
            return None
        opened, places = open_constants({**self.equations, state: expr}, self.fixed)
        numbers = dict(zip(places, map(sympy.Float, fitted.constants), strict=True))
        rows = fitted.independent
        gain = float(rows @ np.log2(_squares(now) / _squares(fitted))) / 2
        most = float(rows.max())
        return _Compared(
            opened[state].xreplace(numbers),
            formula_bits(expr, most, place) - formula_bits(own, most, place) - gain,
            gain,
        )

    def _prune(self, place: Place, best: _Compared, now: Followed) -> _Compared:
        """Take terms out that do not pay: lines along another formula may have asked for them."""
        while True:
            terms = sympy.Add.make_args(best.expr)
            fewer = [sympy.Add(*terms[:i], *terms[i + 1 :]) for i in range(len(terms))]
            # A function that hardly changes is a constant.
            fewer += [
                best.expr - term + term.xreplace({TIME: self._middle})
                for term in terms
                if term.free_symbols == {TIME}
            ]
            tried = [self._compare(place, one, now) for one in fewer if one != 0]
            less = min(filter(None, tried), key=lambda one: one.bits, default=None)
            if less is None or less.bits >= best.bits:
                return best
            best = less

    def _say(self, state: str, best: _Compared) -> Drift:
        times = np.concatenate([run.t for run in self.course.runs])
        said = say(state, best.expr, self.equations[state], times, best.gain)
        return Drift(best.expr, best.bits, said, is_timed(best.expr, self.equations[state]))

    @property
    def _middle(self) -> sympy.Expr:
        return sympy.Float(float(np.median(np.concatenate([run.t for run in self.course.runs]))))

    @property
    def _driven(self) -> tuple[str, ...]:
        names = dict.fromkeys([*self.course.runs[0].names, *self.course.inputs])
        return tuple(name for name in names if name not in self.equations)

    def _columns(self) -> dict[str, np.ndarray]:
        """Name -> (n,) values of all columns along the fitted trajectories, and the times."""
        flow = Flow(dict(self.equations), self._driven, ())
        return columns_along(self._shoot(flow), self.followed.misses)

    def _shoot(self, flow: Flow) -> list[Shooting]:
        """Cut the runs into the windows that the equations were followed over, for a flow."""
        cut = self.course.shoot(flow, self.followed.length, self.windows)
        pairs = zip(cut, self.followed.shootings, strict=True)
        return [replace(new, pace=old.pace) for new, old in pairs]

    def _lines(self, libraries: Mapping[str, TermsInTime], now: Followed) -> dict[str, Lines]:
        """Give the linear view of each equation, with the terms of its library."""
        opened, places = open_constants(self.equations, self.fixed)
        states, first = list(self.equations), len(places)
        probes: list[tuple[int, sympy.Expr]] = []
        begin, put = {}, dict(zip(places, map(sympy.Float, now.constants), strict=True))
        for state, library in libraries.items():
            begin[state] = first + len(probes)
            row, every = states.index(state), (*library.terms, *library.inside)
            probes += [(row, term) for term in (*every, opened[state].xreplace(put))]
        symbols = tuple(sympy.Symbol(f"probe {i}") for i in range(len(probes)))
        flow = Flow(opened, self._driven, (*places, *symbols), probes=tuple(probes))
        probed = replace(
            now,
            shootings=tuple(self._shoot(flow)),
            constants=np.array([*now.constants, *np.zeros(len(probes))]),
        )
        with np.errstate(all="ignore"):
            z, slopes, owners = probed.linearise()
        if not np.all(np.isfinite(slopes)):
            return {}
        for place in range(len(states)):
            mine = owners == place
            if not np.any(mine):
                continue
            far = mine & (np.abs(z) > FAR * robust_scale(z[mine]))
            level = math.sqrt(max(float(np.mean(z[mine & ~far] ** 2)), LEAST_SQUARE))
            z[mine], slopes[mine] = z[mine] / level, slopes[mine] / level
            z[far], slopes[far] = 0.0, 0.0
        starts = np.arange(first + len(probes), slopes.shape[1])
        owned = [place.state for place in places.values()]
        found = {}
        for state, library in libraries.items():
            others = [i for i in range(first) if owned[i] != state]
            mine_too = [i for i in range(first) if owned[i] == state]
            last = begin[state] + len(library.terms) + len(library.inside)
            basis = orthogonal(slopes[:, [*others, *starts]])
            asked = np.column_stack(
                [-z, slopes[:, last], slopes[:, mine_too], slopes[:, begin[state] : last]]
            )
            left = asked - basis @ (basis.T @ asked)
            count = 2 + len(mine_too)
            found[state] = Lines(
                left[:, 0],
                left[:, 0] + left[:, 1],
                left[:, 2:count],
                left[:, count:],
                len(z),
            )
        return found

    def _integrals(self, state: str, library: TermsInTime) -> Lines:
        """Give the linear view of an equation along the measured rows, integrated over the time.

        Noise is in the integrals too, but no error of other equations is.
        """
        parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        place = self.course.states.index(state)
        for run, noise in zip(self.course.runs, self.course.noise, strict=True):
            columns = {**run.by_name, "t": run.t}
            columns |= {n: evaluate(e, {"t": run.t}) for n, e in self.course.inputs.items()}
            exprs = (self.equations[state], *library.terms, *library.inside)
            slopes = np.array([np.broadcast_to(evaluate(e, columns), len(run)) for e in exprs])
            whole = cumulative_trapezoid(slopes, run.t, axis=1, initial=0).T
            x = run.by_name[state][:, None]
            # Where a run begins is free.
            weights = 1 / noise[:, [place]]
            begin = weights / np.linalg.norm(weights)
            both = np.column_stack([x, whole]) * weights
            both -= begin @ (begin.T @ both)
            parts.append((both[:, 0], both[:, 1], both[:, 2:]))
        target, own, design = (np.concatenate(some) for some in zip(*parts, strict=True))
        rows = sum(int(np.sum(np.isfinite(own[:, place]))) for own in self.course.noise)
        return Lines(target - own, target, np.zeros((len(target), 0)), design, rows)

    def refit(self, equations: Mapping[str, sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give equations with the constants that fit the trajectories best, where a fit ends.

        Parameters
        ----------
        equations : state -> right-hand side.
        """
        fitted = self.fit(equations)
        if fitted is None:
            return dict(equations)
        opened, places = open_constants(equations, self.fixed)
        put = dict(zip(places, map(sympy.Float, fitted.constants), strict=True))
        return {state: expr.xreplace(put) for state, expr in opened.items()}

    def fit(self, equations: Mapping[str, sympy.Expr]) -> Followed | None:
        """Fit all constants and starts of equations; None where they cannot be integrated.

        Parameters
        ----------
        equations : state -> right-hand side.
        """
        opened, places = open_constants(equations, self.fixed)
        flow = Flow(opened, self._driven, tuple(places))
        shootings = tuple(self._shoot(flow))
        values = np.array([place.value for place in places.values()])
        # Where the equations diverge their starts are nowhere.
        starts = [
            np.where(np.isfinite(found), found, s.starts)
            for s, found in zip(shootings, self.followed.starts, strict=True)
        ]

        def make() -> list[np.ndarray] | None:
            now = self._descend(_follow(self.followed, shootings, values, starts))
            return [now.constants, *now.starts, *now.misses] if now.finite else None

        data = [
            (s.windows.t, s.windows.x, s.windows.driven_at(s.pace), s.spread, s.pace, s.flow.stride)
            for s in shootings
        ]
        found = recalled("drift", make, opened, self._driven, values, starts, data)
        if found is None:
            return None
        constants, *rest = found
        count = len(shootings)
        begun, misses = tuple(rest[:count]), tuple(rest[count:])
        return Followed(shootings, constants, begun, misses, self.followed.length)

    def _descend(self, now: Followed) -> Followed:
        """Take steps for as long as they gain."""
        for _ in range(self.settings.rounds):
            better = _step(now) if now.finite else None
            if better is None:
                break
            before, now = now, better
            if _total(before) - _total(now) < _GAIN * _total(before):
                break
        return now


def _step(now: Followed) -> Followed | None:
    """Take one step of Gauss and Newton, shortened until it gains; None where nothing does."""
    with np.errstate(all="ignore"):
        z, slopes, _ = now.linearise()
    if not np.all(np.isfinite(slopes)):
        return None
    unit, size = unit_columns(slopes)
    root = np.sqrt(cauchy_weights(z, FAR))
    move = -np.linalg.lstsq(unit * root[:, None], z * root, rcond=DEPENDENT)[0] / size
    count, k = len(now.constants), len(now.starts[0])
    for share in _SHARES:
        step, first, starts = share * move, count, []
        for own in now.starts:
            lanes = step[first : first + own.size].reshape(-1, k).T
            starts.append(own + lanes)
            first += own.size
        with np.errstate(all="ignore"):
            trial = _follow(now, now.shootings, now.constants + step[:count], starts)
        if trial.finite and _total(trial) < _total(now):
            return trial
    return None


def _follow(
    like: Followed,
    shootings: Sequence[Shooting],
    constants: np.ndarray,
    starts: Sequence[np.ndarray],
) -> Followed:
    with np.errstate(all="ignore"):
        misses = [s.misses(constants, at) for s, at in zip(shootings, starts, strict=True)]
    return Followed(tuple(shootings), constants, tuple(starts), tuple(misses), like.length)


def _total(followed: Followed) -> float:
    """Sum of the squares of residuals, of which those far off count little."""
    return float(sum(np.sum(FAR**2 * np.log1p((z / FAR) ** 2)) for z in followed.misses))


def _squares(followed: Followed) -> np.ndarray:
    """(k,) mean size of the squares of residuals, of which those far off count little."""
    total = sum(np.sum(FAR**2 * np.log1p((z / FAR) ** 2), axis=(0, 2)) for z in followed.misses)
    return np.asarray(total / np.maximum(followed.counts, 1))
