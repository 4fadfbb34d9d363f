"""Asked: what a call of discover was given is of the kind that it needs, or refused in one line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dynsr.data import Trajectory
from dynsr.errors import InputError, quoted
from dynsr.jobs import check_seed

FLAGS = ("snap", "explicit_time", "discrete", "stochastic")


def check_asked(states: Sequence[str], seed: Any, **given: Any) -> int:
    """Check arguments of :func:`dynsr.discover` that nothing else looks at; gives the seed.

    Parameters
    ----------
    states : those of the data.
    seed : what all chance is to come from.
    given : arguments of :data:`KINDS`, by name.

    Raises InputError that names the argument.
    """
    for name, (fits, wanted) in KINDS.items():
        if name in given and not fits(given[name]):
            raise InputError(f"{name} {quoted(given[name])} must be {wanted}")
    for state in given.get("slopes") or {}:
        if state not in states:
            raise InputError(
                f"slopes of {quoted(state)}, which is no state; the states are: {', '.join(states)}"
            )
    return check_seed(seed)


def _is_names(value: Any) -> bool:
    return isinstance(value, (str, Sequence))


# Arguments whose values nothing else looks at: whether one fits, and what it must be.
KINDS: dict[str, tuple[Any, str]] = {
    "method": (lambda v: _is_names(v) or hasattr(v, "search"), "a method, its name, or several"),
    "targets": (_is_names, "'all', a state, or several"),
    "known": (lambda v: v is None or isinstance(v, Mapping), "a mapping of states to formulas"),
    "slopes": (
        lambda v: (
            v is None
            or (
                isinstance(v, Mapping)
                and all(hasattr(own, "__len__") and not isinstance(own, str) for own in v.values())
            )
        ),
        "a mapping of states to arrays of slopes",
    ),
    "scheme": (lambda v: v is None or isinstance(v, str), "the name of a scheme"),
    "out": (lambda v: v is None or isinstance(v, (str, os.PathLike)), "a folder"),
    "progress": (lambda v: v is None or callable(v), "a function"),
    "settings": (lambda v: hasattr(v, "selection"), "DiscoverySettings"),
    **dict.fromkeys(FLAGS, (lambda v: isinstance(v, (bool, np.bool_)), "True or False")),
}


def choose_targets(targets: str | Sequence[str], run: Trajectory) -> tuple[str, ...]:
    """Give the states whose equations are searched; raises InputError for one that is no state."""
    if isinstance(targets, str):
        targets = run.states if targets == "all" else (targets,)
    for target in targets:
        run.index(target)
    if not targets:
        raise InputError("no target was given; use 'all'")
    return tuple(dict.fromkeys(targets))
