"""Scaling: data of huge or tiny numbers are searched in units that make them numbers near 1."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast
from warnings import warn

import numpy as np
import sympy
from threadpoolctl import threadpool_limits

from dynsr.data import Trajectory, in_formulas, read_sums, take_trajectories
from dynsr.discovery.apart import check_vary, search_apart
from dynsr.discovery.asked import check_asked
from dynsr.discovery.confirmation import confirm
from dynsr.discovery.delayed import check_delays, search_delayed
from dynsr.discovery.every_row import are_apart, on_every_row, take_windows
from dynsr.discovery.free import check_free, search_free
from dynsr.discovery.hidden import check_hidden, search_hidden
from dynsr.discovery.intervals import printed_order
from dynsr.discovery.problem import DISCOVERY
from dynsr.discovery.profile import Ends
from dynsr.discovery.provenance import with_provenance
from dynsr.discovery.result import Discovery, keep_if_asked, with_profiles
from dynsr.discovery.second_order import search_orders
from dynsr.discovery.start import Start
from dynsr.discovery.stochastic import check_stochastic, search_stochastic
from dynsr.discovery.uncertainty import check_ensemble, with_ensemble
from dynsr.discovery.unmeasured import coupling_of
from dynsr.discovery.unseen import search_stepped, take_steps
from dynsr.discovery.verdict import LAW, LEVELS
from dynsr.discovery.volumes import with_volumes
from dynsr.engines import DEFAULT_ENGINE, start_engine
from dynsr.errors import DynsrWarning, InputError
from dynsr.expression import counting, expand_terms, read_own_bits
from dynsr.fit import Candidate, ParetoFront, free_constants, loosen, read_inputs, tidy
from dynsr.jobs import Budget, finish_by

# Columns and spans of sizes up to this one, and down to one over it, are searched as they are.
_USUAL = 1e6
# Beyond these products of a few numbers and slopes leave float64.
_LARGEST = 1e50
# Share by which constants of one value are set apart.
_APART = 1e-9
# Whole numbers of more digits are written as floats.
_LONG = 1e12
# What settings say of the columns of the data.
_COLUMNS = ("time", "states", "trajectory", "quantity", "decimal", "doses", "noise", "limits")
_NAMING = (
    "targets", "hold", "known", "slopes", "order", "must", "constraints", "nonnegative", "units",
    "vary", "observed",
)  # fmt: skip
Search = TypeVar("Search", bound=Callable[..., Discovery])


@dataclass(frozen=True)
class Units:
    """Powers of ten in which times and columns are counted; 1 where their size is usual.

    Parameters
    ----------
    time : seconds.
    columns : column -> its unit.

    >>> t = np.linspace(0.0, 1.0, 11)
    >>> units = Units.of([Trajectory(t, 3e9 * np.exp(-t)[:, None], ("x",))])
    >>> units.columns["x"], str(units.restore_slope("x", -sympy.Symbol("x") ** 2))
    (1000000000, '-x**2/1000000000')
    """

    time: sympy.Rational
    columns: Mapping[str, sympy.Rational]

    @classmethod
    def of(cls, runs: Sequence[Trajectory]) -> Units:
        """Choose units for trajectories; raises InputError where float64 cannot hold products.

        A column is as large as its largest value, the time as the longest trajectory.
        """
        span = max(float(run.t[-1] - run.t[0]) for run in runs)
        sizes = {
            name: max(float(np.nanmax(np.abs(own))) for own in columns)
            for name, columns in _measured_columns(runs).items()
        }
        _check("the time", span)
        for name, size in sizes.items():
            _check(f"column {name!r}", size)
            _check(f"the slope of {name!r}", size / span)
        return cls(_unit(span), {name: _unit(size) for name, size in sizes.items()})

    @property
    def usual(self) -> bool:
        """Whether all units are 1."""
        return all(unit == 1 for unit in (self.time, *self.columns.values()))

    @property
    def words(self) -> str:
        """The units in words."""
        named = {"the time": self.time, **self.columns}
        some = [f"{name} of {float(unit):g}" for name, unit in named.items() if unit != 1]
        return "in units for " + ", ".join(some)

    def apply(self, run: Trajectory) -> Trajectory:
        """Give a trajectory in these units."""
        units = np.array([float(self.columns[name]) for name in run.names])
        columns, k = run.columns / units, len(run.states)
        t = run.t / float(self.time)
        sizes = {name: float(unit) for name, unit in self.columns.items()}
        noise = {s: own.in_units(sizes[s]) for s, own in run.noise.items()}
        sums = {s: own.in_units(sizes[s], sizes) for s, own in run.sums.items()}
        limits = {s: own.in_units(sizes[s]) for s, own in run.limits.items()}
        return replace(
            run,
            t=t,
            x=columns[:, :k],
            inputs=columns[:, k:],
            noise=noise,
            sums=sums,
            limits=limits,
        )

    def apply_value(self, name: str, expr: sympy.Expr) -> sympy.Expr:
        """Give an expression for a column in these units."""
        return self._inside(expr, 1) / self.columns[name]

    def apply_slope(self, state: str, expr: sympy.Expr) -> sympy.Expr:
        """Give an expression for the slope of a state in these units."""
        return self._inside(expr, 1) * self.time / self.columns[state]

    def restore_slope(self, state: str, expr: sympy.Expr) -> sympy.Expr:
        """Give an expression for a slope in the units of the data."""
        return expand_terms(self._inside(expr, -1) * self.columns[state] / self.time)

    def _inside(self, expr: sympy.Expr, power: int) -> sympy.Expr:
        named = {**self.columns, "t": self.time}
        return expr.xreplace(
            {sympy.Symbol(n): sympy.Symbol(n) * u**power for n, u in named.items()}
        )

    def restore(
        self, found: Discovery, runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr]
    ) -> Discovery:
        """Give a discovery in the units of the data.

        Parameters
        ----------
        found : in these units; its explanations say so.
        runs, inputs : the data as they were.
        """
        known = {s: self._restore_constants(s, found) for s in found.errors}
        return replace(
            found,
            equations={s: self._restore_equation(s, e) for s, e in found.equations.items()},
            errors={s: errors for s, (errors, _, _) in known.items()},
            fitted={s: middles for s, (_, middles, _) in known.items() if middles},
            profiled={s: ends for s, (_, _, ends) in known.items() if ends},
            front={s: self._restore_front(s, front) for s, front in found.front.items()},
            explanation={s: f"{why} ({self.words})" for s, why in found.explanation.items()},
            diffusion={
                s: own.in_units(s, self.columns, self.time) for s, own in found.diffusion.items()
            },
            trajectories=tuple(runs),
            inputs=dict(inputs),
            settings={
                **found.settings,
                "units": {"t": float(self.time), **{n: float(u) for n, u in self.columns.items()}},
            },
        )

    def _restore_equation(self, state: str, expr: sympy.Expr) -> sympy.Expr:
        restored = self.restore_slope(state, expr)
        long = [n for n in restored.atoms(sympy.Rational) if max(abs(n.p), n.q) >= _LONG]
        return tidy(restored.xreplace({n: sympy.Float(n) for n in long}))

    def _restore_front(self, state: str, front: ParetoFront) -> ParetoFront:
        factor = float(self.columns[state] / self.time)
        return ParetoFront(
            Candidate(self.restore_slope(state, c.expr), factor * c.loss, c.complexity, c.source)
            for c in front
        )

    def _restore_constants(
        self, state: str, found: Discovery
    ) -> tuple[tuple[tuple[float, float], ...], tuple[float, ...], tuple[Ends | None, ...]]:
        """Give (value, standard error) and fitted values in the order of the restored equation.

        Ends of profiles are in the order in which it is printed.

        Which constant became which is seen by moving one at a time.
        """
        pairs = found.errors[state]
        before = found.fitted.get(state) or [value for value, _ in pairs]
        template, values = free_constants(loosen(found.equations[state]), "constant ")
        restored = self.restore_slope(state, template)
        if len(values) != len(pairs) or len(before) != len(pairs):
            return (), (), ()
        # So that constants of one value stay two.
        apart = {s: v * (1 + _APART * i) for i, (s, v) in enumerate(values.items())}

        def read(moved: sympy.Symbol | None = None) -> tuple[sympy.Expr, dict[sympy.Symbol, float]]:
            put = {s: sympy.Float(v * (1 + 1e-3 * (s == moved))) for s, v in apart.items()}
            return free_constants(restored.xreplace(put), "constant ")

        shape, numbers = read()
        plain = np.array(list(numbers.values()))
        found_errors = [(float(value), np.inf) for value in plain]
        middles = plain.tolist()
        profiled = found.profiled.get(state) or [None] * len(pairs)
        places = dict(zip(printed_order(template, values), profiled, strict=True))
        ends: list[Ends | None] = [None] * len(plain)
        known = zip(apart.items(), pairs, before, strict=True)
        for i, ((symbol, own), (value, error), middle) in enumerate(known):
            moved = np.array(list(read(symbol)[1].values()))
            if len(moved) != len(plain) or not own:
                continue
            for place in np.flatnonzero(moved != plain):
                factor = float(plain[place]) / own
                found_errors[place] = value * factor, abs(factor) * error
                middles[place] = middle * factor
                ends[place] = _times(places[i], factor)
        if all(end is None for end in ends):
            return tuple(found_errors), tuple(middles), ()
        printed = tuple(ends[i] for i in printed_order(shape, numbers))
        return tuple(found_errors), tuple(middles), printed


def _times(ends: Ends | None, factor: float) -> Ends | None:
    if ends is None:
        return None
    low, high = sorted(end * factor for end in ends)
    return low, high


def in_fitting_units(search: Search) -> Search:
    """Let a search see its data in units in which they are of the size of 1.

    Parameters
    ----------
    search : takes data and, by name, ``inputs``, ``known``, ``slopes`` and ``engine`` among its
        settings.
    """

    @functools.wraps(search)
    def scaled(data: Any, **settings: Any) -> Discovery:
        # What cannot integrate is refused before the data are read.
        start_engine(settings.get("engine", DEFAULT_ENGINE))
        runs = _take(data, settings)
        runs = read_sums(runs, observed := settings.pop("observed", None))
        seed, discrete = settings.get("seed", 0), bool(settings.get("discrete"))
        members = check_ensemble(settings.pop("ensemble", False), runs, discrete)
        delays = settings.pop("delays", False)
        vary = check_vary(settings.pop("vary", False), runs, discrete)
        others = {"vary": vary, "delays": delays, "observed": observed, "ensemble": members}
        kind = _Kind.read(runs, settings, others)
        if any(run.limits for run in runs) and (kind.noisy or discrete):
            warn(
                "maps and noise in the motion: cells beyond a limit count as empty there",
                DynsrWarning,
                stacklevel=4,
            )
        uncut = bool(vary or kind.together or delays is not False or observed or members)
        stepped = take_steps(runs, settings["inputs"], settings, uncut)
        runs = list(stepped.runs)
        every, deciding = runs, settings.get("settings", DISCOVERY)
        check_asked(runs[0].states, seed, settings=deciding, slopes=settings.get("slopes"))
        # Where runs have constants of their own, a window would be another run, and the start of a
        # hidden state is a constant of a run. Maps and delays are not fitted to all rows later.
        sizes, unfitted = deciding.windows, discrete or delays is not False
        most = math.inf if vary or kind.uncut else sizes.block if unfitted else sizes.above
        runs, windows, settings["slopes"] = take_windows(
            runs, deciding.windows, settings.get("slopes"), most, discrete
        )
        bits = read_own_bits(settings.get("complexity"))
        until = Budget(settings.get("time_budget")).until(1.0)

        def one_search(some: Sequence[Trajectory], own: dict[str, Any]) -> Discovery:
            return _search_in(search, Units.of(some), some, own)

        # Its arrays are small: more threads than one only wait for each other.
        with counting(bits):
            with threadpool_limits(1):
                if delays is not False:
                    asked_delays = check_delays(delays, runs, settings, bool(vary))
                    drives = settings["inputs"]
                    found = search_delayed(one_search, runs, settings, asked_delays, drives)
                elif kind.together:
                    found = kind.search(one_search, runs, settings)
                elif vary:
                    found = search_apart(one_search, runs, settings, vary)
                elif windows or observed:
                    found = search_orders(one_search, runs, settings)
                else:
                    found, stepped = search_stepped(
                        functools.partial(search_orders, one_search),
                        stepped,
                        settings["inputs"],
                        settings,
                    )
                    runs = list(stepped.runs)
                found = with_provenance(found, runs, observed)
                found = finish_by(until, lambda: confirm(found), lambda: found)[0]
                found = finish_by(
                    until, lambda: on_every_row(found, every, windows, deciding), lambda: found
                )[0]
                sure, late = finish_by(
                    until,
                    lambda: with_volumes(with_profiles(found, deciding.profile)),
                    lambda: found,
                )
            whole, cut = finish_by(until, lambda: with_ensemble(sure, members, seed), lambda: sure)
            ended = ["profiles"] * late + ["ensemble"] * bool(members and cut)
            if ended:
                ended = [*whole.settings.get("ended_by_budget", ()), *ended]
                whole = replace(whole, settings={**whole.settings, "ended_by_budget": ended})
            return _keep_fitted(stepped.say(whole), settings.get("out"))

    return cast("Search", scaled)


def _take(data: Any, settings: dict[str, Any]) -> list[Trajectory]:
    """Read the data; the settings lose what is said of their columns, and name them as formulas."""
    asked = {name: settings.pop(name, None) for name in _COLUMNS}
    asked["hold"] = settings.get("hold")
    runs, settings["inputs"] = take_trajectories(data, settings.get("inputs"), **asked)
    settings |= {n: in_formulas(settings[n], runs[0]) for n in _NAMING if n in settings}
    return runs


@dataclass(frozen=True)
class _Kind:
    """What is fitted together with the equations: a hidden state, noise in the motion, free parts.

    Parameters
    ----------
    hidden : the name of a state that was not measured; "" for none.
    noisy : whether the motion has noise.
    free : whether known equations have free functions.
    """

    hidden: str
    noisy: bool
    free: bool

    @classmethod
    def read(
        cls, runs: Sequence[Trajectory], settings: dict[str, Any], others: Mapping[str, Any]
    ) -> _Kind:
        """Take what is asked for; raises InputError for what does not go together."""
        noisy, asked = settings.pop("stochastic", False), settings.pop("hidden", False)
        hidden = check_hidden(asked, runs, settings, {**others, "stochastic": noisy})
        others = {**others, "hidden": hidden}
        noisy = check_stochastic(noisy, runs, settings, others)
        return cls(hidden, noisy, check_free(settings, others))

    @property
    def together(self) -> bool:
        """Whether there is any of these."""
        return bool(self.hidden or self.noisy or self.free)

    @property
    def uncut(self) -> bool:
        """Whether all rows are searched, however many there are."""
        return bool(self.hidden or self.noisy)

    def search(
        self,
        search: Callable[[Sequence[Trajectory], dict[str, Any]], Discovery],
        runs: Sequence[Trajectory],
        settings: dict[str, Any],
    ) -> Discovery:
        """Search with it."""
        if self.noisy:
            return _search_stochastic_in(Units.of(runs), runs, settings)
        if self.hidden:
            return _search_both(search, runs, settings, self.hidden)
        return search_free(search, runs, settings, _sizes_in(Units.of(runs)))


def _search_in(
    search: Search, units: Units, runs: Sequence[Trajectory], settings: dict[str, Any]
) -> Discovery:
    """Search in the units given."""
    if units.usual:
        return search(runs, **settings)
    if settings.get("start") is not None:
        begun = Start.read(settings["start"])
        settings["start"] = begun.rewrite(
            # Columns that these data lack are refused later.
            lambda s, e: units.apply_slope(s, e) if s in units.columns else e
        )
    drives = settings["inputs"]
    given = read_inputs(settings.get("known") or {}, (*runs[0].names, "t"))
    settings["known"] = {s: units.apply_slope(s, e) for s, e in given.items()}
    settings["inputs"] = {n: units.apply_value(n, e) for n, e in drives.items()}
    settings["slopes"] = {
        s: _scale(own, float(units.time / units.columns[s]))
        for s, own in (settings.get("slopes") or {}).items()
    }
    found = search([units.apply(run) for run in runs], **settings)
    return units.restore(found, runs, drives)


def _keep_fitted(found: Discovery, out: str | Path | None) -> Discovery:
    """Keep volumes, and what all rows say in the place of what the windows said."""
    record = found.settings
    later = found.volumes or record.get("windows", {}).get("fitted") or "unseen_steps" in record
    keep_if_asked(found, out if later else None)
    return found


def _search_both(
    search: Callable[[Sequence[Trajectory], dict[str, Any]], Discovery],
    runs: Sequence[Trajectory],
    settings: dict[str, Any],
    name: str,
) -> Discovery:
    """Search with a hidden state, and without one where that gives no law; the better verdict."""
    budget = Budget(settings.get("time_budget"))
    found = _search_hidden_in(Units.of(runs), runs, settings, name)
    if found is not None and (found.verdict.level == LAW or not found.complete):
        alone = None
    else:
        alone = search(runs, {**settings, "out": None, "time_budget": budget.rest()})
    best = _better(found, alone, name)
    keep_if_asked(best, settings.get("out"))
    return best


def _better(found: Discovery | None, alone: Discovery | None, name: str) -> Discovery:
    """Give the discovery of the better verdict, that with the hidden state if they are alike."""
    if alone is None:
        assert found is not None
        return found
    levels = [one.verdict.level for one in (found, alone) if one is not None]
    if found is not None and LEVELS.index(levels[0]) <= LEVELS.index(levels[1]):
        return found
    sure = alone.verdict.level == LAW
    said = f" No {name} is needed." if sure else f" Equations with {name} are no better."
    return replace(alone, explanation={s: why + said for s, why in alone.explanation.items()})


def _search_hidden_in(
    units: Units, runs: Sequence[Trajectory], settings: dict[str, Any], name: str
) -> Discovery | None:
    """Search with a hidden state, in a unit in which its chosen factor stays 1 or -1.

    None where the data need none.
    """
    drives, progress = settings["inputs"], settings.get("progress")
    progress = progress if callable(progress) else None
    if units.usual:
        return search_hidden(runs, settings, name, drives, progress)
    own = {n: units.apply_value(n, e) for n, e in drives.items()}
    found = search_hidden([units.apply(run) for run in runs], settings, name, own, progress)
    if found is None:
        return None
    coupling = coupling_of(name, found.hidden[name], found.equations)
    sizes = {sympy.Symbol(n): unit for n, unit in units.columns.items()}
    unit = units.columns[coupling.state] / units.time / coupling.body.xreplace(sizes)
    wider = replace(units, columns={**units.columns, name: unit})
    pairs = zip(runs, found.trajectories, strict=True)
    whole = [
        replace(
            made,
            t=run.t,
            x=np.column_stack([run.observed, made.x[:, -1] * float(unit)]),
            inputs=run.inputs,
            noise=run.noise,
            limits=run.limits,
        )
        for run, made in pairs
    ]
    restored = wider.restore(found, whole, drives)
    before, now = found.hidden_notes[name], restored.hidden_notes[name]
    said = {**restored.explanation, name: restored.explanation[name].replace(before, now)}
    return replace(restored, explanation=said)


def _search_stochastic_in(
    units: Units, runs: Sequence[Trajectory], settings: dict[str, Any]
) -> Discovery:
    """Search drift and diffusion in the units given."""
    drives, progress = settings["inputs"], settings.get("progress")
    progress = progress if callable(progress) else None
    if units.usual:
        found = search_stochastic(runs, settings, drives, progress)
    else:
        own = {n: units.apply_value(n, e) for n, e in drives.items()}
        scaled = [units.apply(run) for run in runs]
        found = units.restore(search_stochastic(scaled, settings, own, progress), runs, drives)
    keep_if_asked(found, settings.get("out"))
    return found


def _sizes_in(units: Units) -> dict[str, sympy.Rational]:
    """Give the unit of each column and of the time."""
    return {**units.columns, "t": units.time}


def _measured_columns(runs: Sequence[Trajectory]) -> dict[str, list[np.ndarray]]:
    """Column -> its values in each run that has any."""
    columns = [np.column_stack([run.observed, run.inputs]) for run in runs]
    return {
        name: [own[:, i] for own in columns if not np.all(np.isnan(own[:, i]))]
        for i, name in enumerate(runs[0].names)
    }


def _scale(own: Any, factor: float) -> Any:
    """Scale one array of slopes, or one a trajectory."""
    if are_apart(own):
        return [np.asarray(part, dtype=float) * factor for part in own]
    return np.asarray(own, dtype=float) * factor


def _unit(size: float) -> sympy.Rational:
    if size == 0 or 1 / _USUAL <= size <= _USUAL:
        return sympy.S.One
    return sympy.Integer(10) ** math.floor(math.log10(size))


def _check(what: str, size: float) -> None:
    if size != 0 and not 1 / _LARGEST <= size <= _LARGEST:
        raise InputError(
            f"{what} is of the size of {size:.3g}, too far from 1 to compute with in float64; give "
            f"it in a unit in which it lies between {1 / _LARGEST:g} and {_LARGEST:g}"
        )
