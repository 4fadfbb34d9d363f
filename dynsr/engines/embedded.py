"""The embedded engine: integration and sparse regression in Python alone; the default."""

from __future__ import annotations

import platform
from collections.abc import Sequence

import numpy as np
import scipy
import sympy

from dynsr import __version__
from dynsr.engines.adaptive import solve_driven
from dynsr.engines.base import (
    AbstractEngine,
    InitialValueProblem,
    Integration,
    SparseProblem,
    SparseSolution,
)
from dynsr.engines.tsit5.groups import solve_all
from dynsr.engines.tsit5.single import solve


class EmbeddedEngine(AbstractEngine):
    """Tsit5 and the sparse optimizers written in Python; needs nothing else installed.

    >>> EmbeddedEngine().name
    'embedded'
    """

    name = "embedded"
    takes_drives = True

    def integrate(self, problem: InitialValueProblem) -> Integration:
        """Solve an initial value problem by :func:`dynsr.engines.tsit5.single.solve`."""
        return solve_driven(problem) if problem.drives else solve(problem)

    def integrate_all(self, problems: Sequence[InitialValueProblem]) -> list[Integration]:
        """Solve many problems by :func:`dynsr.engines.tsit5.groups.solve_all`."""
        if any(problem.drives for problem in problems):
            return [self.integrate(problem) for problem in problems]
        return solve_all(problems)

    def regress(self, problem: SparseProblem) -> SparseSolution:
        """Solve a sparse regression problem by :func:`dynsr.engines.sparse.solve.solve_sparse`."""
        # Here, so that who only integrates does not load linear algebra it never uses.
        from dynsr.engines.sparse.solve import solve_sparse

        return solve_sparse(problem)

    def versions(self) -> dict[str, str]:
        """Name dynsr, the numerical libraries and Python with their versions."""
        return {
            "dynsr": __version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "sympy": sympy.__version__,
            "python": platform.python_version(),
        }
