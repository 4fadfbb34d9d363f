"""Limits: cells that say only that a state was below, or above, a limit of its measurement."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynsr.errors import InputError, one_line

_PAIR = re.compile(r"(?P<low>[^.\s].*?|)\s*\.\.\s*(?P<high>\S.*|)")


@dataclass(frozen=True)
class Range:
    """The limits between which a state can be measured, as the user says.

    Parameters
    ----------
    below : at or below it a value is below the limit of detection; None for no such limit.
    above : at or above it a value is beyond the end of the range; None for no such limit.
    column : the column of the limits of detection, one for each row; "" for none.
    """

    below: float | None = None
    above: float | None = None
    column: str = ""

    @property
    def words(self) -> str:
        """The limits as they are written, such as "0.05..100"."""
        if self.column or self.above is None:
            return self.column or f"<{self.below:g}"
        return f">{self.above:g}" if self.below is None else f"{self.below:g}..{self.above:g}"


def read_limits(limits: Mapping[str, Any] | None) -> dict[str, Range]:
    """Read what a caller says of the limits of states.

    Parameters
    ----------
    limits : state -> the limit of detection in its units, as a number or as text such as "<0.05";
        the upper end of the range, such as ">100"; both, as a pair or as "0.05..100"; or the name
        of a column of limits of detection.

    Raises InputError where it has another form, or the range is empty.

    >>> read = read_limits({"x": 0.05, "y": ">100", "z": "0.05..100", "w": "w_lod"})
    >>> [own.words for own in read.values()]
    ['<0.05', '>100', '0.05..100', 'w_lod']
    """
    found = {}
    for state, said in (limits or {}).items():
        own = _read_limit(said)
        ends = [end for end in (own.below, own.above) if end is not None] if own else []
        fine = bool(ends) and all(map(math.isfinite, ends)) and ends == sorted(ends)
        if own is None or not (fine or own.column):
            shown = one_line(repr(said))[:60]
            raise InputError(
                f"the limit of {state!r} is {shown}; give the limit of detection, such as 0.05, "
                'the end of the range, such as ">100", both, such as "0.05..100", or a column'
            )
        found[state] = own
    return found


def _read_limit(said: Any) -> Range | None:
    if isinstance(said, str):
        text = said.strip()
        if pair := _PAIR.fullmatch(text):
            said = tuple(end or None for end in (pair["low"], pair["high"]))
        elif text[:1] in (">", "\u2265"):
            said = (None, text[1:].lstrip("= "))
        elif re.match(r"[^\W\d]", text) and text.lower() not in ("nan", "inf", "infinity"):
            return Range(column=text)
        else:
            said = (text.lstrip("<=\u2264 "), None)
    if not isinstance(said, (tuple, list)):
        said = (said, None)
    if len(said) != 2:
        return None
    try:
        below, above = (None if end is None else float(end) for end in said)
    except (TypeError, ValueError):
        return None
    return Range(below, above)


@dataclass(frozen=True, eq=False)
class Limits:
    """The cells of one state in which only a limit is known: what was measured is beyond it.

    Parameters
    ----------
    below : (n,) limits that the measured value was below; NaN at other rows. inf says that it was
        below a limit that is not known.
    above : (n,) limits that the measured value was above; NaN at other rows. -inf says that it was
        above a limit that is not known.

    >>> limits = Limits(np.array([np.nan, 0.5, np.inf]), np.full(3, np.nan))
    >>> limits.there.tolist(), limits.known.tolist()
    ([False, True, True], [False, True, False])
    """

    below: np.ndarray
    above: np.ndarray

    @classmethod
    def none(cls, rows: int) -> Limits:
        """Give limits of so many rows of which none has one."""
        return cls(np.full(rows, np.nan), np.full(rows, np.nan))

    @property
    def there(self) -> np.ndarray:
        """(n,) whether a row has a limit, known or not."""
        return ~(np.isnan(self.below) & np.isnan(self.above))

    @property
    def known(self) -> np.ndarray:
        """(n,) whether a row has a limit that is known."""
        return np.isfinite(self.below) | np.isfinite(self.above)

    @property
    def level(self) -> np.ndarray:
        """(n,) the limit of each row, whichever it is; NaN or inf where it is not known."""
        return np.where(np.isfinite(self.below), self.below, self.above)

    @property
    def side(self) -> np.ndarray:
        """(n,) 1 where the value was below a limit that is known, -1 elsewhere."""
        return np.where(np.isfinite(self.below), 1.0, -1.0)

    @classmethod
    def join(cls, parts: Sequence[Limits]) -> Limits:
        """Give the rows of several, one below the other."""
        return cls(*(np.concatenate([getattr(p, n) for p in parts]) for n in ("below", "above")))

    def select(self, rows: slice | np.ndarray) -> Limits:
        """Give the limits of some rows."""
        return Limits(self.below[rows], self.above[rows])

    def at(self, rows: np.ndarray, count: int) -> Limits:
        """Give the limits of more rows, of which these are some.

        Parameters
        ----------
        rows : (n,) the place of each.
        count : how many there are then.
        """
        found = Limits.none(count)
        found.below[rows], found.above[rows] = self.below, self.above
        return found

    def where(self, kept: np.ndarray) -> Limits:
        """Give the same rows with the limits of some of them, and no others.

        Parameters
        ----------
        kept : (n,) booleans.
        """
        return Limits(np.where(kept, self.below, np.nan), np.where(kept, self.above, np.nan))

    def in_units(self, unit: float) -> Limits:
        """Give the limits where the state is counted in another unit; a negative one turns them."""
        both = self.below / unit, self.above / unit
        return Limits(*both) if unit > 0 else Limits(*both[::-1])

    def within(self, x: np.ndarray) -> np.ndarray:
        """Give values (n,) with those on the wrong side of a limit moved to it."""
        found: np.ndarray = np.fmax(np.fmin(x, self.below), self.above)
        return found

    def with_words(
        self, below: np.ndarray | float | None = None, above: float | None = None
    ) -> Limits:
        """Give the same limits, with a number in the place of those that are not known.

        Parameters
        ----------
        below : the number, or (n,) of them; where that is NaN, the limit stays unknown.
        above : the number for those that the value was above; None for none.
        """
        found = self
        if below is not None:
            words = np.isinf(self.below) & ~np.isnan(below)
            found = replace(found, below=np.where(words, below, self.below))
        if above is not None:
            found = replace(found, above=np.where(np.isinf(self.above), above, self.above))
        return found


def limit_cells(
    x: np.ndarray,
    limits: Limits | None,
    below: np.ndarray | float | None = None,
    above: float | None = None,
) -> tuple[np.ndarray, Limits]:
    """Give values and limits of a state where it is known between which it can be measured.

    Parameters
    ----------
    x : (n,) values; NaN where there is none.
    limits : those of cells.
    below : the limit of detection, or (n,) of them, NaN for none; None for none at all.
    above : the upper end of the range; None for none.

    >>> x, limits = limit_cells(np.array([0.3, 0.05, 0.01]), None, 0.05)
    >>> x.tolist(), limits.below.tolist()
    ([0.3, nan, nan], [nan, 0.05, 0.05])
    """
    own = (Limits.none(len(x)) if limits is None else limits).with_words(below, above)
    if below is not None:
        own = replace(own, below=np.where(x <= below, below, own.below))
    if above is not None:
        own = replace(own, above=np.where(x >= above, above, own.above))
    return np.where(own.there, np.nan, x), own
