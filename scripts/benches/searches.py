"""How often the true equations are found where a state is hidden, or acts after a delay.

    scripts/bench searches --draws 3 --cases prey "pipe, held input" --noise 0,0.01

A draw counts as found where the equations have the true terms and no others. With a hidden state
these are the terms of what the data determine, in which it does not appear. A wrong law is another
system with the verdict "law". Exact data are drawn once. All searches are quick ones.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import sympy
from covered import LATE, Late, noisy, solve
from joblib import Parallel, delayed

from dynsr.data import Trajectory
from dynsr.discovery import Discovery, discover
from dynsr.discovery.unmeasured import coupling_of
from dynsr.errors import InputError
from dynsr.expression import parse, skeleton
from dynsr.fit import with_floats
from dynsr.selection import law_of

# Whether a system is the true one, whether its verdict is "law", and the seconds.
Outcome = tuple[bool, bool, float]


@dataclass(frozen=True)
class Hidden:
    """A system of which one state is not measured, and the term by which it enters."""

    law: dict[str, str]
    start: tuple[float, ...]
    end: float
    name: str
    term: str

    def run(self, noise: float, seed: int) -> Trajectory:
        """Give 200 noisy rows of the other states."""
        t, x = solve(tuple(self.law.items()), self.start, self.end, 200)
        seen = [place for place, state in enumerate(self.law) if state != self.name]
        states = tuple(state for state in self.law if state != self.name)
        return Trajectory(t, noisy(x[:, seen], noise, seed), states)

    def is_found(self, found: Discovery) -> bool:
        """Whether what the data determine has the true terms and no others."""
        if self.name not in found.equations:
            return False
        own = _terms(found.equations, self.name, found.hidden[self.name])
        truth = {state: parse(text) for state, text in self.law.items()}
        return own is not None and own == _terms(truth, self.name, parse(self.term))

    @property
    def asked(self) -> dict[str, Any]:
        """What is asked of the search."""
        return {"hidden": self.name}


def _terms(
    exprs: Mapping[str, sympy.Expr], name: str, term: sympy.Expr
) -> dict[str, set[sympy.Expr]] | None:
    """Give the terms, without their factors, of what the data determine of each state."""
    law = law_of(exprs, coupling_of(name, term, exprs))
    if law is None:
        return None
    parts = {s: sympy.Add.make_args(sympy.expand(e)) for s, e in law.items()}
    return {s: {skeleton(t.as_coeff_Mul()[1]) for t in own} for s, own in parts.items()}


def _is_found_late(system: Late, found: Discovery) -> bool:
    """Whether an equation with a delay has the true terms and no others."""
    (state,) = (s for s in found.equations if s in ("x", "y"))
    # The start of a fit has a number where the law has none, such as in exp(-x).
    return bool(skeleton(with_floats(found.equations[state])) == skeleton(parse(system.start)))


HIDDEN = {
    "oscillator": Hidden({"x": "v", "v": "-4*x"}, (1.0, 0.5), 12.0, "v", "v"),
    "oscillator with friction": Hidden({"x": "v", "v": "-4*x - 0.3*v"}, (1.0, 0.5), 12.0, "v", "v"),
    "pendulum with friction": Hidden(
        {"x": "v", "v": "-2*sin(x) - 0.3*v"}, (2.0, 0.0), 12.0, "v", "v"
    ),
    "prey": Hidden(
        {"x": "1.1*x - 0.4*x*y", "y": "0.1*x*y - 0.4*y"}, (10.0, 5.0), 30.0, "y", "-0.4*x*y"
    ),
    "first of two compartments": Hidden(
        {"x": "-1.1*x + 0.3*y", "y": "0.5*x - 0.3*y"}, (10.0, 0.0), 10.0, "y", "0.3*y"
    ),
    "infected of an epidemic": Hidden(
        {"I": "0.6*S*I - 0.2*I", "S": "-0.6*S*I"}, (0.01, 1.5), 40.0, "S", "0.6*S*I"
    ),
    "ends of a chain of three": Hidden(
        {"a": "-0.5*a", "b": "0.5*a - 0.3*b", "c": "0.3*b - 0.1*c"},
        (10.0, 0.0, 0.0),
        20.0,
        "b",
        "0.3*b",
    ),
    "substrate and product of an enzyme": Hidden(
        {"S": "-1.1*S*(0.8 - C) + 0.3*C", "C": "1.1*S*(0.8 - C) - 0.8*C", "P": "0.5*C"},
        (3.0, 0.0, 0.0),
        15.0,
        "C",
        "0.5*C",
    ),
}


def search(
    run: Trajectory, asked: Mapping[str, Any], is_found: Callable[[Discovery], bool]
) -> Outcome:
    """Search once."""
    began = time.process_time()
    try:
        found = discover(run, preset="quick", jobs=1, progress=False, **asked)
        right, level = is_found(found), found.verdict.level
    except InputError:
        right, level = False, ""
    return right, level == "law", time.process_time() - began


def main() -> None:
    """Print a row for each case and size of the noise."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--cases", nargs="+", choices=[*HIDDEN, *LATE], default=[*HIDDEN, *LATE])
    parser.add_argument("--noise", default="0,0.01,0.05", help="shares of the spread, by commas")
    parser.add_argument("--jobs", type=int, default=-1, help="searches at a time")
    asked = parser.parse_args()
    print("| case | noise | true terms | of these a law | wrong law | s |")
    print("| :--- | ---: | ---: | ---: | ---: | ---: |")
    for name in asked.cases:
        case = HIDDEN.get(name) or LATE[name]
        hidden = isinstance(case, Hidden)
        options = case.asked if hidden else {"delays": 1.03 * case.delay}
        check = case.is_found if hidden else partial(_is_found_late, case)
        for noise in map(float, asked.noise.split(",")):
            draws = asked.draws if noise else 1
            each = Parallel(asked.jobs)(
                delayed(search)(case.run(noise, seed), options, check) for seed in range(draws)
            )
            right, law = (np.array(own) for own in list(zip(*each, strict=True))[:2])
            seconds = np.mean([own[2] for own in each])
            print(
                f"| {name} | {noise:.0%} | {right.sum()} of {draws} | {(right & law).sum()} "
                f"| {(~right & law).sum()} | {seconds:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
