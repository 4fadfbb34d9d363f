"""Choice of an engine by its name; nothing foreign is loaded before it is asked for."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING

from dynsr.arguments import checked
from dynsr.engines.julia.setup import require_julia
from dynsr.errors import InputError

if TYPE_CHECKING:
    from dynsr.engines.base import AbstractEngine

ENGINES = ("embedded", "julia")
DEFAULT_ENGINE = "embedded"
# What somebody who waits should know of an engine whose first answer takes long.
START_NOTES = {
    "julia": "Julia starts and compiles first: 10 s to a minute, minutes after an installation"
}
_STARTED: dict[str, AbstractEngine] = {}


@checked
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


def start_engine(engine: str | AbstractEngine) -> None:
    """Start an engine other than the embedded one, so that no work is lost where it does not start.

    Parameters
    ----------
    engine : its name, or an engine.

    Raises InputError for an unknown name, EngineUnavailable where it does not start.

    >>> start_engine("embedded")
    """
    chosen = find_engine(engine)
    if not is_embedded(chosen):
        chosen.versions()


def refuse_idle(engine: str | AbstractEngine | None, why: str) -> None:
    """Refuse an engine other than the embedded one where there is nothing that it could do.

    Parameters
    ----------
    engine : its name, an engine, or None.
    why : why there is nothing, in words.

    Raises InputError, with what to do instead, and as :func:`find_engine` does.

    >>> refuse_idle("embedded", "a map is iterated")
    """
    if engine is not None and not is_embedded(chosen := find_engine(engine)):
        raise InputError(f"{why}: engine {chosen.name!r} has nothing to do; leave it out")


def is_embedded(engine: AbstractEngine) -> bool:
    """Whether an engine is the one that is always there.

    >>> is_embedded(find_engine("embedded"))
    True
    """
    from dynsr.engines.embedded import EmbeddedEngine

    return isinstance(engine, EmbeddedEngine)


def share_engine(engine: AbstractEngine, workers: int) -> str | AbstractEngine:
    """Give what stands for an engine in ``workers`` processes.

    A name where :func:`find_engine` gives this very engine for it, so that each process finds its
    own by it; else the engine itself, which worker processes get as a copy.

    Parameters
    ----------
    engine : the engine.
    workers : how many processes are to use it; with 1 it stays in this one.

    Raises InputError when it is to be copied and cannot be.

    >>> share_engine(find_engine("embedded"), 4)
    'embedded'
    """
    if workers > 1:
        engine.share()
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
