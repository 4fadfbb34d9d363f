import numpy as np
import pytest

from dynsr.data.system import CART_POLE, SYSTEMS, System, find_system
from dynsr.errors import InputError
from dynsr.expression.evaluation import compile_numpy
from dynsr.expression.parsing import parse


def test_a_system_is_read_from_strings_with_parameters():
    """Parameters stand for numbers, and the last state is the target by default."""
    system = System.from_strings({"x": "s*(y - x)", "y": "-y"}, parameters={"s": 10})
    assert system.rhs[0].expand() == parse("10*y - 10*x")
    assert system.target == "y"


@pytest.mark.parametrize(
    ("equations", "settings"),
    [
        ({}, {}),
        ({"x": "z"}, {}),
        ({"sin": "1"}, {}),
        ({"t": "1"}, {}),
        ({"x": "x"}, {"x0": [1.0, 2.0]}),
        ({"x": "x"}, {"x0": [float("nan")]}),
        ({"x": "x"}, {"train": (1.0, 0.0)}),
        ({"x": "x"}, {"step": 0.0}),
        ({"x": "x"}, {"target": "y"}),
        ({"x": "x"}, {"inputs": {"x": "t"}}),
        ({"x": "x + u"}, {"inputs": {"u": "x"}}),
        ({"x": "-x"}, {"parameters": {"x": 3.0}}),
        ({"x": "-t*x"}, {"parameters": {"t": 3.0}}),
        ({"x": "u - x"}, {"inputs": {"u": "t"}, "parameters": {"u": 3.0}}),
    ],
)
def test_a_system_that_does_not_hold_together_is_refused(equations: dict, settings: dict):
    """Names, lengths and spans are checked against each other at once."""
    with pytest.raises(InputError):
        System.from_strings(equations, **settings)


def test_the_cart_pole_obeys_its_mechanics():
    """Both accelerations solve the two Lagrange equations of a cart with a hanging pendulum."""
    rng = np.random.default_rng(0)
    w, x, y, z, t = rng.uniform(-1, 1, size=(5, 30))
    force = -0.2 + 0.5 * np.sin(6 * t)
    values = compile_numpy(CART_POLE.closed_rhs(), [*CART_POLE.states, "t"])(
        np.array([w, x, y, z, t])
    )
    angular, linear = values[2], values[3]
    # With theta'' and s'' from the Lagrangian of masses 1 and 1, length 1: the mirrored cart -x.
    np.testing.assert_allclose(angular - linear * np.cos(w) + 9.81 * np.sin(w), 0, atol=1e-12)
    np.testing.assert_allclose(
        2 * linear - angular * np.cos(w) + y**2 * np.sin(w) + force, 0, atol=1e-12
    )


def test_sample_times_end_with_the_span():
    """Ten seconds at 0.01 s are 1001 times, the last of them 10."""
    times = CART_POLE.times(CART_POLE.train)
    assert len(times) == 1001 and times[-1] == pytest.approx(10.0)


def test_unknown_names_list_what_there_is():
    """An unknown system or state is answered with the names that exist."""
    with pytest.raises(InputError, match="pendulum"):
        find_system("pendulumm")
    with pytest.raises(InputError, match="theta1, theta2"):
        SYSTEMS["pendulum"].index("theta3")


def test_a_parameter_is_a_number_and_never_text():
    """Text in a parameter's place is refused by name, and none of it is run."""
    for value in ("__import__('os').getcwd()", "1", float("nan"), None):
        with pytest.raises(InputError, match=r"parameter .k. is .*; give a finite number"):
            System.from_strings({"x": "k*x"}, parameters={"k": value})
