"""What the Julia engine needs on this machine: what is missing, and setting it up by juliapkg.

Knows neither numbers nor equations, so that what is missing is known at once.
"""

from __future__ import annotations

import atexit
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path

from dynsr.data import own_folder
from dynsr.errors import EngineError, EngineUnavailable, say_install

INSTALL = f"{say_install('julia')}, then dynsr doctor --install"
ENVIRONMENT = {
    # PythonCall needs no conda; with threads it needs Julia's own handling of signals.
    "JULIA_CONDAPKG_BACKEND": "Null",
    "PYTHON_JULIACALL_HANDLE_SIGNALS": "yes",
    "PYTHON_JULIACALL_STARTUP_FILE": "no",
}
OLDEST_JULIA = (1, 10)
# The newest that dynsr was run with as a whole; later ones are let in and noted.
PROVEN_JULIA = (1, 10, 5)
_VERSION_SECONDS = 20.0
OWN_PROGRAM, OWN_PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
_OWN = (OWN_PROGRAM, OWN_PROJECT)

# juliapkg tells its progress on standard output, where only the answer is wanted.
_RESOLVE = """
import os
answer = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
try:
    from dynsr.engines.julia.setup import keep_one_list
    keep_one_list()
    import juliapkg
    juliapkg.resolve()
    print(juliapkg.executable(), juliapkg.project(), sep="\\n", file=answer)
except Exception as problem:
    print(type(problem).__name__, problem, file=answer)
    sys.exit(1)
finally:
    answer.close()
"""


def find_sources() -> Path:
    """Give the folder of dynsr's Julia package: ``julia`` of a checkout, or ``dynsr_julia``.

    The second is what it is called where dynsr is installed, next to ``dynsr``. juliapkg looks for
    ``juliapkg.json`` in the folders next to a package too, so that it finds either.
    """
    beside = Path(__file__).resolve().parents[3]
    for folder in (beside / "dynsr_julia", beside / "julia"):
        if (folder / "src" / "DynSR.jl").is_file():
            return folder
    raise EngineUnavailable(f"dynsr's Julia code is missing in {beside}; reinstall dynsr")


def keep_one_list() -> None:
    """Let juliapkg read the list of packages of :func:`find_sources` alone, of all copies of it.

    A checkout on the path and an installed dynsr have one each, whose paths contradict each other;
    standard error reports which one is taken. Nothing happens where juliapkg is not installed or
    not asked.
    """
    if OWN_PROJECT in os.environ:
        return
    try:
        from juliapkg import deps

        find = deps.deps_files
    except (ImportError, AttributeError):
        return
    own = find_sources() / "juliapkg.json"

    def is_other(file: str) -> bool:
        there = Path(file)
        return (there.parent / "src" / "DynSR.jl").is_file() and not there.samefile(own)

    others = sorted(filter(is_other, find()))
    if others:
        listed = ", ".join(str(Path(file).parent) for file in others)
        sys.stderr.write(f"dynsr's Julia code is taken from {own.parent}, not from {listed}\n")
        deps.deps_files = lambda: [file for file in find() if not is_other(file)]


def require_julia() -> None:
    """Raise EngineUnavailable, with the remedy, where Julia cannot start; start nothing."""
    missing = find_missing()
    if missing:
        raise EngineUnavailable(missing)


def find_missing() -> str:
    """Say in one line what keeps Julia from starting and how to fix it; empty when nothing does.

    Starts nothing and installs nothing.
    """
    if importlib.util.find_spec("juliacall") is None:
        return f"the Julia engine is not installed; run {INSTALL}"
    if any(name in os.environ for name in _OWN):
        return _check_own_project()
    try:
        resolved = _is_resolved()
    # juliapkg raises plain exceptions about its settings.
    except Exception as problem:
        return f"juliapkg refuses its settings: {problem}; correct PYTHON_JULIAPKG_*"
    if not resolved:
        return "Julia and its packages are not set up yet; run dynsr doctor --install"
    return ""


def _check_own_project() -> str:
    program, project = (os.environ.get(name) for name in _OWN)
    if program is None or project is None:
        here, absent = _OWN if project is None else _OWN[::-1]
        return f"{here} is set without {absent}; set both or neither"
    if shutil.which(program) is None:
        return f"PYTHON_JULIACALL_EXE names no program: {program!r}; give the path of julia"
    if not os.path.exists(project):
        return f"PYTHON_JULIACALL_PROJECT does not exist: {project!r}; give a Julia project"
    return ""


def _is_resolved() -> bool:
    """Whether juliapkg has set up Julia before; only then does it start without installing."""
    if importlib.util.find_spec("juliapkg") is None:
        return False
    from juliapkg.state import STATE

    return "meta" not in STATE or os.path.exists(STATE["meta"])


def explain_start(problem: str) -> str:
    """Say in one line why Julia does not start and how to fix it.

    Parameters
    ----------
    problem : what the worker said.
    """
    if OWN_PROGRAM not in os.environ:
        return f"Julia does not start: {problem}; run dynsr doctor --install"
    wrong = _check_program(os.environ[OWN_PROGRAM])
    if wrong:
        return f"Julia does not start: {wrong}"
    remedy = "give a project with the packages of dynsr's julia/Project.toml and PythonCall"
    return f"Julia does not start: {problem}; {remedy}"


def _check_program(program: str) -> str:
    """Say what is wrong with the program that the environment names; "" where it is a Julia."""
    name = OWN_PROGRAM
    try:
        done = subprocess.run(
            [program, "--version"],
            check=False,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_VERSION_SECONDS,
        )
        answer = " ".join((done.stdout or done.stderr).split())[:80]
    except (OSError, subprocess.TimeoutExpired) as problem:
        return f"{name} cannot be run: {program!r} ({type(problem).__name__}); give another julia"
    found = re.match(r"julia version (\d+)\.(\d+)", answer)
    if not found:
        return (
            f"{name} names no Julia: {program!r} answers {answer!r} to --version; "
            "give the path of julia"
        )
    if (int(found[1]), int(found[2])) < OLDEST_JULIA:
        oldest = ".".join(map(str, OLDEST_JULIA))
        return f"{name} is {answer}, and {oldest} is the oldest that serves; give a newer one"
    return ""


def note_julia(version: str) -> str:
    """Say so where a Julia is newer than the newest that dynsr was run with; else "".

    >>> note_julia("1.13.0")
    'newer than 1.10.5, the newest that dynsr was run with'
    >>> note_julia("1.10.4")
    ''
    """
    found = tuple(map(int, re.findall(r"\d+", version)[:3]))
    proven = ".".join(map(str, PROVEN_JULIA))
    return f"newer than {proven}, the newest that dynsr was run with" * (found > PROVEN_JULIA)


def start_environment() -> dict[str, str]:
    """Give the environment of the process that Julia runs in."""
    environment = {**ENVIRONMENT, **os.environ}
    if OWN_PROJECT in os.environ:
        # juliapkg would look for its own project in the first depot.
        environment |= _writable_depot(os.environ)
    return environment


def _writable_depot(environment: Mapping[str, str]) -> dict[str, str]:
    """Put a depot that can be written before a first one that cannot: juliacall keeps a log there.

    The first is that of ``JULIA_DEPOT_PATH``, or ``.julia`` at home.
    """
    given = environment.get("JULIA_DEPOT_PATH")
    if given == "":
        # Julia has no depot at all then, as asked.
        return {}
    home = os.path.join(os.path.expanduser("~"), ".julia")
    first = (given or "").split(os.pathsep)[0]
    if _takes_files(os.path.join(os.path.expanduser(first) if first else home, "logs")):
        return {}
    # An empty entry stands for the depots that come with Julia.
    others = given if first else f"{home}{os.pathsep}{given or ''}"
    return {"JULIA_DEPOT_PATH": f"{own_depot()}{os.pathsep}{others}"}


@cache
def own_depot() -> str:
    """Give a depot for what Julia writes, kept with other caches or gone with this process."""
    home = os.path.expanduser("~")
    caches = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    depot = os.path.join(caches or os.path.join(home, ".cache"), "dynsr", "julia")
    if _takes_files(depot):
        return depot
    stack = ExitStack()
    atexit.register(stack.close)
    return str(stack.enter_context(own_folder("dynsr-julia-")))


def _takes_files(folder: str) -> bool:
    """Whether a file can be made in a folder, which is made where it is not there yet."""
    try:
        os.makedirs(folder, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def is_configured() -> bool:
    """Whether somebody has set Julia up or said where it is, so that it ought to start."""
    if importlib.util.find_spec("juliacall") is None:
        return False
    if any(name in os.environ for name in _OWN):
        return True
    try:
        return _is_resolved()
    # Settings that juliapkg refuses are settings.
    except Exception:
        return True


def locate() -> tuple[str, str]:
    """Give the Julia program and project in use; juliapkg sets them up where they are not yet.

    Raises EngineUnavailable when juliacall is not installed or a setting of the environment is
    wrong, EngineError when juliapkg fails. What juliapkg prints goes to standard error.
    """
    if importlib.util.find_spec("juliacall") is None:
        raise EngineUnavailable(f"juliacall is not installed; run {INSTALL}")
    if any(name in os.environ for name in _OWN):
        wrong = _check_own_project()
        if wrong:
            raise EngineUnavailable(wrong)
        return os.environ[OWN_PROGRAM], os.environ[OWN_PROJECT]
    code = f"import sys; sys.path[:] = {json.dumps(sys.path)}\n{_RESOLVE}"
    done = subprocess.run(
        [sys.executable, "-u", "-c", code],
        check=False,
        stdout=subprocess.PIPE,
        text=True,
        env={**ENVIRONMENT, **os.environ},
    )
    answer = done.stdout.splitlines()
    if done.returncode:
        reason = " ".join(answer) or f"it ended with exit code {done.returncode}"
        raise EngineError(f"juliapkg cannot set up Julia: {reason[:500]}; see its output above")
    return answer[0], answer[1]


def install() -> str:
    """Set up Julia and its packages through juliapkg and say where they are; raises as locate."""
    program, project = locate()
    if OWN_PROGRAM in os.environ:
        return f"nothing to install: {OWN_PROJECT} names {project}"
    return f"Julia and its packages are set up: {program} in {project}"
