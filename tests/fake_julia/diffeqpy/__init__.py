"""A stand-in for diffeqpy over that for juliacall: one solver, by small Runge-Kutta steps."""

from types import SimpleNamespace

import numpy as np
from juliacall import STEPS, _runge_kutta, slopes_of


def _slopes(code):
    head, body = code.split(" -> begin ")
    lines = [line.strip() for line in body.removesuffix("; end").split("; ")]
    return slopes_of("\n".join([f"{head} -> begin", *(f"    {x}" for x in lines), "end"]))


_FUNCTIONS = {
    "x -> Vector{Float64}(x)": lambda x: np.array(x, dtype=float),
    "s -> reduce(hcat, s.u)": lambda s: s.u,
    "s -> string(s.retcode)": lambda s: "Success",
    "s -> s.stats.naccept": lambda s: STEPS,
    "s -> s.stats.nreject": lambda s: 0,
}


class _DifferentialEquations:
    def seval(self, code):
        """Answer the pieces of Julia that the worker evaluates."""
        return _FUNCTIONS[code] if code in _FUNCTIONS else _slopes(code)

    def ODEProblem(self, slopes, x0, span):  # noqa: N802 (Julia's name)
        """Pose a problem."""
        assert isinstance(x0, np.ndarray) and isinstance(span, tuple)
        return slopes, x0

    def Tsit5(self):  # noqa: N802 (Julia's name)
        """Name the solver."""
        return "Tsit5"

    def solve(self, problem, solver, saveat, reltol, abstol, maxiters):
        """Solve it; as in Julia, a column is a time."""
        assert solver == "Tsit5" and reltol > 0 and abstol > 0 and maxiters > 0
        slopes, x0 = problem
        return SimpleNamespace(u=_runge_kutta(slopes, x0, saveat).T)


de = _DifferentialEquations()
