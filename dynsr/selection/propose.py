"""Proposals: the sums of terms of the library that are expected to take the fewest bits.

A beam of the best sums of each length is grown by one term at a time; the constants inside its
terms are moved by variable projection (Golub and Pereyra 1973; the slopes of Kaufman 1975) before
it grows further, and terms that no longer pay are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

from dynsr.library import Library, LibrarySettings
from dynsr.selection.evidence import Evidence

# Square of what is left of a unit column from which on it is rounding.
_NOTHING = 1e-8
# Share of the misses by which two sums of as many terms differ that are two functions.
_SAME = 1e-7


@dataclass(frozen=True)
class ProposalSettings:
    """Settings of the proposals; they stand in a run's record.

    Parameters
    ----------
    nodes : points of a view of the data at most.
    softness : weight of the defects in it: smoothed states are not quite those of a system.
    beam : sums of each length that are grown further.
    singles : single terms that are grown further; half as many pairs, and so on to the beam.
    parents : shorter sums from which the same one is reached at most.
    terms : terms of a sum at most.
    steps : steps of the constants inside a new sum.
    reach : step of a constant inside, in logarithms of a size, up to which a linear fit of it is
        believed before it is fitted.
    farthest, better : farthest that a step moves it, and share by which it must be better for
        another one.
    tier, wider : the cheapest forms that are looked through first, and how many times as many then.
    exchanged : sums of which one form at a time is exchanged.
    rounds : times that this is done, while it finds better ones.
    kept : sums that are proposed.
    library : the forms that sums are made of.
    """

    nodes: int = 240
    softness: float = 1000.0
    beam: int = 40
    singles: int = 160
    parents: int = 2
    terms: int = 6
    steps: int = 5
    reach: float = 0.7
    farthest: float = 1.0
    better: float = 1e-4
    tier: int = 12
    wider: int = 4
    exchanged: int = 5
    rounds: int = 3
    kept: int = 45
    library: LibrarySettings = LibrarySettings()


PROPOSALS = ProposalSettings()


@dataclass(frozen=True, eq=False)
class _Units:
    """Rows (P, r) of length 1, or of 0 where there is nothing, and their lengths (P,)."""

    rows: np.ndarray
    sizes: np.ndarray

    def some(self, places: np.ndarray) -> _Units:
        """Give some of the rows."""
        return _Units(self.rows[places], self.sizes[places])


def _unit(rows: np.ndarray) -> _Units:
    sizes = np.linalg.norm(rows, axis=1)
    fine = np.isfinite(sizes) & (sizes > 1e-150) & (sizes < 1e150)
    units = np.where(fine[:, None], rows / np.where(fine, sizes, 1.0)[:, None], 0.0)
    return _Units(units, np.where(fine, sizes, np.inf))


@dataclass(frozen=True, eq=False)
class Sum:
    """A sum of forms, fitted to the evidence.

    Parameters
    ----------
    places : of its forms in the library, in order.
    constants : of each form, those inside.
    weights : (s,) coefficients.
    basis : (s, r) orthonormal rows that span its mapped terms.
    rest : (r,) what is left of the target.
    left : its sum of squares.
    cost : bits of its terms and constants.
    bits : all bits.
    """

    places: tuple[int, ...]
    constants: tuple[np.ndarray, ...]
    weights: np.ndarray
    basis: np.ndarray
    rest: np.ndarray
    left: float
    cost: float
    bits: float

    def without(self, place: int) -> tuple[tuple[int, ...], tuple[np.ndarray, ...]]:
        """Give its forms and their constants without those of one of them."""
        before, behind = slice(place), slice(place + 1, None)
        return (
            (*self.places[before], *self.places[behind]),
            (*self.constants[before], *self.constants[behind]),
        )

    def write(self, library: Library) -> sympy.Expr:
        """Write it as a formula."""
        forms = (library.forms[place] for place in self.places)
        written = (f.write(library.names, c) for f, c in zip(forms, self.constants, strict=True))
        pairs = zip(self.weights.tolist(), written, strict=True)
        return sympy.Add(*[sympy.Float(weight) * expr for weight, expr in pairs])


@dataclass(frozen=True, eq=False)
class Proposer:
    """Looks for sums in one view of the data.

    Parameters
    ----------
    evidence : the view.
    library : the forms.
    costs : (forms,) bits of each with its coefficient and the constants inside.
    settings : the numbers that decide.
    """

    evidence: Evidence
    library: Library
    costs: np.ndarray
    settings: ProposalSettings = PROPOSALS

    def best(self) -> list[Sum]:
        """Give the best sums, those of the fewest bits first."""
        found: dict[tuple[int, ...], Sum] = {}
        with np.errstate(all="ignore"):
            for tier in self._tiers():
                self._grow_from_nothing(tier, found)
            for _ in range(self.settings.rounds):
                if not self._exchange(found):
                    break
            for one in self._ranked(found):
                self._thin(one, found)
        return self._front_first(found)

    def _grow_from_nothing(self, tier: np.ndarray, found: dict[tuple[int, ...], Sum]) -> None:
        """Grow sums by one form at a time until two more gain less than a bit."""
        layer, least, idle = [self._nothing], math.inf, 0
        for _ in range(self.settings.terms):
            layer = self._grow(layer, tier)
            found |= {one.places: one for one in layer if _is_better(one, found)}
            best = min((one.bits for one in layer), default=math.inf)
            idle = 0 if best < least - 1 else idle + 1
            if idle == 2:
                return
            least = min(least, best)

    def _tiers(self) -> Iterator[np.ndarray]:
        """Give the forms that sums are grown of, the cheapest few first, and all at last.

        A beam through few forms reaches sums that one through all of them passes by.
        """
        order = np.argsort(self.costs, kind="stable")
        order = order[np.isfinite(self.costs[order])]
        count = self.settings.tier
        while count < len(order):
            yield np.sort(order[:count])
            count *= self.settings.wider
        yield np.sort(order)

    def _ranked(self, found: Mapping[tuple[int, ...], Sum]) -> list[Sum]:
        ranked = sorted(found.values(), key=lambda one: (one.bits, one.places))
        return self._apart(ranked)[: self.settings.kept]

    def _front_first(self, found: Mapping[tuple[int, ...], Sum]) -> list[Sum]:
        """Put the best sum of each length before the others.

        Longer ones follow the errors of the curves too, which the evidence takes for no noise.
        """
        ranked = self._apart(sorted(found.values(), key=lambda one: (one.bits, one.places)))
        front: dict[int, Sum] = {}
        for one in ranked:
            front.setdefault(len(one.places), one)
        best = sorted(front.values(), key=lambda one: (one.bits, one.places))
        return list(dict.fromkeys([*best, *ranked]))[: self.settings.kept]

    def _exchange(self, found: dict[tuple[int, ...], Sum]) -> bool:
        """Put other forms in the place of one, in the best sums; says whether any is better."""
        before = self._ranked(found)
        shorter: dict[tuple[int, ...], Sum] = {}
        for one in before[: self.settings.exchanged]:
            for i in range(len(one.places)):
                places, constants = one.without(i)
                less = shorter.get(places) or self._fit(places, constants)
                if less is not None:
                    shorter[places] = less
        grown = self._grow(list(shorter.values()), np.flatnonzero(np.isfinite(self.costs)))
        found |= {one.places: one for one in grown if _is_better(one, found)}
        return self._ranked(found)[: self.settings.exchanged] != before[: self.settings.exchanged]

    def _apart(self, ranked: Iterable[Sum]) -> list[Sum]:
        """Leave out sums that are the same function as one that takes fewer bits.

        1 - k/(v + k) is v/(v + k).
        """
        told: dict[tuple[int, int], Sum] = {}
        for one in ranked:
            size = math.log(max(one.left + self.evidence.beside, 1e-300))
            told.setdefault((len(one.places), round(size / _SAME)), one)
        return list(told.values())

    @cached_property
    def _rows(self) -> tuple[_Units, tuple[_Units, ...]]:
        """Mapped values of all forms with the constants they begin with, and slopes by these."""
        values, slopes = self.library.both(self.evidence.points)
        turned = (_unit(self.evidence.mapped(own)) for own in slopes.swapaxes(0, 1))
        return _unit(self.evidence.mapped(values)), tuple(turned)

    def _grow(self, layer: Sequence[Sum], tier: np.ndarray) -> list[Sum]:
        """Give the best sums with one form more, each form with the best of its constants."""
        if not layer:
            return []
        places = np.flatnonzero(np.isin(self.library.owners, tier))
        first = np.searchsorted(self.library.owners[places], tier)
        units, turned = self._rows
        gains = self._gains(layer, units.some(places), [own.some(places) for own in turned])
        most = np.maximum.reduceat(gains, first, axis=0)
        left = np.array([one.left for one in layer]) - most
        bits = self.evidence.misses(np.maximum(left, 1e-9 * layer[0].left))
        bits = bits + np.array([one.cost for one in layer]) + self.costs[tier, None]
        bits[~(np.isfinite(bits) & (most > 0))] = np.inf
        # What tells nothing alone may tell all together, and the fewer forms, the more so.
        width = max(self.settings.beam, self.settings.singles // 2 ** len(layer[0].places))
        chosen: dict[tuple[int, ...], list[tuple[int, int]]] = {}
        for flat in np.argsort(bits, axis=None, kind="stable"):
            row, parent = divmod(int(flat), len(layer))
            if len(chosen) == width or not bits[row, parent] < np.inf:
                break
            form = int(tier[row])
            key = tuple(sorted((*layer[parent].places, form)))
            # From the constants of another parent a sum may end elsewhere.
            if (
                form not in layer[parent].places
                and len(chosen.get(key, ())) < self.settings.parents
            ):
                chosen.setdefault(key, []).append((form, parent))
        grown = []
        for ways in chosen.values():
            ends = []
            for form, parent in ways:
                own = np.flatnonzero(self.library.owners[places] == form)
                row = int(places[own[np.argmax(gains[own, parent])]])
                ends.append(self._extend(layer[parent], form, self.library.constants[row]))
            fine = [end for end in ends if end is not None]
            grown += [min(fine, key=lambda end: end.bits)] if fine else []
        return grown

    def _gains(self, layer: Sequence[Sum], units: _Units, turned: Sequence[_Units]) -> np.ndarray:
        """(P, layer) squares that each row takes off, its constants inside set free."""
        first, second = turned
        rest = np.array([one.rest for one in layer])
        rows = [units.rows, first.rows, second.rows]
        pulls = [own @ rest.T for own in rows]
        pairs = [(i, j) for i in range(3) for j in range(i, 3)]
        products = {
            (i, j): np.tile(np.sum(rows[i] * rows[j], axis=1)[:, None], len(layer))
            for i, j in pairs
        }
        for place in range(max(len(one.basis) for one in layer)):
            basis = np.array(
                [one.basis[place] if place < len(one.basis) else 0 * one.rest for one in layer]
            )
            said = [own @ basis.T for own in rows]
            for i, j in pairs:
                products[i, j] -= said[i] * said[j]
        pull, turn, last = pulls
        whole = products[0, 0]
        alone = np.where(whole > _NOTHING, pull**2 / np.maximum(whole, _NOTHING), 0.0)
        # The second slope is taken out of the others first, where there is one.
        size = products[2, 2]
        inverse = np.where(size > _NOTHING, 1 / np.maximum(size, _NOTHING), 0.0)
        by, beside = products[0, 2] * inverse, products[1, 2] * inverse
        own = whole - by * products[0, 2]
        other = products[1, 1] - beside * products[1, 2]
        both = products[0, 1] - by * products[1, 2]
        left, turned_left = pull - by * last, turn - beside * last
        area = own * other - both**2
        weight = (left * other - turned_left * both) / area
        move = (turned_left * own - left * both) / area
        more = last * inverse - weight * by - move * beside
        reach = np.maximum(
            np.abs(move / weight * (units.sizes / first.sizes)[:, None]),
            np.abs(more / weight * (units.sizes / second.sizes)[:, None]),
        )
        free = (own > _NOTHING) & (area > _NOTHING * own) & (reach <= self.settings.reach)
        return np.where(free, weight * pull + move * turn + more * last, alone)

    def _extend(self, one: Sum, form: int, best: np.ndarray) -> Sum | None:
        order = int(np.searchsorted(one.places, form))
        places = (*one.places[:order], form, *one.places[order:])
        constants = (*one.constants[:order], best, *one.constants[order:])
        return self._settle(places, constants, self.settings.steps)

    def _settle(
        self, places: tuple[int, ...], constants: tuple[np.ndarray, ...], steps: int
    ) -> Sum | None:
        """Fit a sum, and move the constants inside while that is better."""
        best = self._fit(places, constants)
        if best is None or not any(map(len, constants)):
            return best
        for _ in range(steps):
            moved = self._move(best)
            if moved is None:
                break
            better = moved.left + self.evidence.beside < (1 - self.settings.better) * (
                best.left + self.evidence.beside
            )
            if moved.left < best.left:
                best = moved
            if not better:
                break
        return best

    def _plain(self, place: int) -> np.ndarray:
        """Mapped values of a form without a constant."""
        own, row = self._rows[0], int(self.library.first[place])
        return np.asarray(own.rows[row] * own.sizes[row])

    def _mapped(self, place: int, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        form = self.library.forms[place]
        values, slopes = form.both(self.library.names, self.evidence.points, constants[None])
        return self.evidence.mapped(values[0]), self.evidence.mapped(slopes[0])

    @property
    def _nothing(self) -> Sum:
        """The sum of no forms."""
        y = self.evidence.y
        left, none = float(y @ y), np.zeros((0, len(y)))
        return Sum((), (), np.zeros(0), none, y, left, 0.0, float(self.evidence.misses(left)))

    def _fit(self, places: tuple[int, ...], constants: tuple[np.ndarray, ...]) -> Sum | None:
        """Fit the coefficients; None where the terms are not finite or not independent."""
        y = self.evidence.y
        if not places:
            return self._nothing
        rows = np.array(
            [
                self._mapped(place, own)[0] if len(own) else self._plain(place)
                for place, own in zip(places, constants, strict=True)
            ]
        )
        if not np.all(np.isfinite(rows)):
            return None
        sizes = np.linalg.norm(rows, axis=1)
        if not np.all((sizes > 1e-150) & (sizes < 1e150)):
            return None
        q, r = np.linalg.qr((rows / sizes[:, None]).T)
        if np.min(np.abs(np.diag(r))) ** 2 <= _NOTHING:
            return None
        inner = q.T @ y
        rest = y - q @ inner
        weights = np.linalg.solve(r, inner) / sizes
        left = float(rest @ rest)
        cost = float(self.costs[list(places)].sum())
        bits = float(self.evidence.misses(left)) + cost
        return Sum(places, constants, weights, q.T, rest, left, cost, bits)

    def _move(self, one: Sum) -> Sum | None:
        """Take a step of the constants inside."""
        columns = []
        for place, own, weight in zip(one.places, one.constants, one.weights, strict=True):
            if len(own):
                columns += list(weight * self._mapped(place, own)[1])
        slopes = np.array(columns)
        if not np.all(np.isfinite(slopes)):
            return None
        # The coefficients follow: what they can do is taken out of the slopes.
        units = _unit(slopes - (slopes @ one.basis.T) @ one.basis)
        gram = units.rows @ units.rows.T + 1e-9 * np.eye(len(slopes))
        steps = np.linalg.solve(gram, units.rows @ one.rest) / units.sizes
        far = self.settings.farthest
        for scale in (1.0, 0.5):
            left = np.clip(scale * steps, -far, far).tolist()
            constants = []
            for place, own in zip(one.places, one.constants, strict=True):
                mine, left = np.array(left[: len(own)]), left[len(own) :]
                constants.append(self.library.moved(place, own, mine) if len(own) else own)
            moved = self._fit(one.places, tuple(constants))
            if moved is not None and moved.left < one.left:
                return moved
        return None

    def _thin(self, one: Sum, found: dict[tuple[int, ...], Sum]) -> None:
        """Leave out terms, that which is missed least first, and keep what that gives."""
        while len(one.places) > 1:
            shorter: list[Sum] = []
            for i in range(len(one.places)):
                places, constants = one.without(i)
                less = found.get(places) or self._settle(places, constants, 1)
                if less is not None:
                    shorter.append(less)
            best = min(shorter, key=lambda s: s.bits, default=None)
            if best is None or best.bits >= one.bits:
                return
            found.setdefault(best.places, best)
            one = best


def _is_better(one: Sum, found: Mapping[tuple[int, ...], Sum]) -> bool:
    return one.places not in found or one.bits < found[one.places].bits


def write_all(sums: Iterable[Sum], library: Library) -> list[sympy.Expr]:
    """Write sums as formulas, each once."""
    return list(dict.fromkeys(one.write(library) for one in sums))
