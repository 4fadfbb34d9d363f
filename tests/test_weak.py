import json

import numpy as np
import pytest
from command_line import run
from scipy.integrate import solve_ivp

import dynsr
from dynsr.data import Trajectory, choose_samples, weak_form
from dynsr.errors import InputError
from dynsr.methods import RationalSearch

FEW = RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1)


def circle(t):
    """Give the trajectory of a circle."""
    return Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), ("x", "y"))


@pytest.mark.parametrize("even", [True, False])
def test_the_true_law_holds_over_every_window(even):
    """On 200 rows the means of y are those of the slope of x within 2e-4, on uneven times too."""
    t = np.linspace(0, 12, 200)
    if not even:
        t = np.sort(np.random.default_rng(0).choice(np.linspace(0, 12, 400), 200, replace=False))
    run = circle(t)
    weak = weak_form(run, "x")
    assert len({tuple(np.diff(w)) for w in weak.windows}) == 3
    assert np.max(np.abs(weak.matrix @ run.x[:, 1] - weak.y)) < 2e-4
    assert np.allclose(weak.matrix.sum(axis=1), 1)


@pytest.mark.parametrize("rows", range(6, 15))
def test_few_rows_have_windows(rows):
    """From six rows on there is a window, and the law of a line holds in it exactly."""
    t = np.cumsum(np.random.default_rng(rows).uniform(0.5, 1, rows))
    weak = weak_form(Trajectory(t, 3 * t[:, None], ("x",)), "x")
    assert len(weak.y) > 0 and np.allclose(weak.y, 3, rtol=1e-2)


def test_windows_that_do_not_fit_are_refused():
    """One line says how many rows there are and what would do."""
    with pytest.raises(InputError, match="10 rows have no window of 12 steps"):
        weak_form(circle(np.arange(10.0)), "x", [12])


def prey(t, noise):
    """Prey and predators with noise, and the slopes of the prey without."""
    law = lambda t, v: [1.5 * v[0] - v[0] * v[1], v[0] * v[1] - 3 * v[1]]  # noqa: E731
    x = solve_ivp(law, (0, 8), [2, 1], t_eval=t, rtol=1e-10, atol=1e-12).y.T
    noisy = x + noise * x.std(axis=0) * np.random.default_rng(0).normal(size=x.shape)
    return Trajectory(t, noisy, ("x", "y")), law(0, x.T)[0]


@pytest.mark.parametrize(
    ("noise", "even", "most"),
    [(0.0, True, 1e-4), (0.01, True, 0.03), (0.05, True, 0.1), (0.01, False, 0.03)],
)
def test_slopes_of_the_weak_scheme_are_those_of_the_law(noise, even, most):
    """On 400 rows of three periods they err by a few per cent of their size in noise."""
    t = np.linspace(0, 8, 400)
    if not even:
        t = np.sort(np.random.default_rng(3).uniform(0, 8, 400))
    data, truth = prey(t, noise)
    samples = choose_samples(data, "x", scheme="weak")
    assert samples.scheme == "weak"
    rows = np.searchsorted(t, samples.t)
    assert 350 < len(rows) < 400
    error = np.sqrt(np.mean((samples.y - truth[rows]) ** 2)) / truth.std()
    assert error < most
    assert error > most / 20


def test_slopes_of_the_weak_scheme_have_the_means_of_the_weak_form():
    """Their means over windows are those that bumps give of the measured values, up to noise."""
    data, truth = prey(np.linspace(0, 8, 400), 0.02)
    samples = choose_samples(data, "x", scheme="weak")
    inside = np.searchsorted(data.t, samples.t)
    weak = weak_form(data, "x", [60])
    whole = (weak.windows[:, 0] >= inside[0]) & (weak.windows[:, 1] <= inside[-1])
    slope = np.zeros(len(data))
    slope[inside] = samples.y
    gap = weak.matrix[whole] @ slope - weak.y[whole]
    assert np.count_nonzero(whole) > 15
    assert np.sqrt(np.mean(gap**2)) < 0.01 * truth.std()
    # Values that change shift both: the means are of these data, and of no others.
    assert np.sqrt(np.mean((weak.matrix[whole] @ truth - weak.y[whole]) ** 2)) > 1e-6


@pytest.mark.slow
def test_a_discovery_by_the_weak_scheme():
    """The law of the predators comes out of noise, and the record names the scheme."""
    data, _ = prey(np.linspace(0, 8, 200), 0.005)
    found = dynsr.discover(data, scheme="weak", method=FEW, targets="y", jobs=1)
    assert {str(t.as_coeff_Mul()[1]) for t in found.equations["y"].args} == {"y", "x*y"}
    assert found.settings["scheme"] == {"y": "weak"}


@pytest.mark.slow
def test_a_velocity_by_the_weak_scheme():
    """x'' = -4 x comes from positions alone."""
    t = np.linspace(0, 6, 150)
    swing = Trajectory(t, np.cos(2 * t)[:, None], ("x",))
    found = dynsr.discover(swing, order=2, scheme="weak", method=FEW, jobs=1)
    assert float(found.equations["x_dot"].subs({"x": 1, "x_dot": 0})) == pytest.approx(-4, abs=0.01)


def test_rows_too_few_for_the_weak_scheme_are_refused(tmp_path):
    """One line names the scheme and how many rows it takes, in Python and in the shell."""
    t = np.arange(12.0)
    said = "12 rows are too few for scheme 'weak'; give at least 16"
    with pytest.raises(InputError, match=said):
        choose_samples(circle(t), "x", scheme="weak")
    path = tmp_path / "few.csv"
    np.savetxt(path, np.column_stack([t, np.exp(-t)]), delimiter=",", header="t,x", comments="")
    words = ("discover", path, "--scheme", "weak", "--method", "sindy", "--jobs", "1")
    assert said in run(*words, code=2).output


@pytest.mark.slow
def test_the_shell_takes_the_weak_scheme(tmp_path):
    """--scheme weak reaches the record."""
    t = np.linspace(0, 4, 40)
    path = tmp_path / "decay.csv"
    np.savetxt(path, np.column_stack([t, np.exp(-t)]), delimiter=",", header="t,x", comments="")
    words = ("--scheme", "weak", "--method", "sindy", "--preset", "quick", "--jobs", "1")
    told = json.loads(run("discover", path, *words, "--json", "--quiet").stdout)
    assert told["settings"]["scheme"] == {"x": "weak"}
