"""Trainable: found equations as a torch module whose constants are parameters.

One of the few files that name torch; nothing imports it before it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping

import sympy
import torch

from dynsr.exports import arguments_of
from dynsr.expression import to_text
from dynsr.methods.constants import free_constants


class EquationModule(torch.nn.Module):
    """dx/dt of a system: ``module(t, state, **inputs)`` with state (..., k) gives (..., k).

    Every float is a parameter (float64, trainable); whole numbers and fractions are structure.
    """

    def __init__(self, equations: Mapping[str, sympy.Expr]) -> None:
        """Compile the equations; their floats become ``constants``."""
        super().__init__()
        self.states = tuple(equations)
        self.inputs = arguments_of(equations)
        symbols: list[sympy.Symbol] = []
        values: list[float] = []
        self._templates = []
        for state, expr in equations.items():
            template, found = free_constants(expr, f"constant_{state}_")
            symbols += found
            values += found.values()
            self._templates.append(template)
        self._symbols = symbols
        self.constants = torch.nn.Parameter(torch.tensor(values, dtype=torch.float64))
        names = [sympy.Symbol(n) for n in (*self.states, "t", *self.inputs)]
        functions = [{"sign": torch.sign, "Abs": torch.abs}, "torch"]
        self._function = sympy.lambdify([*names, *symbols], self._templates, functions, cse=True)

    def forward(
        self, t: torch.Tensor | float, state: torch.Tensor, **inputs: torch.Tensor
    ) -> torch.Tensor:
        """Give dx/dt."""
        columns = list(state.unbind(-1))
        missing = [name for name in self.inputs if name not in inputs]
        if missing:
            raise TypeError(f"input {missing[0]!r} is missing")
        given = [inputs[name] for name in self.inputs]
        found = self._function(*columns, t, *given, *self.constants)
        rows = [torch.as_tensor(f, dtype=state.dtype).expand_as(columns[0]) for f in found]
        return torch.stack(rows, dim=-1)

    def equations(self) -> dict[str, str]:
        """Every state with its right-hand side, the present constants put in."""
        values = [sympy.Float(v) for v in self.constants.tolist()]
        put = dict(zip(self._symbols, values, strict=True))
        return {
            s: to_text(e.xreplace(put)) for s, e in zip(self.states, self._templates, strict=True)
        }
