"""Choice of an engine by its name; nothing foreign is loaded before it is asked for."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING

from dynsr.engines.julia.setup import require_julia
from dynsr.errors import InputError

if TYPE_CHECKING:
    from dynsr.engines.base import AbstractEngine

ENGINES = ("embedded", "julia")
DEFAULT_ENGINE = "embedded"
_STARTED: dict[str, AbstractEngine] = {}


def find_engine(name: str | AbstractEngine = DEFAULT_ENGINE) -> AbstractEngine:
    """Give the engine of that name, the same object each time; an engine is given back.

    Parameters
    ----------
    name : one of ENGINES, or an engine.

    Raises InputError that lists the names when there is none, EngineUnavailable with the remedy
    when it is not installed.

    >>> find_engine("embedded") is find_engine("embedded")
    True
    """
    if isinstance(name, str) and name in ENGINES:
        if name not in _STARTED:
            _STARTED[name] = _start(name)
        return _STARTED[name]
    from dynsr.engines.base import AbstractEngine

    if isinstance(name, AbstractEngine):
        return name
    raise InputError(f"unknown engine {name!r}; the engines are: {', '.join(ENGINES)}")


def share_engine(engine: AbstractEngine, workers: int) -> str | AbstractEngine:
    """Give what stands for an engine in ``workers`` processes.

    A name where :func:`find_engine` gives this very engine for it, so that each process starts its
    own; else the engine itself, which worker processes get as a copy.

    Parameters
    ----------
    engine : the engine.
    workers : how many processes are to use it; with 1 it stays in this one.

    Raises InputError when it is to be copied and cannot be.

    >>> share_engine(find_engine("embedded"), 4)
    'embedded'
    """
    if _STARTED.get(engine.name) is engine:
        return engine.name
    if workers > 1:
        try:
            pickle.dumps(engine)
        # Any error at all: what an engine holds is its own matter.
        except Exception as problem:
            raise InputError(
                f"engine {engine.name!r} cannot be copied into worker processes "
                f"({type(problem).__name__}); use jobs=1"
            ) from None
    return engine


def _start(name: str) -> AbstractEngine:
    if name == "julia":
        # Before NumPy and SymPy load, so that the user is not kept waiting for a refusal.
        require_julia()
        from dynsr.engines.julia.engine import JuliaEngine

        return JuliaEngine()
    from dynsr.engines.embedded import EmbeddedEngine

    return EmbeddedEngine()
