"""Every code block of the documentation is run as a test.

Python blocks of a page share one namespace; of `console` blocks, the lines that begin with `dynsr`
are run. A page works in an empty folder of its own.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from sybil import Example, Sybil
from sybil.parsers.markdown import CodeBlockParser, PythonCodeBlockParser, SkipParser

_ROOT = Path(__file__).parent

# A shell starts background jobs with Ctrl-C ignored; the tests of it and their children would wait.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


class _ConsoleParser(CodeBlockParser):
    language = "console"

    def evaluate(self, example: Example) -> None:
        environment = {**os.environ, "PYTHONPATH": str(_ROOT), "NO_COLOR": "1"}
        for line in example.parsed.splitlines():
            if line.startswith("dynsr "):
                command = [sys.executable, "-m", "dynsr", *shlex.split(line, comments=True)[1:]]
                done = subprocess.run(command, capture_output=True, text=True, env=environment)
                assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"


def _enter(namespace: dict) -> None:
    namespace["find_spec"] = find_spec
    namespace["_folder"] = tempfile.TemporaryDirectory()
    namespace["_before"] = os.getcwd()
    os.chdir(namespace["_folder"].name)


def _leave(namespace: dict) -> None:
    os.chdir(namespace["_before"])
    namespace["find_spec"] = find_spec
    namespace["_folder"].cleanup()


pytest_collect_file = Sybil(
    parsers=[PythonCodeBlockParser(), _ConsoleParser(), SkipParser()],
    patterns=["*.md"],
    excludes=["CHANGELOG.md", "CONTRIBUTING.md"],
    setup=_enter,
    teardown=_leave,
).pytest()
