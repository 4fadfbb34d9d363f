#!/usr/bin/env python3
"""The paper's three data sets as a user of SciML makes them: by diffeqpy, with nothing of dynsr.

Writes lotka-volterra.csv, pendulum.csv and cart-pole.csv, 1002 rows 0.01 s apart, which
`dynsr discover` reads. Needs `pip install diffeqpy`, which sets up Julia where there is none.
"""

import argparse
from collections.abc import MutableSequence
from math import cos, sin
from pathlib import Path

import numpy as np
from diffeqpy import de

State = MutableSequence[float]


def lotka_volterra(du: State, u: State, p: object, t: float) -> None:
    """Hares x and lynxes y."""
    x, y = u
    du[0] = x * (1.5 - y)
    du[1] = -y * (3.0 - x)


def pendulum(du: State, u: State, p: object, t: float) -> None:
    """An angle and its velocity, with friction."""
    theta1, theta2 = u
    du[0] = theta2
    du[1] = -0.1 * theta2 - 9.81 * sin(theta1)


def force(t: float) -> float:
    """The force on the cart."""
    return -0.2 + 0.5 * sin(6.0 * t)


def cart_pole(du: State, u: State, p: object, t: float) -> None:
    """The pole's angle w, the cart's position x, and the velocities of both."""
    w, _, y, z = u
    s, c, f = sin(w), cos(w), force(t)
    du[0] = y
    du[1] = z
    du[2] = -(19.62 * s + s * c * y**2 + f * c) / (2.0 - c**2)
    du[3] = -(s * y**2 + 9.81 * s * c + f) / (2.0 - c**2)


SYSTEMS = {
    "lotka-volterra": (lotka_volterra, "x,y", [1.0, 1.0]),
    "pendulum": (pendulum, "theta1,theta2", [0.4 * np.pi, 1.0]),
    "cart-pole": (cart_pole, "w,x,y,z", [0.3, 0.0, 1.0, 0.0]),
}


def main() -> None:
    """Solve each system over (0, 10.01) and write its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("sciml-data"))
    parser.add_argument("--reltol", type=float, default=1e-3)
    parser.add_argument("--abstol", type=float, default=1e-6)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name, (slopes, states, start) in SYSTEMS.items():
        problem = de.ODEProblem(slopes, start, (0.0, 10.01))
        tolerances = {"reltol": options.reltol, "abstol": options.abstol}
        solution = de.solve(problem, de.Tsit5(), saveat=0.01, **tolerances)
        t = np.array(list(solution.t))
        columns = [t, *np.array([list(u) for u in solution.u]).T]
        header = f"t,{states}"
        if name == "cart-pole":
            columns.append(np.array([force(now) for now in t]))
            header += ",F"
        path = options.out / f"{name}.csv"
        table = np.column_stack(columns)
        np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
        print(f"{path}: {len(t)} rows")


if __name__ == "__main__":
    main()
