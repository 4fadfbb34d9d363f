"""Random systems: mechanisms of textbooks put together by chance, as many as are asked for.

A list of systems that is fixed is known to whoever improves a method on it. What is drawn from a
seed that nobody has looked at yet is not.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count, islice
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.integrate import LSODA

from dynsr.benchmarks.zoo.system import DRAWN, ZooSystem
from dynsr.errors import InputError
from dynsr.expression import compile_columns, parse

# Each [low, high] is a constant between them; x is the state itself, y another one.
_GROWTH = (
    "[.2,2]*x*(1 - x/[2,6])",
    "[.2,2]*x",
    "[.3,1]*x*log([2,6]/x)",
    "[.3,1]*x*(x - [.2,.6])*(1 - x/[2,4])",
    "[.2,2] - [.2,.8]*x",
)
_LOSSES = ("[.2,.9]*x", "[.2,.9]*x", "[.4,1.5]*x/([.3,1] + x)", "([.1,.6]*x + [.05,.3]*x^2)")
_RESPONSES = (
    "x",
    "x/([.4,2] + x)",
    "x^2/([.4,2] + x^2)",
    "x^3/([.4,2] + x^3)",
    "(1 - exp(-[.4,2]*x))",
    "x/([.4,2] + x + [.2,1]*y)",
)
_REGULATIONS = (
    "[.8,3]/(1 + x)",
    "[.8,3]/([.4,2] + x^2)",
    "[.8,3]/(1 + x^4)",
    "[.8,3]*x/([.4,2] + x)",
    "[.8,3]*x^2/([.4,2] + x^2)",
    "[.8,3]*x^3/(1 + x^3)",
)
_FLOWS = (
    "[.2,2]*x - [.2,2]*x^3 + [.05,.4]",
    "[.2,2] - [.2,2]*x - [.05,.4]*x*abs(x)",
    "[.2,2] - [.2,2]*sin(x) - [.1,.5]*x",
    "tanh([1.2,2.5]*x) - [.2,2]*x + [.05,.3]",
    "[.2,2]*cos(x) - [.2,2]*sin(x)",
)
_TANKS = ("[.3,1] - [.3,1]*sqrt(x)", "[.2,2]*exp(-x) - [.1,.5]*x", "[.2,2]*x^(2/3) - [.2,.6]*x")
_REACTIONS = (
    "[.2,2]*x",
    "[.2,2]*x*y",
    "[.2,2]*x*y",
    "[.2,2]*x^2",
    "[.2,2]*x/([.3,1.2] + x)",
    "[.2,2]*x*y^2",
)
# What no term of the searches' library is, whatever its constants.
_BEYOND = (
    "[.2,1]*exp(-[.5,2]*x^2)",
    "-[.3,1.2]*atan([1,3]*x)*y^2/(1 + y^2)",
    "-[.2,.8]*log(1 + exp([2,5]*(x - [.5,1.5])))",
    "[.2,.8]*sin([.5,1.5]*x^2)",
    "[.2,.8]*cos([.5,2]*x*y)",
    "-[.3,1]*x/(1 + [.3,1]*x^2)^0.75",
    "[.2,1]*tanh([.5,2]*(x^2 - [.5,1.5]))",
    "-[.3,1]*sqrt([.5,2] + x^4)",
)
_INFECTIONS = ("s*i", "s*i", "s*i/(1 + [.3,2]*i)", "s*i/(s + i)")
_FORCES = (
    "-[.2,2]*x",
    "-[.2,2]*x - [.1,.8]*x^3",
    "[.2,2]*x - [.2,2]*x^3",
    "-[1,6]*sin(x)",
    "-[.2,2]*x + [.1,.5]*x^2",
    "-[1,6]*sin(x) + [.3,1]*cos(x)",
)
_DAMPING = (
    "",
    "-[.05,.4]*y",
    "-[.05,.3]*y*abs(y)",
    "+[.3,1]*(1 - x^2)*y",
    "-[.1,.4]*y - [.05,.3]*y^3",
)
_FEEDBACKS = (
    "-[.2,.8]*w - [.2,.8]*v",
    "[.3,1] - [.2,.8]*w - [.2,.8]*x",
    "-[.2,.8]*w - [.2,.8]*x*v",
)
_PRODUCTS = ("[.2,1.5]", "[.2,1.5]*x", "[.2,1.5]*y", "[.2,1.5]*x*y", "[.2,1.5]*x^2", "[.2,1.5]*y^2")
# Seconds that a system may be watched, the size it may come to, and the rows it is looked at.
_SPANS, _FAR, _ROWS = (8.0, 12.0, 16.0, 24.0), 30.0, 200
# By what share of its size a state must move, and of its range still in the last two thirds.
_MOVES, _STILL_MOVES = 0.03, 0.02
# Systems tried in vain, one after another, that show a fault.
_PATIENCE = 1000


@dataclass(frozen=True)
class _Draw:
    """Draws templates and fills their constants in."""

    rng: np.random.Generator

    def write(self, templates: tuple[str, ...], x: str, y: str = "") -> str:
        """Draw a template and write it with constants, of two states."""
        template = templates[int(self.rng.integers(len(templates)))]
        text = re.sub(r"\[([\d.]+),([\d.]+)\]", self._constant, template)
        return re.sub(r"\b[xy]\b", lambda own: x if own[0] == "x" else y, text)

    def _constant(self, ends: re.Match[str]) -> str:
        """Draw a constant of two digits, as often below as above the middle of its logarithm."""
        low, high = float(ends[1]), float(ends[2])
        return f"{np.exp(self.rng.uniform(np.log(low), np.log(high))):.2g}"

    def constant(self, low: float, high: float) -> str:
        """Draw a constant."""
        return self.write((f"[{low},{high}]",), "")

    def happens(self, share: float) -> bool:
        """Draw whether something with this probability is so."""
        return bool(self.rng.random() < share)

    def one_of(self, names: str) -> str:
        """Draw a letter."""
        return names[int(self.rng.integers(len(names)))]


def _growth(draw: _Draw, _: int) -> dict[str, str]:
    kind = draw.rng.integers(4)
    if kind == 0:
        return {"x": f"{draw.write(_GROWTH, 'x')} - {draw.write(_LOSSES, 'x')}"}
    if kind == 1:
        eaten = draw.write(_RESPONSES, "x", "x")
        return {"x": f"{draw.write(_GROWTH, 'x')} - {draw.constant(0.3, 1.5)}*{eaten}"}
    if kind == 2:
        made = draw.write(_REGULATIONS, "x")
        return {"x": f"{draw.constant(0.05, 0.4)} + {made} - {draw.write(_LOSSES, 'x')}"}
    return {"x": draw.write(_TANKS, "x")}


def _flow(draw: _Draw, _: int) -> dict[str, str]:
    return {"x": draw.write(_FLOWS, "x")}


def _ecology(draw: _Draw, states: int) -> dict[str, str]:
    """A prey n and a predator p; a second predator q eats either."""
    eaten = draw.write(_RESPONSES, "n", "p")
    found = {
        "n": f"{draw.write(_GROWTH, 'n')} - {draw.constant(0.3, 1.2)}*p*{eaten}",
        "p": f"{draw.constant(0.3, 0.9)}*p*{eaten} - {draw.write(_LOSSES, 'p')}",
    }
    if states == 3:
        prey = draw.one_of("np")
        eaten = draw.write(_RESPONSES, prey, "q")
        found[prey] += f" - {draw.constant(0.3, 1)}*q*{eaten}"
        found["q"] = f"{draw.constant(0.3, 0.8)}*q*{eaten} - {draw.constant(0.1, 0.4)}*q"
    return found


def _genes(draw: _Draw, states: int) -> dict[str, str]:
    """Each is made as the one before it says, in a ring, and is lost."""
    names = "abcd"[:states]
    found = {}
    for place, own in enumerate(names):
        before, after = names[place - 1], names[(place + 1) % states]
        made = draw.write((*_REGULATIONS, "[.4,1.5]*x"), before)
        if draw.happens(0.25):
            made = f"{draw.constant(0.05, 0.3)} + {made}"
        if draw.happens(0.25):
            made += f" + {draw.constant(0.1, 0.4)}*{after}"
        found[own] = f"{made} - {draw.write(_LOSSES, own)}"
    return found


def _reactions(draw: _Draw, states: int) -> dict[str, str]:
    """What a reaction takes from one state it gives to another; some states flow in and out."""
    names = "abcd"[:states]
    found = dict.fromkeys(names, "")
    for _ in range(states + int(draw.rng.integers(2))):
        own = draw.one_of(names)
        others = names.replace(own, "")
        rate = draw.write(_REACTIONS, own, draw.one_of(others))
        found[own] += f" - {rate}"
        found[draw.one_of(others)] += f" + {rate}"
    for own in names:
        if not found[own] or draw.happens(0.4):
            found[own] += f" + {draw.constant(0.1, 0.8)} - {draw.constant(0.1, 0.6)}*{own}"
    return found


def _epidemics(draw: _Draw, states: int) -> dict[str, str]:
    """Shares of a population: susceptible, infected, then removed, then exposed."""
    infected = f"{draw.constant(0.5, 2)}*{draw.write(_INFECTIONS, '')}"
    heal = draw.constant(0.1, 0.5)
    found = {"s": f"-{infected}", "i": f"{infected} - {heal}*i"}
    if states == 4:
        wait = draw.constant(0.3, 1)
        found |= {"e": f"{infected} - {wait}*e", "i": f"{wait}*e - {heal}*i"}
    if states >= 3:
        back = draw.constant(0.05, 0.3)
        found |= {"s": f"{found['s']} + {back}*r", "r": f"{heal}*i - {back}*r"}
    elif draw.happens(0.5):
        turn = draw.constant(0.03, 0.2)
        found = {"s": f"{found['s']} + {turn} - {turn}*s", "i": f"{found['i']} - {turn}*i"}
    return found


def _mechanics(draw: _Draw, states: int) -> dict[str, str]:
    """A mass, its feedback (3 states), or two masses on a spring (4)."""
    force = f"{draw.write(_FORCES, 'x')} {draw.write(_DAMPING, 'x', 'v')}"
    found = {"x": "v", "v": force}
    if states < 4 and draw.happens(0.3):
        found["v"] += f" + {draw.constant(0.1, 0.5)}"
    if states == 3:
        found["v"] += f" + {draw.constant(0.3, 1)}*w"
        found["w"] = draw.write(_FEEDBACKS, "x")
    if states == 4:
        pull = f"{draw.constant(0.2, 1)}*(y - x)"
        other = f"{draw.write(_FORCES, 'y')} {draw.write(_DAMPING, 'y', 'w')}"
        found |= {"v": f"{force} + {pull}", "y": "w", "w": f"{other} - {pull}"}
    return found


def _polynomials(draw: _Draw, states: int) -> dict[str, str]:
    """Each decays, with one or two products of any states."""
    names = "xyz"[:states]
    found = {}
    for own in names:
        text = f"-{draw.constant(0.1, 1)}*{own}"
        for _ in range(1 + int(draw.rng.integers(2))):
            product = draw.write(_PRODUCTS, draw.one_of(names), draw.one_of(names))
            text += f" {draw.one_of('+-')} {product}"
        if draw.happens(0.4):
            text += f" - {draw.constant(0.1, 1)}*{own}^3"
        found[own] = text
    return found


_POSITIVE, _EITHER = (0.2, 3.0), (-1.5, 1.5)
_SHARES = {"s": (0.6, 1.0), "i": (0.01, 0.2), "r": (0.0, 0.2), "e": (0.0, 0.1)}


@dataclass(frozen=True)
class _Field:
    """A field: what writes its systems, of how many states, and where a state starts.

    Parameters
    ----------
    write : gives the equations of so many states.
    sizes : numbers of states, each as often as it is listed here.
    starts : between what a state starts, by its name or for all; below 0 it never falls where it
        starts above.
    """

    write: Callable[[_Draw, int], dict[str, str]]
    sizes: tuple[int, ...]
    starts: Mapping[str, tuple[float, float]] | tuple[float, float]

    def between(self, state: str) -> tuple[float, float]:
        """Between what a state starts."""
        return self.starts if isinstance(self.starts, tuple) else self.starts[state]


_FIELDS = {
    "growth": _Field(_growth, (1,), _POSITIVE),
    "flows": _Field(_flow, (1,), _EITHER),
    "ecology": _Field(_ecology, (2, 2, 3), _POSITIVE),
    "genes": _Field(_genes, (2, 2, 3, 4), _POSITIVE),
    "reactions": _Field(_reactions, (2, 3, 3, 4), _POSITIVE),
    "epidemics": _Field(_epidemics, (2, 3, 4), _SHARES),
    "mechanics": _Field(_mechanics, (2, 2, 2, 3, 4), _EITHER),
    "polynomials": _Field(_polynomials, (2, 2, 3), _EITHER),
}


def draw_systems(number: int, seed: int = 0, *, beyond: bool = False) -> list[ZooSystem]:
    """Draw systems that stay bounded and keep moving from both of their starts.

    Parameters
    ----------
    number : how many; those of a smaller number are the first of a larger one.
    seed : all chance comes from it.
    beyond : whether one equation of each contains a mechanism that is no sum of library terms,
        so that a law cannot be found.

    Raises InputError for a number below 1.

    >>> first, second = draw_systems(2, seed=7)
    >>> draw_systems(1, seed=7) == [first]
    True
    """
    if number < 1:
        raise InputError(f"number {number} of random systems must be at least 1")
    return list(islice(_draw_all(seed, beyond), number))


def _draw_all(seed: int, beyond: bool) -> Iterator[ZooSystem]:
    """Draw system after system; each depends on the seed and its own place alone."""
    last = 0
    for place in count(1):
        found = _draw_one(seed, place, beyond)
        if found is not None:
            last = place
            yield found
        # So many in vain are no chance.
        assert place - last < _PATIENCE


def _draw_one(seed: int, place: int, beyond: bool) -> ZooSystem | None:
    """Draw a system; None for one that runs away, comes to rest, or leaves its field."""
    draw = _Draw(np.random.default_rng([seed, place]))
    kind = list(_FIELDS)[draw.rng.integers(len(_FIELDS))]
    field = _FIELDS[kind]
    equations = field.write(draw, int(draw.rng.choice(field.sizes)))
    if beyond:
        # In mechanics the slope of a place is its speed.
        moved = [state for state, text in equations.items() if text not in equations]
        own = moved[int(draw.rng.integers(len(moved)))]
        equations[own] += f" + {draw.write(_BEYOND, own, draw.one_of(''.join(equations)))}"
    span = float(draw.rng.choice(_SPANS))
    ends = np.array([field.between(state) for state in equations])
    starts = [draw.rng.uniform(*ends.T).round(2) for _ in range(2)]
    program = compile_columns([parse(text) for text in equations.values()], list(equations))
    positive = ends[:, 0] >= 0
    if not all(_keeps_moving(program, start, span, positive) for start in starts):
        return None
    source = f"drawn from seed {seed}"
    first, second = (tuple(start.tolist()) for start in starts)
    name = f"{kind}-{'beyond-' * beyond}{seed}-{place}"
    return ZooSystem(name, kind, source, equations, (first, second), span, DRAWN)


def _keeps_moving(
    program: Callable[..., np.ndarray], start: np.ndarray, span: float, positive: np.ndarray
) -> bool:
    """Whether all states stay where they may be, move, and still move in the end."""

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        return program(*x)

    solver = LSODA(slope, 0.0, start, span, rtol=1e-8, atol=1e-10)
    times = np.linspace(0.0, span, _ROWS)
    pieces = [start[:, None]]
    while solver.status == "running":
        with catch_warnings():
            # It warns of equations that it gives up; these are not kept.
            simplefilter("ignore", UserWarning)
            solver.step()
        if solver.status == "failed" or not np.max(np.abs(solver.y)) < _FAR:
            return False
        own = times[(times > solver.t_old) & (times <= solver.t)]
        pieces.append(solver.dense_output()(own))
    rows = np.hstack(pieces)
    if not np.all(np.isfinite(rows)) or np.any(rows[positive] < -1e-9):
        return False
    size, late = np.abs(rows).max(axis=1), rows[:, _ROWS // 3 :]
    moves = rows.std(axis=1) > _MOVES * np.maximum(size, 1.0)
    rest = np.abs(late - late[:, -1:]).max(axis=1)
    return bool(np.all(moves & (rest > _STILL_MOVES * np.ptp(rows, axis=1))))
