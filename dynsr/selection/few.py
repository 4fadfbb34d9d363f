"""Few terms: all sums of some plain terms and of one or two functions with a constant inside.

Exact slopes along a short arc are followed by very many sums of many terms, and one that loses
them one by one ends anywhere. Hardly any sum of few terms follows them but the law: all of these
are looked at, for some values of the constants inside, and the likeliest then have theirs moved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import Program, compile_columns
from dynsr.fit import solve_each
from dynsr.selection.profiles import INSIDE, find_profiles, write_sum
from dynsr.selection.terms import products

# Plain terms beside one function and beside two, at most.
_BESIDE, _BESIDE_TWO = 4, 3
# Values that are looked at beside plain terms, pairs of functions that are tried there, and choices
# of plain terms that two more are put beside.
_WORK, _WORK_TWO, _CHOICES = 3e8, 3e7, 6000
# Of the values of a constant every which is tried.
_EVERY = 2
# Places in the order of likelihood that one more plain term is worth.
_LONGER = 4
# Sums of plain terms alone that are kept of each choice; sums of each number of terms whose
# constants are moved, and of these beside the same plain terms.
_LIKELY, _MOVED, _EACH = 3, 120, 20
# Sums of as many terms with one function, and of the same plain ones with two, whose constants are
# moved roughly, how often that is done, and the share of a column that others must not say.
_ROUGH, _SHARPENED, _SHARPER = 4000, 400, 5
# Sums that are given.
_GIVEN = 6
# Steps that constants inside make, and the share of a step that is still tried.
_STEPS, _LEAST = 12, 1e-3
# Share of a column that is not in others from which on it says anything.
_OWN = 1e-6
# What two functions that are nearly one leave of each other, squared.
_APART = 1e-8

_Terms = tuple[tuple[int, ...], tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class _Sum:
    """Plain terms and functions by their places, the constants inside these, and what is left.

    What is left is a root mean square.
    """

    plain: tuple[int, ...]
    functions: tuple[int, ...]
    inside: tuple[float, ...]
    left: float

    @property
    def terms(self) -> _Terms:
        """Its plain terms and functions."""
        return self.plain, self.functions

    def without(self, place: int) -> _Sum:
        """Take a plain term out."""
        return replace(self, plain=tuple(i for i in self.plain if i != place))

    @property
    def count(self) -> int:
        """Constants of the sum."""
        return len(self.plain) + 2 * len(self.functions)


@dataclass(frozen=True, eq=False)
class FewTerms:
    """Sums of few terms at rows of exact slopes.

    Parameters
    ----------
    samples : the rows.
    plain : terms without a constant inside, the likeliest first, and their values (p, n).
    values : these.
    functions : functions of a constant inside.
    signs : whether each may stand beside another, with a constant below 0 and with one above it.
    which, tried : (q,) place of a function, each in one stretch, and a constant inside it.
    columns : (q, 2, n) values with it, and slopes by its logarithm.
    programs : what computes each function and its slope by the constant.
    """

    samples: Samples
    plain: tuple[sympy.Expr, ...]
    values: np.ndarray
    functions: tuple[sympy.Expr, ...]
    signs: tuple[tuple[bool, bool], ...]
    which: np.ndarray
    tried: np.ndarray
    columns: np.ndarray
    programs: tuple[Program, ...]

    @classmethod
    def of(
        cls,
        samples: Samples,
        plain: Sequence[sympy.Expr],
        allowed: Callable[[sympy.Expr], bool] = lambda _: True,
    ) -> FewTerms:
        """Make the functions that textbooks have of the columns, each beside up to one of them.

        Parameters
        ----------
        samples : the rows.
        plain : terms without a constant inside, the likeliest first.
        allowed : whether a term may be used.
        """
        rows = samples.X.T
        own = sympy.Symbol(samples.target)
        short = [sympy.S.One, *products(samples.names, 1)]
        before = [*short, *(own * e for e in short[1:])]
        constants: dict[sympy.Expr, set[float]] = {}
        signs: dict[sympy.Expr, tuple[bool, bool]] = {}
        for profile in find_profiles(samples):
            for function, *more in profile.make(INSIDE):
                for factor in before if function.has(INSIDE) and not more else ():
                    expr = function * factor
                    if not allowed(expr):
                        continue
                    constants.setdefault(expr, set()).update(profile.tried)
                    if factor in short:
                        signs[expr] = _signs(expr)
        which, tried = [np.empty(0, dtype=int)], [np.empty(0)]
        columns = [np.empty((0, 2, len(samples)))]
        programs = [
            compile_columns([e, e.diff(INSIDE)], (*samples.names, str(INSIDE))) for e in constants
        ]
        for place, (program, inside) in enumerate(zip(programs, constants.values(), strict=True)):
            k = np.array(sorted(inside))
            values = _values(program, samples, k)
            values[:, 1] *= k[:, None]
            fine = np.all(np.isfinite(values), axis=(1, 2))
            which.append(np.full(int(fine.sum()), place))
            tried.append(k[fine])
            columns.append(values[fine])
        plain = [expr for expr in plain if allowed(expr)]
        values = compile_columns(plain, samples.names)(*rows)
        usable = np.all(np.isfinite(values), axis=1)
        return cls(
            samples,
            tuple(e for e, fine in zip(plain, usable, strict=True) if fine),
            values[usable],
            tuple(constants),
            tuple(signs.get(expr, (False, False)) for expr in constants),
            np.concatenate(which),
            np.concatenate(tried),
            np.concatenate(columns),
            tuple(programs),
        )

    def plain_sums(self, most: float) -> list[sympy.Expr]:
        """Give sums of plain terms alone, the fewest first.

        Parameters
        ----------
        most : root mean square that a sum leaves at most.
        """
        return self._shortest(self._of_none(), most)

    def with_one(self, most: float) -> list[sympy.Expr]:
        """Give sums with one function, the fewest constants first; as :meth:`plain_sums`."""
        return self._shortest(self._of_one(), most)

    def with_two(self, most: float, enough: float) -> list[sympy.Expr]:
        """Give sums with two functions, the fewest constants first; as :meth:`plain_sums`.

        Parameters
        ----------
        most : root mean square that a sum leaves at most.
        enough : what a sum leaves beside which no others are looked for.
        """
        return self._shortest(self._of_two(enough), most)

    def _shortest(self, sums: Sequence[_Sum], most: float) -> list[sympy.Expr]:
        """Move the constants of sums, and give the shortest that leave no more than so much."""
        enough = [one for one in self._move(sums) if one.left <= most]
        found: dict[_Terms, _Sum] = {}
        for one in self._thin(enough, most):
            found[one.terms] = min(found.get(one.terms, one), one, key=_left)
        ranked = sorted(found.values(), key=lambda one: (one.count, one.left))
        written = (self._write(one) for one in ranked)
        return [expr for expr in written if expr is not None][:_GIVEN]

    def _thin(self, sums: Sequence[_Sum], most: float) -> list[_Sum]:
        """Take the plain terms out of sums that are not needed, those first that are missed least.

        What is left without a term is found once, whichever sum it is taken out of.
        """
        thin: list[_Sum] = []
        moved: dict[_Terms, _Sum] = {}
        while sums:
            fewer = [list(map(one.without, one.plain)) for one in sums]
            new = {short.terms: short for own in fewer for short in own}
            for short in self._move([one for terms, one in new.items() if terms not in moved]):
                moved[short.terms] = short
            further: dict[_Terms, _Sum] = {}
            for one, own in zip(sums, fewer, strict=True):
                least = min((moved[short.terms] for short in own), key=_left, default=one)
                if least is one or least.left > most:
                    thin.append(one)
                else:
                    further[least.terms] = least
            sums = list(further.values())
        return thin

    def _subsets(self, most: int, count: float) -> list[tuple[int, ...]]:
        """Give so many choices of plain terms, the shortest and likeliest first."""
        places = range(len(self.plain))
        every = chain.from_iterable(combinations(places, size) for size in range(most + 1))
        ranked = sorted(every, key=lambda own: sum(own) + _LONGER * len(own))
        return ranked[: max(int(count), 1)]

    def _of_none(self) -> list[_Sum]:
        """Give the likeliest sums of plain terms, of each number of them."""
        found: dict[int, dict[tuple[int, ...], _Sum]] = {}
        for places in self._subsets(_BESIDE, _CHOICES):
            basis, goal = self._without(places)
            told = _told_by_two(_unit(self.values, _rest(self.values, basis)), goal)
            for flat in np.argsort(-np.triu(told, 1), axis=None)[:_LIKELY].tolist():
                own = tuple(sorted({*places, *divmod(flat, len(told))}))
                left = _root_mean(goal @ goal - told.flat[flat], goal)
                found.setdefault(len(own), {})[own] = _Sum(own, (), (), left)
        return _likeliest(own.values() for own in found.values())

    def _without(self, places: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Give an orthonormal basis (n, p) of some plain terms, and the slopes without them."""
        basis = np.linalg.qr(self.values[list(places)].T)[0]
        return basis, self.samples.y - basis @ (basis.T @ self.samples.y)

    def _of_one(self) -> list[_Sum]:
        """Give the likeliest sums with one function, of each number of terms."""
        which, tried = self.which[::_EVERY], self.tried[::_EVERY]
        columns, turned = np.moveaxis(self.columns[::_EVERY], 1, 0).copy()
        if not len(which):
            return []
        begins = np.flatnonzero(np.diff(which, prepend=-1))
        ends, found = [*begins[1:], len(which)], dict[int, list[_Sum]]()
        pairs = ((columns, columns), (turned, turned), (columns, turned))
        products_of = [np.einsum("qn,qn->q", a, b) for a, b in pairs]
        for places in self._subsets(_BESIDE, _WORK / columns.size):
            beside = np.column_stack(self._without(places))
            gains = _told_near(columns @ beside, turned @ beside, products_of)
            best = np.maximum.reduceat(gains, begins)
            goal = beside[:, -1]
            for i in np.argsort(-best)[:_EACH].tolist():
                at = begins[i] + int(np.argmax(gains[begins[i] : ends[i]]))
                left = _root_mean(goal @ goal - best[i], goal)
                one = _Sum(places, (int(which[at]),), (float(tried[at]),), left)
                found.setdefault(len(places), []).append(one)
        likely = (sorted(own, key=_left)[:_ROUGH] for own in found.values())
        return _likeliest(self._move(own, _SHARPER) for own in likely)

    def _of_two(self, enough: float) -> list[_Sum]:
        """Give the likeliest sums with two functions, up to the first that leave little enough."""
        usual = np.array(self.signs, dtype=bool).reshape(-1, 2)[self.which]
        few = np.flatnonzero(usual[np.arange(len(usual)), (self.tried > 0).astype(int)])[::_EVERY]
        which, tried, columns = self.which[few], self.tried[few], self.columns[few, 0].copy()
        if not len(which):
            return []
        begins = np.flatnonzero(np.diff(which, prepend=-1))
        ends = [*begins[1:], len(which)]
        found: dict[int, list[_Sum]] = {}
        for places in self._subsets(_BESIDE_TWO, _WORK_TWO / len(few) ** 2):
            basis, goal = self._without(places)
            told = _told_by_two(_unit(columns, _rest(columns, basis)), goal)
            best = np.maximum.reduceat(np.maximum.reduceat(told, begins, 0), begins, 1)
            flat = np.argsort(-np.triu(best), axis=None)[:_SHARPENED]
            rough = []
            for i, j in zip(*np.unravel_index(flat, best.shape), strict=True):
                block = told[begins[i] : ends[i], begins[j] : ends[j]]
                row, column = divmod(int(np.argmax(block)), block.shape[1])
                at = [begins[i] + row, begins[j] + column]
                rough.append(
                    _Sum(places, tuple(which[at].tolist()), tuple(tried[at].tolist()), 0.0)
                )
            likely = sorted(self._move(rough, _SHARPER), key=_left)[:_EACH]
            found.setdefault(len(places), []).extend(likely)
            if likely and likely[0].left <= enough:
                break
        return _likeliest(found.values())

    def _move(self, sums: Sequence[_Sum], steps: int = _STEPS) -> list[_Sum]:
        """Move the constants inside sums to where these leave least (Gauss and Newton).

        Sums of as many terms are moved side by side.
        """
        found = list(sums)
        shapes = [(len(one.plain), len(one.functions)) for one in sums]
        for shape in dict.fromkeys(shapes):
            places = [place for place, own in enumerate(shapes) if own == shape]
            alike = self._move_alike([sums[i] for i in places], steps)
            for place, one in zip(places, alike, strict=True):
                found[place] = one
        return found

    def _move_alike(self, sums: Sequence[_Sum], steps: int) -> list[_Sum]:
        plain = self.values[np.array([one.plain for one in sums], dtype=int)]
        basis = np.linalg.qr(np.swapaxes(plain, 1, 2))[0]
        whole = np.broadcast_to(self.samples.y, (len(sums), 1, len(self.samples)))
        goal = _rest(whole, basis)[:, 0]
        functions = np.array([one.functions for one in sums], dtype=int)
        count = functions.shape[1]
        best = np.array([one.inside for one in sums], dtype=float)
        step, share = np.zeros_like(best), np.ones(len(sums))
        least, own = np.full(len(sums), np.inf), np.arange(len(sums))
        for _ in range(steps + 1):
            # A constant that changes its sign is that of another function.
            most = np.abs(best[own])
            inside = best[own] + share[own, None] * np.clip(step[own], -most / 2, most)
            rows = self._bent(functions[own], inside)
            fine = np.all(np.isfinite(rows), axis=(1, 2))
            rows = _rest(np.where(fine[:, None, None], rows, 0.0), basis[own])
            values = solve_each(rows[:, :count], goal[own])[1]
            missed = goal[own] - np.einsum("mc,mcn->mn", values, rows[:, :count])
            left = np.where(fine, np.mean(missed**2, axis=1), np.inf)
            better = left < least[own]
            settled = better & (left > (1 - _LEAST) * least[own])
            now = own[better]
            rows[:, count:] *= values[:, :, None]
            least[now], best[now] = left[better], inside[better]
            step[now] = solve_each(rows[better], goal[now])[1][:, count:]
            share[now] = 1.0
            share[own[~better]] /= 4
            own = own[~settled]
            if not count or not len(own):
                break
        moved = zip(sums, best.tolist(), np.sqrt(least).tolist(), strict=True)
        return [replace(one, inside=tuple(inside), left=left) for one, inside, left in moved]

    def _bent(self, functions: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """(m, 2 f, n) values of functions (m, f), and then their slopes by the constants inside."""
        count = functions.shape[1]
        found = np.empty((len(functions), 2 * count, len(self.samples)))
        for side in range(count):
            for function in np.unique(functions[:, side]).tolist():
                own = np.flatnonzero(functions[:, side] == function)
                both = _values(self.programs[function], self.samples, inside[own, side])
                found[own, side], found[own, side + count] = both[:, 0], both[:, 1]
        return found

    def _at(self, functions: Sequence[int], constants: np.ndarray) -> np.ndarray:
        """(2 f, n) values of functions and then their slopes by the constants inside."""
        return self._bent(np.array([functions], dtype=int), constants[None])[0]

    def _write(self, one: _Sum) -> sympy.Expr | None:
        """Write a sum; None where its terms only cancel each other."""
        rows = self._at(one.functions, np.array(one.inside))[: len(one.functions)]
        columns = np.concatenate([self.values[list(one.plain)], rows])
        inside = [
            self.functions[i].xreplace({INSIDE: sympy.Float(c)})
            for i, c in zip(one.functions, one.inside, strict=True)
        ]
        terms = [*(self.plain[i] for i in one.plain), *inside]
        y = self.samples.y
        return write_sum(_solve(columns, y), terms, columns, y)


def _left(one: _Sum) -> float:
    return one.left


def _root_mean(total: float, rows: np.ndarray) -> float:
    """Root mean square of a sum of squares over rows, which rounding may leave below 0."""
    return float(np.sqrt(max(total, 0.0) / len(rows)))


def _likeliest(kinds: Iterable[Iterable[_Sum]]) -> list[_Sum]:
    """Give the sums of each kind that leave least."""
    return [one for own in kinds for one in sorted(own, key=_left)[:_MOVED]]


def _rest(columns: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Give what is left of columns (..., c, n) without those of a basis (..., n, p)."""
    return np.asarray(columns - (columns @ basis) @ np.swapaxes(basis, -1, -2))


def _values(program: Program, samples: Samples, constants: np.ndarray) -> np.ndarray:
    """(m, 2, n) values and slopes of a function with each of the constants (m,) inside."""
    held = np.repeat(constants, len(samples))
    both = program(*np.tile(samples.X.T, len(constants)), held)
    return np.moveaxis(both.reshape(2, len(constants), len(samples)), 1, 0)


def _told_near(pull: np.ndarray, turn: np.ndarray, products_of: Sequence[np.ndarray]) -> np.ndarray:
    """Give the squares (q,) that functions explain whose constants inside move a little.

    Parameters
    ----------
    pull, turn : (q, p + 1) products of functions, and of their slopes by the logarithm of the
        constant, with an orthonormal basis of what is beside them, and with what is left.
    products_of : (q,) of the functions, of the slopes, and of both.
    """
    own, bent, mixed = (
        whole - np.einsum("qk,qk->q", a[:, :-1], b[:, :-1])
        for whole, a, b in zip(products_of, (pull, turn, pull), (pull, turn, turn), strict=True)
    )
    first, second = pull[:, -1], turn[:, -1]
    told = own > _OWN**2 * products_of[0]
    own = np.where(told, own, 1.0)
    apart = own * bent - mixed**2
    # Where it moves by more than to the next constant tried, that one says it.
    safe = np.where(apart > _OWN * own * np.abs(bent), apart, np.inf)
    value, move = (first * bent - second * mixed) / safe, (second * own - first * mixed) / safe
    near = np.isfinite(safe) & (np.abs(move) <= np.abs(value))
    gains = np.where(near, first * value + second * move, first**2 / own)
    return np.where(told, gains, 0.0)


def _told_by_two(columns: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Give the squares (q, q) of (n,) that each two of the columns (q, n) of length 1 explain."""
    pull, alike = columns @ goal, columns @ columns.T
    squares, apart = pull**2, 1 - alike**2
    told = squares[:, None] + squares[None] - 2 * np.outer(pull, pull) * alike
    return np.where(apart > _APART, told, 0.0) / np.maximum(apart, _APART)


def _unit(whole: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Give what is left of columns (q, n) the length 1, and 0 where that is nothing."""
    sizes = np.linalg.norm(rest, axis=1)
    told = sizes > _OWN * np.linalg.norm(whole, axis=1)
    return rest * np.where(told, 1 / np.maximum(sizes, 1e-300), 0.0)[:, None]


def _solve(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Give the coefficients (c,) of columns (c, n) whose sum is closest to y."""
    sizes = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    return np.asarray(np.linalg.lstsq((columns / sizes[:, None]).T, y, rcond=None)[0] / sizes)


def _signs(expr: sympy.Expr) -> tuple[bool, bool]:
    """Whether a function is usual beside another, with a constant below 0, and with one above it.

    Of what saturates from the other side, as (1 - x) / (k - x) does, one writing is enough.
    """
    powers = [p for p in expr.atoms(sympy.Pow, sympy.exp) if p.has(INSIDE)]
    lines = [p for p in powers if p.is_Pow and p.base.has(INSIDE)]
    above = (expr / sympy.Mul(*lines)).free_symbols
    below = any(above & line.free_symbols for line in lines)
    return not below, all(line.exp == -1 for line in lines)
