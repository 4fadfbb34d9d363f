import subprocess
import sys

import pytest

from dynsr.errors import InputError
from dynsr.methods.registry import METHODS, make_method


def test_the_names_give_the_methods_with_their_presets():
    """Each preset of the GA and SINDy has the settings that the paper's tables print."""
    assert METHODS == ("dynaifeynman", "ga", "sindy")
    assert make_method("ga", "paper", "cart-pole").bits == 60
    assert make_method("ga", "best").scaled
    sindy = make_method("sindy", "paper", "lotka-volterra")
    assert (sindy.optimizer, sindy.max_iterations) == ("ADMM", 10000)
    assert make_method("sindy", "quick", "pendulum") == make_method("sindy", "paper", "pendulum")


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("eureqa",), "unknown method 'eureqa'; the methods are: dynaifeynman, ga, sindy"),
        (("ga", "worst"), "unknown preset 'worst'; the presets are: paper, best, quick"),
        (("sindy", "paper", "lorenz"), "no paper settings for 'lorenz'"),
    ],
)
def test_unknown_names_are_refused(arguments, message):
    """One line names what is unknown and what there is."""
    with pytest.raises(InputError, match=message):
        make_method(*arguments)


def test_a_choice_loads_only_what_it_chose():
    """To make a GA loads neither torch nor SINDy."""
    code = (
        "import sys; from dynsr.methods.registry import make_method; make_method('ga');"
        "sys.exit('torch' in sys.modules or 'dynsr.methods.sindy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
