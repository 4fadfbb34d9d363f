"""Sparse regression on the embedded engine: reads the settings and calls the release asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dynsr.engines import sparse_2021, sparse_current, sparse_path
from dynsr.engines.base import SparseProblem, SparseSolution
from dynsr.errors import InputError

DEFAULT_WEIGHT = 0.1
_KEYS_2021 = {"SR3": ("lambda", "threshold", "nu"), "ADMM": ("lambda", "threshold", "rho")}
_KEYS_CURRENT = {
    "SR3": ("threshold", "lambda", "nu", "proximal"),
    "ADMM": ("threshold", "lambda", "rho"),
    "STLSQ": ("threshold", "lambda", "rho"),
}


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

    >>> theta = np.array([[1.0, 1.0, 1.0, 1.0], [0.0, 1.0, 2.0, 3.0]])
    >>> line = SparseProblem(theta, 2 * theta[1], "STLSQ", {"threshold": 0.1})
    >>> solve_sparse(line).coefficients.round(9).tolist()
    [0.0, 2.0]
    """
    return _solve_current(problem) if problem.release is None else _solve_2021(problem)


def _solve_2021(problem: SparseProblem) -> SparseSolution:
    if problem.optimizer not in _KEYS_2021:
        raise InputError(
            f"optimizer {problem.optimizer} is not offered for release {problem.release}; "
            "use SR3 or ADMM, or release None"
        )
    _check_keys(problem, _KEYS_2021[problem.optimizer])
    kind: Any = sparse_2021.SR3 if problem.optimizer == "SR3" else sparse_2021.ADMM
    second = _positive(problem.settings, "nu" if problem.optimizer == "SR3" else "rho", 1.0)
    if "threshold" in problem.settings:
        optimizers = [kind.at_threshold(t, second) for t in _thresholds(problem)]
    else:
        optimizers = [kind(_positive(problem.settings, "lambda", DEFAULT_WEIGHT), second)]
    cap = int(problem.max_iterations)
    if problem.implicit:
        corrected = problem.release == "2021-corrected"
        return sparse_2021.solve_implicit(
            problem.theta, problem.dx, optimizers, problem.normalize, cap, corrected
        )
    if len(optimizers) > 1:
        raise InputError(
            f"{len(optimizers)} thresholds for an explicit problem of release {problem.release}; "
            "give one threshold, or release None"
        )
    return sparse_2021.solve_explicit(
        problem.theta, problem.dx, optimizers[0], problem.normalize, cap
    )


def _solve_current(problem: SparseProblem) -> SparseSolution:
    _check_keys(problem, _KEYS_CURRENT[problem.optimizer])
    settings: Mapping[str, Any] = problem.settings
    proximal = settings.get("proximal", "hard")
    if proximal not in ("hard", "soft"):
        raise InputError(f"proximal {proximal!r} is unknown; use hard or soft")
    algorithm: sparse_current.Algorithm
    if problem.optimizer == "SR3":
        nu = _positive(settings, "nu", 1.0)
        algorithm = sparse_current.SR3(nu, soft=proximal == "soft")
    elif problem.optimizer == "ADMM":
        algorithm = sparse_current.ADMM(_positive(settings, "rho", 1.0))
    else:
        algorithm = sparse_current.STLSQ(float(settings.get("rho", 0.0)))
    solve_kind = sparse_path.solve_implicit if problem.implicit else sparse_path.solve_explicit
    return solve_kind(
        problem.theta, problem.dx, algorithm, _thresholds(problem), int(problem.max_iterations)
    )


def _check_keys(problem: SparseProblem, known: tuple[str, ...]) -> None:
    release = "today" if problem.release is None else f"release {problem.release}"
    for key in problem.settings:
        if key not in known:
            raise InputError(
                f"unknown setting {key!r} of {problem.optimizer} ({release}); "
                f"the settings are: {', '.join(known)}"
            )
    if "threshold" in problem.settings and "lambda" in problem.settings:
        raise InputError("both lambda and threshold are given; give one of them")


def _positive(settings: Mapping[str, Any], key: str, default: float) -> float:
    value = float(settings.get(key, default))
    if value <= 0:
        raise InputError(f"setting {key} = {value:g} must be above 0")
    return value


def _thresholds(problem: SparseProblem) -> list[float]:
    given = problem.settings.get("threshold", problem.settings.get("lambda", DEFAULT_WEIGHT))
    values = [float(v) for v in np.atleast_1d(np.asarray(given, dtype=float))]
    if not values or any(v <= 0 for v in values):
        raise InputError(f"threshold {given!r} must be above 0")
    return values
