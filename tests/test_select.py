import subprocess
import sys

import numpy as np
import pytest

from dynsr.engines.base import InitialValueProblem
from dynsr.engines.embedded import EmbeddedEngine
from dynsr.engines.registry import find_engine
from dynsr.errors import InputError
from dynsr.expression.parsing import parse


def test_the_embedded_engine_integrates():
    """The engine of that name solves an initial value problem with a known solution."""
    engine = find_engine("embedded")
    problem = InitialValueProblem((parse("-x", ["x"]),), ("x",), [1.0], [0.0, 1.0], 1e-9, 1e-9)
    assert abs(engine.integrate(problem).x[-1, 0] - np.exp(-1.0)) < 1e-8


def test_an_engine_is_its_own_choice():
    """What is an engine already is given back, so that users may bring their own."""
    engine = EmbeddedEngine()
    assert find_engine(engine) is engine


def test_an_unknown_engine_is_refused_with_the_names():
    """The message lists the engines there are."""
    with pytest.raises(InputError, match=r"unknown engine 'matlab'.*embedded, julia"):
        find_engine("matlab")


def test_versions_name_every_part():
    """The embedded engine names dynsr, numpy, SymPy and Python."""
    assert {"dynsr", "numpy", "sympy", "python"} <= set(EmbeddedEngine().versions())


@pytest.mark.slow
def test_an_engine_loads_no_more_than_it_needs():
    """A missing Julia is told before NumPy and SymPy load, the slowest part of a start; the
    embedded engine, once chosen, has loaded neither Julia's bridge nor torch nor tables.
    """
    code = (
        "import importlib.util, sys; find = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name: None\n"
        "from dynsr.engines.registry import find_engine\n"
        "try: find_engine('julia')\n"
        "except Exception as problem: print(type(problem).__name__, end=' ')\n"
        "print({'numpy', 'sympy'} & set(sys.modules))\n"
        "importlib.util.find_spec = find; find_engine('embedded')\n"
        "print({'juliacall', 'torch', 'matplotlib', 'pandas'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["EngineUnavailable set()", "set()"]
