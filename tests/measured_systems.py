"""Systems measured in noise, as the tests of whole systems need them."""

from functools import lru_cache

import numpy as np
import sympy
from scipy.integrate import solve_ivp

from dynsr.data import Trajectory
from dynsr.expression import parse
from dynsr.fit import Measurements, with_floats


@lru_cache
def measured(system, start, end, rows, share, seed=0):
    """Measurements of a system, each column off by a share of its spread."""
    equations = dict(system)
    names = [*equations, "t"]
    slope = sympy.lambdify(sympy.symbols(names), [parse(e) for e in equations.values()])
    t = np.linspace(0, end, rows)
    x = solve_ivp(lambda s, z: slope(*z, s), (0, end), start, t_eval=t, rtol=1e-9, atol=1e-9).y.T
    noisy = x + share * x.std(axis=0) * np.random.default_rng(seed).normal(size=x.shape)
    return Measurements.of([Trajectory(t, noisy, tuple(equations))], {}, 2000)


def run(rhs, start, end, rows, names, rtol=1e-10, every_row=False):
    """Integrate closely, with a step for every row if asked."""
    t = np.linspace(0, end, rows)
    tight = {"rtol": rtol, "atol": 1e-12, "max_step": t[1] if every_row else np.inf}
    solved = solve_ivp(lambda _, x: rhs(*x), (0, end), start, "DOP853", t, **tight)
    return Trajectory(t, solved.y.T, names)


def floats(equations):
    """Give {state: formula with free constants}."""
    return {state: with_floats(parse(text)) for state, text in equations.items()}
