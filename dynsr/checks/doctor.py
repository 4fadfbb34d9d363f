"""Doctor: what is installed, what works, what is missing and the line that mends it."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata

import numpy as np
import sympy

from dynsr import __version__
from dynsr.engines import ENGINES, AbstractEngine, InitialValueProblem, SparseProblem, find_engine
from dynsr.engines import install as install_julia
from dynsr.errors import EngineError, EngineUnavailable

# What dynsr needs, by the names under which pip knows them.
REQUIRED = (
    "numpy",
    "scipy",
    "sympy",
    "torch",
    "pysindy",
    "joblib",
    "pandas",
    "typer",
    "rich",
    "matplotlib",
    "jinja2",
)
OPTIONAL = {"juliacall": "julia", "diffeqpy": "diffeqpy"}
OK, MISSING, FAILS = "ok", "missing", "fails"


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    ``state`` is "ok", "missing" or "fails"; ``detail`` a version, a measurement or what went
    wrong; ``remedy`` the one line that mends it. What is not ``required`` may be missing.
    """

    name: str
    state: str
    detail: str
    remedy: str = ""
    required: bool = True

    def as_dict(self) -> dict[str, str | bool]:
        """Give the fields as plain data."""
        return asdict(self)


def examine(engines: Sequence[str] = ENGINES) -> list[Check]:
    """Look at every part and try every engine, with an integration and a regression each.

    Nothing is installed; Julia is started where it is set up.

    >>> {check.name: check.state for check in examine(["embedded"])}["embedded: integration"]
    'ok'
    """
    checks = [
        Check("dynsr", OK, __version__),
        Check("python", OK, f"{platform.python_version()} on {platform.platform(terse=True)}"),
        *(_examine_package(name, "", True) for name in REQUIRED),
        *(_examine_package(name, extra, False) for name, extra in OPTIONAL.items()),
    ]
    for name in engines:
        checks.extend(_examine_engine(name))
    return checks


def is_healthy(checks: Sequence[Check]) -> bool:
    """Whether all that is required is there, and nothing that is there fails.

    >>> is_healthy([Check("julia", "missing", "not set up", "dynsr doctor --install", False)])
    True
    """
    return all(c.state == OK or (c.state == MISSING and not c.required) for c in checks)


def install() -> str:
    """Set up Julia and its packages, and say where they are.

    Raises EngineUnavailable where juliacall is not installed, EngineError where it does not work.
    """
    return install_julia()


def _examine_package(name: str, extra: str, required: bool) -> Check:
    try:
        return Check(name, OK, metadata.version(name), required=required)
    except metadata.PackageNotFoundError:
        remedy = f"pip install 'dynsr[{extra}]'" if extra else f"pip install {name}"
        return Check(name, MISSING, "not installed", remedy, required)


def _examine_engine(name: str) -> Iterator[Check]:
    required = name == "embedded"
    try:
        engine = find_engine(name)
    except EngineUnavailable as problem:
        yield Check(f"{name}: engine", MISSING, *_split_remedy(str(problem)), required)
        return
    for verb, attempt in (("integration", _try_integration), ("regression", _try_regression)):
        yield _examine_verb(f"{name}: {verb}", engine, attempt, required)
    if not required:
        yield from _examine_versions(engine)


def _examine_verb(
    name: str, engine: AbstractEngine, attempt: Callable[[AbstractEngine], float], required: bool
) -> Check:
    try:
        # The first call may start and compile; the second is what a user waits for.
        attempt(engine)
        start = time.perf_counter()
        gap = attempt(engine)
    except EngineUnavailable as problem:
        return Check(name, MISSING, *_split_remedy(str(problem)), required)
    except EngineError as problem:
        return Check(name, FAILS, str(problem), "", required)
    seconds = time.perf_counter() - start
    state = OK if gap < 1e-6 else FAILS
    return Check(name, state, f"off by {gap:.1e}, {seconds:.3f} s", "", required)


def _examine_versions(engine: AbstractEngine) -> Iterator[Check]:
    try:
        versions = engine.versions()
    except EngineError:
        # The verbs above have told why.
        return
    for part, version in versions.items():
        yield Check(f"{engine.name}: {part}", OK, version, required=False)


def _try_integration(engine: AbstractEngine) -> float:
    """Largest error of dx/dt = -x over one second."""
    t = np.linspace(0.0, 1.0, 11)
    problem = InitialValueProblem((-sympy.Symbol("x"),), ("x",), np.array([1.0]), t, 1e-9, 1e-9)
    return float(np.abs(engine.integrate(problem).x[:, 0] - np.exp(-t)).max())


def _try_regression(engine: AbstractEngine) -> float:
    """Largest error of the coefficients of dx/dt = 2 x among 1, x, x^2."""
    x = np.linspace(0.1, 2.0, 40)
    theta = np.array([np.ones_like(x), x, x**2])
    problem = SparseProblem(theta, 2 * x, "STLSQ", {"threshold": 0.1})
    return float(np.abs(engine.regress(problem).coefficients - [0.0, 2.0, 0.0]).max())


def _split_remedy(message: str) -> tuple[str, str]:
    """Part what is wrong from the remedy, which is what follows the last semicolon."""
    what, _, remedy = message.rpartition("; ")
    return what, remedy.removeprefix("run ")
