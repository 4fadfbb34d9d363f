"""Every code block of the documentation is run as a test.

Python blocks of a page share one namespace; where a text block follows, they must print what it
holds, numbers to a hundredth. Of `console` blocks, the lines that begin with `dynsr` are run; where
a text block follows, what the last one prints begins with it. A page works in an empty folder of
its own.
"""

from __future__ import annotations

import gc
import io
import os
import re
import shlex
import signal
import tempfile
from contextlib import redirect_stdout
from importlib.util import find_spec
from pathlib import Path

import pytest
from sybil import Example, Sybil
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.markdown import CodeBlockParser, SkipParser

from dynsr.jobs import let_garbage_wait

# No test starts workers unless it asks for them: they change no result and take long to start.
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")

_ROOT = Path(__file__).parent
# Folders and pages of the documentation that search.
_SEARCHING = {
    "gallery",
    "coming-from",
    "README.md",
    "asked.md",
    "index.md",
    "measuring.md",
    "tutorial.md",
    "your-data.md",
}

# A shell starts background jobs with Ctrl-C ignored; the tests of it and their children would wait.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# As in a command.
let_garbage_wait()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark pages slow that search: blocks of a page build on each other."""
    for item in items:
        if item.path.suffix == ".md" and {item.path.parent.name, item.path.name} & _SEARCHING:
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish() -> None:
    """Keep what all tests share out of every later look for garbage, a tenth of the suite."""
    gc.freeze()


_NUMBER = re.compile(r"(?<![\w.])\d+\.?\d*(?:e[+-]?\d+)?")
_SHOWN = re.compile(r"(?:```)?\n\n```text\n(.*?)```\n", re.DOTALL)


def _compare(said: str, shown: str) -> None:
    """Hold two texts to be the same but for the last digits of their numbers."""
    assert _NUMBER.sub("0", said) == _NUMBER.sub("0", shown)
    numbers = [[float(n) for n in _NUMBER.findall(text)] for text in (said, shown)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.01), f"{said}\n{shown}"


class _PythonParser(CodeBlockParser):
    language = "python"

    def evaluate(self, example: Example) -> None:
        said = io.StringIO()
        with redirect_stdout(said):
            PythonEvaluator()(example)
        shown = _SHOWN.match(example.document.text, example.region.end)
        if shown:
            _compare(said.getvalue().strip(), shown[1].strip())


class _ConsoleParser(CodeBlockParser):
    language = "console"

    def evaluate(self, example: Example) -> None:
        from typer.testing import CliRunner

        from dynsr.cli.app import app

        said: list[str] = []
        for line in example.parsed.splitlines():
            if line.startswith("dynsr "):
                done = CliRunner().invoke(app, shlex.split(line, comments=True)[1:])
                assert done.exit_code == 0, f"{line}\n{done.output}"
                said = done.stdout.splitlines()
        shown = _SHOWN.match(example.document.text, example.region.end)
        if shown:
            lines = shown[1].strip().splitlines()
            _compare("\n".join(said[: len(lines)]), "\n".join(lines))


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
    parsers=[_PythonParser(), _ConsoleParser(), SkipParser()],
    patterns=["*.md"],
    excludes=["CHANGELOG.md", "CONTRIBUTING.md"],
    setup=_enter,
    teardown=_leave,
).pytest()
