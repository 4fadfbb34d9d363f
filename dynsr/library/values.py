"""Values: what the forms of a library are at some points, forms of the same atoms at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynsr.expression import compile_columns
from dynsr.library.atoms import Atom
from dynsr.library.forms import Form, Library


@dataclass(frozen=True, eq=False)
class FormValues:
    """Evaluates the forms of a library at n points.

    Parameters
    ----------
    library : the forms.
    points : (names, n) values of all columns.

    >>> x = np.linspace(0.5, 2.0, 20)[None]
    >>> library = Library.of(["x"], x)
    >>> values, slopes = FormValues(library, x).of(np.array([0, 1]), np.zeros((2, library.most)))
    >>> values.shape, slopes.shape == (2, library.most, 20)
    ((2, 20), True)
    """

    library: Library
    points: np.ndarray

    def of(self, places: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give values (k, n) of forms, and slopes (k, most, n) by steps of their constants.

        The slopes are 0 where a form has fewer constants.

        Parameters
        ----------
        places : (k,) of the forms.
        constants : (k, most) of those inside each.
        """
        values = self._plain[self._rows[places]]
        slopes = np.zeros((len(places), self.library.most, values.shape[1]))
        kinds = self._kinds[places]
        for kind in np.unique(kinds[kinds > 0]):
            some = np.flatnonzero(kinds == kind)
            self._multiply(self._atoms[kind], some, places[some], constants[some], values, slopes)
        slopes *= self.library.units[places][:, :, None]
        return values, slopes

    @property
    def begun(self) -> tuple[np.ndarray, np.ndarray]:
        """Values (P, n) of all forms with all constants that they begin with, and slopes."""
        constants = np.zeros((len(self.library.owners), self.library.most))
        for row, own in zip(constants, self.library.constants, strict=True):
            row[: len(own)] = own
        return self.of(self.library.owners, constants)

    def _multiply(
        self,
        atoms: tuple[Atom, ...],
        some: np.ndarray,
        places: np.ndarray,
        constants: np.ndarray,
        values: np.ndarray,
        slopes: np.ndarray,
    ) -> None:
        """Multiply some rows of values by their atoms, and put their slopes in."""
        value, turned, used, held = values[some], list[np.ndarray](), 0, 0
        for atom in atoms:
            rows = self.points[self._columns[places, held : held + atom.columns].T]
            own, by = atom.both(rows, constants[:, used : used + len(atom.inside)])
            turned = [slope * own for slope in turned]
            turned += [value * slope for slope in by.swapaxes(0, 1)]
            value = value * own
            used, held = used + len(atom.inside), held + atom.columns
        values[some] = value
        for place, slope in enumerate(turned):
            slopes[some, place] = slope

    @cached_property
    def _by_atoms(self) -> dict[tuple[str, ...], int]:
        """Names of the atoms of a form -> number of its kind; 0 for none."""
        found: dict[tuple[str, ...], int] = {(): 0}
        for form in self.library.forms:
            found.setdefault(_names(form), len(found))
        return found

    @cached_property
    def _kinds(self) -> np.ndarray:
        """(forms,) number of the kind of each."""
        return np.array([self._by_atoms[_names(form)] for form in self.library.forms])

    @cached_property
    def _atoms(self) -> dict[int, tuple[Atom, ...]]:
        """Number of a kind -> its atoms."""
        each = zip(self._kinds.tolist(), self.library.forms, strict=True)
        return {kind: tuple(f.atom for f in form.factors) for kind, form in each}

    @cached_property
    def _columns(self) -> np.ndarray:
        """(forms, most) places of the columns of their atoms, one atom after the other."""
        each = [[c for f in form.factors for c in f.columns] for form in self.library.forms]
        found = np.zeros((len(each), max(map(len, each), default=0)), dtype=int)
        for row, own in zip(found, each, strict=True):
            row[: len(own)] = own
        return found

    @cached_property
    def _numbered(self) -> dict[object, int]:
        """Powers of columns, or a term that is given -> number of the row of its values."""
        found: dict[object, int] = {}
        for form in self.library.forms:
            found.setdefault(_plain(form), len(found))
        return found

    @cached_property
    def _rows(self) -> np.ndarray:
        """(forms,) number of the row of what is not an atom."""
        return np.array([self._numbered[_plain(form)] for form in self.library.forms])

    @cached_property
    def _plain(self) -> np.ndarray:
        """(rows, n) values of products of powers, and of terms that are given."""
        found = np.ones((len(self._numbered), self.points.shape[1]))
        for form in self.library.forms:
            row = self._numbered[_plain(form)]
            if form.own is not None:
                found[row] = compile_columns([form.own], self.library.names)(*self.points)
                continue
            plain = np.ones(self.points.shape[1])
            for place, power in form.powers:
                plain = plain * self.points[place] ** power
            found[row] = plain
        return found


def _names(form: Form) -> tuple[str, ...]:
    return tuple(factor.atom.name for factor in form.factors)


def _plain(form: Form) -> object:
    return form.powers if form.own is None else form.own
