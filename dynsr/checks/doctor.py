"""Doctor: what is installed, what works, what is missing and how to fix it."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata

import numpy as np
import sympy
from packaging.requirements import Requirement

from dynsr import __version__
from dynsr.engines import (
    ENGINES,
    AbstractEngine,
    InitialValueProblem,
    SparseProblem,
    find_engine,
    is_configured,
    note_julia,
)
from dynsr.engines import install as install_julia
from dynsr.errors import EngineError, EngineUnavailable, say_install

# Extras that build and test dynsr; using it needs none of their packages.
_WORKSHOP = ("dev", "docs")
OK, MISSING, FAILS = "ok", "missing", "fails"


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    ``state`` is "ok", "missing" or "fails"; ``detail`` a version, a measurement or what went
    wrong; ``remedy`` the one line that says how to fix it. What is not ``required`` may be missing.
    """

    name: str
    state: str
    detail: str
    remedy: str = ""
    required: bool = True


def examine(engines: Sequence[str] = ENGINES) -> list[Check]:
    """Look at every package and try every engine, with an integration and a regression each.

    Nothing is installed; Julia is started where it is set up. The packages are those that dynsr's
    own metadata names: what it requires, and what its extras add.

    Parameters
    ----------
    engines : names of the engines to try.

    Raises InputError when an engine is unknown.

    >>> {check.name: check.state for check in examine(["embedded"])}["embedded: integration"]
    'ok'
    """
    checks = [
        Check("dynsr", OK, __version__),
        Check("python", OK, f"{platform.python_version()} on {platform.platform(terse=True)}"),
        *_examine_packages(),
    ]
    for name in engines:
        checks.extend(_examine_engine(name))
    return checks


def is_healthy(checks: Sequence[Check]) -> bool:
    """Whether all that is required is there, and nothing that is there fails.

    Parameters
    ----------
    checks : what :func:`examine` gave.

    >>> is_healthy([Check("julia", "missing", "not set up", "dynsr doctor --install", False)])
    True
    """
    return all(c.state == OK or (c.state == MISSING and not c.required) for c in checks)


def install() -> str:
    """Set up Julia and its packages, and say where they are.

    Raises EngineUnavailable where juliacall is not installed, EngineError where it does not work.
    """
    return install_julia()


def _examine_packages() -> Iterator[Check]:
    """Look at every package that this Python needs once, under the smallest extra that has it."""
    try:
        named = metadata.metadata("dynsr")
    except metadata.PackageNotFoundError:
        yield Check("packages", MISSING, "dynsr is not installed", "pip install .", False)
        return
    every = [Requirement(line) for line in named.get_all("Requires-Dist") or ()]
    asked = {
        extra: [r for r in every if r.marker is None or r.marker.evaluate({"extra": extra})]
        for extra in ("", *(named.get_all("Provides-Extra") or ()))
        if extra not in _WORKSHOP
    }
    seen = {"dynsr"}
    # Every extra has the packages that are always required, so that these come first.
    for extra, requirements in sorted(asked.items(), key=lambda pair: (len(pair[1]), pair[0])):
        for requirement in requirements:
            if requirement.name not in seen:
                seen.add(requirement.name)
                yield _examine_package(requirement, extra)


def _examine_package(requirement: Requirement, extra: str) -> Check:
    name, required = requirement.name, not extra
    remedy = say_install(extra) if extra else f'pip install "{name}{requirement.specifier}"'
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Check(name, MISSING, "not installed", remedy, required)
    if not requirement.specifier.contains(version, prereleases=True):
        detail = f"{version} where {requirement.specifier} is needed"
        return Check(name, FAILS, detail, remedy, required)
    return Check(name, OK, version, required=required)


def _examine_engine(name: str) -> Iterator[Check]:
    required = name == "embedded"
    try:
        engine = find_engine(name)
    except EngineUnavailable as problem:
        state = FAILS if name == "julia" and is_configured() else MISSING
        yield Check(f"{name}: engine", state, *_split_remedy(str(problem)), required)
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
        # It is set up, or it would not have been tried.
        return Check(name, FAILS, *_split_remedy(str(problem)), required)
    except EngineError as problem:
        return Check(name, FAILS, str(problem), "", required)
    seconds = time.perf_counter() - start
    state = OK if gap < 1e-6 else FAILS
    return Check(name, state, f"off by {gap:.1e}, {seconds:.3f} s", "", required)


def _examine_versions(engine: AbstractEngine) -> Iterator[Check]:
    try:
        versions = engine.versions()
    except EngineError:
        # The rows of the integration and the regression say why.
        return
    for package, version in versions.items():
        note = note_julia(version) if package == "julia" else ""
        detail = f"{version}, {note}" if note else version
        yield Check(f"{engine.name}: {package}", OK, detail, required=False)


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
    """Separate what is wrong from the remedy, which follows the last semicolon."""
    what, _, remedy = message.rpartition("; ")
    return what, remedy.removeprefix("run ")
