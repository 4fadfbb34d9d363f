import subprocess
import sys


def test_importing_dynsr_starts_nothing_heavy():
    """``import dynsr`` loads neither torch nor Julia nor matplotlib nor pandas."""
    code = (
        "import dynsr, sys; "
        "print(sorted({'torch', 'juliacall', 'matplotlib', 'pandas'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_discovering_loads_nothing_that_it_does_not_need():
    """Each worker loads what ``discover`` loads: no plots, no tables, no scipy.stats, no torch."""
    code = (
        "import sys, dynsr; dynsr.discover; "
        "print(sorted({'torch', 'matplotlib', 'pandas', 'scipy.stats'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
