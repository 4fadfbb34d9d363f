"""The registry of methods: which there are, by name and preset.

Everything that names a method or a preset reads it here: the command line and its help, the
Python interface, the replication. Nothing foreign loads before a method is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from dynsr.arguments import checked
from dynsr.errors import InputError

if TYPE_CHECKING:
    from dynsr.methods.base import AbstractMethod

# Preset -> what it means, whatever the method.
PRESETS: dict[str, str] = {
    "best": "the settings that find most",
    "quick": "short searches, for a first look",
    "paper": "as published; general choices where the paper chose by hand for a system",
}
DEFAULT_PRESET = "best"
# The methods that the paper compares, as its tables call them.
PAPER_METHODS = ("dynaifeynman", "ga", "sindy")
AUTO = "auto"


@dataclass(frozen=True)
class MethodEntry:
    """What is known of a method before its code is loaded.

    Parameters
    ----------
    name : its one name, in records and on the command line.
    class_name : its class, as ``dynsr.methods`` exports it.
    description : one line for the help.
    presets : preset -> what it means for this method.
    aliases : other names that it answers to.
    extra : the optional extra of the package without which a part of it does not run; "" if none.
    """

    name: str
    class_name: str
    description: str
    presets: Mapping[str, str]
    aliases: tuple[str, ...] = ()
    extra: str = ""

    def load(self) -> type[AbstractMethod]:
        """Give the class, with the code that it needs."""
        found: type[AbstractMethod] = getattr(import_module("dynsr.methods"), self.class_name)
        return found


METHODS: dict[str, MethodEntry] = {
    entry.name: entry
    for entry in (
        MethodEntry(
            "rational",
            "RationalSearch",
            "sparse sums and ratios of features grown from the variables",
            {
                "best": "features of cost up to 6",
                "quick": "features of cost up to 4",
                "paper": "as best; the paper does not have it",
            },
        ),
        MethodEntry(
            "sindy",
            "SINDy",
            "sparse regression on a library of functions",
            {
                "best": "a path of thresholds, sums and ratios, on a grown library",
                "quick": "as best, which takes about a second",
                "paper": "one implicit regression by SR3 of the release of 2021; a grown library "
                "stands for the one that the paper chose by hand for each system",
            },
        ),
        MethodEntry(
            "dynaifeynman",
            "DynAIFeynman",
            "AI Feynman 2.0 on slopes, with polynomials, enumeration and networks",
            {
                "best": "all stages, sums and ratios first; chosen by description length",
                "quick": "as paper with a fifth of the epochs and a quarter of the formulas",
                "paper": "500 epochs, degree 4; chosen by lowest error",
            },
            extra="torch",
        ),
        MethodEntry(
            "genetic",
            "GeneticAlgorithm",
            "evolution of bitstrings that stand for words of a grammar",
            {
                "best": "a large population of longer words, each fitted as a f + b",
                "quick": "a tenth of the paper's iterations",
                "paper": "the sizes of the cart-pole in Table 2; general constants stand for those "
                "that the paper chose by hand for each system",
            },
            aliases=("ga",),
        ),
    )
}
# What "auto" runs by preset: (method, its preset, changes of single settings). Beside the other
# methods DynAIFeynman needs only the stages that look at the samples as they are: reductions take
# a minute a state, and sums and ratios are searched by a method of their own, so that its formulas
# meet the others before any is snapped. A genetic search of full size would take longest of all.
_BESIDE = {
    "stages": ("polynomial", "brute force", "refinement", "snapping"),
    "candidates": 50_000,
    "max_depth": 1,
}
_AUTO: dict[str, tuple[tuple[str, str, Mapping[str, Any]], ...]] = {
    "best": (
        ("rational", "best", {}),
        ("sindy", "best", {}),
        ("dynaifeynman", "best", _BESIDE),
        ("genetic", "quick", {}),
    ),
    "quick": (("rational", "quick", {}), ("sindy", "quick", {})),
    "paper": (("sindy", "paper", {}), ("dynaifeynman", "paper", {}), ("genetic", "paper", {})),
}


def find_method(name: str) -> MethodEntry:
    """Give what is known of the method of that name or alias.

    Raises InputError that lists the names when there is none.

    >>> find_method("ga").name
    'genetic'
    """
    for entry in METHODS.values():
        if name == entry.name or name in entry.aliases:
            return entry
    raise InputError(f"unknown method {name!r}; the methods are: {name_methods()}")


@checked
def make_method(name: str, preset: str = DEFAULT_PRESET, **changes: Any) -> AbstractMethod:
    """Give the method ``name`` with the settings called ``preset``.

    Parameters
    ----------
    name : one of METHODS, or an alias of one.
    preset : one of PRESETS; what it means for each method its entry in METHODS says.
    changes : settings of the method that replace those of the preset.

    Raises InputError that lists the names when there is no such method or preset.

    >>> make_method("rational", "quick").costs
    (3, 4)
    """
    return find_method(name).load().preset(check_preset(preset), **changes)


def check_preset(name: str) -> str:
    """Give the name of a preset back; raises InputError that lists them when it is unknown.

    >>> check_preset("best")
    'best'
    """
    if name not in PRESETS:
        raise InputError(f"unknown preset {name!r}; the presets are: {', '.join(PRESETS)}")
    return name


def choose_methods(
    method: str | AbstractMethod | Sequence[str | AbstractMethod], preset: str = DEFAULT_PRESET
) -> dict[str, AbstractMethod]:
    """Give the methods to run by name.

    Parameters
    ----------
    method : "auto" for those of the preset, a name, a method with its settings, or several.
    preset : the settings of those that are named.

    Raises InputError that lists the names when a method or preset is unknown, when none is given,
    and when two of the same name differ in their settings.

    >>> list(choose_methods("auto", "quick"))
    ['rational', 'sindy']
    """
    from dynsr.methods.base import AbstractMethod

    check_preset(preset)
    chosen: dict[str, AbstractMethod] = {}
    for item in [method] if isinstance(method, (str, AbstractMethod)) else method:
        if isinstance(item, AbstractMethod):
            made = [item]
        elif item == AUTO:
            made = [make_method(name, own, **changes) for name, own, changes in _AUTO[preset]]
        else:
            made = [make_method(str(item), preset)]
        for one in made:
            if chosen.setdefault(one.name, one) != one:
                raise InputError(
                    f"two methods are called {one.name!r} and differ in their settings; give one"
                )
    if not chosen:
        raise InputError(f"no method was given; use {AUTO!r}")
    return chosen


def name_methods() -> str:
    """List "auto" and all names with their aliases, for messages.

    >>> name_methods()
    'auto, rational, sindy, dynaifeynman, genetic (ga)'
    """
    return ", ".join([AUTO, *map(_title, METHODS.values())])


def describe_methods() -> str:
    """Say what each method is, for the help."""
    lines = [f"{AUTO}: several, as the preset says"]
    for entry in METHODS.values():
        more = f" (complete with the extra {entry.extra})" if entry.extra else ""
        lines.append(f"{_title(entry)}: {entry.description}{more}")
    return "; ".join(lines)


def describe_presets() -> str:
    """Say what each preset means, for the help."""
    return "; ".join(f"{name}: {meaning}" for name, meaning in PRESETS.items())


def _title(entry: MethodEntry) -> str:
    return f"{entry.name} ({', '.join(entry.aliases)})" if entry.aliases else entry.name
