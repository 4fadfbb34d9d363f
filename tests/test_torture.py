"""Four discoveries are killed or interrupted at random moments; scripts/torture does hundreds."""

import importlib.util
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "scripts" / "torture.py"
SEARCH = (
    "--preset",
    "quick",
    "--method",
    "rational,sindy",
    "--functions",
    "none",
    "--targets",
    "x",
)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc to look at processes")
def test_four_discoveries_that_are_ended_end_in_the_same_result(tmp_path):
    """Whatever ends the command or a worker: same result but for times, and nothing left over."""
    spec = importlib.util.spec_from_file_location("torture", SCRIPT)
    assert spec is not None and spec.loader is not None
    script = sys.modules["torture"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    counts = {"parent": 1, "worker": 1, "interrupt": 1, "terminate": 1}
    with script.warmed() as warm:
        tally = script.torture(counts, 1, script.Work(tmp_path, SEARCH, 1, warm))
    assert tally.trials == counts
    assert tally.faults == []
    assert sum(tally.hits.values()) > 2
