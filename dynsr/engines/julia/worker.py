"""The process in which Julia runs: reads requests from standard input and answers on the output.

Torch is never imported here: loading it before Julia can crash both. What Julia or a library
prints goes to standard error, so that nothing but messages reaches the engine.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import pickle
import sys
from collections.abc import Callable
from typing import IO, Any

import numpy as np

from dynsr.engines.julia.setup import OWN_PROJECT, keep_one_list, own_depot

LONGEST_MESSAGE = 600
_IS_PACKAGE = (
    'path -> (found = Base.find_package("DynSR"); found !== nothing && samefile(found, path))'
)
# The user's project stays on the path from which packages are loaded.
_ACTIVATE_BESIDE = (
    "folder -> (push!(LOAD_PATH, dirname(Base.active_project())); mkpath(folder); "
    "Base.set_active_project(folder))"
)
_LOADED_VERSION = (
    "name -> (m = [m for (id, m) in Base.loaded_modules if id.name == name]; "
    'isempty(m) ? "" : string(pkgversion(m[1])))'
)
_TINY_SLOPES = "(du, u, p, t) -> begin\n    du[1] = -1.0 * u[1]\n    nothing\nend"


class Session:
    """Julia with dynsr's module in it; ``tell`` is given the stages of its start as text."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        """Start nothing yet: the first request does."""
        self._tell = tell
        self._module: Any = None
        self._warm: set[tuple[str, ...]] = set()
        self._calls = {
            "integrate": self._integrate,
            "integrate_driven": self._integrate_driven,
            "regress": self._regress,
            "diffeqpy": self._integrate_by_diffeqpy,
        }
        self._versions: dict[str, str] = {}

    def load(self, source: str) -> None:
        """Start Julia and load dynsr's module from its file; nothing happens the second time."""
        if self._module is not None:
            return
        self._tell(f"starting Julia ({_announce_packages()})")
        keep_one_list()
        import juliacall

        self._tell("loading Julia's packages (compiled on the first time, which takes minutes)")
        main = juliacall.Main
        # The package of that very file, compiled when it was installed; a project that does not
        # hold it includes the file.
        if main.seval(_IS_PACKAGE)(source):
            main.seval("import DynSR")
        else:
            main.seval("path -> Base.include(Main, path)")(source)
        self._module = main.seval("Main.DynSR")
        lines = str(self._module.versions()).splitlines()
        self._versions = {
            **dict(line.split(" ", 1) for line in lines),
            "juliacall": str(juliacall.__version__),
        }

    def warm_up(self, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        """Compile what the call needs, so that the time it is given is for its work alone.

        Julia compiles each optimizer, release and kind of regression by itself.
        """
        call = header["call"]
        if call not in self._calls:
            return
        kind = _kind_of_regression(header, arrays) if call == "regress" else (call,)
        if kind not in self._warm:
            self._tell(f"compiling {' '.join(kind)}, once a session")
            tiny = _tiny_regression if call == "regress" else _tiny_integration
            if call == "diffeqpy":
                # It may install and compile packages, and why that fails is reported.
                _load_diffeqpy()
            # Whether the tiny problem can be solved does not matter.
            with contextlib.suppress(Exception):
                self._calls[call](*tiny(header, arrays))
            self._warm.add(kind)

    def answer(
        self, header: dict[str, Any], arrays: dict[str, np.ndarray]
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Do what is asked: "integrate", "regress", "diffeqpy" or "versions"."""
        if header["call"] == "versions":
            own = _diffeqpy_versions() if header.get("program") == "diffeqpy" else {}
            return {"versions": {**self._versions, **own}}, {}
        return self._calls[header["call"]](header, arrays)

    def _integrate(
        self, header: dict[str, Any], arrays: dict[str, np.ndarray]
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        return _solve(self._module.integrate, header, arrays)

    def _integrate_driven(
        self, header: dict[str, Any], arrays: dict[str, np.ndarray]
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        drives = (arrays[name] for name in ("counts", "starts", "pieces", "stops"))
        return _solve(self._module.integrate_driven, header, arrays, *drives)

    def _integrate_by_diffeqpy(
        self, header: dict[str, Any], arrays: dict[str, np.ndarray]
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        de, vector = _load_diffeqpy()
        t = arrays["t"]
        slopes = self._module.compile(str(header["slopes"]))
        problem = de.ODEProblem(slopes, vector(arrays["x0"]), (float(t[0]), float(t[-1])))
        solver = de.Tsit5()
        # As in integrate: releases differ in how much the first step may grow.
        controller = self._module.first_step_controller(solver)
        solution = de.solve(
            problem,
            solver,
            **({} if controller is None else {"controller": controller}),
            callback=self._module.clock(float(header["max_seconds"])),
            saveat=vector(t),
            reltol=float(header["reltol"]),
            abstol=float(header["abstol"]),
            maxiters=int(header["max_steps"]),
        )
        x, accepted, rejected, message = self._module.answer_at(
            vector(t), solution, float(header["max_seconds"])
        )
        facts = {"accepted": int(accepted), "rejected": int(rejected), "message": str(message)}
        return facts, {"x": np.array(x, copy=True).astype(float)}

    def _regress(
        self, header: dict[str, Any], arrays: dict[str, np.ndarray]
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        coefficients, iterations, converged = self._module.regress(
            arrays["theta"],
            arrays["dx"],
            str(header["optimizer"]),
            str(header["release"]),
            arrays["weights"],
            float(header["relaxation"]),
            str(header["proximal"]),
            bool(header["normalize"]),
            int(header["max_iterations"]),
            bool(header["implicit"]),
        )
        facts = {"iterations": int(iterations), "converged": bool(converged)}
        return facts, {"coefficients": np.array(coefficients, copy=True).astype(float)}


def _solve(
    integrate: Any, header: dict[str, Any], arrays: dict[str, np.ndarray], *drives: np.ndarray
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    x, accepted, rejected, message = integrate(
        str(header["slopes"]),
        arrays["x0"],
        arrays["t"],
        float(header["reltol"]),
        float(header["abstol"]),
        int(header["max_steps"]),
        float(header["max_seconds"]),
        *drives,
    )
    facts = {"accepted": int(accepted), "rejected": int(rejected), "message": str(message)}
    return facts, {"x": np.array(x, copy=True).astype(float)}


def _load_diffeqpy() -> tuple[Any, Any]:
    """Give DifferentialEquations.jl, and the function that makes an array one of Julia's own."""
    import juliacall

    # diffeqpy installs another Julia unless it finds a program of that name.
    folders = [str(juliacall.Main.seval("Sys.BINDIR")), *os.environ["PATH"].split(os.pathsep)]
    os.environ["PATH"] = os.pathsep.join(dict.fromkeys(folders))
    if OWN_PROJECT in os.environ and "diffeqpy" not in sys.modules:
        # It adds packages that it misses to the active project, which is the user's own.
        juliacall.Main.seval(_ACTIVATE_BESIDE)(
            os.path.join(own_depot(), "environments", "diffeqpy")
        )
    from diffeqpy import de

    return de, juliacall.Main.seval("x -> Vector{Float64}(x)")


def _diffeqpy_versions() -> dict[str, str]:
    """Name the versions of diffeqpy and of the DifferentialEquations.jl that it loads."""
    import juliacall

    _load_diffeqpy()
    try:
        own = importlib.metadata.version("diffeqpy")
    except importlib.metadata.PackageNotFoundError:
        own = "from a folder of the path"
    loaded = str(juliacall.Main.seval(_LOADED_VERSION)("DifferentialEquations"))
    return {"diffeqpy": own, "DifferentialEquations": loaded}


def _announce_packages() -> str:
    """Say what a start does with packages; none are installed into a user's own project."""
    if OWN_PROJECT in os.environ:
        return f"with the packages of {os.environ[OWN_PROJECT]}"
    return "packages that are missing are installed, which takes minutes"


def _kind_of_regression(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> tuple[str, ...]:
    """Name what Julia compiles by itself, by whether one threshold is given or several."""
    words = (
        "regress",
        "implicit" if header["implicit"] else "explicit",
        str(header["optimizer"]),
        str(header["release"]),
        str(header["proximal"]),
        "thresholds" if len(arrays["weights"]) > 1 else "",
    )
    return tuple(word for word in words if word)


def _tiny_integration(
    header: dict[str, Any], arrays: dict[str, np.ndarray]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    tiny = {**header, "slopes": _TINY_SLOPES, "max_steps": 1000, "max_seconds": 60.0}
    one = np.array([1.0])
    pieces = {"counts": one, "starts": 0 * one, "pieces": np.ones((4, 1)), "stops": one / 2}
    return tiny, {"x0": one, "t": np.array([0.0, 1.0]), **pieces}


def _tiny_regression(
    header: dict[str, Any], arrays: dict[str, np.ndarray]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Give dx/dt = 2x / (1 + x), which both explicit and implicit searches find terms for."""
    x = np.linspace(0.1, 2.0, 20)
    weights = np.array([0.01, 0.02])[: len(arrays["weights"])]
    tiny = {**header, "max_iterations": 10}
    return tiny, {"theta": np.array([np.ones(20), x]), "dx": 2 * x / (1 + x), "weights": weights}


def main() -> None:
    """Answer requests until the engine closes the pipe."""
    requests, answers = _take_pipes()

    def send(event: str, arrays: dict[str, np.ndarray] | None = None, **facts: Any) -> None:
        pickle.dump(({"event": event, **facts}, arrays or {}), answers)
        answers.flush()

    session = Session(lambda text: send("progress", text=text))
    while True:
        try:
            header, arrays = pickle.load(requests)  # noqa: S301 (our own parent)
        except EOFError:
            return
        # Whatever a foreign library raises, the engine gets a message and the worker lives on.
        try:
            session.load(header["source"])
        except Exception as problem:
            send("unavailable", message=_one_line(problem))
            continue
        try:
            session.warm_up(header, arrays)
            send("working")
            facts, results = session.answer(header, arrays)
        except Exception as problem:
            send("error", message=_one_line(problem))
            continue
        send("answer", results, **facts)


def _take_pipes() -> tuple[IO[bytes], IO[bytes]]:
    """Keep the pipes for messages and turn everyone else's standard output to the error's."""
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nowhere, 0)
    os.close(nowhere)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return requests, answers


def _one_line(problem: Exception) -> str:
    """Give the message of an exception in one line, without the stack."""
    text = str(problem).split("Stacktrace:")[0]
    # A program that juliacall ran says on its own standard error why it failed.
    output = str(getattr(problem, "stderr", None) or "").strip()
    if output:
        text += f" It said: {output.splitlines()[-1]}"
    line = " ".join(text.split()) or type(problem).__name__
    return line if len(line) <= LONGEST_MESSAGE else line[: LONGEST_MESSAGE - 3] + "..."
