"""Domain changes of the target as a stage: other stages search for T(y), the inverse comes back."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dynsr.data import Samples
from dynsr.fit import Candidate, ParetoFront, score_candidate
from dynsr.methods.feynman.problem import make_targets
from dynsr.methods.feynman.stages.base import AbstractStage, Context

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

    Formulas are scored on y itself, not on T(y). ``keep`` of each change's formulas, the most
    accurate ones for T(y), are brought back.
    """

    inner: tuple[AbstractStage, ...]
    changes: tuple[str, ...] = DOMAIN_CHANGES
    keep: int = 6
    name = "domain change"

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
                source = f"{candidate.source} of {target.change.name}"
                found.append(score_candidate(target.build(candidate.expr), samples, source))
        return found
