import time

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.samples import Samples, make_samples
from dynsr.data.system import CART_POLE, MICHAELIS_MENTEN, System
from dynsr.data.trajectory import Trajectory
from dynsr.expression.evaluation import compile_numpy
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate
from dynsr.methods.rational import RationalSearch


def _integrate(system: System) -> Trajectory:
    rhs = compile_numpy(system.closed_rhs(), [*system.states, "t"])
    t = system.times(system.train)
    x = solve_ivp(
        lambda time, x: rhs(np.append(x, time)),
        (t[0], t[-1]),
        system.x0,
        "DOP853",
        t,
        rtol=1e-11,
        atol=1e-11,
    ).y.T
    inputs = compile_numpy(list(system.inputs.values()), ["t"])(t[None]).T
    return Trajectory(t, x, system.states, inputs, tuple(system.inputs))


def _find(samples: Samples, **settings: object) -> list[Candidate]:
    return [c for found in RationalSearch(**settings).find(samples) for c in found]


def _same(expr: sympy.Expr, law: sympy.Expr, tolerance: float = 1e-3) -> bool:
    """Whether both are one function on a fresh sample of the variables."""
    names = sorted(str(s) for s in law.free_symbols | expr.free_symbols)
    points = np.random.default_rng(9).uniform(0.2, 1.0, size=(len(names), 50))
    a, b = compile_numpy([expr, law], names)(points)
    return bool(np.all(np.abs(a - b) <= tolerance * (1 + np.abs(b))))


@pytest.mark.slow
def test_a_ratio_is_found_from_a_trajectory():
    """Michaelis-Menten kinetics are recovered as a ratio, with their constants."""
    samples = make_samples(_integrate(MICHAELIS_MENTEN), "x", "central6")
    found = _find(samples, costs=(2,))
    assert any(_same(c.expr, MICHAELIS_MENTEN.rhs[0], 1e-4) for c in found)


def test_a_search_for_sums_alone_finds_no_ratio():
    """With denominators switched off every formula is a sum of features."""
    samples = make_samples(_integrate(MICHAELIS_MENTEN), "x", "central6")
    for candidate in _find(samples, costs=(2,), denominators=False, max_terms=3):
        assert sympy.denom(sympy.together(candidate.expr)).is_number


@pytest.mark.slow
def test_the_cart_pole_law_is_found_without_a_library():
    """Both accelerations of the cart-pole come out in their exact rational form, F known."""
    trajectory = _integrate(CART_POLE)
    for target, costs in (("z", (4,)), ("y", (4, 6))):
        samples = make_samples(trajectory, target, "central6")
        law = CART_POLE.rhs[CART_POLE.index(target)]
        assert any(_same(c.expr, law) for c in _find(samples, costs=costs, rounds=1))


def test_a_constant_target_is_its_own_formula():
    """Slopes that never change need no search."""
    x = np.linspace(0, 1, 20)
    samples = Samples(x[:, None], np.full(20, 2.5), ("x",), "x", "given", x)
    (candidate,) = _find(samples)
    assert candidate.expr == parse("2.5")


def _planted(formula: str, names: str, rows: int = 300) -> Samples:
    X = np.random.default_rng(0).uniform(1.0, 3.0, (rows, len(names)))
    y = compile_numpy([parse(formula, list(names))], list(names))(X.T)[0]
    return Samples(X, y, tuple(names), "y", "given", np.arange(float(rows)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("formula", "changes"),
    [("(a*c+b*d)/(a+b)", ()), ("sqrt((a*b+c)/(1+c/d))", ("square",))],
)
def test_negative_powers_and_changed_targets_find_more(formula, changes):
    """A ratio without a constant term, and a root of a ratio, come out to rounding."""
    samples = _planted(formula, "abcd")
    settings = {"costs": (4,), "rounds": 1, "width": 64}
    found = _find(samples, inverses=True, changes=changes, **settings)
    assert min(c.loss for c in found) < 1e-9
    assert min(c.loss for c in _find(samples, **settings, max_terms=4)) > 1e-4


def test_the_deadline_ends_a_search_early():
    """A search that would take long gives what it has when its seconds are over."""
    samples = _planted("exp(a*b)*sin(c*d)/(a+log(b+c))", "abcd", 1000)
    began = time.monotonic()
    found = _find(samples, costs=(6,), seconds=0.2)
    assert time.monotonic() - began < 10
    assert all(np.isfinite(c.loss) for c in found)
