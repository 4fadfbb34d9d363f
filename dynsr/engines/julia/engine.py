"""The Julia engine: OrdinaryDiffEqTsit5 and DataDrivenSparse, the tools of the paper, by juliacall.

Julia runs in a process of its own, started on the first use and shared by all processes of a run.
Only the worker in it and the setup know juliacall.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from dynsr.engines.adaptive import integrate_in_parts
from dynsr.engines.base import (
    AbstractEngine,
    InitialValueProblem,
    Integration,
    SparseProblem,
    SparseSolution,
)
from dynsr.engines.drives import Drive
from dynsr.engines.julia.process import Announce, Message, WorkerProcess
from dynsr.engines.julia.setup import (
    explain_start,
    find_sources,
    require_julia,
    start_environment,
)
from dynsr.engines.julia.shared import Guest, Host, find_host, has_host
from dynsr.engines.julia.source import write_slopes
from dynsr.engines.sparse.solve import read_settings
from dynsr.errors import EngineError, EngineUnavailable, printable

# Installing and compiling the packages for the first time is what takes this long.
START_SECONDS = 3600.0
REGRESS_SECONDS = 600.0
# The solver keeps the time limit of an integration itself; this is for the way there and back.
GRACE_SECONDS = 30.0
LONGEST_SECONDS = 1e9


def announce_on_stderr(text: str) -> None:
    """Write a line of progress to standard error."""
    # Whether anybody reads it is no matter of the work.
    with suppress(OSError):
        sys.stderr.write(f"{printable(text)}\n")
        sys.stderr.flush()


class JuliaEngine(AbstractEngine):
    """Integrates and regresses in Julia.

    Parameters
    ----------
    regress_seconds : a regression that takes more seconds is stopped.
    start_seconds : so is a start of Julia, which may install and compile packages.
    announce : is given a line when a stage of the start takes more than two seconds.

    With ``PYTHON_JULIACALL_EXE`` and ``PYTHON_JULIACALL_PROJECT`` set, that Julia runs in that
    project, and nothing is resolved or installed; it must hold OrdinaryDiffEqTsit5,
    DataDrivenDiffEq, DataDrivenSparse and PythonCall. Otherwise juliapkg's own settings
    (``PYTHON_JULIAPKG_*``) say where Julia lives.

    Raises EngineUnavailable, with the remedy, where Julia is not set up.
    """

    name = "julia"
    takes_drives = True
    # What the worker is asked for.
    integration = "integrate"

    def __init__(
        self,
        regress_seconds: float = REGRESS_SECONDS,
        start_seconds: float = START_SECONDS,
        announce: Announce = announce_on_stderr,
    ) -> None:
        """Check that Julia is there; it starts on the first use."""
        require_julia()
        self.regress_seconds = regress_seconds
        self.start_seconds = start_seconds
        self.announce = announce
        self._versions: dict[str, str] = {}
        self._process: WorkerProcess | Guest | None = None
        self._host: Host | None = None
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel to another process as settings; that one finds or starts a Julia by itself."""
        return (type(self), (self.regress_seconds, self.start_seconds, self.announce))

    def integrate(self, problem: InitialValueProblem) -> Integration:
        """Solve an initial value problem by OrdinaryDiffEqTsit5.

        Raises EngineError when Julia fails, dies or is late, EngineUnavailable when it does not
        start.
        """
        if not problem.drives:
            return self._integrate(problem)
        if not self.takes_drives:
            raise EngineError(f"{self.name} integrates no measured inputs")
        return integrate_in_parts(problem, self._integrate)

    def _integrate(self, problem: InitialValueProblem) -> Integration:
        drives = problem.drives
        header = {
            "call": "integrate_driven" if drives else self.integration,
            "slopes": write_slopes(problem.rhs, problem.states, [d.name for d in drives]),
            "reltol": float(problem.reltol),
            "abstol": float(problem.abstol),
            "max_steps": int(problem.max_steps),
            # Julia is given a number that it can add to its clock.
            "max_seconds": min(float(problem.max_seconds), LONGEST_SECONDS),
        }
        seconds = problem.max_seconds + GRACE_SECONDS
        arrays = {"x0": problem.x0, "t": problem.t}
        if drives:
            arrays |= _together(drives, problem)
        facts, results = self._ask(header, arrays, seconds)
        x = _expect(results, "x", (len(problem.t), len(problem.states)))
        finite = bool(np.isfinite(x).all())
        message = str(facts["message"])
        if not finite and not message:
            message = "the solution is not finite"
        return Integration(
            x, finite and not message, int(facts["accepted"]), int(facts["rejected"]), message
        )

    def regress(self, problem: SparseProblem) -> SparseSolution:
        """Solve a sparse regression: by DataDrivenSparse today, by DynSR's own code as in 2021.

        Raises InputError when the settings are wrong, EngineError when Julia fails, dies, is late
        or answers coefficients that are not finite, EngineUnavailable when it does not start.
        """
        settings = read_settings(problem)
        header = {
            "call": "regress",
            "optimizer": problem.optimizer,
            "release": problem.release or "",
            "relaxation": settings.relaxation,
            "proximal": settings.proximal,
            "normalize": bool(problem.normalize),
            "max_iterations": int(problem.max_iterations),
            "implicit": bool(problem.implicit),
        }
        arrays = {
            "theta": problem.theta,
            "dx": problem.dx,
            "weights": np.array(settings.weights),
        }
        facts, results = self._ask(header, arrays, self.regress_seconds)
        count = len(problem.theta) * (2 if problem.implicit else 1)
        coefficients = _expect(results, "coefficients", (count,))
        if not np.isfinite(coefficients).all():
            raise EngineError("Julia's coefficients are not finite; scale the library or drop rows")
        iterations = int(facts["iterations"])
        return SparseSolution(
            coefficients, None if iterations < 0 else iterations, bool(facts["converged"])
        )

    def versions(self) -> dict[str, str]:
        """Name Julia and its packages with their versions; starts Julia when it has not run."""
        if not self._versions:
            asked = {"call": "versions", "program": self.integration}
            facts, _ = self._ask(asked, {}, GRACE_SECONDS)
            self._versions = {str(k): str(v) for k, v in facts["versions"].items()}
        return dict(self._versions)

    def close(self) -> None:
        """End Julia; it starts again on the next use."""
        with self._lock:
            if self._process is not None:
                self._process.close()
            self._process = None

    def share(self) -> None:
        """Let processes that are started from now on ask this Julia instead of one of their own."""
        with self._lock:
            if self._host is None and not has_host():
                self._host = Host(self._answer)

    def _ask(
        self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], seconds: float
    ) -> Message:
        return self._answer(header, arrays, seconds, self.start_seconds)

    def _answer(
        self,
        header: Mapping[str, Any],
        arrays: Mapping[str, np.ndarray],
        seconds: float,
        start_seconds: float,
        check: Callable[[], None] = lambda: None,
    ) -> Message:
        with self._lock:
            check()
            asked = {**header, "source": str(find_sources() / "src" / "DynSR.jl")}
            process = self._reach()
            if isinstance(process, Guest):
                return process.request(asked, arrays, seconds, start_seconds, self.announce)
            try:
                return process.request(asked, arrays, seconds, start_seconds, self.announce, check)
            except EngineUnavailable as problem:
                raise EngineUnavailable(explain_start(str(problem))) from None

    def _reach(self) -> WorkerProcess | Guest:
        """Give what answers, started again where it is not there."""
        if self._process is None or not self._process.alive:
            if self._process is not None:
                self._process.close()
            own = self._host is not None
            self._process = (None if own else find_host()) or WorkerProcess(
                "dynsr.engines.julia.worker", "julia", start_environment()
            )
        return self._process


def _together(drives: Sequence[Drive], problem: InitialValueProblem) -> dict[str, np.ndarray]:
    """Put all drives into one array of each kind, with as many coefficients a piece."""
    most = max(len(drive.pieces) for drive in drives)
    pieces = [np.pad(d.pieces, ((most - len(d.pieces), 0), (0, 0))) for d in drives]
    inside = (problem.stops > problem.t[0]) & (problem.stops < problem.t[-1])
    return {
        "counts": np.array([len(drive.starts) for drive in drives], dtype=float),
        "starts": np.concatenate([drive.starts for drive in drives]),
        "pieces": np.concatenate(pieces, axis=1),
        "stops": np.unique(problem.stops[inside]),
    }


def _expect(results: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...]) -> np.ndarray:
    value = results.get(name)
    if value is None or value.shape != shape:
        found = None if value is None else value.shape
        raise EngineError(f"Julia answered {name} of shape {found} where {shape} was asked for")
    return value
