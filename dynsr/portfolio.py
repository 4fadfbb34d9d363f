"""Portfolio: which methods a discovery runs, by name and preset."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dynsr.errors import InputError
from dynsr.methods.base import AbstractMethod

PRESETS = ("best", "fast", "paper")


def _sindy(preset: str) -> AbstractMethod:
    from dynsr.methods.sindy import SINDy

    return SINDy.preset("paper" if preset == "paper" else "best")


def _feynman(preset: str) -> AbstractMethod:
    from dynsr.methods.feynman.search import DynAIFeynman

    return DynAIFeynman.preset("paper" if preset == "paper" else "best")


def _genetic(preset: str) -> AbstractMethod:
    from dynsr.methods.genetic import GeneticAlgorithm

    return GeneticAlgorithm()


def _rational(preset: str) -> AbstractMethod:
    from dynsr.methods.feynman.rational import RationalSearch

    return RationalSearch(costs=(3, 4)) if preset == "fast" else RationalSearch()


METHODS: dict[str, Callable[[str], AbstractMethod]] = {
    "rational": _rational,
    "sindy": _sindy,
    "dynaifeynman": _feynman,
    "genetic": _genetic,
}
# What "auto" runs, by preset.
_AUTO = {
    "best": ("rational",),
    "fast": ("rational",),
    "paper": ("sindy", "dynaifeynman", "genetic"),
}


def choose_methods(
    method: str | AbstractMethod | Sequence[str | AbstractMethod], preset: str
) -> dict[str, AbstractMethod]:
    """Give the methods to run by name; "auto" stands for those of the preset.

    Raises InputError that lists the names when a method or preset is unknown.

    >>> list(choose_methods("rational", "best"))
    ['rational']
    """
    if preset not in PRESETS:
        raise InputError(f"unknown preset {preset!r}; the presets are: {', '.join(PRESETS)}")
    if isinstance(method, (str, AbstractMethod)):
        wanted: list[str | AbstractMethod] = list(_AUTO[preset]) if method == "auto" else [method]
    else:
        wanted = list(method)
    chosen: dict[str, AbstractMethod] = {}
    for item in wanted:
        if isinstance(item, AbstractMethod):
            chosen[item.name] = item
        elif item in METHODS:
            chosen[item] = METHODS[item](preset)
        else:
            raise InputError(
                f"unknown method {str(item)!r}; the methods are: auto, {', '.join(METHODS)}"
            )
    if not chosen:
        raise InputError("no method was given; use 'auto'")
    return chosen
