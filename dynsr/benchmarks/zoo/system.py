"""One animal of the zoo: a textbook system with its source, two starts and a time span."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from dynsr.data import System

SEEN, DRAWN = "seen", "drawn"


@dataclass(frozen=True)
class ZooSystem:
    """A textbook system: where it is from, its equations, two starts, and how long it is watched.

    Parameters
    ----------
    name : what it is called, unique.
    kind : its field, such as "ecology".
    source : who wrote it down, and when.
    equations : state -> right-hand side, in state units a second.
    starts : start states; the first gives the data, the second, if any, is never searched.
    span : seconds from time 0 that both are watched.
    group : "seen" where methods have been improved on it, or "drawn" for a random system.

    >>> decay = ZooSystem("a", "b", "c", {"x": "-2*x"}, ((1.0,), (3.0,)), 2.0)
    >>> decay.system.rhs
    (-2*x,)
    """

    name: str
    kind: str
    source: str
    equations: Mapping[str, str]
    starts: tuple[tuple[float, ...], ...]
    span: float
    group: str = SEEN

    @cached_property
    def system(self) -> System:
        """The system with its first start, trained over its span."""
        return System.from_strings(
            self.equations,
            x0=self.starts[0],
            name=self.name,
            train=(0.0, self.span),
            test=(0.0, self.span),
            step=self.span / 1000,
            description=self.source,
        )
