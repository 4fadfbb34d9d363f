"""All systems of the zoo: textbook systems that dynsr has been improved on."""

from __future__ import annotations

from collections.abc import Sequence

from dynsr.benchmarks.zoo.cells import CELLS
from dynsr.benchmarks.zoo.chaos import CHAOS
from dynsr.benchmarks.zoo.machines import MACHINES
from dynsr.benchmarks.zoo.populations import POPULATIONS
from dynsr.benchmarks.zoo.system import ZooSystem
from dynsr.errors import InputError

ZOO: tuple[ZooSystem, ...] = (*POPULATIONS, *CELLS, *MACHINES, *CHAOS)


def find_animals(names: Sequence[str] = ()) -> list[ZooSystem]:
    """Give the systems of the zoo, or those of some names.

    Raises InputError for a name that no system has.

    >>> [animal.kind for animal in find_animals(["logistic"])]
    ['growth']
    """
    known = {animal.name: animal for animal in ZOO}
    for name in names:
        if name not in known:
            raise InputError(f"unknown system {name!r}; they are: {', '.join(known)}")
    return [known[name] for name in names] or list(known.values())
