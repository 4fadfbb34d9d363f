"""What works without torch, what says that it did without, and what asks for it."""

import subprocess
import sys

import pytest

# A finder that refuses torch, as if it were not installed; then the lines of one test.
_BLOCKED = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
import numpy as np
import dynsr
from dynsr.data import Samples
from dynsr.methods.feynman.search import DynAIFeynman

t = np.linspace(0, 4, 200)
data = dynsr.Trajectory(t, np.column_stack([np.exp(-0.5 * t), t + 1]), ("x", "z"))
X = np.random.default_rng(0).uniform(1, 2, (60, 2))
samples = Samples(X, X[:, 0] + np.sin(X[:, 1]), ("a", "b"), "a", "given", np.arange(60.0))
"""


def _run(lines: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", _BLOCKED + lines], capture_output=True, text=True, timeout=300
    )


def test_the_default_methods_run_without_torch():
    """A discovery by the default methods needs no torch, and has nothing to say about it."""
    done = _run("""
found = dynsr.discover(data, targets="x", jobs=1, preset="quick")
print(found.equations["x"], "|", found.explanation["x"])
""")
    assert done.returncode == 0, done.stderr
    equation, _, why = done.stdout.partition("|")
    assert equation.strip() == "-0.5*x" and "torch" not in why


def test_a_search_that_did_without_its_network_says_so():
    """The explanation names the stages that did not run, and the command that brings them."""
    done = _run("""
method = DynAIFeynman.preset("quick", candidates=2000)
found = dynsr.discover(data, targets="x", jobs=1, method=method)
print(found.explanation["x"])
""")
    assert done.returncode == 0, done.stderr
    assert "symmetry, separability, compositionality" in done.stdout
    assert 'did not run: the network of DynAIFeynman needs torch: pip install "dynsr[torch]"' in (
        done.stdout
    )


@pytest.mark.parametrize(
    ("lines", "user"),
    [
        (
            "DynAIFeynman(stages=('symmetry',)).search(samples, np.random.default_rng(0))",
            "the network of DynAIFeynman",
        ),
        (
            "from dynsr.methods.feynman.enumeration.brute_force import BruteForce\n"
            "BruteForce(device='cuda').search(samples, np.random.default_rng(0))",
            "device 'cuda'",
        ),
        ("dynsr.discover(data, targets='x', jobs=1, preset='quick').to_torch()", "a torch module"),
        ("dynsr.discover(data, targets='x', jobs=1, preset='quick').hybrid()", "a hybrid model"),
    ],
)
def test_what_needs_torch_gives_one_line_with_the_command(lines, user):
    """Asking for what only torch can do ends in one line that says how to install it."""
    done = _run(lines)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1
    assert last == f'dynsr.errors.MissingExtra: {user} needs torch: pip install "dynsr[torch]"'
