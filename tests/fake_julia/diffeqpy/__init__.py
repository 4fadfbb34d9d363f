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
        assert isinstance(span, tuple)
        if slopes.__code__.co_argcount == 2:
            # What was compiled from a text gets an array of Julia's own.
            assert isinstance(x0, np.ndarray)
            return slopes, x0, span

        def of_python(t, u):
            du = [0.0] * len(u)
            slopes(du, u, None, t)
            return du

        return of_python, np.array(x0), span

    def Tsit5(self):  # noqa: N802 (Julia's name)
        """Name the solver."""
        return "Tsit5"

    def solve(self, problem, solver, saveat, reltol, abstol, **options):
        """Solve it."""
        slopes, x0, (start, end) = problem
        assert solver == "Tsit5" and reltol > 0 and abstol > 0
        if np.ndim(saveat):
            assert options["controller"] == "growth of ten for Tsit5"
            assert options["callback"].endswith(" s at most") and options["maxiters"] > 0
        else:
            saveat = start + saveat * np.arange(round((end - start) / saveat) + 1)
        return SimpleNamespace(t=saveat, u=_runge_kutta(slopes, x0, saveat))


de = _DifferentialEquations()
