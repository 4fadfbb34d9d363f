"""Hidden: a state that nobody measured, found together with its equation.

Where x' = f(x) + a(x) h, the slope of x shows h but for f: h = x'/a(x) is a first curve of it, and
h' = g(x, h) is then proposed by the library as any other equation; the joint fit of states and
constants, in which h is free, scores the system. The same x is followed by h + p(x) in the place of
h, for every p: of these ways to write one law, that of the fewest bits is taken. The factor of h
cannot be known either: it is 1 or -1. What the data determine is the equation of x'' in x and x'
alone, in which h is eliminated; by that two systems are compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, combinations

import numpy as np
import sympy

from dynsr.data import SmoothedTrajectory, Trajectory, scale_of
from dynsr.expression import differentiate, evaluate, expand_terms, skeleton
from dynsr.fit import CollocationSettings, Measurements, Mesh
from dynsr.library import Written
from dynsr.selection.alone import Alone
from dynsr.selection.changes import prune_each
from dynsr.selection.comparison import (
    ComparisonSettings,
    Equations,
    SystemComparison,
    SystemFit,
    apart_by,
    shuffle,
)
from dynsr.selection.rates import SIGMA
from dynsr.selection.renewal import renew
from dynsr.selection.shapes import bare_terms, rounded
from dynsr.selection.terms import products


@dataclass(frozen=True)
class HiddenSettings:
    """The numbers that decide a hidden state; they are in a discovery's record.

    Parameters
    ----------
    degree : most columns in a product that the hidden state is multiplied with.
    couplings : such products, those of the fewest bits first, for each state.
    improved : couplings that are followed to the end, the best first.
    rounds : times that systems are written otherwise, and their equations proposed again.
    written, pruned : systems that are written otherwise each time, the best of those that come
        close, and ways of these that lose the terms that do not pay.
    aside : rms difference of two laws as a multiple of that along the data, where each column takes
        any of its values.
    """

    degree: int = 2
    couplings: int = 6
    improved: int = 3
    rounds: int = 4
    written: int = 4
    pruned: int = 6
    aside: float = 5.0


HIDDEN: HiddenSettings = HiddenSettings()


@dataclass(frozen=True)
class Coupling:
    """Where a hidden state enters: one term of the equation of one state.

    Parameters
    ----------
    name : of the hidden state.
    state : in whose equation it is.
    body : what it is multiplied with, 1 or a product of columns.
    sign : 1 or -1; another factor where a user chose one.

    >>> x = sympy.Symbol("x")
    >>> Coupling("y", "x", x).keeps(1.1 * x - x * sympy.Symbol("y"))
    False
    """

    name: str
    state: str
    body: sympy.Expr = sympy.S.One
    sign: sympy.Expr = sympy.S.One

    @property
    def symbol(self) -> sympy.Symbol:
        """The hidden state."""
        return sympy.Symbol(self.name)

    @property
    def term(self) -> sympy.Expr:
        """The term."""
        return self.sign * self.body * self.symbol

    @property
    def slope(self) -> sympy.Symbol:
        """The slope of the state."""
        return sympy.Symbol(f"{self.state}'")

    def keeps(self, expr: sympy.Expr) -> bool:
        """Whether the hidden state is in an equation by this term alone.

        Parameters
        ----------
        expr : the equation of the state.
        """
        rest = expand_terms(expr) - self.term
        return self.symbol not in expand_terms(rest).free_symbols

    def sized(self, mesh: Mesh) -> Mesh:
        """Give a mesh in which the hidden state is followed as closely as its term asks for.

        Where the factor of the hidden state is large, a small part of it moves the state that
        shows it.
        """
        factor = np.abs(np.broadcast_to(evaluate(self.body, mesh.columns), len(mesh.t)))
        place, sizes = mesh.states.index(self.name), np.full(mesh.start.shape, np.inf)
        term = scale_of(factor * mesh.start[:, place])
        sizes[:, place] = np.divide(term, factor, out=sizes[:, place], where=factor > 0)
        return replace(mesh, sizes=sizes)

    def rest(self, exprs: Mapping[str, sympy.Expr]) -> sympy.Expr:
        """Give the equation of the state without this term."""
        return expand_terms(expand_terms(exprs[self.state]) - self.term)

    def turned(self, exprs: Equations) -> tuple[Coupling, Equations]:
        """Give the same system with the other sign of the hidden state."""
        other = {s: expand_terms(e.subs(self.symbol, -self.symbol)) for s, e in exprs.items()}
        other[self.name] = expand_terms(-other[self.name])
        return replace(self, sign=-self.sign), other

    def shifted(self, exprs: Equations, shift: sympy.Expr) -> Equations | None:
        """Give the same system with the hidden state less a function of the others in its place.

        Parameters
        ----------
        exprs : the system.
        shift : the function p: the new hidden state is the old one less p. None where its slope is
            not one of the system.
        """
        columns = {str(s) for s in shift.free_symbols}
        if not columns <= exprs.keys() - {self.name}:
            return None
        moved = {s: e.subs(self.symbol, self.symbol + shift) for s, e in exprs.items()}
        slope = sum(differentiate(shift, sympy.Symbol(s)) * moved[s] for s in columns)
        moved[self.name] = moved[self.name] - slope
        return {s: _without_rounding(expand_terms(e)) for s, e in moved.items()}


def law_of(exprs: Mapping[str, sympy.Expr], coupling: Coupling) -> Equations | None:
    """Give what the data determine: the system with the slope of a state for the hidden one.

    None where the hidden state is not seen in the slope of this state, or not by a factor alone.

    Parameters
    ----------
    exprs : the system.
    coupling : where the hidden state enters.

    >>> x, y = sympy.symbols("x y")
    >>> law_of({"x": y, "y": -4 * x}, Coupling("y", "x"))
    {'y': -4*x}
    >>> law_of({"x": y + sympy.Symbol("u"), "y": -4 * x}, Coupling("y", "x"))
    {'y': u' - 4*x}
    """
    mine, hidden = exprs[coupling.state], coupling.symbol
    factor = expand_terms(differentiate(mine, hidden))
    if factor == 0 or hidden in factor.free_symbols:
        return None
    known = {hidden: (coupling.slope - mine.subs(hidden, 0)) / factor}
    turned = _slope_along(mine, exprs)
    others = {s: e for s, e in exprs.items() if s not in (coupling.state, coupling.name)}
    law = {**others, coupling.name: turned}
    return {s: expand_terms(e.xreplace(known)) for s, e in law.items()}


def write_law(law: Equations, exprs: Mapping[str, sympy.Expr], coupling: Coupling) -> Equations:
    """Give a law as a system in which the equation of the seen state is that of another system.

    Parameters
    ----------
    law : what :func:`law_of` gave.
    exprs : the other system.
    coupling : where the hidden state enters in it.

    >>> x, y = sympy.symbols("x y")
    >>> write_law({"y": -4 * x}, {"x": y - x, "y": x}, Coupling("y", "x"))
    {'x': -x + y, 'y': -5*x + y}
    """
    state, name, mine = coupling.state, coupling.name, exprs[coupling.state]
    slopes = {s: e.xreplace({coupling.slope: mine}) for s, e in law.items()}
    slope = slopes.pop(name)
    found = {**slopes, state: mine}
    slope -= _slope_along(mine, {**found, name: sympy.S.Zero})
    found[name] = expand_terms(slope / (coupling.sign * coupling.body))
    return {s: expand_terms(found[s]) for s in exprs}


def _slope_along(expr: sympy.Expr, slopes: Mapping[str, sympy.Expr]) -> sympy.Expr:
    """Give the slope of an expression where some columns have these slopes; u' is that of u."""
    others = {str(s) for s in expr.free_symbols} - slopes.keys()
    own = {n: sympy.S.One if n == "t" else sympy.Symbol(f"{n}'") for n in sorted(others)}
    every = {**slopes, **own}
    return sympy.Add(*(differentiate(expr, sympy.Symbol(n)) * e for n, e in every.items()))


def _without_rounding(expr: sympy.Expr) -> sympy.Expr:
    """Leave out terms that are only what rounding left of two that are equal."""
    terms = sympy.Add.make_args(expr)
    sizes = [abs(float(term.as_coeff_Mul()[0])) for term in terms]
    least = np.finfo(float).eps * max(sizes, default=0.0)
    return sympy.Add(*(t for t, size in zip(terms, sizes, strict=True) if size > least))


@dataclass(frozen=True, eq=False)
class HiddenComparison(SystemComparison):
    """Fits systems in which a hidden state enters by one term alone."""

    coupling: Coupling = field(kw_only=True)

    @property
    def _how(self) -> CollocationSettings:
        # The first curve of a hidden state is rough: it takes all steps of each stage. With defects
        # of any size it would follow whatever the others leave.
        return replace(self.settings.fit, early=self.settings.fit.gain, loose=0.0)

    def fit(self, exprs: Equations, near: SystemFit | None = None) -> SystemFit | None:
        """Fit every constant and start; None where the system is not one of these."""
        if not self.coupling.keeps(exprs[self.coupling.state]):
            return None
        return super().fit(exprs, near)

    def fit_near(self, exprs: Equations, near: SystemFit) -> SystemFit | None:
        """Fit from a system that is almost the same."""
        if not self.coupling.keeps(exprs[self.coupling.state]):
            return None
        return super().fit_near(exprs, near)


@dataclass(frozen=True, eq=False)
class HiddenFit:
    """A system with a hidden state, fitted to the states that were measured.

    Parameters
    ----------
    coupling : where the hidden state enters.
    data : the measurements with its curve.
    fit : the system.
    comparison : what fitted it, and others.
    """

    coupling: Coupling
    data: Measurements
    fit: SystemFit
    comparison: HiddenComparison

    @property
    def bits(self) -> float:
        """All bits."""
        return self.fit.bits

    def signed(self) -> tuple[Coupling, Equations, Measurements]:
        """Give coupling, system and data, the hidden state above 0 where it keeps one sign."""
        mesh, states = self.fit.problem.mesh, self.fit.fit.states
        place = mesh.states.index(self.coupling.name)
        if states[:, place].max() > 0:
            return self.coupling, dict(self.fit.exprs), self.data
        turned = states.copy()
        turned[:, place] *= -1
        return *self.coupling.turned(self.fit.exprs), self.data.along(turned, mesh.states)


def find_hidden(
    data: Measurements,
    name: str,
    state: str,
    alone: SystemFit | None,
    comparison: ComparisonSettings,
    settings: HiddenSettings = HIDDEN,
) -> Iterator[HiddenFit]:
    """Give systems with one state that was not measured, in no order.

    Parameters
    ----------
    data : the measured states, their noise and smoothed curves.
    name : of the hidden state.
    state : in whose equation it is.
    alone : what :func:`best_alone` gives of this state, which may need no hidden one.
    comparison : how systems are fitted and their bits are counted.
    settings : the numbers that decide.
    """
    rests = dict.fromkeys((sympy.S.Zero, _by_inputs(data, state)))
    begun = [
        one
        for body in _bodies(data, state, comparison, settings)
        for rest in rests
        if (one := _begin(data, Coupling(name, state, body), rest, comparison)) is not None
    ]
    begun.sort(key=lambda one: one.bits)
    # A state that needs no hidden one takes fewer bits alone.
    least = [one.bits for one in (*begun[:1], alone) if one is not None]
    for one in begun[: settings.improved]:
        if one.bits <= min(least) + comparison.behind:
            yield _finish(one, settings)


def best_alone(data: Measurements, comparison: ComparisonSettings) -> dict[str, SystemFit | None]:
    """Give the best equation of each measured state, the others read from their curves.

    Parameters
    ----------
    data, comparison : as in :func:`find_hidden`.
    """
    return {state: _alone(state, data, comparison) for state in data.runs[0].states}


def find_without(
    data: Measurements, alone: Mapping[str, SystemFit | None], comparison: ComparisonSettings
) -> SystemFit | None:
    """Give the system of the measured states alone; None where none can be fitted.

    Parameters
    ----------
    data, comparison : as in :func:`find_hidden`.
    alone : what :func:`best_alone` gives.
    """
    own = SystemComparison(data.mesh(tuple(alone)), comparison)
    fit = own.fit({s: _equation_of(s, found) for s, found in alone.items()})
    return None if fit is None else renew(own, prune_each(own, fit))


def _alone(state: str, data: Measurements, comparison: ComparisonSettings) -> SystemFit | None:
    """Fit the equation of a state that leads where the others are read from their curves."""
    alone = Alone.of(state, data, comparison)
    alone.rank_sums()
    return alone.best()


def _equation_of(state: str, found: SystemFit | None) -> sympy.Expr:
    return sympy.S.Zero if found is None else found.exprs[state]


def _bodies(
    data: Measurements, state: str, comparison: ComparisonSettings, settings: HiddenSettings
) -> list[sympy.Expr]:
    """Give what the hidden state may be multiplied with: products that keep one sign."""
    names = data.runs[0].names
    signs = np.concatenate([_signs(*pair) for pair in zip(data.runs, data.smoothed, strict=True)])
    # Between rows of different signs a column is 0, and nothing is seen of what it multiplies.
    driven = set(data.runs[0].input_names)
    one_signed = {
        name
        for name, own in zip(names, signs.T, strict=True)
        if len({*own} - {0.0}) == 1 and not (name in driven and 0.0 in own)
    }
    allow = comparison.demands.limits(state).allow
    found = [
        body
        for body in [sympy.S.One, *products(names, settings.degree)]
        if {str(s) for s in body.free_symbols} <= one_signed and allow(body)
    ]
    comparison_of_terms = SystemComparison(data.mesh(data.runs[0].states), comparison)
    # Of equally many columns, textbooks multiply with some rather than with others.
    found.sort(
        key=lambda body: comparison_of_terms.term_bits(body * sympy.Symbol(state), state, Written())
    )
    return found[: settings.couplings]


def first_curve(
    data: Measurements, coupling: Coupling, exprs: Mapping[str, sympy.Expr] | None = None
) -> Measurements:
    """Give the same data with a curve of the hidden state, from the slope of another one.

    Parameters
    ----------
    data : the measured states.
    coupling : where the hidden state enters.
    exprs : the equations, where they are known; by default it is all of the slope.
    """
    curves = []
    rest = sympy.S.Zero if exprs is None else coupling.rest(exprs)
    for run, own in zip(data.runs, data.smoothed, strict=True):
        columns = dict(zip(run.names, np.column_stack([own.x, run.inputs]).T, strict=True))
        columns["t"] = run.t
        slope = own.slope[:, run.index(coupling.state)] - evaluate(rest, columns)
        used = [name in coupling.body.free_symbols for name in map(sympy.Symbol, run.names)]
        sure = np.all(_signs(run, own)[:, used] != 0, axis=1)
        factor = float(coupling.sign) * evaluate(coupling.body, columns)
        # Where a factor may be 0 nothing is seen of what it multiplies.
        curves.append(np.interp(run.t, run.t[sure], (slope / factor)[sure]))
    return data.with_hidden(coupling.name, curves)


def _signs(run: Trajectory, smoothed: SmoothedTrajectory) -> np.ndarray:
    """Give the signs (n, columns) of states and inputs; 0 where noise leaves a sign open."""
    values = np.column_stack([smoothed.x, run.inputs])
    errors = np.column_stack([smoothed.x_sd, np.zeros_like(run.inputs)])
    return np.where(np.abs(values) > SIGMA * errors, np.sign(values), 0.0)


def _by_inputs(data: Measurements, state: str) -> sympy.Expr:
    """Give the part of the slope of a state that its inputs make at once.

    A hidden state is smoother than inputs that act on its slope. So it is what bends least when
    multiples of the inputs are taken from the slope.
    """
    names = data.runs[0].input_names
    if not names:
        return sympy.S.Zero
    place, slopes, inputs = data.runs[0].index(state), [], []
    for run, own in zip(data.runs, data.smoothed, strict=True):
        slopes.append(np.diff(own.slope[:, place], 2))
        inputs.append(np.diff(run.inputs, 2, axis=0))
    bent, by = np.concatenate(slopes), np.concatenate(inputs)
    factors = np.linalg.lstsq(by, bent, rcond=None)[0]
    return sympy.Add(
        *(sympy.Float(c) * sympy.Symbol(n) for c, n in zip(factors, names, strict=True) if c)
    )


def _begin(
    data: Measurements, coupling: Coupling, rest: sympy.Expr, comparison: ComparisonSettings
) -> HiddenFit | None:
    """Look for the equation of the hidden state, which is the slope of another one less a rest."""
    own_equation = coupling.term + rest
    curves, best = first_curve(data, coupling, {coupling.state: own_equation}), None
    # A system that follows the data gives a better curve than slopes do.
    for _ in range(comparison.again):
        mesh = coupling.sized(curves.mesh((coupling.state, coupling.name)))
        own = HiddenComparison(mesh, comparison, curves.runs[0].states, coupling=coupling)
        alone = Alone(coupling.name, {coupling.state: own_equation}, own)
        alone.rank(alone.propose())
        found = alone.best()
        if found is None or (best is not None and found.bits > best.bits - comparison.gain):
            break
        curves = curves.along(found.fit.states, mesh.states)
        best = HiddenFit(coupling, curves, found, own)
    return best


def _finish(begun: HiddenFit, settings: HiddenSettings) -> HiddenFit:
    """Find the equations of the other states, and the shortest way to write the system."""
    names = [*begun.data.runs[0].states[:-1], begun.coupling.name]
    comparison, fit = begun.comparison, begun.fit
    others = [s for s in names if s not in fit.exprs]
    if others:
        mesh, own = begun.coupling.sized(begun.data.mesh(names)), comparison.settings
        exprs = {**fit.exprs, **{s: _equation_of(s, _alone(s, begun.data, own)) for s in others}}
        exprs = {s: exprs[s] for s in names}
        comparison = HiddenComparison(mesh, own, coupling=begun.coupling)
        whole = comparison.fit(exprs)
        if whole is None:
            return begun
        fit = prune_each(comparison, whole)
    for _ in range(settings.rounds):
        before = fit
        most = before.bits + comparison.settings.near
        close = sorted((f for f in comparison.fits() if f.bits <= most), key=lambda f: f.bits)
        every = [w for f in close[: settings.written] for w in _ways(begun.coupling, f.exprs)]
        ways = sorted(filter(None, map(comparison.fit, every)), key=lambda f: f.bits)
        ways = [prune_each(comparison, way) for way in dict.fromkeys(ways[: settings.pruned])]
        fit = renew(comparison, min([fit, *ways], key=lambda f: f.bits))
        if fit.bits > before.bits - comparison.settings.gain:
            break
    data = begun.data.along(fit.fit.states, comparison.mesh.states)
    return HiddenFit(begun.coupling, data, fit, comparison)


def _ways(coupling: Coupling, exprs: Equations) -> Iterator[Equations]:
    """Give other ways to write a system: those in which a term, or some of them, go."""
    for shift in _shifts(coupling, exprs):
        moved = coupling.shifted(exprs, shift)
        if moved is None:
            continue
        yield moved
        for constant in _constants(coupling, moved):
            again = coupling.shifted(moved, constant)
            if again is not None:
                yield again


def _shifts(coupling: Coupling, exprs: Equations) -> Iterator[sympy.Expr]:
    """Give functions of the states by which terms go when the hidden state is shifted by them.

    Those of its own equation that are linear in it are the slopes of some of them, and those of the
    other equation are multiples of others.
    """
    own, column = expand_terms(exprs[coupling.name]), sympy.Symbol(coupling.state)
    factor, parts = coupling.sign * coupling.body, []
    for term in sympy.Add.make_args(own):
        linear = term / coupling.symbol
        if coupling.symbol not in linear.free_symbols:
            parts += _integral(expand_terms(linear / factor), column)
    rest = coupling.rest(exprs)
    back = [expand_terms(-term / factor) for term in sympy.Add.make_args(rest) if term != 0]
    every = chain.from_iterable(combinations(parts, n) for n in range(len(parts) + 1))
    yield from dict.fromkeys([*(sympy.Add(*some) for some in every), *back, sympy.Add(*back)])


def _integral(term: sympy.Expr, column: sympy.Symbol) -> list[sympy.Expr]:
    """Give what a power, a sine, a cosine or an exponential is the slope of; nothing for others."""
    factor, own = term.as_independent(column, as_Add=False)
    power = own.as_base_exp()[1] if own.as_base_exp()[0] == column else None
    simple = own == 1 or (power is not None and power.is_Rational and power != -1)
    wave = own.func in (sympy.sin, sympy.cos, sympy.exp) and own.args[0].diff(column).is_number
    return [expand_terms(factor * sympy.integrate(own, column))] if simple or wave else []


def _constants(coupling: Coupling, exprs: Equations) -> Iterator[sympy.Expr]:
    """Give the numbers by which a term goes when the hidden state is shifted by one of them."""
    own = expand_terms(exprs[coupling.name])
    if not own.is_polynomial(coupling.symbol):
        return
    step = sympy.Dummy()
    moved = expand_terms(own.subs(coupling.symbol, coupling.symbol + step))
    by_body: dict[sympy.Expr, sympy.Expr] = {}
    for term in sympy.Add.make_args(moved):
        rest, body = term.as_independent(*(s for s in term.free_symbols if s != step))
        by_body[body] = by_body.get(body, sympy.S.Zero) + rest
    for factor in by_body.values():
        if step in factor.free_symbols:
            roots = np.roots([float(c) for c in sympy.Poly(factor, step).all_coeffs()])
            yield from (sympy.Float(r.real) for r in roots if r.imag == 0 and r != 0)


def different_laws(
    best: HiddenFit, every: Iterable[HiddenFit], most: float, settings: HiddenSettings = HIDDEN
) -> list[tuple[Equations, float]]:
    """Give systems that are other laws, with the bits that each takes more, the closest first.

    Ways to write one law have the same equations once the hidden state is eliminated. In each the
    hidden state enters as it does in the system.

    Parameters
    ----------
    best : the system.
    every : what was found.
    most : bits more at most.
    settings : the numbers that decide.
    """
    coupling = best.coupling
    share, columns = best.comparison.settings.apart, _measured_columns(best)
    aside = shuffle(columns)
    mine = law_of(best.fit.exprs, coupling)
    if mine is None:
        return []
    known, found = [mine], list[tuple[Equations, float]]()

    def is_new(law: Equations, other: Equations) -> bool:
        return any(
            apart_by(evaluate(other[s], columns), e, columns) > share
            or apart_by(evaluate(other[s], aside), e, aside) > settings.aside * share
            for s, e in law.items()
        )

    for fit in sorted((f for one in every for f in one.comparison.fits()), key=lambda f: f.bits):
        more = fit.bits - best.bits
        if fit is best.fit or more > most or fit.exprs.keys() != best.fit.exprs.keys():
            continue
        law = law_of(fit.exprs, coupling)
        if law is None:
            found.append((fit.exprs, more))
        elif not _has_all(law, mine) and all(is_new(law, other) for other in known):
            known.append(law)
            seen = coupling.state
            same = skeleton(fit.exprs[seen]) == skeleton(best.fit.exprs[seen])
            found.append((fit.exprs if same else write_law(law, best.fit.exprs, coupling), more))
    return found


def _has_all(law: Equations, mine: Equations) -> bool:
    """Whether a law has every term of another one, and so is this one with more of them."""
    return all(bare_terms(mine[s]) <= bare_terms(rounded(law[s])) for s in mine)


def _measured_columns(found: HiddenFit) -> dict[str, np.ndarray]:
    """Give the columns of a system, with the slope of its state for the hidden one."""
    mesh = found.fit.problem.mesh
    columns = dict(zip(mesh.states, found.fit.fit.states.T, strict=True))
    columns |= dict(zip(mesh.driven_names, mesh.driven[:, : len(mesh.t)], strict=True))
    slope = evaluate(found.fit.exprs[found.coupling.state], columns)
    step = float(np.median(mesh.h))
    turned = {f"{n}'": np.gradient(columns[n]) / step for n in mesh.driven_names if n != "t"}
    del columns[found.coupling.name]
    return {**columns, **turned, found.coupling.slope.name: slope}
