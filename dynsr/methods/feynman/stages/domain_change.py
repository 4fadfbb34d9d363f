"""Domain changes of the target as a stage: other stages search for T(y), the inverse comes back."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dynsr.data import Samples
from dynsr.errors import InputError
from dynsr.fit import Candidate, ParetoFront, score_candidate
from dynsr.methods.feynman.problem import CHANGES, make_targets
from dynsr.methods.feynman.stages.base import AbstractStage, Context
from dynsr.methods.limits import Limits

DOMAIN_CHANGES = (
    "inv",
    "square",
    "sqrt",
    "log",
    "exp",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
)


@dataclass(frozen=True)
class DomainChange(AbstractStage):
    """Run ``inner`` stages on T(y) for every change T that can be undone on the range of y.

    Formulas are scored on y itself, not on T(y).

    Parameters
    ----------
    inner : the stages that search for T(y).
    changes : names of T, of DOMAIN_CHANGES.
    keep : formulas of each change, the most accurate ones for T(y), that are brought back.

    Raises InputError for an unknown change.
    """

    inner: tuple[AbstractStage, ...]
    changes: tuple[str, ...] = DOMAIN_CHANGES
    keep: int = 6
    name = "domain change"

    def __post_init__(self) -> None:
        """Check the changes' names."""
        for change in self.changes:
            if change not in DOMAIN_CHANGES:
                known = ", ".join(DOMAIN_CHANGES)
                raise InputError(f"unknown domain change {change!r}; they are: {known}")

    def within(self, limits: Limits) -> DomainChange:
        """Give the stage with the changes whose way back is allowed."""
        vocabulary = limits.vocabulary
        if vocabulary is None:
            return self
        allowed = tuple(c for c in self.changes if vocabulary.has(CHANGES[c].back))
        return replace(self, changes=allowed)

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Run the inner stages on each changed target."""
        found = []
        targets = [t for t in make_targets(samples.y, self.changes) if t.change.name != "y"]
        for done, target in enumerate(targets):
            if context.seconds_left <= 0:
                break
            context.tell(self.name, done, len(targets))
            changed = replace(samples, y=target.values)
            inner = [c for stage in self.inner for c in stage.run(changed, context)]
            for candidate in ParetoFront(inner).candidates[-self.keep :]:
                source = f"{self.name}: {candidate.source} of {target.change.name}"
                found.append(score_candidate(target.build(candidate.expr), samples, source))
        return found
