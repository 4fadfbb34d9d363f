"""Systems that every format is written of and read from, and slopes to compare with."""

import numpy as np

from dynsr.data.system import SYSTEMS, System
from dynsr.discovery.result import Discovery
from dynsr.expression.export import to_numpy

# Beside the known systems: every function of the table, and names that languages keep.
ODD = {
    "functions": System.from_strings(
        {
            "x": "sin(x)+cos(y)-tan(x/3)+0.3*asin(y/9)+acos(x/9)*atan(y)+sqrt(x^2)-pi*sign(y-x)",
            "y": "sinh(x/5)+cosh(y/5)-tanh(x)+exp(-y)*log(2+x^2)+abs(x-y)^1.5+x^0.7/(0.4+y^2)-t/7",
        },
        x0=[1.2, 0.7],
    ),
    "names": System.from_strings(
        {
            "end": "-2.5*end + state*k1",
            "state": "0.3*double - state",
            "double": "p*end - slope^2*double",
            "p": "-i*p",
            "i": "E - i*T",
            "E": "-0.1*E*e",
            "e": "-e",
            "T": "-T",
            "slope": "c-slope",
            "c": "-c/4",
            "K1": "-K1/5",
            "k1": "-k1/5",
        }
    ),
}
KNOWN = {**SYSTEMS, **ODD}
POINTS = 3
NAMES = list(KNOWN)


def points(name):
    """Give times and states at which the right-hand sides are compared."""
    rng = np.random.default_rng(7)
    k = len(KNOWN[name].states)
    return rng.uniform(0.1, 3, POINTS), rng.uniform(0.3, 1.7, (POINTS, k))


def slopes(name):
    """Give the slopes (points, k) as dynsr computes them."""
    system = KNOWN[name]
    equations = dict(zip(system.states, system.closed_rhs(), strict=True))
    rhs = to_numpy(equations)
    return np.array([rhs(t, state) for t, state in zip(*points(name), strict=True)])


def made(equations, **settings):
    """Give a discovery of equations that nobody judged, without data."""
    return Discovery(dict(equations), {}, {}, {}, settings=settings)
