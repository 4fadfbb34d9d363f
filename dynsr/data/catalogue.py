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


DEFINITIONS = {
    definition.name: definition
    for definition in (
        Definition(
            "lotka-volterra",
            "prey x and predators y",
            {"x": "x*(1.5 - y)", "y": "-y*(3 - x)"},
            x0=(1.0, 1.0),
        ),
        Definition(
            "pendulum",
            "damped pendulum: angle theta1 in rad, angular velocity theta2 in rad/s",
            {"theta1": "theta2", "theta2": "-0.1*theta2 - 9.81*sin(theta1)"},
            # 0.4 pi as Julia computes it: 0.4 * float(pi)
            x0=(0.4 * 3.141592653589793, 1.0),
        ),
        # The printed equations have other signs, and an angular acceleration where the velocity is
        # meant; these are the ones that reproduce the paper's numbers.
        Definition(
            "cart-pole",
            "pole angle w in rad, cart position x in m, their velocities y and z, force F in N",
            {
                "w": "y",
                "x": "z",
                "y": "-(19.62*sin(w) + sin(w)*cos(w)*y^2 + F*cos(w)) / (2 - cos(w)^2)",
                "z": "-(sin(w)*y^2 + 9.81*sin(w)*cos(w) + F) / (2 - cos(w)^2)",
            },
            x0=(0.3, 0.0, 1.0, 0.0),
            inputs={"F": "-0.2 + 0.5*sin(6*t)"},
        ),
        Definition(
            "lorenz",
            "Lorenz's convection model (1963), chaotic",
            {"x": "10*(y - x)", "y": "x*(28 - z) - y", "z": "x*y - 8/3*z"},
            x0=(-8.0, 8.0, 27.0),
        ),
        Definition(
            "rossler",
            "Roessler's attractor (1976), chaotic",
            {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 5.7)"},
            (1.0, 1.0, 0.0),
            train=(0.0, 50.0),
            test=(50.0, 75.0),
            step=0.02,
        ),
        Definition(
            "van-der-pol",
            "Van der Pol's oscillator (1926)",
            {"x": "y", "y": "2*(1 - x^2)*y - x"},
            x0=(1.0, 0.0),
        ),
        Definition(
            "duffing",
            "Duffing's oscillator with a known periodic force F",
            {"x": "y", "y": "x - x^3 - 0.2*y + F"},
            (1.0, 0.0),
            {"F": "0.3*cos(t)"},
            (0.0, 30.0),
            (30.0, 45.0),
            0.02,
        ),
        Definition(
            "michaelis-menten",
            "enzyme kinetics with a constant inflow",
            {"x": "0.6 - 1.5*x/(0.3 + x)"},
            x0=(0.9,),
            train=(0.0, 8.0),
            test=(8.0, 12.0),
        ),
        Definition(
            "sir",
            "epidemic: susceptible s and infected i as shares",
            {"s": "-0.4*s*i", "i": "0.4*s*i - 0.1*i"},
            (0.99, 0.01),
            train=(0.0, 60.0),
            test=(60.0, 90.0),
            step=0.1,
        ),
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
