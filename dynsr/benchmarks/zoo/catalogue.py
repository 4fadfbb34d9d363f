"""All systems of the zoo, in two halves that are fixed: one to tune on, one to publish."""

from __future__ import annotations

from collections.abc import Sequence

from dynsr.benchmarks.zoo.cells import CELLS
from dynsr.benchmarks.zoo.chaos import CHAOS
from dynsr.benchmarks.zoo.machines import MACHINES
from dynsr.benchmarks.zoo.populations import POPULATIONS
from dynsr.benchmarks.zoo.system import HALVES, ZooSystem
from dynsr.errors import InputError

ZOO: tuple[ZooSystem, ...] = (*POPULATIONS, *CELLS, *MACHINES, *CHAOS)


def find_animals(half: str = "all", names: Sequence[str] = ()) -> list[ZooSystem]:
    """Give the systems of one half or of "all", or those of some names.

    Raises InputError for another half and for a name that the half does not have.

    >>> [animal.half for animal in find_animals(names=["logistic", "budworm"])]
    ['tuning', 'unseen']
    """
    if half not in (*HALVES, "all"):
        raise InputError(f"unknown half {half!r}; write {', '.join(HALVES)} or all")
    known = {animal.name: animal for animal in ZOO if half in (animal.half, "all")}
    for name in names:
        if name not in known:
            raise InputError(f"unknown system {name!r}; they are: {', '.join(known)}")
    return [known[name] for name in names] or list(known.values())
