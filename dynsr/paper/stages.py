"""Stages of a search: which ran, and what each one put on the front of formulas."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from dynsr.fit import ParetoFront
from dynsr.methods import AbstractMethod

# They work on the formulas of other stages, which keep their source.
_REFINING = ("refinement", "snapping")
# Stages whose formulas follow from the samples and the settings alone.
_WITHOUT_CHANCE = (
    "simple functions",
    "sums of powers",
    "sums of functions",
    "rational",
    "polynomial",
    "brute force",
    "domain change",
    "sindy",
)


def stage_of(source: str) -> str:
    """Give the stage that a candidate's source names; what follows a colon says how.

    >>> stage_of("symmetry: scaling in a/b")
    'symmetry'
    """
    return source.partition(":")[0]


def is_deterministic(sources: Iterable[str]) -> bool:
    """Whether formulas of these sources come from stages that no seed changes.

    >>> is_deterministic(["polynomial 4", "brute force"]), is_deterministic(["ga"])
    (True, False)
    """
    return all(source.startswith(_WITHOUT_CHANCE) for source in sources)


def describe_stages(
    front: ParetoFront, ran: Iterable[str], method: AbstractMethod
) -> tuple[dict[str, Any], ...]:
    """Give each stage that ran with what it came to.

    Parameters
    ----------
    front : what the search gave.
    ran : names that the search reported as it went on, in order.
    method : the method; its setting ``stages``, if it has one, separates stages from steps. Its
        network is shown too: it gives no formula itself, the stages after it ask it.

    Every dictionary has ``stage``, ``formulas`` (of the front) and ``best_loss`` (RMSE of the best
    one, on the front or not; None where there is none).
    """
    known = (*getattr(method, "stages", ()), "network")
    names = dict.fromkeys(s for s in ran if s in known and s not in _REFINING)
    names |= dict.fromkeys(stage_of(leader.source) for leader in front.best_by_source)
    return tuple(
        {
            "stage": name,
            "formulas": sum(stage_of(c.source) == name for c in front),
            "best_loss": min(
                (c.loss for c in front.best_by_source if stage_of(c.source) == name), default=None
            ),
        }
        for name in names
    )
