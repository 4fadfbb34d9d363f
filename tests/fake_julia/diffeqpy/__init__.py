"""A stand-in for diffeqpy over that for juliacall: one solver, by small Runge-Kutta steps."""

import os
from types import SimpleNamespace

import numpy as np
from juliacall import _runge_kutta

# The true one installs a Julia when it finds none.
assert os.environ["PATH"].startswith("/opt/julia/bin"), "no program named julia would be found"


class _DifferentialEquations:
    def ODEProblem(self, slopes, x0, span):  # noqa: N802 (Julia's name)
        """Pose a problem."""
        assert isinstance(x0, np.ndarray) and isinstance(span, tuple)
        return slopes, x0

    def Tsit5(self):  # noqa: N802 (Julia's name)
        """Name the solver."""
        return "Tsit5"

    def solve(self, problem, solver, controller, saveat, reltol, abstol, maxiters):
        """Solve it."""
        assert controller == "growth of ten for Tsit5"
        assert solver == "Tsit5" and reltol > 0 and abstol > 0 and maxiters > 0
        slopes, x0 = problem
        return SimpleNamespace(u=_runge_kutta(slopes, x0, saveat))


de = _DifferentialEquations()
