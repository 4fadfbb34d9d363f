"""Orders: equations of second order as systems of first order; the time as a variable; maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import sympy

from dynsr.data import (
    Samples,
    SlopeSettings,
    Trajectory,
    add_velocities,
    choose_samples,
    choose_second_samples,
    is_still,
)
from dynsr.errors import InputError
from dynsr.expression import check_name, write_line
from dynsr.fit import tidy
from dynsr.verdict import pair_rows

Order = int | Mapping[str, int]


@dataclass(frozen=True)
class Form:
    """What form the equations have, in addition to what all of them have.

    Parameters
    ----------
    velocities : state whose equation is of second order -> name of its velocity. The velocity is a
        state of its own, made from the data: ``x' = x_dot`` is known and ``x_dot' = f`` is sought.
    explicit_time : whether the time ``t`` is a variable that equations may hold.
    discrete : whether they are a map, ``x[n+1] = f(x[n])`` from row to row.

    >>> form = Form({"x": "x_dot"})
    >>> form.searched(["x", "y"])
    ('x_dot', 'y')
    """

    velocities: Mapping[str, str] = field(default_factory=dict)
    explicit_time: bool = False
    discrete: bool = False

    @property
    def known(self) -> dict[str, sympy.Expr]:
        """State -> its velocity."""
        return {state: sympy.Symbol(name) for state, name in self.velocities.items()}

    @property
    def record(self) -> dict[str, Any]:
        """What the record of a discovery says; nothing for first order without the time."""
        return {
            **({"velocities": dict(self.velocities)} if self.velocities else {}),
            **({"explicit_time": True} if self.explicit_time else {}),
            **({"kind": "map"} if self.discrete else {}),
        }

    def prepare(
        self,
        runs: Sequence[Trajectory],
        scheme: str = "auto",
        settings: SlopeSettings | None = None,
    ) -> list[Trajectory]:
        """Give the trajectories with the velocities as more states; those that have them stay.

        Parameters
        ----------
        runs : trajectories of the same columns.
        scheme : how slopes are made.
        settings : what the choice of a scheme rests on.
        """
        if not self.velocities or set(self.velocities.values()) <= set(runs[0].names):
            return list(runs)
        return add_velocities(runs, self.velocities, scheme, settings or SlopeSettings())

    def searched(self, states: Sequence[str]) -> tuple[str, ...]:
        """Give the states whose equations are sought: a velocity in the place of its state."""
        return tuple(self.velocities.get(state, state) for state in states)

    def samples(self, runs: Sequence[Trajectory], state: str, **choices: Any) -> Samples:
        """Make the samples of a state, of a velocity by its own second differences.

        Parameters
        ----------
        runs : what :meth:`prepare` gave.
        state : whose slopes are wanted.
        choices : what :func:`dynsr.data.slopes.choose_samples` takes too.
        """
        if state in self.velocities.values() and choices.get("slopes") is None:
            choices.pop("slopes", None)
            found = choose_second_samples(runs, self.velocities, state, **choices)
        elif self.discrete:
            found = pair_rows(runs, state)
        else:
            found = choose_samples(list(runs), state, **choices)
        return self.with_time(found)

    def with_time(self, found: Samples) -> Samples:
        """Add the time to the columns where equations may contain it.

        Parameters
        ----------
        found : samples of a state.
        """
        if not self.explicit_time:
            return found
        timed = np.column_stack([found.X, found.t])
        return replace(found, X=timed, names=(*found.names, "t"))

    def complete(self, states: Sequence[str]) -> tuple[str, ...]:
        """Give the searched states, before each velocity the state that it is of.

        >>> Form({"x": "x_dot"}).complete(["x_dot", "y"])
        ('x', 'x_dot', 'y')
        """
        owners = {velocity: state for state, velocity in self.velocities.items()}
        pairs = [(owners[s], s) if s in owners else (s,) for s in states]
        return tuple(dict.fromkeys(name for pair in pairs for name in pair))


def read_form(
    order: Order,
    explicit_time: bool,
    discrete: bool,
    runs: Sequence[Trajectory],
    targets: Sequence[str],
    slopes: Mapping[str, Any] | None = None,
) -> Form:
    """Read what form the equations of the targets shall have.

    Parameters
    ----------
    order : 1 or 2 for all targets, or state -> 1 or 2. A state that never changes has order 1: it
        has no velocity to search.
    explicit_time : whether ``t`` is a variable.
    discrete : whether the equations are a map.
    runs : trajectories; their names must not be those of the velocities.
    targets : the states whose equations are sought.
    slopes : the user's own slopes, which go with order 1.

    Raises InputError when an order is neither 1 nor 2, a state is unknown, or the choices do not go
    together.

    >>> swing = Trajectory([0.0, 1.0], [[0.0], [1.0]], ("x",))
    >>> read_form(2, False, False, [swing], ["x"]).velocities
    {'x': 'x_dot'}
    """
    orders = dict(order) if isinstance(order, Mapping) else dict.fromkeys(targets, order)
    for state, number in orders.items():
        runs[0].index(state)
        if isinstance(number, bool) or number not in (1, 2):
            raise InputError(f"order {number!r} of {state!r} must be 1 or 2")
        if state not in targets:
            raise InputError(f"order of {state!r} is given, but it is no target; add it to them")
    if discrete and (slopes or 2 in orders.values()):
        raise InputError("a map goes from row to row and has no slopes; leave order and slopes out")
    if slopes and 2 in orders.values():
        raise InputError("own slopes go with order 1; velocities are made from the data")
    seconds = [s for s in targets if orders.get(s) == 2 and not _is_still(runs, s)]
    return Form({state: _name(state, runs[0]) for state in seconds}, explicit_time, discrete)


def _is_still(runs: Sequence[Trajectory], state: str) -> bool:
    place = runs[0].index(state)
    seen = [run.x[run.measured[:, place], place] for run in runs]
    return all(is_still(own) for own in seen if len(own))


def _name(state: str, run: Trajectory) -> str:
    names = [f"{state}{ending}" for ending in ("_dot", "_velocity", "_rate")]
    free = [name for name in names if name not in run.names]
    if not free:
        raise InputError(f"{names[0]!r} is a column already; rename it, or leave {state!r} order 1")
    return check_name(free[0], "column")


def form_of(settings: Mapping[str, Any]) -> Form:
    """Give the form of the equations of a discovery from its record."""
    velocities = settings.get("velocities", {})
    known = isinstance(velocities, Mapping) and all(isinstance(v, str) for v in velocities.values())
    return Form(
        dict(velocities) if known else {},
        settings.get("explicit_time") is True,
        settings.get("kind") == "map",
    )


def write_lines(equations: Mapping[str, sympy.Expr], settings: Mapping[str, Any]) -> list[str]:
    """Write the equations as a reader has them, one per line: x'' replaces two of first order.

    Parameters
    ----------
    equations : state -> right-hand side.
    settings : the record of the discovery.

    >>> x, v = sympy.symbols("x x_dot")
    >>> write_lines({"x": v, "x_dot": -4 * x - v}, {"velocities": {"x": "x_dot"}})
    ["x'' = -4*x - x'"]
    >>> write_lines({"x": 3 * x}, {"kind": "map"})
    ['x[n+1] = 3*x']
    """
    velocities = form_of(settings).velocities
    owners = {velocity: state for state, velocity in velocities.items()}
    primes = {sympy.Symbol(v): sympy.Symbol(f"{s}'") for v, s in owners.items()}
    delays = settings.get("delays", {})
    if isinstance(delays, Mapping):
        primes |= {sympy.Symbol(str(n)): sympy.Symbol(str(text)) for n, text in delays.items()}
    written = {
        f"{owners[s]}'" if s in owners else s: tidy(e).xreplace(primes)
        for s, e in equations.items()
        if velocities.get(s) not in equations
    }
    return [write_line(s, e, form_of(settings).discrete) for s, e in written.items()]


def explain_velocity(state: str, velocity: str) -> str:
    """Say in words why the equation of a state of second order is its velocity."""
    return f"{state}' = {velocity} names the slope of {state}, whose own equation was sought."
