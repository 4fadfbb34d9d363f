"""Other systems: what Windows lacks is asked for before it is used."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from dynsr.discovery import Discovery

ROOT = Path(__file__).parents[1]

# What signal and os have on Linux and not on Windows; libraries are loaded before it goes.
_WITHOUT = """
import os, signal, sys
import joblib, numpy, scipy.interpolate, scipy.optimize, sympy, threadpoolctl
for module, names in (
    (signal, "SIGALRM SIGKILL SIGHUP SIGQUIT SIGPIPE SIG_BLOCK SIG_SETMASK SIG_UNBLOCK setitimer "
             "getitimer ITIMER_REAL alarm pthread_sigmask sigwait siginterrupt pause"),
    (os, "fork forkpty killpg getpgid setsid geteuid getuid getgid uname getloadavg "
         "sched_getaffinity mkfifo statvfs"),
):
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
for name in ("fcntl", "resource", "termios", "pwd", "grp"):
    sys.modules[name] = None
sys.path.insert(0, ROOT)
"""


def run_without(code: str) -> str:
    """Run code in a Python that lacks what Windows lacks."""
    setup = _WITHOUT.replace("ROOT", repr(str(ROOT)))
    command = [sys.executable, "-c", setup + code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_discovery_needs_nothing_that_windows_lacks(tmp_path: Path) -> None:
    """Without alarms, forks and masks of signals the program reads a file with Windows' ends of
    lines, keeps to a budget, fills a folder, writes a report and answers in JSON.
    """
    path, out = tmp_path / "decay.csv", tmp_path / "a folder"
    rows = "\r\n".join(f"{k / 20},{2.0 ** (-k / 20)!r}" for k in range(80))
    path.write_bytes(f"t,x\r\n{rows}\r\n".encode())
    words = ["discover", str(path), "--jobs", "1", "--json", "--quiet"]
    words += ["--time-budget", "600", "--out", str(out)]
    code = f"""
import json, sys
sys.argv = ["dynsr", *{words!r}]
import runpy
runpy.run_module("dynsr", run_name="__main__")
"""
    equations = json.loads(run_without(code))["equations"]
    assert equations["x"].startswith("-0.6931")
    assert Discovery.load(out / "discovery.json").as_record()["equations"] == equations
    assert (out / "report.html").stat().st_size > 10_000
