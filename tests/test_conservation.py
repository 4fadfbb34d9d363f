"""What rests along exact runs is conserved by the equations that are found."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dynsr
from dynsr.expression import evaluate, parse
from dynsr.selection.conservation import conserve, find_conserved

RATES = {"a": "-0.9*a + 0.3*b", "b": "0.9*a - 0.8*b + 0.2*c", "c": "0.5*b - 0.2*c"}


def isomers():
    """Three isomers that turn into each other, a to b to c and back."""
    matrix = np.array([[-0.9, 0.3, 0.0], [0.9, -0.8, 0.2], [0.0, 0.5, -0.2]])
    t = np.linspace(0, 8, 200)
    start = (2.0, 0.1, 0.0)
    solved = solve_ivp(lambda _, x: matrix @ x, (0, 8), start, "DOP853", t, rtol=1e-11, atol=1e-13)
    return dynsr.Trajectory(t, solved.y.T, ("a", "b", "c"))


def test_what_rests_is_found_with_whole_weights():
    """The sum of the isomers rests, so does twice one state and another; no two that are alike."""
    assert find_conserved([isomers()], ("a", "b", "c")) == [{"a": 1, "b": 1, "c": 1}]
    t = np.linspace(0, 3, 30)
    pairs = dynsr.Trajectory(t, np.stack([np.exp(-t), 3 - 2 * np.exp(-t)], axis=1), ("x", "y"))
    assert find_conserved([pairs], ("x", "y")) == [{"x": 2, "y": 1}]
    alike = dynsr.Trajectory(t, np.stack([np.exp(-t), np.exp(-t)], axis=1), ("x", "y"))
    assert find_conserved([alike], ("x", "y")) == []


def test_a_constant_inflow_is_no_state_of_a_closed_system():
    """0.42 along a run whose sum is 2.1 is 0.2 of that sum, so that the three rates add up to 0."""
    found = conserve({s: parse(e) for s, e in RATES.items()}, [isomers()])
    assert {s: str(e) for s, e in found.items()} == {s: str(parse(e)) for s, e in RATES.items()}
    shorter = {**RATES, "b": "0.7*a - b + 0.42"}
    found = conserve({s: parse(e) for s, e in shorter.items()}, [isomers()])
    rows = {name: np.random.default_rng(i).uniform(0, 3, 20) for i, name in enumerate("abc")}
    for state, true in RATES.items():
        assert np.allclose(evaluate(found[state], rows), evaluate(parse(true), rows))


@pytest.mark.slow
def test_a_law_of_a_closed_system_holds_from_other_starts():
    """From another start, with another sum, the isomers follow what was found."""
    found = dynsr.discover(isomers(), jobs=1)
    rows = {name: np.random.default_rng(i).uniform(0, 3, 20) for i, name in enumerate("abc")}
    for state, true in RATES.items():
        assert np.allclose(evaluate(found.equations[state], rows), evaluate(parse(true), rows))
