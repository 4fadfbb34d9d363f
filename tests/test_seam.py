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
