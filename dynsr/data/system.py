"""System: an ordinary differential equation that is known, with its start and time spans."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data.catalogue import DEFINITIONS, find_definition
from dynsr.errors import InputError
from dynsr.expression import check_name, parse, to_text

# Of a table that is made: a hundred megabytes as text, some ten times that while it is made.
_MOST_NUMBERS = 5e6


@checked
@dataclass(frozen=True)
class System:
    """A first-order system of k ordinary differential equations, dx/dt = f(x, u(t), t).

    Parameters
    ----------
    name : what to call it.
    states : the k state names, in order.
    rhs : k SymPy expressions in the states, the inputs and ``t``; in state units per second.
    inputs : input name -> SymPy expression in ``t``, such as the force on a cart.
    x0 : (k,) start state.
    train, test : (start, end) of the two time spans in seconds.
    target : the state whose equation is sought when one is; the last state by default.
    step : seconds between samples.
    description : what it is, in a few words.

    Raises InputError when names clash, lengths differ or an expression has an unknown name.

    >>> decay = System.from_strings({"x": "-2*x"}, x0=[1.0])
    >>> decay.rhs
    (-2*x,)
    """

    name: str
    states: tuple[str, ...]
    rhs: tuple[sympy.Expr, ...]
    x0: tuple[float, ...]
    inputs: Mapping[str, sympy.Expr] = field(default_factory=dict)
    train: tuple[float, float] = (0.0, 10.0)
    test: tuple[float, float] = (10.0, 15.0)
    target: str = ""
    step: float = 0.01
    description: str = ""

    def __post_init__(self) -> None:
        """Check the fields against each other."""
        names = [*self.states, *self.inputs]
        for name in self.states:
            check_name(name, "state")
        for name in self.inputs:
            check_name(name, "input")
        duplicates = sorted({n for n in names if names.count(n) > 1 or n == "t"})
        if duplicates:
            raise InputError(
                f"name {duplicates[0]!r} is used twice (t is the time); give each its own name"
            )
        if not self.states:
            raise InputError("a system has no states; give at least one equation")
        if len(self.rhs) != len(self.states):
            raise InputError(
                f"{len(self.states)} states but {len(self.rhs)} equations; give one each"
            )
        if len(self.x0) != len(self.states) or not all(math.isfinite(v) for v in self.x0):
            raise InputError(
                f"x0 {tuple(self.x0)} must be {len(self.states)} finite numbers, one per state"
            )
        for expr in self.rhs:
            parse(expr, [*names, "t"])
        for expr in self.inputs.values():
            parse(expr, ["t"])
        for label, (start, end) in (("train", self.train), ("test", self.test)):
            if not (math.isfinite(start) and math.isfinite(end) and end > start):
                raise InputError(f"{label} span ({start}, {end}) must run forward in time")
        if not (self.step > 0 and math.isfinite(self.step)):
            raise InputError(f"step {self.step} must be a positive number of seconds")
        object.__setattr__(self, "target", self.target or self.states[-1])
        self.index(self.target)

    @classmethod
    def from_strings(
        cls,
        equations: Mapping[str, str],
        *,
        x0: Sequence[float] | None = None,
        inputs: Mapping[str, str] | None = None,
        parameters: Mapping[str, float] | None = None,
        name: str = "user system",
        train: tuple[float, float] = (0.0, 10.0),
        test: tuple[float, float] = (10.0, 15.0),
        step: float = 0.01,
        target: str = "",
        description: str = "",
    ) -> System:
        """Build a system from equations written as text.

        Parameters
        ----------
        equations : state -> right-hand side in states, inputs, parameters and ``t``, in state
            units per second.
        x0 : (k,) start state; ones by default.
        inputs : input name -> expression in ``t`` and parameters.
        parameters : name -> the number that it stands for in the equations.
        name, train, test, step, target, description : as the fields of System.

        Raises InputError when an expression cannot be read, a parameter has the name of a state, an
        input or ``t``, or the fields do not fit each other.

        >>> System.from_strings({"x": "s*(y-x)", "y": "-y"}, parameters={"s": 10.0}).states
        ('x', 'y')
        """
        values: dict[str, float] = {}
        for key, value in (parameters or {}).items():
            if not isinstance(value, numbers.Real) or not math.isfinite(value):
                raise InputError(f"parameter {key!r} is {value!r}; give a finite number")
            if key in (*equations, *(inputs or {}), "t"):
                raise InputError(
                    f"parameter {key!r} is named as a state, an input or the time t; rename it"
                )
            exact = isinstance(value, numbers.Integral)
            values[check_name(key, "parameter")] = int(value) if exact else float(value)
        names = [*equations, *(inputs or {}), *(parameters or {}), "t"]
        for state in equations:
            check_name(state, "state")

        def read(text: str, allowed: Sequence[str]) -> sympy.Expr:
            return parse(text, allowed, values)

        return cls(
            name=name,
            states=tuple(equations),
            rhs=tuple(read(text, names) for text in equations.values()),
            x0=tuple(float(v) for v in (x0 if x0 is not None else [1.0] * len(equations))),
            inputs={k: read(v, ["t", *(parameters or {})]) for k, v in (inputs or {}).items()},
            train=train,
            test=test,
            target=target,
            step=step,
            description=description,
        )

    def index(self, state: str) -> int:
        """Position of a state; raises InputError that lists the states when there is none."""
        if state not in self.states:
            raise InputError(
                f"unknown state {state!r} of {self.name}; the states are: {', '.join(self.states)}"
            )
        return self.states.index(state)

    def with_rhs(self, state: str, expr: sympy.Expr) -> System:
        """Give the same system with ``expr`` as the right-hand side of one state.

        Raises InputError when there is no such state or the expression has an unknown name.
        """
        rhs = list(self.rhs)
        rhs[self.index(state)] = expr
        return System(**{**self.__dict__, "rhs": tuple(rhs)})

    def closed_rhs(self) -> tuple[sympy.Expr, ...]:
        """Right-hand sides in the states and ``t`` alone, the inputs put in."""
        values = {sympy.Symbol(k): v for k, v in self.inputs.items()}
        return tuple(expr.xreplace(values) for expr in self.rhs)

    def times(self, span: tuple[float, float], step: float | None = None) -> np.ndarray:
        """Sample times (n,) over ``span`` in seconds, end included.

        Parameters
        ----------
        span : (start, end) in seconds.
        step : seconds between samples; the system's own by default.

        Raises InputError when these are no two times one after the other and a step that fits
        between them, or make a table of more than five million numbers.
        """
        step = self.step if step is None else step
        length = span[1] - span[0]
        if not (0 <= length < math.inf and 0 < step < math.inf):
            raise InputError(
                f"span {span[0]:g} to {span[1]:g} s and step {step:g} s must be finite, forward in "
                "time and above 0"
            )
        columns = 1 + len(self.states) + len(self.inputs)
        if length / step * columns > _MOST_NUMBERS:
            raise InputError(
                f"step {step:g} over {length:g} s makes {length / step:.3g} rows of {columns} "
                f"columns, more than {_MOST_NUMBERS:g} numbers; take a larger step"
            )
        return span[0] + step * np.arange(math.floor(length / step + 1e-9) + 1)

    def equations(self) -> dict[str, str]:
        """Every state with its right-hand side as text."""
        return {s: to_text(e) for s, e in zip(self.states, self.rhs, strict=True)}


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


@checked
def find_system(name: str) -> System:
    """Give the system of that name; raises InputError that lists the names when there is none.

    >>> find_system("pendulum").states
    ('theta1', 'theta2')
    """
    return SYSTEMS[find_definition(name).name]
