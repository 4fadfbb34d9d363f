"""Scaling: data of huge or tiny numbers are searched in units that make them numbers near 1."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy

from dynsr.data import RADIAN, Trajectory, carry, is_in_degrees
from dynsr.discovery.every_row import are_apart
from dynsr.discovery.hidden import search_hidden
from dynsr.discovery.options import Options, Search
from dynsr.discovery.orders import form_of
from dynsr.discovery.result import Discovery
from dynsr.discovery.start import Start
from dynsr.discovery.unmeasured import coupling_of
from dynsr.errors import InputError
from dynsr.expression import expand_terms, free_constants, parse
from dynsr.fit import (
    Candidate,
    ParetoFront,
    loosen,
    read_inputs,
    tidy,
)
from dynsr.parameters import Ends, printed_order
from dynsr.verdict import OtherFormula, Verdict

# Columns and spans of sizes up to this one, and down to one over it, are searched as they are.
_USUAL = 1e6
# Beyond these products of a few numbers and slopes leave float64.
_LARGEST = 1e50
# Share by which constants of one value are set apart.
_APART = 1e-9
# Whole numbers of more digits are written as floats.
_LONG = 1e12


@dataclass(frozen=True)
class Units:
    """Powers of ten in which times and columns are counted; 1 where their size is usual.

    What is in degrees is counted in radians, in which sines and their slopes are of one size.

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
        said = runs[0].origin.get("units") or {}
        radian = sympy.Rational(RADIAN)
        radians = {n: radian if is_in_degrees(said.get(n, "")) else sympy.S.One for n in sizes}
        return cls(_unit(span), {n: own * _unit(sizes[n] / own) for n, own in radians.items()})

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

    def apply_values(self, exprs: Mapping[str, sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give expressions for columns, by their names, in these units."""
        return {name: self.apply_value(name, expr) for name, expr in exprs.items()}

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
        form = form_of(found.settings)
        own = {v: self.columns[s] / self.time for s, v in form.velocities.items()}
        whole = replace(self, columns={**self.columns, **own})
        if own:
            runs = [run.as_measured() for run in form.prepare(carry(runs))]
        restored = whole.restore_columns(found, runs, inputs)
        units = {"t": float(self.time), **{n: float(u) for n, u in self.columns.items()}}
        return replace(restored, settings={**found.settings, "units": units})

    def restore_columns(
        self, found: Discovery, runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr]
    ) -> Discovery:
        """Give a discovery in the units of the data, all of whose columns have one here.

        Parameters
        ----------
        found, runs, inputs : as for :meth:`restore`, with velocities in the runs.
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
            verdict=self._restore_verdict(found.verdict),
            trajectories=tuple(runs),
            inputs=dict(inputs),
        )

    def _restore_equation(self, state: str, expr: sympy.Expr) -> sympy.Expr:
        restored = self.restore_slope(state, expr)
        long = [n for n in restored.atoms(sympy.Rational) if max(abs(n.p), n.q) >= _LONG]
        return tidy(restored.xreplace({n: sympy.Float(n) for n in long}))

    def _restore_verdict(self, verdict: Verdict) -> Verdict:
        """Give other formulas and the span in the units of the data, and say those of the words."""
        states = {
            s: replace(
                own,
                reason=self._said(own.reason),
                alternatives=tuple(
                    OtherFormula.of(self._restore_equation(s, parse(a.equation)), a.bits)
                    for a in own.alternatives
                ),
            )
            for s, own in verdict.states.items()
        }
        span = verdict.span * float(self.time)
        return replace(verdict, reason=self._said(verdict.reason), states=states, span=span)

    def _said(self, reason: str) -> str:
        """Give a reason, with the units of its numbers where it has any."""
        return f"{reason} ({self.words})" if re.search(r"\d", reason) else reason

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


def search_in_units(
    search: Search, units: Units, runs: Sequence[Trajectory], options: Options
) -> Discovery:
    """Search in the units given.

    Parameters
    ----------
    search, units : finds equations of trajectories, and the units that these are given in.
    runs, options : the data, and what is asked of them.
    """
    if units.usual:
        return search(runs, options)
    begun = options.start
    if begun is not None:
        begun = Start.read(begun).rewrite(
            # Columns that these data lack are refused later.
            lambda s, e: units.apply_slope(s, e) if s in units.columns else e
        )
    given = read_inputs(options.known or {}, (*runs[0].names, "t"))
    scaled = replace(
        options,
        start=begun,
        known={s: units.apply_slope(s, e) for s, e in given.items()},
        inputs=units.apply_values(options.drives),
        slopes={
            s: _scale(own, float(units.time / units.columns[s]))
            for s, own in (options.slopes or {}).items()
        },
    )
    return units.restore(search([units.apply(r) for r in runs], scaled), runs, options.drives)


def hidden_in_units(
    units: Units, runs: Sequence[Trajectory], options: Options, name: str
) -> Discovery | None:
    """Search with a hidden state, in a unit in which its chosen factor stays 1 or -1.

    Parameters
    ----------
    units, runs, options : as for :func:`search_in_units`.
    name : of the hidden state.

    None where the data need none.
    """
    if units.usual:
        return search_hidden(runs, options, name)
    drives = options.drives
    scaled = replace(options, inputs=units.apply_values(drives))
    found = search_hidden([units.apply(run) for run in runs], scaled, name)
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
