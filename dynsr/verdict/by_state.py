"""By state: what a discovery has of each state; an unknown name is answered with the states."""

from __future__ import annotations

from typing import NoReturn, TypeVar

from dynsr.errors import say_near

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
        known = ", ".join(self) or "none"
        raise KeyError(f"no state {name!r}{say_near(name, self)}; the states are: {known}")
