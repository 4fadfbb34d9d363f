"""The seam between dynsr and an engine: two problems in, arrays out.

Across this line go strings, numbers, tuples, SymPy expressions and float64 arrays; never an
object of the engine's own, never a Python callback. Nothing is left to an engine's default.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import sympy

from dynsr.engines.drives import Drive
from dynsr.errors import InputError
from dynsr.expression import parse

DEFAULT_RELTOL = 1e-3
DEFAULT_ABSTOL = 1e-6
# Data of these hold no error of a solver that a search could see.
FINE_RELTOL = 1e-9
FINE_ABSTOL = 1e-12
Release = Literal["2021", "2021-corrected"]
Optimizer = Literal["SR3", "ADMM", "STLSQ"]


@dataclass(frozen=True, eq=False)
class InitialValueProblem:
    """Integrate dx/dt = rhs(x, t) from ``x0`` at ``t[0]`` and give x at every ``t``.

    Parameters
    ----------
    rhs : k expressions in ``states``, the time ``t`` and the names of ``drives`` alone (inputs that
        are expressions already put in).
    states : the k names.
    x0 : (k,) start state at ``t[0]``.
    t : (n,) times in seconds, strictly increasing, at which to save.
    reltol, abstol : tolerances of the solver; the defaults are DifferentialEquations.jl's.
    max_steps : more steps than this count as divergence.
    max_seconds : so does more time than this.
    drives : inputs that were measured; for engines that take them.
    stops : (s,) times in seconds that no step may pass over, where there are drives.
    """

    rhs: tuple[sympy.Expr, ...]
    states: tuple[str, ...]
    x0: np.ndarray
    t: np.ndarray
    reltol: float = DEFAULT_RELTOL
    abstol: float = DEFAULT_ABSTOL
    max_steps: int = 100_000
    max_seconds: float = 60.0
    drives: tuple[Drive, ...] = ()
    stops: np.ndarray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        """Check shapes, names and tolerances; raises InputError."""
        x0, t = np.asarray(self.x0, dtype=float), np.asarray(self.t, dtype=float)
        if len(self.rhs) != len(self.states) or x0.shape != (len(self.states),):
            raise InputError(
                f"{len(self.rhs)} equations and a start of shape {x0.shape} do not fit "
                f"{len(self.states)} states; give one of each a state"
            )
        if t.ndim != 1 or len(t) < 2 or not np.all(np.isfinite(t)) or np.any(np.diff(t) <= 0):
            raise InputError("t must be at least two increasing finite times")
        if not np.all(np.isfinite(x0)):
            raise InputError(f"x0 {x0.tolist()} must be finite numbers")
        for name, value in (("reltol", self.reltol), ("abstol", self.abstol)):
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} {value} must be a positive number")
        for expr in self.rhs:
            parse(expr, [*self.states, "t", *(drive.name for drive in self.drives)])
        object.__setattr__(self, "x0", x0)
        object.__setattr__(self, "t", t)


@dataclass(frozen=True, eq=False)
class Integration:
    """What an engine found for an InitialValueProblem.

    ``x`` (n, k) holds NaN from the time on where the solution diverged or a limit was met;
    ``success`` says whether all of it is finite. ``accepted`` and ``rejected`` count steps.
    """

    x: np.ndarray
    success: bool
    accepted: int
    rejected: int
    message: str = ""


@dataclass(frozen=True, eq=False)
class SparseProblem:
    """Find few coefficients c with dx = c . theta, or an implicit (rational) relation.

    Parameters
    ----------
    theta : (p, m) values of p library functions at m samples.
    dx : (m,) derivative of one state, state units per second.
    optimizer : "SR3", "ADMM" or "STLSQ".
    settings : the optimizer's own numbers. SR3: ``lambda`` or ``threshold``, ``nu`` and, today,
        ``proximal`` ("hard" or "soft"); ADMM: ``lambda`` or ``threshold``, and ``rho``;
        STLSQ: ``threshold``, ``rho``. ``threshold`` may be a tuple of thresholds to try.
    normalize : divide each library row by its 2-norm during the solve (releases of 2021 only).
    max_iterations : iteration cap.
    implicit : search for q with [dx theta; theta]' q = 0 instead (SINDy-PI).
    release : "2021", the paper's release with its quirks; "2021-corrected", the same optimizers
        with a search free of them; None, DataDrivenSparse.jl as it is today.
    """

    theta: np.ndarray
    dx: np.ndarray
    optimizer: Optimizer = "SR3"
    settings: Mapping[str, float | str | tuple[float, ...]] = field(default_factory=dict)
    normalize: bool = True
    max_iterations: int = 5000
    implicit: bool = False
    release: Release | None = None

    def __post_init__(self) -> None:
        """Check shapes, names and numbers; raises InputError."""
        theta, dx = np.asarray(self.theta, dtype=float), np.asarray(self.dx, dtype=float)
        if theta.ndim != 2 or dx.shape != (theta.shape[1],):
            raise InputError(
                f"theta {theta.shape} and dx {dx.shape} do not fit; theta is (functions, samples) "
                "and dx (samples,)"
            )
        if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(dx))):
            raise InputError("theta or dx has a value that is not finite; drop such samples")
        if self.optimizer not in ("SR3", "ADMM", "STLSQ"):
            raise InputError(
                f"unknown optimizer {self.optimizer!r}; the optimizers are: SR3, ADMM, STLSQ"
            )
        if self.release not in (None, "2021", "2021-corrected"):
            raise InputError(
                f"unknown release {self.release!r}; the releases are: 2021, 2021-corrected, None"
            )
        if int(self.max_iterations) < 1:
            raise InputError(f"max_iterations {self.max_iterations} must be at least 1")
        for key, value in self.settings.items():
            if key != "proximal":
                _check_setting(key, value)
        object.__setattr__(self, "theta", theta)
        object.__setattr__(self, "dx", dx)


def _check_setting(key: str, value: object) -> None:
    """Refuse what is not a number from 0 up, or for the threshold a sequence of such."""
    several = key == "threshold" and isinstance(value, (tuple, list)) and len(value) > 0
    for number in value if several else [value]:  # type: ignore[attr-defined]
        if not (isinstance(number, (int, float)) and np.isfinite(number) and number >= 0):
            raise InputError(f"setting {key} = {value!r} must be a number from 0 up")


@dataclass(frozen=True, eq=False)
class SparseSolution:
    """Coefficients of a SparseProblem.

    ``coefficients`` has p numbers, or 2p for an implicit problem: p of the denominator, then p of
    the numerator, with dx = -(num . theta) / (den . theta). ``iterations`` is None when an
    implicit search came back empty.
    """

    coefficients: np.ndarray
    iterations: int | None
    converged: bool


class AbstractEngine(ABC):
    """Integrates and regresses. The same claims hold for every engine.

    ``name`` is what records call it; ``takes_drives`` says whether it integrates measured inputs.
    """

    name: str
    takes_drives: bool = False

    def __repr__(self) -> str:
        """Name the engine; the same in every process, as the keys of records need."""
        return f"{type(self).__name__}({self.name!r})"

    @abstractmethod
    def integrate(self, problem: InitialValueProblem) -> Integration:
        """Solve an initial value problem by Tsit5; a divergence is a result, not an error."""

    def integrate_all(self, problems: Sequence[InitialValueProblem]) -> list[Integration]:
        """Solve many problems, one answer each in the same order; an engine may do so at once."""
        return [self.integrate(problem) for problem in problems]

    @abstractmethod
    def regress(self, problem: SparseProblem) -> SparseSolution:
        """Solve a sparse regression problem."""

    @abstractmethod
    def versions(self) -> dict[str, str]:
        """Name every part that took part in an answer, with its version."""

    def share(self) -> None:  # noqa: B027 (most engines cost nothing in each process)
        """Prepare for processes that are started from now on and ask an engine of this name."""

    def close(self) -> None:  # noqa: B027 (most engines hold nothing)
        """Give back what the engine holds; it starts again on its next use."""
