"""Answers do not contradict themselves: what is said of an equation is true of that equation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dynsr
from dynsr.expression import shown
from dynsr.fit import tidy

QUICK = {"preset": "quick", "jobs": 1, "progress": False}


def solve(rhs, start, times, noise=0.0, seed=0):
    """Give the states of a system at times, with noise in shares of their spread."""
    spans = (times[0], times[-1])
    x = solve_ivp(rhs, spans, start, t_eval=times, rtol=1e-10, atol=1e-12).y.T
    return x + noise * x.std(axis=0) * np.random.default_rng(seed).normal(size=x.shape)


@pytest.mark.slow
def test_the_source_and_the_bits_are_those_of_the_answer():
    """In noise what slopes preferred is given up: neither its source nor its bits are told."""
    t = np.linspace(0, 20, 60)
    x = solve(lambda _, s: [s[1], -0.2 * s[1] - 0.5 * s[0] ** 3], [1.0, 0.5], t, 0.03)
    found = dynsr.discover({"t": t, "x": x[:, 0], "v": x[:, 1]}, **QUICK)
    assert str(found.equations["x"]) == "v" and len(found.equations["v"].args) == 2
    assert found.explanation["x"].endswith("Found by trying every column and a constant alone.")
    assert "every column" not in found.explanation["v"]
    for state, expr in found.equations.items():
        assert found.details[state].startswith(f"{state}' = {shown(tidy(expr))} takes ")
