"""Choice of an engine by its name; nothing foreign is loaded before it is asked for."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from dynsr.engines.julia.setup import require_julia
from dynsr.errors import InputError

if TYPE_CHECKING:
    from dynsr.engines.base import AbstractEngine

ENGINES = ("embedded", "julia")


def find_engine(name: str | AbstractEngine) -> AbstractEngine:
    """Give the engine of that name, the same object each time; an engine is given back.

    Raises InputError that lists the names when there is none, EngineUnavailable when it is not
    installed.

    >>> find_engine("embedded") is find_engine("embedded")
    True
    """
    if isinstance(name, str) and name in ENGINES:
        return _start(name)
    from dynsr.engines.base import AbstractEngine

    if isinstance(name, AbstractEngine):
        return name
    raise InputError(f"unknown engine {name!r}; the engines are: {', '.join(ENGINES)}")


@cache
def _start(name: str) -> AbstractEngine:
    if name == "julia":
        # Before NumPy and SymPy load, so that the user is not kept waiting for a refusal.
        require_julia()
        from dynsr.engines.julia.engine import JuliaEngine

        return JuliaEngine()
    from dynsr.engines.embedded import EmbeddedEngine

    return EmbeddedEngine()
