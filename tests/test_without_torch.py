"""What works without torch, what says that it did without, and what asks for it."""

import json
import subprocess
import sys

import pytest

from dynsr.errors import say_install

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

# The tests look at what one such process says.
_LINES = """
import json
from dynsr.errors import MissingExtra
from dynsr.methods.feynman.enumeration.brute_force import BruteForce

found = dynsr.discover(data, targets="x", jobs=1, preset="quick", functions=())
small = DynAIFeynman.preset("quick", candidates=100)
without = dynsr.discover(data, targets="x", jobs=1, method=small)
rng = np.random.default_rng(0)
refused = {}
for name, call in {
    "the network of DynAIFeynman": lambda: DynAIFeynman(stages=("symmetry",)).search(samples, rng),
    "device 'cuda'": lambda: BruteForce(device="cuda").search(samples, rng),
    "a torch module": found.to_torch,
    "a hybrid model": found.hybrid,
}.items():
    try:
        call()
    except MissingExtra as error:
        refused[name] = str(error)
print(json.dumps({
    "equation": str(found.equations["x"]),
    "why": found.explanation["x"],
    "without": without.explanation["x"],
    "refused": refused,
}))
"""


@pytest.fixture(scope="module")
def said() -> dict:
    """Give what a process without torch says."""
    done = subprocess.run(
        [sys.executable, "-c", _BLOCKED + _LINES], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_the_default_methods_run_without_torch(said):
    """A discovery by the default methods needs no torch, and has nothing to say about it."""
    assert said["equation"] == "-0.5*x" and "torch" not in said["why"]


@pytest.mark.slow
def test_a_search_that_did_without_its_network_says_so(said):
    """The explanation names the stages that did not run, and the command that brings them."""
    assert "symmetry, separability, compositionality" in said["without"]
    line = f"did not run: the network of DynAIFeynman needs torch: {say_install('torch')}"
    assert line in said["without"]


@pytest.mark.parametrize(
    "user",
    ["the network of DynAIFeynman", "device 'cuda'", "a torch module", "a hybrid model"],
)
def test_what_needs_torch_gives_one_line_with_the_command(said, user):
    """Asking for what only torch can do ends in one line that says how to install it."""
    assert said["refused"][user] == f"{user} needs torch: {say_install('torch')}"
