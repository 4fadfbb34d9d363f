"""The paper's SINDy settings, as data: candidate functions and optimizers of section A.3.

The functions are in the paper's order and the names in the catalogue's; F is the cart's known
force, -0.2 + 0.5 sin(6 t). The printed table names optimizer and iteration cap alone. The numbers
beside them, lambda = 0.01 and nu = 1, lambda = 0.1 and rho = 2, are the ones with which the
release of 2021 gives the printed coefficients.
"""

from __future__ import annotations

from dynsr.engines.base import Optimizer

BASES: dict[str, tuple[str, ...]] = {
    "pendulum": (
        "theta1",
        "theta2",
        "sin(theta1)",
        "cos(theta2)",
        "cos(theta1)",
        "sin(theta2)",
        "cos(theta1)*sin(theta2)",
        "1",
    ),
    "lotka-volterra": (
        "x",
        "y",
        "x*y",
        "sin(x)",
        "sin(y)",
        "cos(x)",
        "cos(y)",
        "1",
        "1.5*x - x*y",
    ),
    "cart-pole": (
        "1",
        "w",
        "x",
        "y",
        "z",
        "y^2",
        "z^2",
        "y^3",
        "z^3",
        "y^4",
        "z^4",
        "sin(w)",
        "cos(w)",
        "sin(w)*y",
        "sin(w)*z",
        "sin(w)*y^2",
        "sin(w)*z^2",
        "cos(w)^2",
        "cos(w)*sin(w)",
        "cos(w)*sin(w)*y",
        "cos(w)*sin(w)*z",
        "cos(w)*sin(w)*y^2",
        "cos(w)*sin(w)*z^2",
        "F",
        "cos(w)*F",
        "sin(w)*F",
        "-(cos(w)*F + 19.62*sin(w) + cos(w)*sin(w)*y^2) / (2 - cos(w)^2)",
    ),
}

# System -> (optimizer, its settings, iteration cap).
OPTIMIZERS: dict[str, tuple[Optimizer, dict[str, float], int]] = {
    "pendulum": ("SR3", {"lambda": 0.01, "nu": 1.0}, 5000),
    "lotka-volterra": ("ADMM", {"lambda": 0.1, "rho": 2.0}, 10_000),
    "cart-pole": ("SR3", {"lambda": 0.01, "nu": 1.0}, 5000),
}

# Seconds between saved states. The slope's own step is 0.01 s for all three.
STATE_STEPS = {"pendulum": 0.01, "lotka-volterra": 0.01, "cart-pole": 0.001}
SLOPE_STEP = 0.01
END = 10.0
