"""Known systems as text, for whoever only reads them.

The first three are the paper's (section 4.1 and appendix A.1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dynsr.errors import InputError


@dataclass(frozen=True)
class Definition:
    """A known system as text: what :meth:`dynsr.data.system.System.from_strings` takes."""

    name: str
    description: str
    equations: Mapping[str, str]
    x0: tuple[float, ...]
    inputs: Mapping[str, str] = field(default_factory=dict)
    train: tuple[float, float] = (0.0, 10.0)
    test: tuple[float, float] = (10.0, 15.0)
    step: float = 0.01


_LOTKA_VOLTERRA = Definition(
    equations={"x": "x*(1.5 - y)", "y": "-y*(3 - x)"},
    x0=(1.0, 1.0),
    name="lotka-volterra",
    description="prey x and predators y",
)

_PENDULUM = Definition(
    equations={"theta1": "theta2", "theta2": "-0.1*theta2 - 9.81*sin(theta1)"},
    # 0.4 pi as Julia computes it: 0.4 * float(pi)
    x0=(0.4 * 3.141592653589793, 1.0),
    name="pendulum",
    description="damped pendulum: angle theta1 in rad, angular velocity theta2 in rad/s",
)

# The printed equations have other signs, and an angular acceleration where the velocity is
# meant; these are the ones that reproduce the paper's numbers.
_CART_POLE = Definition(
    equations={
        "w": "y",
        "x": "z",
        "y": "-(19.62*sin(w) + sin(w)*cos(w)*y^2 + F*cos(w)) / (2 - cos(w)^2)",
        "z": "-(sin(w)*y^2 + 9.81*sin(w)*cos(w) + F) / (2 - cos(w)^2)",
    },
    x0=(0.3, 0.0, 1.0, 0.0),
    inputs={"F": "-0.2 + 0.5*sin(6*t)"},
    name="cart-pole",
    description="pole angle w in rad, cart position x in m, their velocities y and z, force F in N",
)

_LORENZ = Definition(
    equations={"x": "10*(y - x)", "y": "x*(28 - z) - y", "z": "x*y - 8/3*z"},
    x0=(-8.0, 8.0, 27.0),
    name="lorenz",
    description="Lorenz's convection model (1963), chaotic",
)
_ROSSLER = Definition(
    equations={"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 5.7)"},
    x0=(1.0, 1.0, 0.0),
    train=(0.0, 50.0),
    test=(50.0, 75.0),
    step=0.02,
    name="rossler",
    description="Roessler's attractor (1976), chaotic",
)
_VAN_DER_POL = Definition(
    equations={"x": "y", "y": "2*(1 - x^2)*y - x"},
    x0=(1.0, 0.0),
    name="van-der-pol",
    description="Van der Pol's oscillator (1926)",
)
_DUFFING = Definition(
    equations={"x": "y", "y": "x - x^3 - 0.2*y + F"},
    x0=(1.0, 0.0),
    inputs={"F": "0.3*cos(t)"},
    train=(0.0, 30.0),
    test=(30.0, 45.0),
    step=0.02,
    name="duffing",
    description="Duffing's oscillator with a known periodic force F",
)
_MICHAELIS_MENTEN = Definition(
    equations={"x": "0.6 - 1.5*x/(0.3 + x)"},
    x0=(0.9,),
    train=(0.0, 8.0),
    test=(8.0, 12.0),
    name="michaelis-menten",
    description="enzyme kinetics with a constant inflow",
)
_SIR = Definition(
    equations={"s": "-0.4*s*i", "i": "0.4*s*i - 0.1*i"},
    x0=(0.99, 0.01),
    train=(0.0, 60.0),
    test=(60.0, 90.0),
    step=0.1,
    name="sir",
    description="epidemic: susceptible s and infected i as shares",
)

DEFINITIONS = {
    definition.name: definition
    for definition in (
        _LOTKA_VOLTERRA,
        _PENDULUM,
        _CART_POLE,
        _LORENZ,
        _ROSSLER,
        _VAN_DER_POL,
        _DUFFING,
        _MICHAELIS_MENTEN,
        _SIR,
    )
}


def find_definition(name: str) -> Definition:
    """Give the system of that name; raises InputError that lists the names when there is none.

    >>> find_definition("lorenz").equations["x"]
    '10*(y - x)'
    """
    if name not in DEFINITIONS:
        raise InputError(f"unknown system {name!r}; the systems are: {', '.join(DEFINITIONS)}")
    return DEFINITIONS[name]
