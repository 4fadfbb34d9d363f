"""Forms: terms of laws by what they are made of, with the values that they take.

A form is a product of powers of the columns and of atoms. It is written in SymPy once; its values,
and their slopes by the constants inside, come from its atoms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import chain, combinations, combinations_with_replacement, permutations, product

import numpy as np
import sympy

from dynsr.expression import marks
from dynsr.library.atoms import ATOMS, Atom, Domain, Inside
from dynsr.library.prior import Term, read_body

# Atoms of which two may stand in one term, of different columns.
_TOGETHER = ("saturates1", "saturates2", "inhibits1", "inhibits2")
# Atoms that are another one, or none, beside a column of their own.
_INVERSES = ("inverse", "inverse square", "inverse cube", "power")
_CANCELLED = (*_INVERSES, "inhibits1", "inhibits2", "inhibits3", "inhibits4")
# Names in the order of the alphabet, in place of those of the columns of a form.
_NAMES = ("a", "b", "c", "d", "e", "f", "g", "h")


@dataclass(frozen=True)
class LibrarySettings:
    """Settings of the library; they are part of a run's record.

    Parameters
    ----------
    degree : most columns in a product without a function.
    alone : most powers of one column where it is the only one.
    below : share of its largest value by which a column may fall below 0 that is never negative.
    away : share of its usual size that a column stays away from 0 for its inverse to be a term.
    low, beyond : sizes at which a function may bend: from half of that quantile of its column's own
        sizes, up to that multiple of the largest,
    widest, apart : so far from each other at most, and so many times each the one before.
    roam : times as far as where they are begun sizes may be moved.
    functions : whether there are others than products of the columns.
    rare : whether these are the rare atoms and all with several constants inside, not the others.
    most : rows of values at most; of more, those of the forms with fewest factors are kept.
    """

    degree: int = 3
    alone: int = 5
    below: float = 0.03
    away: float = 0.1
    low: float = 0.02
    beyond: float = 3.0
    widest: float = 100.0
    apart: float = 1.9
    roam: float = 10.0
    functions: bool = True
    rare: bool = False
    most: int = 12_000


@dataclass(frozen=True)
class Factor:
    """An atom of certain columns, by their places."""

    atom: Atom
    columns: tuple[int, ...]


@dataclass(frozen=True)
class Form:
    """A product of powers of columns and of atoms, or a term that is given.

    Parameters
    ----------
    powers : (place of a column, exponent) of each.
    factors : the atoms.
    own : a term that is taken as it is.
    """

    powers: tuple[tuple[int, int], ...] = ()
    factors: tuple[Factor, ...] = ()
    own: sympy.Expr | None = None

    @cached_property
    def inside(self) -> tuple[Inside, ...]:
        """The constants inside."""
        return tuple(one for factor in self.factors for one in factor.atom.inside)

    @property
    def constants(self) -> int:
        """How many constants are inside."""
        return len(self.inside)

    @property
    def columns(self) -> set[int]:
        """Places of its columns; none of a term that is given."""
        return {place for place, _ in self.powers}.union(*(f.columns for f in self.factors))

    def _renamed(self, places: Mapping[int, int]) -> Form:
        """Give the form of other columns."""
        powers = sorted((places[place], power) for place, power in self.powers)
        factors = (Factor(f.atom, tuple(places[i] for i in f.columns)) for f in self.factors)
        return Form(tuple(powers), tuple(factors))

    def read(self, names: Sequence[str]) -> Term:
        """Take it apart as :func:`read_body` does what it writes.

        Forms that differ by the names of their columns alone are written once.

        Parameters
        ----------
        names : of all columns.
        """
        if self.own is not None:
            return read_body(self.own)
        # How a term is read depends on which of its names comes first in the alphabet.
        held = sorted(self.columns, key=lambda place: names[place])
        term = _read(self._renamed({place: i for i, place in enumerate(held)}))
        said = {_NAMES[i]: names[place] for i, place in enumerate(held)}
        return tuple(sorted(replace(f, columns=tuple(said[c] for c in f.columns)) for f in term))

    def write(self, names: Sequence[str], constants: Iterable[float] = ()) -> sympy.Expr:
        """Write it in its columns.

        Parameters
        ----------
        names : of all columns.
        constants : values of those inside.
        """
        if self.own is not None:
            return self.own
        symbols, left = [sympy.Symbol(name) for name in names], iter(constants)
        parts = [symbols[place] ** power for place, power in self.powers]
        for factor in self.factors:
            numbers = tuple(float(next(left)) for _ in factor.atom.inside)
            parts.append(factor.atom.write(tuple(symbols[i] for i in factor.columns), numbers))
        return sympy.Mul(*parts)


@dataclass(frozen=True, eq=False)
class Library:
    """All forms of some columns, with the constants that each starts from.

    Parameters
    ----------
    names : the columns.
    forms : the forms.
    starts : (g, c) constants of each.
    roam : times as far as where they are begun sizes may be moved.
    """

    names: tuple[str, ...]
    forms: tuple[Form, ...]
    starts: tuple[np.ndarray, ...] = field(repr=False)
    roam: float = 1.0

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        points: np.ndarray,
        turning: Sequence[str] = (),
        own: Sequence[sympy.Expr] = (),
        settings: LibrarySettings = LibrarySettings(),
        beside: Sequence[str] = (),
    ) -> Library:
        """Give the forms that the values of the columns allow.

        Parameters
        ----------
        names, points : the columns and their values (names, n), then those of ``beside``.
        turning : columns that may be angles.
        own : terms that are taken as they are.
        settings : which forms.
        beside : columns that only these may hold, such as the time.

        >>> x = np.linspace(0.5, 2.0, 20)[None]
        >>> library = Library.of(["x"], x)
        >>> any(str(f.write(["x"], [0.5])) == "x/(x + 0.5)" for f in library.forms)
        True
        """
        maker = _Maker(points[: len(names)], np.isin(names, list(turning)), settings)
        taken: dict[Form, np.ndarray] = {}
        begun: dict[tuple[Factor, ...], np.ndarray] = {}
        rows = 0
        for form in chain((Form(own=e) for e in own), maker.forms()):
            if form in taken:
                continue
            if form.factors not in begun:
                begun[form.factors] = maker.starts(form)
            rows += len(begun[form.factors])
            if rows > settings.most:
                break
            taken[form] = begun[form.factors]
        return cls((*names, *beside), tuple(taken), tuple(taken.values()), settings.roam)

    @cached_property
    def owners(self) -> np.ndarray:
        """(P,) place of the form of every row of values."""
        return np.repeat(np.arange(len(self.forms)), [len(s) for s in self.starts])

    @cached_property
    def constants(self) -> list[np.ndarray]:
        """Constants (c,) of every row of values."""
        return [row for own in self.starts for row in own]

    @cached_property
    def inside(self) -> np.ndarray:
        """(forms,) how many constants are inside each."""
        return np.array([form.constants for form in self.forms])

    @cached_property
    def most(self) -> int:
        """Constants inside a form at most."""
        return max(1, *self.inside.tolist())

    @cached_property
    def units(self) -> np.ndarray:
        """(forms, most) steps of 1 of the constants: what is signed has the size of its starts."""
        found = np.ones((len(self.forms), self.most))
        for i, (form, own) in enumerate(zip(self.forms, self.starts, strict=True)):
            for j in (j for j, one in enumerate(form.inside) if one.signed):
                found[i, j] = max(float(np.max(np.abs(own[:, j]))), 1e-300)
        return found

    def moved(self, places: np.ndarray, constants: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Give the constants inside forms after steps along their slopes, where columns see them.

        Parameters
        ----------
        places : (...) of the forms.
        constants, steps : (..., most) the constants, and steps along their slopes; of those that a
            form does not have, any.
        """
        signs, low, high = (own[places] for own in self._moves)
        added = constants + steps * self.units[places]
        moved = np.where(signs == 0, added, constants * np.exp(signs * steps))
        return np.clip(moved, low, high)

    @cached_property
    def _moves(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(forms, most) signs of steps of logarithms, 0 where there are none; least; most."""
        signs, low, high = (np.zeros((len(self.forms), self.most)) for _ in range(3))
        for i, (form, own) in enumerate(zip(self.forms, self.starts, strict=True)):
            count = own.shape[1]
            signs[i, : form.constants] = [one.sign for one in form.inside]
            free = np.array([one.free for one in form.inside], dtype=bool)
            low[i, :count] = np.where(free, -np.inf, own.min(axis=0))
            high[i, :count] = np.where(free, np.inf, own.max(axis=0))
        further = np.where(signs == 0, 1.0, self.roam)
        return signs, low / further, high * further

    @cached_property
    def begun(self) -> np.ndarray:
        """(P, most) constants of every row of values; 0 where its form has fewer."""
        return padded(self.constants, self.most)

    @cached_property
    def first(self) -> np.ndarray:
        """(forms,) the first row of values of each form."""
        return np.searchsorted(self.owners, np.arange(len(self.forms)))


@dataclass(frozen=True)
class _Maker:
    """Makes forms of columns with certain values."""

    points: np.ndarray
    turning: np.ndarray
    settings: LibrarySettings

    def forms(self) -> Iterator[Form]:
        """Give all forms, products first."""
        degree = self.settings.degree if len(self.points) > 1 else self.settings.alone
        for count in range(degree + 1):
            for chosen in combinations_with_replacement(range(len(self.points)), count):
                yield Form(_powers(chosen))
        factors = list(self.factors()) if self.settings.functions else []
        for count in range(max((f.atom.most for f in factors), default=0) + 1):
            for factor in (f for f in factors if count <= f.atom.most):
                for chosen in combinations_with_replacement(range(len(self.points)), count):
                    if not _is_said(factor, chosen):
                        yield Form(_powers(chosen), (factor,))
        waves = [f for f in factors if f.atom.name in ("sine", "cosine")]
        yield from (Form((), (a, b)) for a, b in combinations_with_replacement(waves, 2) if a != b)
        both = [f for f in factors if f.atom.name in _TOGETHER]
        for one, other in combinations(both, 2):
            if one.columns != other.columns:
                yield Form((), (one, other))

    def factors(self) -> Iterator[Factor]:
        """Give the atoms that the values of the columns allow."""
        places = range(len(self.points))
        rare = self.settings.rare
        for atom in (a for a in ATOMS.values() if a.rare == rare or (rare and len(a.inside) > 1)):
            # Columns that change places are another constant, or sign, of the same.
            ordered = atom.domain is Domain.APART_POSITIVE
            chosen = (permutations if ordered else combinations)(places, atom.columns)
            yield from (Factor(atom, columns) for columns in chosen if self._allow(atom, columns))

    def _allow(self, atom: Atom, columns: tuple[int, ...]) -> bool:
        domain, rows = atom.domain, self.points[list(columns)]
        if domain is Domain.FAR_FROM_0:
            sizes = np.linalg.norm(rows, axis=0)
            return bool(np.min(sizes) > self.settings.away * np.median(sizes))
        if domain is Domain.APART_POSITIVE:
            return bool(np.min(rows[0] - rows[1]) > 0)
        if domain is Domain.APART_BOTH_SIGNS:
            apart = rows[0] - rows[1]
            return bool(np.min(apart) < 0 < np.max(apart))
        return all(self._allows(domain, place) for place in columns)

    def _allows(self, domain: Domain, place: int) -> bool:
        row = self.points[place]
        low, high = float(np.min(row)), float(np.max(row))
        size = float(np.median(np.abs(row)))
        if not (low < high and size > 0):
            return False
        if domain is Domain.NEVER_NEGATIVE:
            return low > -self.settings.below * high
        if domain is Domain.POSITIVE:
            return low > 0
        if domain is Domain.AWAY_FROM_0:
            return low > self.settings.away * size
        if domain is Domain.BOTH_SIGNS:
            return low < 0 < high
        if domain is Domain.SHARE:
            return low > 0 and high < 1
        if domain is Domain.TURNING:
            return bool(self.turning[place])
        return True

    def starts(self, form: Form) -> np.ndarray:
        """(g, c) constants that a form starts from."""
        each = []
        for factor in (f for f in form.factors if f.atom.inside):
            rows = self.points[list(factor.columns)]
            each.append(factor.atom.begin(rows, self._sizes(factor.columns[0])))
        if not each:
            return np.zeros((1, 0))
        if len(each) > 1:
            each = [own[1::2] for own in each]
        return np.array([np.concatenate(rows) for rows in product(*each)])

    def _sizes(self, place: int) -> np.ndarray:
        """(g,) sizes of a column at which a function of it may bend."""
        sizes, settings = np.abs(self.points[place]), self.settings
        high = settings.beyond * float(sizes.max())
        least = float(np.quantile(sizes, settings.low)) / 2
        low = min(max(least, high / settings.widest), high / settings.apart)
        steps = math.ceil(math.log(high / low) / math.log(settings.apart))
        return np.geomspace(low, high, 1 + steps)


def padded(rows: Sequence[Sequence[float] | np.ndarray], width: int) -> np.ndarray:
    """(n, width) rows of numbers, with 0 where they are shorter.

    Parameters
    ----------
    rows, width : the n rows, and how long they become.

    >>> padded([[1.0], [2.0, 3.0]], 2).tolist()
    [[1.0, 0.0], [2.0, 3.0]]
    """
    found = np.zeros((len(rows), width))
    for whole, own in zip(found, rows, strict=True):
        whole[: len(own)] = own
    return found


@lru_cache(maxsize=50_000)
def _read(form: Form) -> Term:
    return read_body(form.write(_NAMES, map(float, marks(form.constants))))


def _powers(chosen: Sequence[int]) -> tuple[tuple[int, int], ...]:
    return tuple((place, list(chosen).count(place)) for place in sorted(set(chosen)))


def _is_said(factor: Factor, chosen: Sequence[int]) -> bool:
    """Whether a product is another form: v/(v + k) is a saturation, and v/v is nothing."""
    return factor.atom.name in _CANCELLED and not set(factor.columns).isdisjoint(chosen)
