"""Claims about which terms stay where the data are exact."""

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.samples import Samples
from dynsr.data.slopes import choose_samples
from dynsr.data.trajectory import Trajectory
from dynsr.expression import skeleton
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import score_candidate
from dynsr.fit.noise import Noise, noise_of
from dynsr.fit.parsimony import collapse, limits
from dynsr.selection.pick import pick_equation


@pytest.fixture(scope="module")
def oscillator():
    """Van der Pol's oscillator as a solver of everyday tolerance leaves it, 4000 rows."""
    t = np.linspace(0, 20, 4000)
    found = solve_ivp(
        lambda t, u: [u[1], (1 - u[0] ** 2) * u[1] - u[0]],
        (0, 20),
        [1.0, 0.0],
        t_eval=t,
        rtol=1e-6,
        atol=1e-8,
    )
    return Trajectory(t, found.y.T, ("x", "y"))


@pytest.mark.parametrize(
    ("state", "long", "short"),
    [
        ("x", "64146.1*y/(y^2 + 64141.7)", "y"),
        ("x", "y + 2.4e-7*x^5", "y"),
        ("x", "y*exp(-5e-8*x^8)", "y"),
        ("x", "20000.3*sin(y/20000)", "y"),
        ("y", "y - x - x^2*y + 2.4e-7*x^5", "y - x - x^2*y"),
        ("y", "y - x - x^2*y*exp(-5e-8*x^8)", "y - x - x^2*y"),
        ("y", "(y - x - x^2*y)/(1 + 3e-8*y^2)", "y - x - x^2*y"),
    ],
)
def test_limits_of_longer_forms_collapse(oscillator, state, long, short):
    """A choice between long forms alone gives the law that they tend to, exact."""
    samples = choose_samples(oscillator, state)
    found = pick_equation(state, [score_candidate(parse(long), samples)], samples)
    assert sympy.simplify(found.candidate.expr - parse(short)) == 0


def test_a_term_of_the_law_stays_however_small():
    """A true term a thousandth the size of the rest stays: without it misses grow tenfold."""
    t = np.linspace(0, 10, 2000)
    x = solve_ivp(
        lambda t, u: [u[1], -u[0] - 1e-3 * u[0] ** 3],
        (0, 10),
        [1.0, 0.0],
        t_eval=t,
        rtol=1e-11,
        atol=1e-12,
    ).y.T
    samples = choose_samples(Trajectory(t, x, ("x", "y")), "y")
    law = score_candidate(parse("-x - 0.001*x^3"), samples)
    assert pick_equation("y", [law], samples).candidate.expr.coeff(parse("x^3")) != 0


def test_a_term_at_work_in_few_rows_stays():
    """A term that only the last few rows of a hundred feel stays though the median does not."""
    x = np.linspace(0, 1, 1000)
    law = parse("-x + 5*x^400")
    y = -x + 5 * x**400
    samples = Samples(x[:, None], y, ("x",), "x", "central4", x, 1e-6)
    candidate = score_candidate(law, samples)
    assert collapse(candidate, [], samples, Noise(1e-6, 1000.0)) is candidate


def test_noisy_data_keep_terms_that_rows_together_show():
    """Where slopes are noisy a term below the noise of a row stays: many rows tell it."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (2000, 2))
    y = -x[:, 0] - 0.1 * x[:, 1] + rng.normal(0, 0.1, 2000)
    samples = Samples(x, y, ("x", "v"), "v", "savgol(9,2)", np.arange(2000.0), 0.1)
    law = score_candidate(parse("-x - 0.1*v"), samples)
    assert collapse(law, [], samples, Noise(0.067, 2000.0)) is law


def test_a_shorter_formula_that_misses_as_little_is_the_choice(oscillator):
    """Of two formulas in the pool with the same misses the longer is never taken."""
    samples = choose_samples(oscillator, "x")
    pool = [
        score_candidate(parse(e), samples)
        for e in ("64146.1*y/(y^2 + 64141.7)", "y", "y + 1e-9*x", "sin(y)", "0.9*y")
    ]
    assert pick_equation("x", pool, samples).candidate.expr == sympy.Symbol("y")


def test_what_no_formula_explains_is_no_noise(oscillator):
    """Exact slopes that no candidate explains keep their own error as floor, and all rows count."""
    samples = choose_samples(oscillator, "y")
    pool = [score_candidate(parse(e), samples) for e in ("-x", "1.5 - y/9", "y - x - 0.9*x*y")]
    noise = noise_of(pool, samples)
    assert noise.floor < 1e-3 * np.sqrt(np.mean(samples.y**2))
    assert noise.effective_rows == len(samples)


def test_the_formula_that_follows_wins_where_the_law_is_missing(oscillator):
    """Among formulas that all miss, one with a tenth of the misses beats one with few bits."""
    samples = choose_samples(oscillator, "y")
    pool = [
        score_candidate(parse(e), samples)
        for e in ("-x", "1.5 - y/9", "1.02*y - 0.97*x - 1.01*x^2*y + 0.05*x^3 + 0.3*sin(x*y)")
    ]
    found = pick_equation("y", pool, samples).candidate
    assert skeleton(found.expr).has(parse("x^2*y"))


def test_limits_hold_every_vanishing_part():
    """Terms above, below and inside functions go one at a time; functions take their series."""
    found = {str(e) for e in limits(parse("a*sin(b)/(c + d)"))}
    assert {"a*b/(c + d)", "a*sin(b)/c", "a*sin(b)/d"} <= found
