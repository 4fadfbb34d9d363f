"""One comparison of two programs, as a row with a verdict."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class CrosscheckRow:
    """One comparison.

    Parameters
    ----------
    section, system, subject : what was compared.
    ours, theirs : the two programs.
    compared : how many numbers were compared.
    difference : the largest, relative for coefficients and in the states' own units for
        trajectories; None where one side is absent.
    limit : up to which difference the two agree.
    worst : where the largest difference occurred, or why a side is absent.

    ``verdict`` is one of agrees, differs, absent.

    >>> CrosscheckRow("records", "pendulum", "states", "embedded", "scipy", 9, 1e-9, 1e-8).verdict
    'agrees'
    """

    section: str
    system: str
    subject: str
    ours: str
    theirs: str
    compared: int
    difference: float | None
    limit: float
    worst: str = ""
    verdict: str = field(init=False)

    def __post_init__(self) -> None:
        """Compare the difference with its limit."""
        if self.difference is None:
            verdict = "absent"
        else:
            verdict = "agrees" if self.difference <= self.limit else "differs"
        object.__setattr__(self, "verdict", verdict)

    def as_dict(self) -> dict[str, Any]:
        """Give the fields as plain data; a number that is not finite is None."""
        return {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in asdict(self).items()
        }


def absent(section: str, system: str, ours: str, theirs: str, reason: str) -> CrosscheckRow:
    """Give the row of a comparison that cannot be made."""
    return CrosscheckRow(section, system, "", ours, theirs, 0, None, math.nan, reason)
