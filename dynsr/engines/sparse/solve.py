"""Sparse regression on the embedded engine: reads the settings and calls the release asked for."""

from __future__ import annotations

from typing import Any

from dynsr.engines.base import SparseProblem, SparseSolution
from dynsr.engines.sparse import current, release_2021
from dynsr.engines.sparse.settings import read_settings


def solve_sparse(problem: SparseProblem) -> SparseSolution:
    """Solve a sparse regression problem.

    Release "2021" follows DataDrivenDiffEq.jl 0.5 and repeats its implicit search with its
    quirks; "2021-corrected" has the same optimizers and a plain best-of-all implicit search; None
    follows DataDrivenSparse.jl as it is today, which never normalises.

    Settings and their defaults. 2021: ``lambda`` 0.1, or ``threshold`` t instead (SR3:
    lambda = t^2 nu / 2, ADMM: lambda = t rho), ``nu`` 1 (SR3), ``rho`` 1 (ADMM). Today:
    ``threshold`` (or ``lambda``, the same number) 0.1, ``nu`` 1 and ``proximal`` "hard" or "soft"
    (SR3), ``rho`` 1 (ADMM) or 0 (STLSQ). ``threshold`` may be a tuple where several are tried.

    Raises InputError on a setting that the optimizer does not have.

    >>> import numpy as np
    >>> theta = np.array([[1.0, 1.0, 1.0, 1.0], [0.0, 1.0, 2.0, 3.0]])
    >>> line = SparseProblem(theta, 2 * theta[1], "STLSQ", {"threshold": 0.1})
    >>> solve_sparse(line).coefficients.round(9).tolist()
    [0.0, 2.0]
    """
    return _solve_current(problem) if problem.release is None else _solve_2021(problem)


def _solve_2021(problem: SparseProblem) -> SparseSolution:
    settings = read_settings(problem)
    kind: Any = release_2021.SR3 if problem.optimizer == "SR3" else release_2021.ADMM
    optimizers = [kind(weight, settings.relaxation) for weight in settings.weights]
    cap = int(problem.max_iterations)
    if problem.implicit:
        corrected = problem.release == "2021-corrected"
        return release_2021.solve_implicit(
            problem.theta, problem.dx, optimizers, problem.normalize, cap, corrected
        )
    return release_2021.solve_explicit(
        problem.theta, problem.dx, optimizers[0], problem.normalize, cap
    )


def _solve_current(problem: SparseProblem) -> SparseSolution:
    settings = read_settings(problem)
    algorithm: current.Algorithm
    if problem.optimizer == "SR3":
        algorithm = current.SR3(settings.relaxation, soft=settings.proximal == "soft")
    elif problem.optimizer == "ADMM":
        algorithm = current.ADMM(settings.relaxation)
    else:
        algorithm = current.STLSQ(settings.relaxation)
    solve_kind = current.solve_implicit if problem.implicit else current.solve_explicit
    return solve_kind(
        problem.theta, problem.dx, algorithm, settings.weights, int(problem.max_iterations)
    )
