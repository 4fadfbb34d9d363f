"""A stand-in for juliacall: its calls, answered in Python, and ways to fail on purpose.

``max_steps`` of an integration chooses the failure; anything else is solved by small
Runge-Kutta steps from the Julia source that was sent.
"""

import itertools
import math
import os
import re
import signal
import sys
import time
from types import SimpleNamespace

import numpy as np

__version__ = "0.0-fake"

STEPS = 40
DIE, HANG, RAISE, CHATTER, NOT_FINITE, WRONG_SHAPE, CRASH = 13, 14, 15, 16, 17, 18, 19

if os.environ.get("FAKE_JULIA_START") == "fail":
    # As juliacall's start script does: the error and its stack are printed, then it raises.
    print('ERROR: SystemError: opening file "/depot/logs": Read-only file system', file=sys.stderr)
    print("Stacktrace:", *(f"  [{i}] deep_{i}()" for i in range(60)), sep="\n", file=sys.stderr)
    sys.stderr.flush()
    raise RuntimeError("PythonCall.jl did not start properly\nsecond line")
if os.environ.get("FAKE_JULIA_START") == "no julia":
    # As juliacall does where the program's answer is not that of a Julia.
    raise ValueError("not enough values to unpack (expected 2, got 1)")
if os.environ.get("FAKE_JULIA_START") == "slow":
    # Julia itself takes far longer before it says anything.
    time.sleep(0.3)
    print("[ Info: Precompiling Symbolics [0c5d862f]", file=sys.stderr, flush=True)
    time.sleep(1.0)


class JuliaError(Exception):
    """As juliacall raises it: the words of Julia, then a stack."""


def _not_a_number(function):
    def call(*arguments):
        try:
            return function(*arguments)
        except (ValueError, ZeroDivisionError, OverflowError):
            return math.nan

    return call


_SCOPE = {
    name: _not_a_number(getattr(math, name))
    for name in [
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "sinh",
        "cosh",
        "tanh",
        "exp",
        "log",
        "sqrt",
    ]
}
_SCOPE |= {"power": _not_a_number(pow), "abs": abs, "sign": lambda x: (x > 0) - (x < 0)}
_SCOPE |= {"NaN": math.nan, "Inf": math.inf}


def slopes_of(source, drive=None):
    """Read the Julia source of right-hand sides as Python."""
    lines = source.split("\n")
    assert lines[0] == "(du, u, p, t) -> begin" and lines[-2:] == ["    nothing", "end"]
    body = re.sub(r"\[(\d+)\]", lambda m: f"[{int(m[1]) - 1}]", "\n".join(lines[1:-2]))
    text = f"def slopes(t, u):\n    du = [0.0] * len(u)\n{body.replace('^', '**')}\n    return du"
    scope = {**_SCOPE, "drive": drive, "p": None}
    exec(text, scope)
    return scope["slopes"]


def _runge_kutta(slopes, x0, t):
    rows = [x0]
    for start, end in itertools.pairwise(t):
        x, h = rows[-1], (end - start) / STEPS
        for now in start + h * np.arange(STEPS):
            a = np.array(slopes(now, x))
            b = np.array(slopes(now + h / 2, x + h / 2 * a))
            c = np.array(slopes(now + h / 2, x + h / 2 * b))
            d = np.array(slopes(now + h, x + h * c))
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
        rows.append(x)
    return np.array(rows)


def _log(call):
    """Write down which call came to which process, where a test asks for it."""
    if "FAKE_JULIA_LOG" in os.environ:
        with open(os.environ["FAKE_JULIA_LOG"], "a") as log:
            log.write(f"{call} {os.getpid()}\n")


def _integrate_driven(
    source,
    x0,
    t,
    reltol,
    abstol,
    max_steps,
    max_seconds,
    counts,
    starts,
    pieces,
    stops,
):
    _log("integrate_driven")
    assert pieces.shape[1] == len(starts) == counts.sum()
    assert np.all(stops > t[0]) and np.all(stops < t[-1]) and np.all(np.diff(stops) > 0)
    ends = np.cumsum(counts).astype(int)

    def drive(p, k, at):
        span = slice(ends[k - 1] - int(counts[k - 1]), ends[k - 1])
        i = max(np.searchsorted(starts[span], at, side="right") - 1, 0)
        return np.polyval(pieces[:, span][:, i], at - starts[span][i])

    slopes = slopes_of(source, drive)
    # Each stop is the end of a step.
    rows = np.unique(np.concatenate([t, stops]))
    x = _runge_kutta(slopes, x0, rows)
    return x[np.searchsorted(rows, t)], STEPS * (len(rows) - 1), 0, ""


def _integrate(source, x0, t, reltol, abstol, max_steps, max_seconds):
    _log("integrate")
    assert isinstance(source, str) and x0.flags.writeable and t.dtype == float
    if max_steps == DIE:
        print("something broke", file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    if max_steps == CRASH:
        print("[7] signal 11 (1): Segmentation fault\nin expression starting at", file=sys.stderr)
        print(*(f"unknown function (ip: {i:x})" for i in range(60)), sep="\n", file=sys.stderr)
        sys.stderr.flush()
        os.kill(os.getpid(), signal.SIGSEGV)
    if max_steps == HANG:
        time.sleep(60)
    if max_steps == RAISE:
        raise JuliaError("UndefVarError: `foo` not defined\nStacktrace:\n [1] deep inside")
    if max_steps == CHATTER:
        print("on standard output")
        os.write(1, b"straight to the descriptor\n")
    x = _runge_kutta(slopes_of(source), x0, t)
    if max_steps == NOT_FINITE:
        x[-1] = np.nan
    if max_steps == WRONG_SHAPE:
        x = x.T
    return x, STEPS * (len(t) - 1), 0, ""


def _regress(
    theta,
    dx,
    optimizer,
    release,
    weights,
    relaxation,
    proximal,
    normalize,
    max_iterations,
    implicit,
):
    _log(f"regress-{'implicit' if implicit else 'explicit'}-{len(weights)}")
    if implicit:
        return np.zeros(2 * len(theta)), -1, False
    coefficients = np.linalg.lstsq(theta.T, dx, rcond=None)[0]
    coefficients[np.abs(coefficients) < weights.min()] = 0.0
    return coefficients, int(max_iterations), bool(normalize)


def _answer_at(t, solution, max_seconds):
    assert len(t) == len(solution.u) and max_seconds > 0
    return solution.u, STEPS, 0, ""


_MODULE = SimpleNamespace(
    integrate=_integrate,
    integrate_driven=_integrate_driven,
    regress=_regress,
    compile=slopes_of,
    answer_at=_answer_at,
    clock=lambda seconds: f"{seconds} s at most",
    first_step_controller=lambda solver: f"growth of ten for {solver}",
    versions=lambda: f"julia 1.10.0-fake\nOrdinaryDiffEqTsit5 process{os.getpid()}",
)


class _Main:
    loaded = ""

    def seval(self, code):
        """Answer the pieces of Julia that the worker evaluates."""
        if code == "path -> Base.include(Main, path)":
            return self.include
        if code.startswith('path -> (found = Base.find_package("DynSR");'):
            package = os.environ.get("FAKE_JULIA_PACKAGE")
            return lambda path: package is not None and os.path.samefile(package, path)
        if code == "import DynSR":
            _log("import")
            self.loaded = os.environ["FAKE_JULIA_PACKAGE"]
            return None
        if code == "Main.DynSR":
            assert self.loaded, "the sources were not included"
            return _MODULE
        if code.startswith("folder -> (push!(LOAD_PATH, dirname(Base.active_project()));"):
            return lambda folder: _log(f"active {folder}")
        if code.startswith("name -> (m = [m for (id, m) in Base.loaded_modules"):
            return lambda name: os.environ.get("FAKE_JULIA_DIFFEQPY", "")
        if code == "Sys.BINDIR":
            return "/opt/julia/bin"
        if code == "x -> Vector{Float64}(x)":
            return lambda x: np.array(x, dtype=float)
        raise JuliaError(f"ParseError: {code}")

    def include(self, path):
        """Take note of the module's file."""
        _log("include")
        with open(path) as file:
            assert "module DynSR" in file.read()
        self.loaded = path


Main = _Main()
