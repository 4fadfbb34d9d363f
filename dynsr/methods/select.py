"""Choice of a method by its name; nothing foreign is loaded before it is asked for."""

from __future__ import annotations

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
