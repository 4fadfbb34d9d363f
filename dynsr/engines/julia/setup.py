"""What the Julia engine needs on this machine: what is missing, and setting it up by juliapkg.

Knows neither numbers nor equations, so that what is missing is known at once.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from dynsr.errors import EngineError, EngineUnavailable

INSTALL = "pip install 'dynsr[julia]', then dynsr doctor --install"
ENVIRONMENT = {
    # PythonCall needs no conda; with threads it needs Julia's own handling of signals.
    "JULIA_CONDAPKG_BACKEND": "Null",
    "PYTHON_JULIACALL_HANDLE_SIGNALS": "yes",
    "PYTHON_JULIACALL_STARTUP_FILE": "no",
}
_OWN_PROJECT = ("PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT")

# juliapkg tells its progress on standard output, where only the answer is wanted.
_RESOLVE = """
import os
answer = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
try:
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
    """Give the ``julia`` folder: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[2]
    for folder in (package / "julia", package.parent / "julia"):
        if (folder / "src" / "DynSR.jl").is_file():
            return folder
    raise EngineUnavailable(f"the julia folder of dynsr is missing beside {package}; reinstall it")


def require_julia() -> None:
    """Raise EngineUnavailable, with the remedy, where Julia cannot start; start nothing."""
    missing = find_missing()
    if missing:
        raise EngineUnavailable(missing)


def find_missing() -> str:
    """Say in one line what keeps Julia from starting and what mends it; empty when nothing does.

    Starts nothing and installs nothing.
    """
    if importlib.util.find_spec("juliacall") is None:
        return f"the Julia engine is not installed; run {INSTALL}"
    if any(name in os.environ for name in _OWN_PROJECT):
        return _check_own_project()
    try:
        resolved = _is_resolved()
    # juliapkg raises plain exceptions about its settings.
    except Exception as problem:
        return f"juliapkg refuses its settings: {problem}; mend PYTHON_JULIAPKG_*"
    if not resolved:
        return "Julia and its packages are not set up yet; run dynsr doctor --install"
    return ""


def _check_own_project() -> str:
    program, project = (os.environ.get(name) for name in _OWN_PROJECT)
    if program is None or project is None:
        here, absent = _OWN_PROJECT if project is None else _OWN_PROJECT[::-1]
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


def name_remedy() -> str:
    """Say what mends a Julia that does not start."""
    if _OWN_PROJECT[0] in os.environ:
        return "give a project with the packages of dynsr's julia/Project.toml and PythonCall"
    return "run dynsr doctor --install"


def locate() -> tuple[str, str]:
    """Give the Julia program and project in use; juliapkg sets them up where they are not yet.

    Raises EngineUnavailable when juliacall is not installed or a setting of the environment is
    wrong, EngineError when juliapkg fails. What juliapkg prints goes to standard error.
    """
    if importlib.util.find_spec("juliacall") is None:
        raise EngineUnavailable(f"juliacall is not installed; run {INSTALL}")
    if any(name in os.environ for name in _OWN_PROJECT):
        wrong = _check_own_project()
        if wrong:
            raise EngineUnavailable(wrong)
        return os.environ[_OWN_PROJECT[0]], os.environ[_OWN_PROJECT[1]]
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
    if _OWN_PROJECT[0] in os.environ:
        return f"nothing to install: {_OWN_PROJECT[1]} names {project}"
    return f"Julia and its packages are set up: {program} in {project}"
