"""Windows of a chaotic flow: one that passes a saddle does not decide on all others."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynsr.data import Trajectory
from dynsr.expression import parse
from dynsr.verdict.flow_verdict import give_verdict

LAW = {"x": "10*(y - x)", "y": "28*x - y - x*z", "z": "x*y - 8*z/3"}


@pytest.fixture(scope="module")
def runs():
    """Give two stretches of Lorenz' flow with 1 % noise, of which the first passes the origin."""
    t, rng, found = np.arange(200) * 0.02, np.random.default_rng(4), []
    for start in ([-10.42370071, -4.12891646, 35.58403892], [-8.0, 7.0, 27.0]):
        x = solve_ivp(
            lambda _, s: [
                10 * (s[1] - s[0]),
                28 * s[0] - s[1] - s[0] * s[2],
                s[0] * s[1] - 8 * s[2] / 3,
            ],
            (0, 4),
            start,
            "DOP853",
            t,
            rtol=1e-10,
            atol=1e-10,
        ).y.T
        noise = 0.01 * np.array([7.9, 9.0, 8.6]) * rng.normal(size=x.shape)
        found.append(Trajectory(t, x + noise, ("x", "y", "z")))
    return found


@pytest.mark.slow
def test_a_law_is_one_though_a_window_leaves_a_saddle_on_the_wrong_side(runs):
    """There the start that noise leaves leads to the mirror image: shorter windows are followed."""
    found = give_verdict({s: parse(e) for s, e in LAW.items()}, runs)
    assert found.level == "law"


@pytest.mark.slow
@pytest.mark.parametrize(("state", "wrong"), [("y", "27.4*x - x*z"), ("z", "x*y - 2.8*z")])
def test_a_wrong_equation_is_no_law_in_shorter_windows(runs, state, wrong):
    """Constants 5 % off, or a term too few, are seen in any window."""
    own = {s: parse(e) for s, e in (LAW | {state: wrong}).items()}
    assert give_verdict(own, runs).level != "law"
