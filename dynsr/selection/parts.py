"""Parts: every generator, refiner, early end and term of the score of the searches, by name.

Switched off one at a time, they show what each costs and earns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynsr.errors import InputError

# Name of a part -> what it does.
PARTS: Mapping[str, str] = {
    "look-permuted": "equations of other states with names exchanged, on exact slopes",
    "look-rare": "sums with rare functions, on exact slopes",
    "look-again": "second and third looks that know the equations found for other states",
    "end-look": "an equation that exact slopes leave no doubt of ends the search",
    "end-simple": "one whose constants are all simple numbers is such an equation",
    "end-alone": "one that every other choice of terms misses by far more is such an equation",
    "joints": "ratios with the sine and cosine of a joint, in noise",
    "citing": "sums with terms of other equations",
    "polynomials": "all products of low degree fitted at once and taken out one by one",
    "fluxes": "terms that several equations share, proposed again in all of them",
    "changed-permuted": "equations of one form change together",
    "couplings": "systems tied by a mass matrix",
    "renewal": "one equation of a system proposed again, along its states",
    "pruning": "terms taken out one by one",
    "move-leaders": "the formulas that lead alone",
    "end-confirmed": "formulas of rough slopes that exact states confirm end the search",
    "whole-polynomials": "polynomials of exact rows far apart",
    "approximations": "sums that keep closer to the data where no law is found",
    "belief": "noise is believed to be as little as a system leaves",
    "methods": "the other methods where no equations of exact data are found without them",
    "bits-simple": "bits saved by simple numbers",
    "bits-shared": "bits saved by constants that two equations share",
    "bits-inside": "bits of constants inside of another size than their columns",
}


@dataclass(frozen=True)
class Parts:
    """Which parts of the searches take part; they are in the record of a run.

    Parameters
    ----------
    off : names of PARTS that are left out.

    Raises InputError for a name that is no part.

    >>> Parts(("citing",)).has("citing"), Parts().has("citing")
    (False, True)
    """

    off: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the names."""
        for name in self.off:
            if name not in PARTS:
                raise InputError(f"unknown part {name!r}; the parts are: {', '.join(PARTS)}")

    def has(self, name: str) -> bool:
        """Whether a part takes part."""
        assert name in PARTS, name
        return name not in self.off
