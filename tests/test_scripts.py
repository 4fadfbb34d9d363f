import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SCRIPTS = ("table1", "table2", "figure1", "appendix_ga", "appendix_dynaifeynman", "appendix_sindy")


def run(script, *arguments):
    """Run a script of the repository."""
    return subprocess.run(
        [sys.executable, ROOT / "scripts" / f"{script}.py", *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"},
    )


@pytest.mark.parametrize("name", SCRIPTS)
def test_each_script_is_small_and_says_what_it_makes(name):
    """A script is a few lines over the API and names its table or figure first."""
    text = (ROOT / "scripts" / f"{name}.py").read_text()
    assert len(text.splitlines()) <= 25
    assert os.access(ROOT / "scripts" / f"{name}.py", os.X_OK)
    assert text.splitlines()[1].startswith(('"""Table', '"""Figure'))


@pytest.mark.slow
def test_the_appendix_of_the_ga_is_made_and_continued(tmp_path):
    """--quick gives three tables of two runs each; the next call takes them from the records."""
    first = run("appendix_ga", "--quick", "--out", tmp_path)
    assert first.returncode == 0, first.stderr
    assert first.stdout.count("GA-Baseline on") == 3
    table = (tmp_path / "tables" / "appendix_ga_pendulum.csv").read_text().splitlines()
    assert len(table) == 3 and table[0].startswith("Run,Formula,Stage,As printed")
    cells = {p: p.stat().st_mtime_ns for p in tmp_path.glob("cells/*.json")}
    assert len(cells) == 6 and run("appendix_ga", "--quick", "--out", tmp_path).returncode == 0
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("cells/*.json")} == cells
    refused = run("appendix_ga", "--out", tmp_path)
    assert refused.returncode == 2 and "quick True" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_table_2_is_printed_and_written(tmp_path):
    """The script of Table 2 needs no search."""
    done = run("table2", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "bitstring length" in done.stdout
    assert "| iterations | 100 | 40 | 100 |" in (tmp_path / "tables" / "table2.md").read_text()
