import subprocess
import sys

import pytest


@pytest.mark.slow
def test_nothing_heavy_is_loaded_before_it_is_needed():
    """``import dynsr`` loads neither torch nor Julia nor matplotlib nor pandas; ``discover``, which
    every worker loads, needs no plots, no tables, no scipy.stats and no torch. What is written for
    torch needs none either: each report has it.
    """
    code = (
        "import dynsr, sys\n"
        "heavy = {'torch', 'juliacall', 'matplotlib', 'pandas', 'scipy.stats'}\n"
        "print(sorted(heavy & set(sys.modules))); dynsr.discover\n"
        "print(sorted(heavy & set(sys.modules)), 'dynsr.discovery.search' in sys.modules)\n"
        "x = dynsr.parse('x'); found = dynsr.Discovery({'x': -2 * x}, {'x': ()}, {}, {})\n"
        "print('torch.nn.Module' in found.export('torch'), sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "[] True", "True []"]
