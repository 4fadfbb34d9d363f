"""Known systems, as values. The first three are the paper's (section 4.1 and appendix A.1)."""

from __future__ import annotations

from dynsr.definitions import DEFINITIONS, find_definition
from dynsr.system import System

SYSTEMS: dict[str, System] = {
    name: System.from_strings(
        known.equations,
        x0=known.x0,
        inputs=known.inputs,
        name=name,
        train=known.train,
        test=known.test,
        step=known.step,
        description=known.description,
    )
    for name, known in DEFINITIONS.items()
}

LOTKA_VOLTERRA = SYSTEMS["lotka-volterra"]
PENDULUM = SYSTEMS["pendulum"]
CART_POLE = SYSTEMS["cart-pole"]
LORENZ = SYSTEMS["lorenz"]
ROSSLER = SYSTEMS["rossler"]
VAN_DER_POL = SYSTEMS["van-der-pol"]
DUFFING = SYSTEMS["duffing"]
MICHAELIS_MENTEN = SYSTEMS["michaelis-menten"]
SIR = SYSTEMS["sir"]

PAPER_SYSTEMS = (LOTKA_VOLTERRA, PENDULUM, CART_POLE)


def find_system(name: str) -> System:
    """Give the system of that name; raises InputError that lists the names when there is none.

    >>> find_system("pendulum").states
    ('theta1', 'theta2')
    """
    return SYSTEMS[find_definition(name).name]
