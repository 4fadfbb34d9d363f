"""Sparse regression: the settings of a problem, read for every engine alike, and its solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynsr.engines.base import SparseProblem, SparseSolution
from dynsr.engines.sparse import current, release_2021
from dynsr.errors import InputError

DEFAULT_WEIGHT = 0.1
_KEYS_2021 = {"SR3": ("lambda", "threshold", "nu"), "ADMM": ("lambda", "threshold", "rho")}
_KEYS_CURRENT = {
    "SR3": ("threshold", "lambda", "nu", "proximal"),
    "ADMM": ("threshold", "lambda", "rho"),
    "STLSQ": ("threshold", "lambda", "rho"),
}


@dataclass(frozen=True)
class OptimizerSettings:
    """What an optimizer is run with.

    ``weights`` are the values of lambda (releases of 2021) or the thresholds (today) to try,
    ``relaxation`` is nu (SR3) or rho, ``proximal`` is "hard" or "soft" (SR3 today).
    """

    weights: tuple[float, ...]
    relaxation: float
    proximal: str = "hard"


def read_settings(problem: SparseProblem) -> OptimizerSettings:
    """Read the settings of a problem, with the defaults of its release.

    Raises InputError on a setting that the optimizer does not have or a value it cannot take.

    >>> import numpy as np
    >>> one = np.ones((1, 3))
    >>> read_settings(SparseProblem(one, one[0], "SR3", {"threshold": 0.2}, release="2021"))
    OptimizerSettings(weights=(0.02000...,), relaxation=1.0, proximal='hard')
    """
    return _read_current(problem) if problem.release is None else _read_2021(problem)


def _read_2021(problem: SparseProblem) -> OptimizerSettings:
    if problem.optimizer not in _KEYS_2021:
        raise InputError(
            f"optimizer {problem.optimizer} is not offered for release {problem.release}; "
            "use SR3 or ADMM, or release None"
        )
    _check_keys(problem, _KEYS_2021[problem.optimizer])
    if problem.optimizer == "SR3":
        relaxation = _positive(problem.settings, "nu", 1.0)
        weights = [t**2 * relaxation / 2 for t in _thresholds(problem)]
    else:
        relaxation = _positive(problem.settings, "rho", 1.0)
        weights = [t * relaxation for t in _thresholds(problem)]
    if "threshold" not in problem.settings:
        weights = [_positive(problem.settings, "lambda", DEFAULT_WEIGHT)]
    if len(weights) > 1 and not problem.implicit:
        raise InputError(
            f"{len(weights)} thresholds for an explicit problem of release {problem.release}; "
            "give one threshold, or release None"
        )
    return OptimizerSettings(tuple(weights), relaxation)


def _read_current(problem: SparseProblem) -> OptimizerSettings:
    _check_keys(problem, _KEYS_CURRENT[problem.optimizer])
    settings: Mapping[str, Any] = problem.settings
    proximal = str(settings.get("proximal", "hard"))
    if proximal not in ("hard", "soft"):
        raise InputError(f"proximal {proximal!r} is unknown; use hard or soft")
    if problem.optimizer == "STLSQ":
        relaxation = float(settings.get("rho", 0.0))
    else:
        relaxation = _positive(settings, "nu" if problem.optimizer == "SR3" else "rho", 1.0)
    return OptimizerSettings(tuple(_thresholds(problem)), relaxation, proximal)


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
