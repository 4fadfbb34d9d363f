"""By state: what a discovery has of each state; an unknown name is answered with the states."""

from __future__ import annotations

from difflib import get_close_matches
from typing import NoReturn, TypeVar

T = TypeVar("T")


class ByState(dict[str, T]):
    """State -> what there is of it; for another name the error lists the states.

    >>> ByState({"prey": 1, "hunters": 2})["pray"]
    Traceback (most recent call last):
    ...
    KeyError: "no state 'pray' (did you mean 'prey'?); the states are: prey, hunters"
    """

    def __missing__(self, name: object) -> NoReturn:
        """Raise KeyError that names the states."""
        near = get_close_matches(str(name), list(self), 1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise KeyError(f"no state {name!r}{hint}; the states are: {', '.join(self) or 'none'}")
