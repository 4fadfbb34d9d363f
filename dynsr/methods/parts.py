"""Parts of a long search: what has ended is kept, and read back by a search that is begun again.

A search says with :func:`part` what its parts are. Where a run keeps them, one that was killed goes
on behind its last part and ends in the same result; elsewhere a part is made as it is asked for.
What is made of thousands of fits says with :func:`recalled` what each depends on: begun again, it
goes the same way, and takes them as they were.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


class AbstractKeeper(ABC):
    """What keeps the parts of one task."""

    @abstractmethod
    def take(
        self, name: str, kind: type[T], make: Callable[[], T], is_whole: Callable[[T], bool]
    ) -> T:
        """Give a part as it was kept, else make and keep it; see :func:`part`."""

    @abstractmethod
    def begin(self, name: str, kind: type[T]) -> tuple[T | None, Callable[[Callable[[], T]], None]]:
        """Give the last state that was kept, and what keeps another; see :func:`states`."""

    @abstractmethod
    def recall(
        self, name: str, make: Callable[[], Sequence[np.ndarray] | None], given: Sequence[Any]
    ) -> Sequence[np.ndarray] | None:
        """Give the arrays as they were kept, else make and keep them; see :func:`recalled`."""


_KEEPER: ContextVar[AbstractKeeper | None] = ContextVar("keeper", default=None)


@contextmanager
def keeping(keeper: AbstractKeeper) -> Iterator[None]:
    """Have the parts of searches in the block kept.

    Parameters
    ----------
    keeper : what keeps them.
    """
    before = _KEEPER.set(keeper)
    try:
        yield
    finally:
        _KEEPER.reset(before)


def part(
    name: str,
    kind: type[T],
    make: Callable[[], T],
    is_whole: Callable[[T], bool] = lambda _: True,
) -> T:
    """Give one part of a search, made now or by an earlier run of it that was ended.

    Parts are asked for in the same order each time. All that the search goes on with is in the
    record of the part, the state of its generator too.

    Parameters
    ----------
    name : which part it is.
    kind : the dataclass of its record.
    make : makes it.
    is_whole : whether it may be kept; one that Ctrl-C or a budget has cut may not.
    """
    keeper = _KEEPER.get()
    return make() if keeper is None else keeper.take(name, kind, make, is_whole)


def states(name: str, kind: type[T]) -> tuple[T | None, Callable[[Callable[[], T]], None]]:
    """Give the last kept state of a search that changes one step by step, and what keeps another.

    Each takes the place of the one before, and is made only when that was kept some time ago, so
    that it may be offered at every step. From a state the search goes on as it would have gone.

    Parameters
    ----------
    name : which part it is.
    kind : the dataclass of its record.
    """
    keeper = _KEEPER.get()
    return (None, lambda _: None) if keeper is None else keeper.begin(name, kind)


def recalled(
    name: str, make: Callable[[], Sequence[np.ndarray] | None], *given: Any
) -> Sequence[np.ndarray] | None:
    """Give the arrays that a fit ends with, made now or by an earlier run that was ended.

    Parameters
    ----------
    name : what kind of fit it is.
    make : makes them; None where there is no fit.
    given : all that they depend on: arrays, numbers, texts, and sequences or mappings of them.
    """
    keeper = _KEEPER.get()
    return make() if keeper is None else keeper.recall(name, make, given)


def write_state(rng: np.random.Generator) -> str:
    """Give the state of a generator as text."""
    return json.dumps(rng.bit_generator.state, default=lambda value: value.tolist())


def read_state(rng: np.random.Generator, text: str) -> None:
    """Bring a generator into a state that :func:`write_state` wrote.

    Parameters
    ----------
    rng : the generator, of the same kind.
    text : the state.

    >>> first, other = np.random.default_rng(1), np.random.default_rng(2)
    >>> read_state(other, write_state(first))
    >>> float(first.random()) == float(other.random())
    True
    """
    state: Any = json.loads(text)
    rng.bit_generator.state = state
