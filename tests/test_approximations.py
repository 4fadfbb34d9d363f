import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.trajectory import Trajectory
from dynsr.expression.parsing import parse
from dynsr.expression.vocabulary import Vocabulary
from dynsr.methods.demands import Demands
from dynsr.selection.approximations import MeasuredRuns, find_approximations

PREY = {"x": parse("x*(1 - x/4) - x*y/(1 + x)"), "y": parse("x*y/(1 + x) - 0.5*y")}


def integrate(exprs, x0, t):
    """Give the states (n, k) as SciPy's LSODA integrates them."""
    slope = sympy.lambdify(list(map(sympy.Symbol, exprs)), list(exprs.values()))
    found = solve_ivp(lambda _, x: slope(*x), (t[0], t[-1]), x0, "LSODA", t, rtol=1e-9, atol=1e-11)
    assert found.success
    return found.y.T


def explained(x, found):
    """Mean over the states of the share of their variance that is explained."""
    return float(
        np.mean(1 - np.sum((x - found) ** 2, axis=0) / np.sum((x - x.mean(0)) ** 2, axis=0))
    )


def measure(rows=150, scale=1.0):
    """Integrate predator and prey over four turns, in units of ``scale``."""
    t = np.linspace(0, 30, rows)
    return Trajectory(t, scale * integrate(PREY, [1.0, 0.6], t), ("x", "y"))


def test_a_sum_of_terms_follows_what_is_no_sum_of_terms():
    """Of a law with a ratio, which no library holds, sums follow the whole oscillation: SciPy
    integrates the first to the R2 that is said, above 0.95, and a line does not.
    """
    run = measure()
    found = find_approximations(MeasuredRuns([run], {}, run.states), Demands())
    best = found[0]
    again = integrate(best.exprs, run.x[0], run.t)
    assert explained(run.x, again) == pytest.approx(best.r2, abs=5e-3)
    assert best.r2 > 0.95
    assert all(other.r2 <= best.r2 + 0.005 for other in found)


@pytest.mark.slow
def test_no_unit_matters_to_followers():
    """Data in units a thousand times smaller have the same terms and the same R2."""
    one, other = (
        find_approximations(MeasuredRuns([run], {}, run.states), Demands())[0]
        for run in (measure(100), measure(100, 1000.0))
    )
    assert one.r2 == pytest.approx(other.r2, abs=1e-6)
    shapes = [
        {s: {t.as_coeff_Mul()[1] for t in sympy.Add.make_args(e)} for s, e in f.exprs.items()}
        for f in (one, other)
    ]
    assert shapes[0] == shapes[1]


@pytest.mark.slow
def test_followers_keep_to_what_is_asked_and_to_what_is_known():
    """Without functions none has a sine; a velocity that is known stays as it is."""
    t = np.linspace(0, 12, 200)
    swing = {"q": parse("v"), "v": parse("-sin(q) - 0.1*v")}
    run = Trajectory(t, integrate(swing, [2.0, 0.0], t), ("q", "v"))
    measured_runs = MeasuredRuns([run], {}, run.states)
    free = find_approximations(measured_runs, Demands(), {"q": parse("v")})
    bound = find_approximations(
        measured_runs, Demands(vocabulary=Vocabulary(())), {"q": parse("v")}
    )
    assert any(f.exprs["v"].has(sympy.sin) for f in free)
    assert bound and not any(e.has(sympy.sin, sympy.cos) for f in bound for e in f.exprs.values())
    assert {f.exprs["q"] for f in [*free, *bound]} == {sympy.Symbol("v")}


def test_an_input_drives_what_is_followed():
    """x' = u - x with a measured u is found and followed, in two runs of different length."""
    runs = []
    for rows, wave in ((120, 1.0), (80, 2.0)):
        t = np.linspace(0, 8, rows)
        u = np.cos(wave * t)
        # The solution from 0, in closed form.
        x = (np.cos(wave * t) + wave * np.sin(wave * t) - np.exp(-t)) / (1 + wave**2)
        runs.append(Trajectory(t, x[:, None], ("x",), u[:, None], ("u",)))
    best = find_approximations(MeasuredRuns(runs, {}, ("x",)), Demands())[0]
    terms = best.exprs["x"].as_coefficients_dict()
    assert best.r2 > 0.9999
    assert float(terms[sympy.Symbol("u")]) == pytest.approx(1.0, abs=0.02)
    assert float(terms[sympy.Symbol("x")]) == pytest.approx(-1.0, abs=0.02)


def test_what_diverges_explains_nothing():
    """x' = x^2 leaves the data of a decay: its R2 is -1, and that of the decay is 1."""
    t = np.linspace(0, 3, 40)
    measured_runs = MeasuredRuns([Trajectory(t, np.exp(-t)[:, None], ("x",))], {}, ("x",))
    x = sympy.Symbol("x")
    assert measured_runs.r2({"x": 5 * x**2}).tolist() == [-1.0]
    assert measured_runs.r2({"x": -x}).tolist() == pytest.approx([1.0], abs=1e-9)
