"""The workflow of the public forge, which cannot be run here, at least names what there is."""

import json
import re
from pathlib import Path

import pytest

from dynsr.cli.app import app

yaml = pytest.importorskip("yaml", reason="mkdocs brings PyYAML; pip install pyyaml")
ROOT = Path(__file__).parents[1]
WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
JOBS = WORKFLOW["jobs"]
COMMANDS = [step["run"] for job in JOBS.values() for step in job["steps"] if "run" in step]


def test_every_python_that_is_promised_is_tested_on_three_systems():
    """The matrix, README, home page and set-up name the versions of the package's own metadata."""
    project = (ROOT / "pyproject.toml").read_text()
    promised = re.findall(r'Python :: (3\.\d+)"', project)
    matrix = JOBS["tests"]["strategy"]["matrix"]
    assert matrix["python"] == promised == ["3.11", "3.12", "3.13", "3.14"]
    assert f'requires-python = ">={promised[0]}"' in project
    for page in ("README.md", "docs/index.md", "scripts/environment"):
        assert f"{promised[0]} to {promised[-1]}" in (ROOT / page).read_text(), page
    assert [name.split("-")[0] for name in matrix["os"]] == ["ubuntu", "macos", "windows"]


def test_every_julia_that_is_tested_lies_within_the_bounds():
    """The matrix begins at the oldest one that juliapkg may take, and no newer one is shut out."""
    oldest = json.loads((ROOT / "julia" / "juliapkg.json").read_text())["julia"]
    tested = JOBS["julia"]["strategy"]["matrix"]["julia"]
    assert tested[0] == oldest == "1.10"
    assert all(int(version.removeprefix("1.")) >= 10 for version in tested)
    assert JOBS["julia"]["env"]["DYNSR_REQUIRE_JULIA"] == "1" and "if" not in JOBS["julia"]


def test_the_commands_name_files_and_commands_that_exist():
    """Scripts, tests, the Julia package and dynsr's own commands are there."""
    text = "\n".join(COMMANDS)
    for path in re.findall(r"(?<![\w/])(?:tests|dynsr|julia|scripts|\.ci)/[\w./]+", text):
        assert (ROOT / path).exists(), path
    used = set(re.findall(r"(?<![\w.-])dynsr ([a-z]+)", text))
    assert used <= {command.callback.__name__ for command in app.registered_commands}
    assert {"doctor", "crosscheck", "audit", "replicate"} <= used


def test_it_runs_on_each_push_and_once_a_week():
    """Nothing but what is weekly by itself waits for the schedule; only reading is permitted."""
    # YAML reads the word on as true.
    triggers = WORKFLOW[True]
    assert set(triggers) == {"push", "pull_request", "schedule", "workflow_dispatch"}
    weekly = {name for name, job in JOBS.items() if "== 'schedule'" in job.get("if", "")}
    assert weekly == {"julia-newest", "diffeqpy"}
    assert WORKFLOW["permissions"] == {"contents": "read"}
    assert all(job["timeout-minutes"] <= 120 for job in JOBS.values())
