"""Columns: a table as it stood in its source, before anyone decides what a column means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Columns:
    """Named columns as they stood in the source.

    ``values`` are one-dimensional arrays of equal length: float64, or objects where a cell is no
    number. ``label`` is what a message calls the source, ``notes`` what was noticed on reading,
    ``named`` whether the names are the source's own. ``inputs`` are those the source declares.
    """

    names: tuple[str, ...]
    values: tuple[np.ndarray, ...]
    label: str
    notes: tuple[str, ...] = ()
    named: bool = True
    inputs: tuple[str, ...] = ()


def generated_names(count: int) -> tuple[str, ...]:
    """Name the columns of a table without a header: t, then x or x1, x2, ...

    >>> generated_names(3)
    ('t', 'x1', 'x2')
    """
    return ("t", "x") if count == 2 else ("t", *(f"x{j}" for j in range(1, count)))
