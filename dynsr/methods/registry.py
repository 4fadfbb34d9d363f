"""The registry of methods: which there are, by name and preset; foreign code loads on use."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dynsr.errors import InputError
from dynsr.methods.base import AbstractMethod

METHODS = ("dynaifeynman", "ga", "sindy")
PRESETS = ("paper", "best", "quick")
# The paper's settings of DynAIFeynman but for these.
_QUICK = {"epochs": 100, "candidates": 50_000.0, "branches": 1, "max_depth": 1}


def make_method(name: str, preset: str = "paper", system_name: str | None = None) -> AbstractMethod:
    """Give the method ``name`` with the settings called ``preset``.

    Parameters
    ----------
    name : one of METHODS.
    preset : "paper" for the settings that the paper prints, "best" for the ones that find most,
        "quick" for the paper's with a small budget, meant for a first look.
    system_name : the system, where the paper's settings differ between systems.

    Raises InputError that lists the names when there is no such method or preset.

    >>> make_method("ga", "paper", "pendulum").iterations
    40
    """
    if preset not in PRESETS:
        raise InputError(f"unknown preset {preset!r}; the presets are: {', '.join(PRESETS)}")
    if name == "ga":
        from dynsr.methods.genetic import GeneticAlgorithm

        return GeneticAlgorithm.preset(preset, system_name)
    if name == "sindy":
        from dynsr.methods.sindy import SINDy

        # It is done in a second at its full settings.
        return SINDy.preset("paper" if preset == "quick" else preset, system_name)
    if name == "dynaifeynman":
        from dynsr.methods.feynman.search import DynAIFeynman

        if preset == "quick":
            return DynAIFeynman.preset("paper", **_QUICK)
        return DynAIFeynman.preset(preset)
    raise InputError(f"unknown method {name!r}; the methods are: {', '.join(METHODS)}")


def _rational(preset: str) -> AbstractMethod:
    from dynsr.methods.rational import RationalSearch

    return RationalSearch(costs=(3, 4)) if preset == "quick" else RationalSearch()


def _genetic(preset: str) -> AbstractMethod:
    # Beside the other methods the paper's budget is enough; the best preset's takes hours.
    return make_method("ga", "quick" if preset == "best" else preset)


def _feynman(preset: str) -> AbstractMethod:
    return make_method("dynaifeynman", preset)


def _feynman_beside() -> AbstractMethod:
    """Give the stages that look at the samples as they are; reductions take a minute a state.

    The search for sums and ratios runs beside it as a method of its own, so that its formulas
    meet the others before any is snapped.
    """
    from dynsr.methods.feynman.search import DynAIFeynman

    return DynAIFeynman.preset("best", stages=_DIRECT, candidates=50_000, max_depth=1)


DISCOVERY_METHODS: dict[str, Callable[[str], AbstractMethod]] = {
    "rational": _rational,
    "sindy": lambda preset: make_method("sindy", "best" if preset == "quick" else preset),
    "dynaifeynman": _feynman,
    "genetic": _genetic,
}
# Stages of DynAIFeynman that need no network.
_DIRECT = ("polynomial", "brute force", "refinement", "snapping")
_ALIASES = {"ga": "genetic"}
# What "auto" runs, by preset.
_AUTO = {
    "best": ("rational", "sindy", "dynaifeynman", "genetic"),
    "quick": ("rational", "sindy"),
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
        item = _ALIASES.get(item, item) if isinstance(item, str) else item
        if isinstance(item, AbstractMethod):
            chosen[item.name] = item
        elif item in DISCOVERY_METHODS:
            quick = method == "auto" and preset == "best" and item == "dynaifeynman"
            chosen[item] = _feynman_beside() if quick else DISCOVERY_METHODS[item](preset)
        else:
            raise InputError(
                f"unknown method {str(item)!r}; the methods are: "
                f"auto, {', '.join(DISCOVERY_METHODS)}"
            )
    if not chosen:
        raise InputError("no method was given; use 'auto'")
    return chosen
