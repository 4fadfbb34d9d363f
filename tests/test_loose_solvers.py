"""Errors of a loose solver are no terms: the data say how large the defects of a system may be."""

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import dynsr
from dynsr.data import Trajectory, choose_samples, diagnose, measurement_noise
from dynsr.expression import evaluate, parse, skeleton
from dynsr.fit import (
    Collocation,
    CollocationSettings,
    Measurements,
    Mesh,
    with_floats,
)
from dynsr.selection import look
from dynsr.selection.comparison import COMPARISON, SystemComparison, leaves_noise
from dynsr.verdict import give_verdict

STRICT = CollocationSettings().stiffness[-1]


def compare(damping, tolerance, noise=0.001):
    """Give what fits a pendulum with noise in states from a solver at a tolerance."""
    t = np.linspace(0, 20, 800)
    swing = lambda t, x: [x[1], -4 * np.sin(x[0]) - damping * x[1]]  # noqa: E731
    x = solve_ivp(swing, (0, 20), [1.2, 0.0], t_eval=t, rtol=tolerance, atol=tolerance).y.T
    added = noise * np.std(x, axis=0) * np.random.default_rng(0).standard_normal(x.shape)
    data = Measurements.of([Trajectory(t, x + added, ("q", "v"))], {}, 2000)
    comparison = SystemComparison(data.mesh(("q", "v")), COMPARISON)
    return lambda text: comparison.fit({"q": sympy.Symbol("v"), "v": with_floats(parse(text))})


def filtered(y, step, rate, noise, weight):
    """Minus twice the log likelihood of rows of x' = -rate x by a Kalman filter.

    The rule of the collocation makes of this d = b x_next - a x, of variance noise^2 / weight.
    """
    half = (1 + step * rate / 4) / 2, (1 - step * rate / 4) / 2
    before = 1 - step * rate / 6 * (1 + 4 * half[1])
    after = 1 + step * rate / 6 * (1 + 4 * half[0])
    mean, variance, total = 0.0, 1e8, 0.0
    for row, value in enumerate(y):
        if row:
            mean *= before / after
            variance = (before**2 * variance + noise**2 / weight) / after**2
        spread = variance + noise**2
        total += np.log(spread) + (value - mean) ** 2 / spread
        gain = variance / spread
        mean, variance = mean + gain * (value - mean), variance * (1 - gain)
    return total


def noisy_motion(size, rows=400):
    """Give a mesh of a decay to 0 whose every step has an error of its own, and its numbers."""
    rng, step, rate, noise = np.random.default_rng(5), 0.05, 0.4, 0.1
    x = np.empty(rows)
    x[0] = 3.0
    for row in range(1, rows):
        x[row] = x[row - 1] * np.exp(-rate * step) + size * rng.normal()
    y = (x + noise * rng.normal(size=rows))[:, None]
    t = step * np.arange(rows)
    times = np.concatenate([t, (t[1:] + t[:-1]) / 2])[None]
    mesh = Mesh(t, np.arange(rows - 1), y, np.full_like(y, 1 / noise), y, times, ("x",), ("t",))
    return mesh, (y[:, 0], step, rate, noise)


def test_the_evidence_is_that_of_a_kalman_filter():
    """Differences of the evidence between weights of the defects are those of exact likelihoods."""
    mesh, data = noisy_motion(0.05)
    found, exact = [], []
    for weight in (3.0, 30.0, 300.0):
        problem = Collocation({"x": parse("-2*x/5")}, mesh, weight=weight)
        fit = problem.fit()
        found.append(problem.evidence(np.ascontiguousarray(fit.states.T), fit.constants))
        exact.append(filtered(*data, weight))
    np.testing.assert_allclose(np.diff(found), np.diff(exact), rtol=1e-4)


def test_the_weight_of_defects_is_the_likeliest():
    """A motion with noise of its own gets the weight for which a Kalman filter is likeliest.

    The same without this noise is held as strictly as can be.
    """
    mesh, data = noisy_motion(0.05)
    settings = CollocationSettings(loose=1.0)
    found = Collocation({"x": parse("-2*x/5")}, mesh, settings).fit()
    best = minimize_scalar(lambda w: filtered(*data, np.exp(w)), (0, np.log(STRICT)))
    assert np.log(found.weight) == pytest.approx(best.x, abs=0.5)
    still, _ = noisy_motion(0.0)
    assert Collocation({"x": parse("-2*x/5")}, still, settings).fit().weight == STRICT


@pytest.mark.slow
@pytest.mark.parametrize("extra", ["q^3", "q*v^2"])
def test_errors_of_a_solver_are_no_terms(extra):
    """The true equation takes fewer bits than with a term for what the solver left behind.

    It leaves more than noise all the same, and that is said.
    """
    fit = compare(0.1, 1e-3)
    true, longer = (fit(f"-4.1*sin(q) - 0.1*v{more}") for more in ("", f" + 0.01*{extra}"))
    assert true.bits < longer.bits
    assert true.fit.weight < STRICT
    assert not leaves_noise(true, COMPARISON)


@pytest.mark.slow
def test_small_true_terms_stay():
    """A damping by which the swings shrink by 3 % in all is not taken for an error."""
    fit = compare(0.003, 1e-10)
    true, less = fit("-4.1*sin(q) - 0.01*v"), fit("-4.1*sin(q)")
    assert true.bits < less.bits - 20
    assert leaves_noise(true, COMPARISON)
    assert not leaves_noise(less, COMPARISON)


@pytest.mark.slow
def test_two_species_of_a_loose_solver_are_found():
    """Two species, solved by scipy at its default tolerance, with noise: the four terms alone."""
    t = np.linspace(0, 30, 300)
    both = lambda t, x: [0.7 * x[0] - 0.4 * x[0] * x[1], 0.3 * x[0] * x[1] - 0.6 * x[1]]  # noqa: E731
    x = solve_ivp(both, (0, 30), [2.0, 1.0], t_eval=t).y.T
    x += 0.01 * x.std(axis=0) * np.random.default_rng(0).standard_normal(x.shape)
    found = dynsr.discover((t, x), states=["x", "y"], jobs=1)
    a, b = sympy.symbols("x y")
    assert {term.as_coeff_Mul()[1] for term in found.equations["x"].args} == {a, a * b}
    assert {term.as_coeff_Mul()[1] for term in found.equations["y"].args} == {b, a * b}


def swing(tolerance, rows=300):
    """Give a pendulum as scipy makes it between its steps, at a tolerance."""
    t = np.linspace(0, 10, rows)
    slopes = lambda t, x: [x[1], -4 * np.sin(x[0])]  # noqa: E731
    x = solve_ivp(slopes, (0, 10), [1.2, 0.0], t_eval=t, rtol=tolerance, atol=1e-3 * tolerance).y.T
    return Trajectory(t, x, ("q", "v"))


@pytest.mark.slow
def test_rows_between_the_steps_of_a_loose_solver_are_diagnosed():
    """Rows of scipy's default tolerance were interpolated; with noise, or at 1e-9, they were not.

    Nor were a line, a ramp in steps, and a column at rest, whose differences are 0 too.
    """
    loose, strict = swing(1e-3), swing(1e-9)
    noise = 1e-6 * np.random.default_rng(0).normal(size=(300, 2))
    noisy = Trajectory(loose.t, loose.x + noise, loose.states)
    kinds = [[c.kind for c in diagnose(run, run.states[0])] for run in (loose, strict, noisy)]
    assert [kind[:1] == ["interpolated"] for kind in kinds] == [True, False, False]
    t = loose.t
    for plain in (2 * t, np.round(t), np.where(t < 5, t, 5.0), np.where(t < 5, 0.0, np.sin(t))):
        run = Trajectory(t, np.column_stack([plain, strict.x[:, 0]]), ("x", "q"))
        assert "interpolated" not in {cause.kind for cause in diagnose(run, "x")}


def of_scipy(slopes, start, end, rows, names):
    """Give a system as scipy makes it between its steps, at its default tolerance."""
    t = np.linspace(0, end, rows)
    return Trajectory(t, solve_ivp(slopes, (0, end), start, t_eval=t).y.T, names)


DUFFING = lambda t, x: [x[1], x[0] - x[0] ** 3 - 0.1 * x[1]]  # noqa: E731
RELAXING = lambda t, x: [x[1], 1.5 * (1 - x[0] ** 2) * x[1] - x[0]]  # noqa: E731
INFECTING = lambda t, x: [-0.5 * x[0] * x[1], 0.5 * x[0] * x[1] - 0.1 * x[1]]  # noqa: E731
BY_SCIPY = {
    "duffing": (DUFFING, [1.5, 0.0], 40, ("x", "v"), "v", "-0.1*v + x - x^3"),
    "van der pol": (RELAXING, [2.0, 0.0], 30, ("x", "y"), "y", "1.5*y - 1.5*x^2*y - x"),
    "infections": (INFECTING, [0.99, 0.01], 60, ("S", "I"), "I", "0.5*I*S - 0.1*I"),
}


@pytest.mark.parametrize("rows", [400, 1000])
@pytest.mark.parametrize("name", BY_SCIPY)
def test_the_error_that_a_solver_leaves_in_slopes_is_seen_in_the_rows(name, rows):
    """It is what the slopes miss of the law, to a factor of three; the states have no noise."""
    slopes, start, end, names, state, law = BY_SCIPY[name]
    run = of_scipy(slopes, start, end, rows, names)
    samples = choose_samples([run], state)
    missed = np.abs(samples.y - evaluate(parse(law), samples.columns))
    assert 1 / 3 < samples.noise / np.median(missed) < 3
    assert np.all(measurement_noise(run) == 0)


@pytest.mark.parametrize("name", BY_SCIPY)
@pytest.mark.slow
def test_the_first_look_sees_the_law_behind_the_errors_of_a_solver(name):
    """It misses most rows by little and some by much, and nothing else is probable."""
    slopes, start, end, names, state, law = BY_SCIPY[name]
    seen = look(choose_samples([of_scipy(slopes, start, end, 400, names)], state))
    found = with_floats(seen.candidates[0].expr)
    assert skeleton(found) == skeleton(with_floats(parse(law)))
    assert seen.final
    numbers = [
        sorted(float(n) for n in e.atoms(sympy.Float)) for e in (found, with_floats(parse(law)))
    ]
    np.testing.assert_allclose(*numbers, rtol=2e-3)


@pytest.mark.slow
def test_a_relaxing_oscillator_of_a_loose_solver_is_found():
    """Of rows without noise the constants come to be the simple numbers of the law."""
    slopes, start, end, names, _, law = BY_SCIPY["van der pol"]
    found = dynsr.discover([of_scipy(slopes, start, end, 400, names)], jobs=1)
    assert sympy.expand(sympy.nsimplify(found.equations["y"] - sympy.nsimplify(parse(law)))) == 0
    assert found.equations["x"] == sympy.Symbol("y")


@pytest.mark.slow
def test_a_law_may_be_missed_by_the_errors_of_a_solver():
    """The verdict of exact rows of a loose solver allows for them, but for no other equation.

    Where the equation is no law, the tolerance is named.
    """
    run, (q, v) = swing(1e-3), sympy.symbols("q v")
    law, other = {"q": v, "v": -4 * sympy.sin(q)}, {"q": v, "v": -3.94 * q + 0.55 * q**3}
    found = give_verdict(law, [run])
    assert found.level == "law"
    assert "within the errors of the solver" in found.states["q"].reason
    wrong = give_verdict(other, [run])
    assert wrong.level != "law"
    assert "solve again with rtol=1e-9" in wrong.states["v"].reason
    assert "exactly" in give_verdict(law, [swing(1e-9)]).states["q"].reason
