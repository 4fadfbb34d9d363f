"""Proposals: the sums of terms of the library that are expected to take the fewest bits.

A beam of the best sums of each length is grown by one term at a time; the constants inside its
terms are moved by variable projection (Golub and Pereyra 1973; the slopes of Kaufman 1975) before
it grows further, and terms that no longer pay are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import sympy

from dynsr.expression import added_bits, bits_in_force
from dynsr.fit import NOTHING_LEFT, one_of_each_shape
from dynsr.library import (
    FormValues,
    Library,
    LibrarySettings,
    Place,
    Written,
    read_body,
    textbooks,
    write_down,
)
from dynsr.selection.evidence import Evidence
from dynsr.selection.shapes import bodies_of, wide_factors
from dynsr.selection.subsets import SINGULAR

# Rows of values whose gains are counted at once.
_BLOCK = 256
# Share of the misses by which two sums of as many terms differ that are two functions.
_SAME = 1e-7


@dataclass(frozen=True)
class ProposalSettings:
    """Settings of the proposals; they are in the record of a run.

    Parameters
    ----------
    nodes : points of a view of the data at most.
    beam : sums of each length that are grown further.
    shortest : the same of single terms, and of pairs: a term that explains nothing alone may
        explain all together with others.
    parents : shorter sums from which the same one is reached at most.
    free : whether all constants inside a sum move where the gain of a new term is expected. In
        noise they follow what is no law.
    starts : neighbours of each constant inside a form from which fits begin, the most probable.
    fitted : times as many are fitted as are grown further.
    shorter : whether sums lose terms that do not pay as soon as they are grown. Where noise hides
        terms, that leads to short sums that are no laws.
    whole : how many of the cheapest terms without a constant inside are thinned from all of them.
    kinds : numbers of constants inside for each of which as many sums are grown further.
    terms : terms of a sum at most.
    steps : steps of the constants inside a new sum.
    reach : step of a constant inside, in logarithms of a size, up to which a linear fit of it is
        believed before it is fitted.
    farthest, better : farthest that a step moves it, and share by which it must be better for
        another one.
    tries : shares of a step, and what damps it, that are tried until one is better.
    tier, wider : the cheapest forms, which are searched first, and the factor of each next tier.
    exchanged : sums of which one form at a time is exchanged.
    rounds : times that this is done, while it finds better ones.
    kept : sums that are proposed.
    doubt : bits by which a linear fit may misjudge a change of an equation: what it expects to take
        that many more than the equation itself is not proposed.
    library : the forms that sums are made of.
    """

    nodes: int = 240
    beam: int = 40
    shortest: tuple[int, ...] = (160, 80)
    parents: int = 2
    free: bool = False
    starts: int = 1
    fitted: int = 2
    shorter: bool = False
    whole: tuple[int, ...] = ()
    kinds: int = 4
    terms: int = 6
    steps: int = 5
    reach: float = 0.7
    farthest: float = 1.0
    better: float = 1e-4
    tries: tuple[tuple[float, float], ...] = ((1.0, 1e-9), (0.5, 1e-9))
    tier: int = 12
    wider: int = 4
    exchanged: int = 5
    rounds: int = 3
    kept: int = 45
    doubt: float = 7.0
    library: LibrarySettings = LibrarySettings()


PROPOSALS = ProposalSettings()
# Exact values tell more sums apart.
EXACT = ProposalSettings(
    beam=80,
    shortest=(4000, 160),
    free=True,
    steps=12,
    fitted=4,
    shorter=True,
    whole=(16,),
)
# Functions of several constants end at the law from few of their starts.
RARE = ProposalSettings(
    starts=9,
    steps=25,
    tries=((1.0, 1e-9), (0.5, 1e-9), (1.0, 1.0)),
    library=LibrarySettings(rare=True),
)


@dataclass(frozen=True, eq=False)
class _Units:
    """Rows (P, r) of length 1, or of 0 where there is nothing, and their lengths (P,)."""

    rows: np.ndarray
    sizes: np.ndarray

    def some(self, places: np.ndarray) -> _Units:
        """Give some of the rows."""
        return _Units(self.rows[places], self.sizes[places])

    def full(self, places: np.ndarray) -> np.ndarray:
        """(P, r) some of the rows with their own lengths."""
        sizes = self.sizes[places, None]
        return self.rows[places] * np.where(sizes < np.inf, sizes, 0.0)


def _have_squares(sizes: np.ndarray) -> np.ndarray:
    """Whether sizes have squares that are float64 numbers."""
    return np.asarray((sizes > 1e-150) & (sizes < 1e150))


def _unit(rows: np.ndarray) -> _Units:
    sizes = np.linalg.norm(rows, axis=1)
    fine = _have_squares(sizes)
    units = np.where(fine[:, None], rows / np.where(fine, sizes, 1.0)[:, None], 0.0)
    return _Units(units, np.where(fine, sizes, np.inf))


@dataclass(frozen=True, eq=False)
class Sum:
    """A sum of forms, fitted to the evidence.

    Parameters
    ----------
    places : of its forms in the library, in order.
    constants : (s, most) those inside each form; 0 for those that it does not have.
    weights : (s,) coefficients.
    left : sum of squares that is left of the target.
    bits : all bits.
    """

    places: tuple[int, ...]
    constants: np.ndarray
    weights: np.ndarray
    left: float
    bits: float

    def write(self, library: Library) -> sympy.Expr:
        """Write it as a formula."""
        forms = (library.forms[place] for place in self.places)
        written = (
            f.write(library.names, own[: f.constants])
            for f, own in zip(forms, self.constants, strict=True)
        )
        pairs = zip(self.weights.tolist(), written, strict=True)
        return sympy.Add(*[sympy.Float(weight) * expr for weight, expr in pairs])


@dataclass(frozen=True, eq=False)
class _Layer:
    """Sums of equally many forms, all fitted at once.

    Parameters
    ----------
    places, constants : (b, s) their forms in order, and (b, s, most) the constants inside.
    weights : (b, s) coefficients.
    rows : (b, s, r) mapped values of the forms.
    slopes : (b, s, most, r) mapped slopes of the forms by their constants.
    basis : (b, s, r) orthonormal rows that span the mapped forms.
    rest : (b, r) what is left of the target.
    left : (b,) its sum of squares; infinite where the forms are not finite or not independent.
    losses : (b, s) squares that are left more without each of the forms.
    """

    places: np.ndarray
    constants: np.ndarray
    weights: np.ndarray
    rows: np.ndarray
    slopes: np.ndarray
    basis: np.ndarray
    rest: np.ndarray
    left: np.ndarray
    losses: np.ndarray

    def __len__(self) -> int:
        return len(self.places)

    def some(self, rows: np.ndarray) -> _Layer:
        """Give some of them."""
        return _Layer(*(getattr(self, own.name)[rows] for own in fields(self)))

    def improve(self, rows: np.ndarray, others: _Layer) -> np.ndarray:
        """Put better sums in the place of some of them; gives for which of these there is none."""
        better = others.left < self.left[rows]
        for own in fields(self):
            getattr(self, own.name)[rows[better]] = getattr(others, own.name)[better]
        return np.asarray(~better)


def _joined(layers: Sequence[_Layer]) -> _Layer:
    """Give the sums of several layers, each choice of forms once."""
    parts = (
        np.concatenate([getattr(layer, own.name) for layer in layers]) for own in fields(_Layer)
    )
    whole = _Layer(*parts)
    kept: dict[tuple[int, ...], int] = {}
    for i in np.argsort(whole.left, kind="stable"):
        kept.setdefault(tuple(whole.places[i].tolist()), int(i))
    return whole.some(np.sort(np.array(list(kept.values()))))


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

    def best(self, enough: Callable[[list[Sum], int], bool] | None = None) -> list[Sum]:
        """Give the best sums, those of the fewest bits first.

        Parameters
        ----------
        enough : whether the best sums of the cheapest forms are good enough to end the search;
            its second argument is how many times more forms there are.
        """
        found: dict[tuple[int, ...], Sum] = {}
        with np.errstate(all="ignore"):
            before: list[_Layer] = []
            # With constants that stay a sum may end elsewhere when it is reached again.
            tried: list[np.ndarray] | None = [] if self.settings.free else None
            tiers = list(self._tiers())
            for left, tier in zip(reversed(range(len(tiers))), tiers, strict=True):
                before = self._grow_from_nothing(tier, before, tried, found)
                if enough is not None and enough(best := self._front_first(found), left):
                    return best
            self._thin_whole(found)
            self._refine(found)
        return self._front_first(found)

    def near(self, places: Sequence[int], *, from_nothing: bool = False) -> list[Sum]:
        """Give the best sums that come of one by adding, exchanging and dropping forms in turn.

        Those that are expected to take many more bits than it are left out.

        Parameters
        ----------
        places : of its forms in the library, whose constants inside do not move.
        from_nothing : whether the sums are grown from nothing instead.
        """
        found: dict[tuple[int, ...], Sum] = {}
        with np.errstate(all="ignore"):
            begun = self._fit(np.array([places]), np.zeros((1, len(places), self.library.most)))
            begun = begun.some(np.isfinite(begun.left))
            most = float(np.min(self._bits(begun), initial=math.inf)) + self.settings.doubt
            if not from_nothing:
                for layer in (begun, self._grow(begun, self._allowed)):
                    self._note(layer, found)
                self._refine(found)
        ranked = self.best() if from_nothing else self._front_first(found)
        return [one for one in ranked if one.bits <= most]

    def _refine(self, found: dict[tuple[int, ...], Sum]) -> None:
        """Exchange forms of the best sums while that finds better ones, then drop some."""
        for _ in range(self.settings.rounds):
            if not self._exchange(found):
                break
        for one in self._ranked(found):
            self._thin(one, found)

    def _grow_from_nothing(
        self,
        tier: np.ndarray,
        before: Sequence[_Layer],
        tried: list[np.ndarray] | None,
        found: dict[tuple[int, ...], Sum],
    ) -> list[_Layer]:
        """Grow sums by one form at a time until two more gain less than a bit, or none can.

        Those of the cheapest forms are grown further by more expensive ones too.

        Parameters
        ----------
        tier, before : the forms, and the best sums of fewer forms of each length.
        tried : marks of the sums that were fitted, which fill up; None where they are fitted again.
        found : the sums found, which fill up.
        """
        layer, least, idle, layers = self._nothing, math.inf, 0, list(before)
        for length in range(self.settings.terms):
            if not self._may_be_better(length + 1, found):
                break
            earlier = layers[length : length + 1]
            layer = self._grow(layer, tier, tried)
            self._note(layer, found)
            self._note_shorter(layer, found)
            if not (own := [one for one in (*earlier, layer) if len(one)]):
                break
            layer = _joined(own)
            best = float(np.min(self._bits(layer)))
            idle = 0 if best < least - 1 else idle + 1
            if idle == 2:
                break
            least = min(least, best)
            layers[length : length + 1] = [layer]
        return layers

    def _may_be_better(self, length: int, found: Mapping[tuple[int, ...], Sum]) -> bool:
        """Whether sums of so many forms that miss nothing would take the fewest bits, or nearly."""
        possible = float(self.evidence.misses(0.0) + self.costs[self._cheapest[:length]].sum())
        least = min((one.bits for one in found.values()), default=math.inf)
        return bool(possible < least + self.settings.doubt)

    def _note(self, layer: _Layer, found: dict[tuple[int, ...], Sum]) -> list[Sum]:
        """Add sums to those that were found, where they are better."""
        bits = self._bits(layer)
        sums = [
            Sum(
                tuple(layer.places[i].tolist()),
                layer.constants[i],
                layer.weights[i],
                float(layer.left[i]),
                float(bits[i]),
            )
            for i in range(len(layer))
        ]
        for one in sums:
            if one.places not in found or one.bits < found[one.places].bits:
                found[one.places] = one
        return sums

    def _note_shorter(self, layer: _Layer, found: dict[tuple[int, ...], Sum]) -> None:
        """Leave out terms while that takes fewer bits, and add the results to the sums found.

        With a term that explains nothing a law may be far behind; without it, it may be first.
        """
        while self.settings.shorter and len(layer) and layer.places.shape[1] > 1:
            without = self.evidence.misses(layer.left[:, None] + layer.losses)
            without = without - self.costs[layer.places]
            least = np.argmin(without, axis=1)
            rows = np.arange(len(layer))
            pays = without[rows, least] < self.evidence.misses(layer.left)
            rows, least = rows[pays], least[pays]
            kept = np.arange(layer.places.shape[1]) != least[:, None]
            shape = len(rows), layer.places.shape[1] - 1
            places = layer.places[rows][kept].reshape(shape)
            constants = layer.constants[rows][kept].reshape(*shape, self.library.most)
            layer = self._fit(places, constants)
            self._note(layer, found)

    def _thin_whole(self, found: dict[tuple[int, ...], Sum]) -> None:
        """Thin the sums of the cheapest terms, and these with one and two forms more.

        Of many terms none may explain anything before most of the others are there.
        """
        # Shorter sums were grown.
        if not self._may_be_better(self.settings.terms + 1, found):
            return
        plain = self._cheapest[self.library.inside[self._cheapest] == 0]
        for most in self.settings.whole:
            places = self._independent(plain[: min(most, len(self.evidence.y) // 4)])[None]
            layer = self._fit(places, np.zeros((*places.shape, self.library.most)))
            for _ in range(3):
                sums = sorted(self._note(layer, {}), key=lambda one: one.bits)
                for one in sums[: self.settings.exchanged]:
                    self._thin(one, found)
                layer = self._grow(layer, self._allowed)

    def _independent(self, places: np.ndarray) -> np.ndarray:
        """Leave out forms without a constant inside of which those before them leave nothing."""
        rows = self._rows[0].rows[self.library.first[places]]
        kept: list[int] = []
        basis = np.zeros((0, rows.shape[1]))
        for i, row in enumerate(rows):
            left = row - (row @ basis.T) @ basis
            # Once more, for what rounding leaves of the others.
            left = left - (left @ basis.T) @ basis
            size = np.linalg.norm(left)
            if size**2 > NOTHING_LEFT:
                basis, kept = np.vstack([basis, left / size]), [*kept, i]
        return np.sort(places[kept])

    def _tiers(self) -> Iterator[np.ndarray]:
        """Give the forms that sums are grown of, the cheapest few first, and all at last.

        A beam through few forms reaches sums that one through all of them passes by.
        """
        count = self.settings.tier
        while count < len(self._cheapest):
            yield np.sort(self._cheapest[:count])
            count *= self.settings.wider
        yield self._allowed

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
        before = self._ranked(found)[: self.settings.exchanged]
        lengths = {len(one.places) for one in before}
        for length in filter(lambda length: self._may_be_better(length, found), lengths):
            shorter = self._shortened([one for one in before if len(one.places) == length])
            grown = self._grow(self._fit(*shorter), self._allowed)
            self._note(grown, found)
            self._note_shorter(grown, found)
        return self._ranked(found)[: self.settings.exchanged] != before

    def _shortened(self, sums: Sequence[Sum]) -> tuple[np.ndarray, np.ndarray]:
        """Give forms and constants of equally long sums without each one of their forms, once."""
        shorter: dict[tuple[int, ...], np.ndarray] = {}
        for one in sums:
            for i in range(len(one.places)):
                less = (*one.places[:i], *one.places[i + 1 :])
                shorter.setdefault(less, np.delete(one.constants, i, axis=0))
        shape = len(shorter), len(sums[0].places) - 1
        places = np.array(list(shorter), dtype=int).reshape(shape)
        return places, np.array(list(shorter.values())).reshape(*shape, self.library.most)

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
    def _allowed(self) -> np.ndarray:
        """Places of the forms that may be terms."""
        return np.flatnonzero(np.isfinite(self.costs))

    @cached_property
    def _cheapest(self) -> np.ndarray:
        """The same, the cheapest first."""
        return self._allowed[np.argsort(self.costs[self._allowed], kind="stable")]

    @cached_property
    def _rows(self) -> tuple[_Units, tuple[_Units, ...]]:
        """Mapped values of all forms with the constants they begin with, and slopes by these."""
        values, slopes = self._values.begun
        turned = (_unit(self.evidence.mapped(own)) for own in slopes.swapaxes(0, 1))
        return _unit(self.evidence.mapped(values)), tuple(turned)

    @cached_property
    def _values(self) -> FormValues:
        """The values of all forms."""
        return FormValues(self.library, self.evidence.points)

    def _bits(self, layer: _Layer) -> np.ndarray:
        """(b,) all bits of sums."""
        return self.evidence.misses(layer.left) + self.costs[layer.places].sum(axis=1)

    def _grow(
        self, layer: _Layer, tier: np.ndarray, tried: list[np.ndarray] | None = None
    ) -> _Layer:
        """Give the best sums with one form more.

        Each form is added to each sum with its best constant. Those that are expected to take the
        fewest bits are fitted, if they were not tried before.
        """
        if not len(layer):
            return layer
        places = np.flatnonzero(np.isin(self.library.owners, tier))
        first = np.searchsorted(self.library.owners[places], tier)
        free = self._freed(layer) if self.settings.free else layer
        gains = self._gains(free, places)
        best = np.maximum.reduceat(gains, first, axis=0)
        # What is expected below nothing at all is not expected to be better for it.
        left = np.maximum(free.left - best, SINGULAR * layer.left.max())
        bits = self.evidence.misses(left) + self.costs[layer.places].sum(axis=1)
        bits = bits + self.costs[tier, None]
        bits[~(np.isfinite(bits) & (best > 0))] = np.inf
        length, widths = layer.places.shape[1], self.settings.shortest
        width = widths[length] if length < len(widths) else self.settings.beam
        room, ways = self._room(self.settings.fitted * width), dict[int, list[tuple[int, int]]]()
        for owner, row, parent in self._choose(layer, tier, bits, room, tried):
            # From the constants of another parent a sum may end elsewhere.
            if (
                len(own := ways.setdefault(owner, []))
                < self.settings.parents * self.settings.starts
            ):
                end = first[row + 1] if row + 1 < len(first) else len(places)
                likely = np.argsort(-gains[first[row] : end, parent], kind="stable")
                own += [(parent, places[first[row] + i]) for i in likely[: self.settings.starts]]
        if not ways:
            return layer.some(np.zeros(0, dtype=int))
        parents, begun = np.array([way for own in ways.values() for way in own]).T
        return self._best_of_each(self._extended(layer, parents, begun), width)

    def _freed(self, layer: _Layer) -> _Layer:
        """Set the constants inside sums free: slopes by them are taken out of the residuals."""
        basis, rest = layer.basis, layer.rest
        for slopes in layer.slopes.reshape(len(layer), -1, rest.shape[1]).swapaxes(0, 1):
            units = _unit(np.nan_to_num(slopes, posinf=0.0, neginf=0.0)).rows
            # Once more, for what rounding leaves of the others.
            for _ in range(2 if units.any() else 0):
                said = np.einsum("bsr,br->bs", basis, units)
                units = units - np.einsum("bs,bsr->br", said, basis)
            sizes = np.linalg.norm(units, axis=1)
            units = units / np.where(sizes**2 > NOTHING_LEFT, sizes, np.inf)[:, None]
            rest = rest - np.sum(rest * units, axis=1)[:, None] * units
            basis = np.concatenate([basis, units[:, None]], axis=1)
        left = np.where(np.isfinite(layer.left), np.sum(rest**2, axis=1), np.inf)
        return replace(layer, basis=basis, rest=rest, left=left)

    def _choose(
        self,
        layer: _Layer,
        tier: np.ndarray,
        bits: np.ndarray,
        room: Sequence[int],
        tried: list[np.ndarray] | None,
    ) -> Iterator[tuple[int, int, int]]:
        """Give the sums to be fitted, by number, with the form's place in the tier and the parent.

        Parameters
        ----------
        layer, tier : the sums and the forms.
        bits : (forms, b) that are expected.
        room : how many sums of each number of constants inside are fitted.
        tried : marks of the sums that were fitted before; those that are given now are added.
        """
        holds = np.zeros((len(self.library.forms), len(layer)), dtype=bool)
        holds[layer.places.T, np.arange(len(layer))] = True
        bits = np.where(holds[tier], np.inf, bits)
        order = np.argsort(bits, axis=None, kind="stable")[: np.count_nonzero(bits < np.inf)]
        rows, parents = np.divmod(order, len(layer))
        # The same sum is reached from several others.
        named = self._marks[layer.places].sum(axis=1)[parents] + self._marks[tier[rows]]
        _, first, owners = np.unique(named, return_index=True, return_inverse=True)
        inside = self.library.inside[layer.places].sum(axis=1)[parents[first]]
        kinds = np.minimum(inside + self.library.inside[tier[rows[first]]], len(room) - 1)
        taken, end = np.zeros(len(first), dtype=bool), 0
        for kind, most in enumerate(room):
            own = np.sort(first[kinds == kind])
            taken[owners[own[:most]]] = True
            end = max(end, own[most - 1] + 1 if len(own) >= most else len(order))
        if tried is not None:
            marks = named[first]
            for earlier in tried:
                taken &= ~np.isin(marks, earlier)
            tried.append(marks[taken])
        for place in np.flatnonzero(taken[owners[:end]]):
            yield int(owners[place]), int(rows[place]), int(parents[place])

    @cached_property
    def _marks(self) -> np.ndarray:
        """(forms,) numbers of which the sum says which forms it is of, in any order."""
        ends = np.iinfo(np.int64)
        return np.random.default_rng(0).integers(ends.min, ends.max, len(self.library.forms))

    def _extended(self, layer: _Layer, parents: np.ndarray, begun: np.ndarray) -> _Layer:
        """Fit sums with one form more each, from the constants that it begins with.

        Parameters
        ----------
        layer, parents : the sums, and which of them.
        begun : the rows of values of the forms.
        """
        units, turned = self._rows
        slopes = np.stack([own.full(begun) for own in turned], axis=1)
        pairs = (
            (layer.places, self.library.owners[begun]),
            (layer.constants, self.library.begun[begun]),
            (layer.rows, units.full(begun)),
            (layer.slopes, slopes),
        )
        joined = [np.concatenate([o[parents], new[:, None]], axis=1) for o, new in pairs]
        order = np.argsort(joined[0], axis=1, kind="stable")
        own = np.arange(len(order))[:, None]
        fitted = self._solve(*(each[own, order] for each in joined))
        return self._move_on(fitted, self.settings.steps)

    def _best_of_each(self, layer: _Layer, width: int) -> _Layer:
        """Give the best sums, each choice of forms once."""
        bits = self._bits(layer)
        kept: dict[tuple[int, ...], int] = {}
        inside, room = self.library.inside[layer.places].sum(axis=1), self._room(width)
        for i in np.argsort(bits, kind="stable"):
            kind, key = min(int(inside[i]), len(room) - 1), tuple(layer.places[i].tolist())
            if np.isfinite(bits[i]) and key not in kept and room[kind]:
                kept[key] = int(i)
                room[kind] -= 1
        return layer.some(np.array(list(kept.values()), dtype=int))

    def _room(self, width: int) -> list[int]:
        """Give how many sums of each number of constants inside are kept, the last of more."""
        kinds = self.settings.kinds
        return [-(-width // kinds)] * kinds

    def _gains(self, layer: _Layer, places: np.ndarray) -> np.ndarray:
        """(P, b) squares that some rows of values take off, their constants inside set free."""
        units, turned = self._rows
        gains = np.zeros((len(places), len(layer)))
        inside = self.library.inside[self.library.owners[places]]
        for count in np.unique(inside):
            own = np.flatnonzero(inside == count)
            # Blocks of rows stay in the cache.
            for rows in np.array_split(own, -(-len(own) // _BLOCK)):
                some = places[rows]
                slopes = [one.some(some) for one in turned[:count]]
                gains[rows] = self._gains_of(layer, units.some(some), slopes)
        return gains

    def _gains_of(self, layer: _Layer, units: _Units, turned: Sequence[_Units]) -> np.ndarray:
        """(P, b) the same for rows with equally many constants inside."""
        rows, last = [units.rows, *(own.rows for own in turned)], len(turned)
        pulls = [own @ layer.rest.T for own in rows]
        left = {
            (i, j): np.tile(np.sum(rows[i] * rows[j], axis=1)[:, None], len(layer))
            for i in range(last + 1)
            for j in range(i, last + 1)
        }
        for basis in layer.basis.swapaxes(0, 1):
            said = [own @ basis.T for own in rows]
            for i, j in left:
                left[i, j] -= said[i] * said[j]
        alone = np.where(
            left[0, 0] > NOTHING_LEFT, pulls[0] ** 2 / np.maximum(left[0, 0], NOTHING_LEFT), 0.0
        )
        # The slopes are taken out of the values one by one, the last first.
        own, inverse = list(pulls), {}
        for k in range(last, 0, -1):
            told = left[k, k] > NOTHING_LEFT
            inverse[k] = np.where(told, 1 / np.maximum(left[k, k], NOTHING_LEFT), 0.0)
            for i in range(k):
                share = left[i, k] * inverse[k]
                own[i] = own[i] - share * own[k]
                for j in range(i, k):
                    left[i, j] = left[i, j] - share * left[j, k]
        weight = own[0] / left[0, 0]
        moves, gain, free = [weight], weight * pulls[0], left[0, 0] > NOTHING_LEFT
        for k in range(1, last + 1):
            said = sum(left[i, k] * move for i, move in enumerate(moves))
            moves.append((own[k] - said) * inverse[k])
            gain = gain + moves[k] * pulls[k]
            reach = np.abs(moves[k] / weight * (units.sizes / turned[k - 1].sizes)[:, None])
            free &= reach <= self.settings.reach
        return np.where(free, gain, alone)

    def _finish(self, places: np.ndarray, constants: np.ndarray, steps: int) -> _Layer:
        """Fit sums, and move the constants inside while that is better."""
        return self._move_on(self._fit(places, constants), steps)

    def _move_on(self, best: _Layer, steps: int) -> _Layer:
        """Move the constants inside of sums while that is better."""
        inside = self.library.inside[best.places].any(axis=1)
        moving = np.flatnonzero(np.isfinite(best.left) & inside)
        for _ in range(steps):
            if not len(moving):
                break
            before = best.left[moving] + self.evidence.beside
            self._move(best, moving)
            after = best.left[moving] + self.evidence.beside
            moving = moving[after < (1 - self.settings.better) * before]
        return best

    def _move(self, best: _Layer, moving: np.ndarray) -> None:
        """Move the constants inside of some sums by a step, or others, if it is better."""
        before, steps = math.nan, np.zeros(0)
        for scale, damped in self.settings.tries:
            own = best.some(moving)
            # A share of a step needs no new one.
            again = damped == before
            steps, before = steps if again else self._steps(own, damped), damped
            moved = self._stepped(own, scale * steps)
            worse = best.improve(moving, moved)
            moving, steps = moving[worse], steps[worse]
            if not again and len(moving):
                # Where a valley bends, a step leads out of it and the next one back, further on.
                moved = moved.some(worse)
                worse = best.improve(moving, self._stepped(moved, self._steps(moved, damped)))
                moving, steps = moving[worse], steps[worse]
            if not len(moving):
                return

    def _stepped(self, layer: _Layer, steps: np.ndarray) -> _Layer:
        """Fit sums after steps of the constants inside."""
        far = self.settings.farthest
        ahead = np.clip(steps, -far, far)
        return self._fit(layer.places, self.library.moved(layer.places, layer.constants, ahead))

    def _steps(self, layer: _Layer, damped: float) -> np.ndarray:
        """(b, s, most) steps of the constants inside (Levenberg); the coefficients follow."""
        count, terms, _, width = layer.slopes.shape
        slopes = layer.weights[:, :, None, None] * layer.slopes
        slopes = np.nan_to_num(slopes, posinf=0.0, neginf=0.0).reshape(count, -1, width)
        # What the coefficients can do is taken out of the slopes.
        slopes = slopes - (slopes @ layer.basis.swapaxes(1, 2)) @ layer.basis
        units = _unit(slopes.reshape(-1, width))
        rows = units.rows.reshape(slopes.shape)
        gram = rows @ rows.swapaxes(1, 2) + damped * np.eye(rows.shape[1])
        pull = rows @ layer.rest[:, :, None]
        steps = np.linalg.solve(gram, pull)[:, :, 0] / units.sizes.reshape(count, -1)
        return steps.reshape(count, terms, self.library.most)

    def _mapped(self, places: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give mapped values (k, r) of forms, and slopes (k, most, r) by the constants inside."""
        values = self._rows[0].full(self.library.first[places])
        slopes = np.zeros((len(places), self.library.most, values.shape[1]))
        inside = self.library.inside[places]
        moving = np.flatnonzero(inside)
        if len(moving):
            raw, turned = self._values.of(places[moving], constants[moving])
            values[moving] = self.evidence.mapped(raw)
            for place in range(self.library.most):
                held = inside[moving] > place
                slopes[moving[held], place] = self.evidence.mapped(turned[held, place])
        return values, slopes

    @property
    def _nothing(self) -> _Layer:
        """The sum of no forms."""
        return self._fit(np.zeros((1, 0), dtype=int), np.zeros((1, 0, self.library.most)))

    def _fit(self, places: np.ndarray, constants: np.ndarray) -> _Layer:
        """Fit the coefficients of sums."""
        rows, slopes = self._mapped(places.ravel(), constants.reshape(-1, self.library.most))
        shape = (*places.shape, len(self.evidence.y))
        slopes = slopes.reshape(*places.shape, *slopes.shape[1:])
        return self._solve(places, constants, rows.reshape(shape), slopes)

    def _solve(
        self, places: np.ndarray, constants: np.ndarray, rows: np.ndarray, slopes: np.ndarray
    ) -> _Layer:
        """Fit the coefficients of sums whose forms have these mapped values and slopes."""
        y, terms = self.evidence.y, places.shape[1]
        sizes = np.linalg.norm(rows, axis=2)
        fine = np.all(_have_squares(sizes), axis=1)
        sizes[~fine] = 1.0
        rows[~fine] = 0.0
        q, r = np.linalg.qr((rows / sizes[:, :, None]).swapaxes(1, 2))
        apart = np.abs(np.diagonal(r, axis1=1, axis2=2))
        fine &= np.all(apart**2 > NOTHING_LEFT, axis=1)
        r[~fine] = np.eye(terms)
        basis = q.swapaxes(1, 2)
        inner = basis @ y
        rest = y - np.einsum("bsr,bs->br", basis, inner)
        weights = np.linalg.solve(r, inner[:, :, None])[:, :, 0]
        losses = weights**2 / np.sum(np.linalg.inv(r) ** 2, axis=2)
        left = np.where(fine, np.sum(rest**2, axis=1), np.inf)
        return _Layer(places, constants, weights / sizes, rows, slopes, basis, rest, left, losses)

    def _thin(self, one: Sum, found: dict[tuple[int, ...], Sum]) -> None:
        """Leave out terms, that which is missed least first, and keep what that gives."""
        while len(one.places) > 1:
            shorter = self._note(self._finish(*self._shortened([one]), 1), {})
            best = min((found.get(s.places, s) for s in shorter), key=lambda s: s.bits)
            if best.bits >= one.bits:
                return
            found.setdefault(best.places, best)
            one = best


def propose(
    evidence: Evidence,
    place: Place,
    allow: Callable[[sympy.Expr], bool] | None,
    offered: Sequence[sympy.Expr] = (),
    others: Sequence[tuple[str, sympy.Expr]] = (),
    settings: ProposalSettings = PROPOSALS,
    *,
    functions: bool = True,
    enough: Callable[[Iterator[sympy.Expr], int], bool] | None = None,
    near: sympy.Expr | None = None,
    from_nothing: bool = False,
) -> list[sympy.Expr]:
    """Give the sums of terms of the library that are expected to take the fewest bits.

    Parameters
    ----------
    evidence : what the data say of the equation.
    place : whose equation it is, and of which columns.
    allow : whether a term may be one; None where all may.
    offered : more terms.
    others : states and equations of theirs; terms in these cost less.
    settings : the numbers that decide.
    functions : whether others than the terms that are offered, those of the other equations and
        products of the columns are terms.
    enough : whether sums of the cheapest terms, the best first, are good enough to end the search;
        its second argument is how many times more terms there are.
    near : an equation to start from; by default sums are grown from nothing.
    from_nothing : whether they are so with ``near`` too, and only those come back that are expected
        to take hardly more bits than it.
    """
    names = place.columns
    begun = () if near is None else bodies_of(near)
    # What one state loses another gains: the whole of an equation is a term of the others.
    whole = [expr for _, expr in others if expr.is_Add]
    own = (*begun, *offered, *cited_terms((expr for _, expr in others), place.state), *whole)
    kinds = replace(settings.library, functions=functions)
    beside = evidence.names[len(names) :]
    library = Library.of(names, evidence.points, place.angles or (), own, kinds, beside)
    stands, prior, weighed = write_down(others), textbooks(), bits_in_force()
    each = evidence.constant_bits
    costs = np.full(len(library.forms), np.inf)
    for i, (form, starts) in enumerate(zip(library.forms, library.starts, strict=True)):
        # To write a form in SymPy takes longer than all else here.
        asked = form.own is not None or allow is not None or weighed
        body = form.write(evidence.names, starts[0]) if asked else sympy.S.One
        if body.is_Add and form.own is not None:
            terms = bodies_of(body)
            if allow is None or all(map(allow, terms)):
                costs[i] = each + sum(term_bits(term, place, stands) for term in terms)
            continue
        if allow is None or allow(body):
            # Those of another equation's term are known, and stay.
            inside = len(body.atoms(sympy.Float)) if form.own in begun else form.constants
            written_out = prior.term_bits(form.read(names), place, stands) + _own_bits(body)
            # What the user offers is told by which of them it is.
            told = min(written_out, math.log2(len(offered))) if form.own in offered else written_out
            costs[i] = told + each * (1 + inside)

    def written(sums: list[Sum]) -> Iterator[sympy.Expr]:
        return (one.write(library) for one in sums)

    proposer = Proposer(evidence, library, costs, settings)
    if begun:
        sums = proposer.near(range(len(begun)), from_nothing=from_nothing)
    elif enough is None:
        sums = proposer.best()
    else:
        sums = proposer.best(lambda sums, left: enough(written(sums), left))
    return list(dict.fromkeys(written(sums)))


def term_bits(body: sympy.Expr, place: Place, written: Written) -> float:
    """Bits of one term without its constants.

    Parameters
    ----------
    body : a product.
    place : whose equation contains it.
    written : what other equations have.
    """
    return textbooks().term_bits(read_body(body), place, written) + _own_bits(body)


def _own_bits(body: sympy.Expr) -> float:
    """Bits that the user adds to a term with a coefficient."""
    return added_bits(sympy.Float(0.5) * body) if bits_in_force() else 0.0


def cited_terms(exprs: Iterable[sympy.Expr], state: str) -> list[sympy.Expr]:
    """Give the terms of equations, which cost less in another one.

    These are the terms themselves, and those with which this state slows itself down as another one
    does, such as friction.

    >>> x, y = sympy.symbols("x y")
    >>> [str(term) for term in cited_terms([0.5 * x - 0.3 * x * sympy.Abs(x - y)], "y")]
    ['x', 'x*Abs(x - y)', 'y*Abs(x - y)']
    """
    bodies = [body for expr in exprs for body in bodies_of(expr) if body.free_symbols]
    own = sympy.Symbol(state)
    wide = [f * own for body in bodies for f in sympy.Mul.make_args(body) if wide_factors(f)]
    return one_of_each_shape([*bodies, *wide])
