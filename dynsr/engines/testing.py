"""For tests of what uses an engine: one that keeps what it was asked."""

from __future__ import annotations

from dynsr.engines.base import (
    AbstractEngine,
    InitialValueProblem,
    Integration,
    SparseProblem,
    SparseSolution,
)
from dynsr.engines.embedded import EmbeddedEngine


class RecordingEngine(AbstractEngine):
    """An engine that answers as another does and keeps every problem that it was given.

    Parameters
    ----------
    name : what records are to call it.
    base : the engine that answers; the embedded one by default.

    ``integrated`` and ``regressed`` have the problems in their order. A copy in a worker process
    keeps its own.

    >>> import numpy as np
    >>> engine = RecordingEngine()
    >>> _ = engine.regress(SparseProblem(np.ones((1, 3)), np.ones(3), "STLSQ"))
    >>> len(engine.regressed), len(engine.integrated)
    (1, 0)
    """

    def __init__(self, name: str = "recording", base: AbstractEngine | None = None) -> None:
        """Keep nothing yet."""
        self.name = name
        self.base = base or EmbeddedEngine()
        self.takes_drives = self.base.takes_drives
        self.integrated: list[InitialValueProblem] = []
        self.regressed: list[SparseProblem] = []

    def integrate(self, problem: InitialValueProblem) -> Integration:
        """Keep the problem and let the base engine solve it."""
        self.integrated.append(problem)
        return self.base.integrate(problem)

    def regress(self, problem: SparseProblem) -> SparseSolution:
        """Keep the problem and let the base engine solve it."""
        self.regressed.append(problem)
        return self.base.regress(problem)

    def versions(self) -> dict[str, str]:
        """Name what the base engine names."""
        return self.base.versions()
