"""Values: what the forms of a library are at some points, forms of the same atoms at once."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynsr.expression import compile_columns
from dynsr.library.forms import Library, padded


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
        for kind in np.unique(kinds):
            some = np.flatnonzero(kinds == kind)
            self._multiply(some, places[some], constants[some], values, slopes)
        slopes *= self.library.units[places][:, :, None]
        return values, slopes

    @property
    def begun(self) -> tuple[np.ndarray, np.ndarray]:
        """Values (P, n) of all forms with all constants that they begin with, and slopes."""
        return self.of(self.library.owners, self.library.begun)

    def _multiply(
        self,
        some: np.ndarray,
        places: np.ndarray,
        constants: np.ndarray,
        values: np.ndarray,
        slopes: np.ndarray,
    ) -> None:
        """Multiply some rows of values by their atoms, which are the same; put their slopes in."""
        value, turned, used, held = values[some], list[np.ndarray](), 0, 0
        for atom in (factor.atom for factor in self.library.forms[places[0]].factors):
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
    def _kinds(self) -> np.ndarray:
        """(forms,) a number for the atoms of each."""
        return _numbered(tuple(f.atom.name for f in form.factors) for form in self.library.forms)

    @cached_property
    def _columns(self) -> np.ndarray:
        """(forms, most) places of the columns of their atoms, one atom after the other."""
        each = [[c for f in form.factors for c in f.columns] for form in self.library.forms]
        return padded(each, max(map(len, each), default=0)).astype(int)

    @cached_property
    def _rows(self) -> np.ndarray:
        """(forms,) a number for what is not an atom: powers of columns, or a term that is given."""
        forms = self.library.forms
        return _numbered(form.powers if form.own is None else form.own for form in forms)

    @cached_property
    def _plain(self) -> np.ndarray:
        """(rows, n) values of products of powers, and of terms that are given."""
        rows, first = np.unique(self._rows, return_index=True)
        found = np.ones((len(rows), self.points.shape[1]))
        for row, form in zip(rows, (self.library.forms[place] for place in first), strict=True):
            if form.own is not None:
                found[row] = compile_columns([form.own], self.library.names)(*self.points)
                continue
            plain = np.ones(self.points.shape[1])
            for place, power in form.powers:
                plain = plain * self.points[place] ** power
            found[row] = plain
        return found


def _numbered(keys: Iterable[Hashable]) -> np.ndarray:
    """(n,) a number for each key, from 0 on; equal keys have the same."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(key, len(numbers)) for key in keys])
