"""Claims about the last fit of the constants of a whole system."""

from dataclasses import dataclass

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.samples import Samples
from dynsr.data.trajectory import Trajectory
from dynsr.expression import free_constants
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate
from dynsr.fit.collocation import Measurements
from dynsr.fit.description import Noise
from dynsr.fit.polishing import polish, simple_numbers
from dynsr.fit.settings import FIT
from dynsr.fit.shooting import match_trajectories, measure_errors
from dynsr.fit.variation import loosen
from dynsr.selection.pick import Pick, RankedCandidate, rank_candidates
from dynsr.verdict.prediction import predict

TRUE = {"x": "1.5*x - x*y", "y": "x*y - 3*y"}


@pytest.fixture(scope="module")
def exact():
    """Predators and prey, solved by scipy."""
    t = np.linspace(0, 10, 501)
    found = solve_ivp(
        lambda t, u: [u[0] * (1.5 - u[1]), -u[1] * (3 - u[0])],
        (0, 10),
        [1.0, 1.0],
        t_eval=t,
        rtol=1e-11,
        atol=1e-12,
    )
    return Trajectory(t, found.y.T, ("x", "y"))


def with_noise(exact, seed=0):
    """One percent of each state's spread."""
    random = np.random.default_rng(seed).normal(size=exact.x.shape)
    return Trajectory(exact.t, exact.x + 0.01 * exact.x.std(axis=0) * random, exact.states)


def rational(text):
    """Read a formula whose decimals are exact, as snapping leaves them."""
    return sympy.nsimplify(parse(text), rational=True)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.slow
def test_constants_fitted_again_come_back_to_their_own_terms(seed):
    """However SymPy sorts terms by their numbers, a pendulum's friction stays beside its speed."""
    t, rng = np.linspace(0, 10, 101), np.random.default_rng(seed)
    friction, pull = rng.uniform(0.15, 0.35), rng.uniform(8.0, 12.0)
    x = solve_ivp(
        lambda t, u: [u[1], -friction * u[1] - pull * np.sin(u[0])], (0, 10), [1.0, 0.0], t_eval=t
    ).y.T
    run = Trajectory(t, x + 0.03 * x.std(axis=0) * rng.normal(size=x.shape), ("a", "v"))
    rough = {"a": parse("0.99*v"), "v": parse("-0.2*v - 9.0*sin(a)")}
    match = polish(rough, [run], {}, {}, {})
    assert match.exprs["a"] == parse("v")
    own = match.exprs["v"].as_coefficients_dict()
    assert float(own[parse("v")]) == pytest.approx(-friction, rel=0.2)
    assert float(own[parse("sin(a)")]) == pytest.approx(-pull, rel=0.1)


@dataclass
class Powers:
    """Coefficients of 1, x, x^2, ... with their covariance."""

    constants: np.ndarray
    covariance: np.ndarray

    @property
    def errors(self):
        """The standard errors."""
        return np.sqrt(np.diag(self.covariance))

    def put(self, numbers):
        """Give the sum with other coefficients."""
        x = sympy.Symbol("x")
        return {"x": sympy.Add(*[number * x**i for i, number in enumerate(numbers)])}


@pytest.mark.parametrize("seed", range(8))
def test_constants_that_are_written_short_are_still_the_fitted_function(seed):
    """Rounding moves a narrow sum of powers by less than its errors, where one by one it would not.

    Far from 0, coefficients of powers have errors of their own size, and together hardly any.
    """
    rng, x = np.random.default_rng(seed), np.linspace(2.0, 2.5, 200)
    design = x[:, None] ** np.arange(4) / 0.01
    covariance = np.linalg.inv(design.T @ design)
    constants = rng.multivariate_normal([3.137, -1.719, 0.841, -0.273], covariance)
    fit = Powers(constants, covariance)
    written = [float(n) for n in simple_numbers(fit, [None] * 4, FIT)]
    moved = design @ (np.array(written) - constants)
    # Half a unit of the last digit is half an error at most.
    assert moved @ moved <= 4 * 0.5**2
    alone = [
        float(f"{c:.{max(0, int(np.ceil(np.log10(abs(c) / e))))}e}")
        for c, e in zip(constants, fit.errors, strict=True)
    ]
    apart = design @ (np.array(alone) - constants)
    assert apart @ apart > 100
    digits = [len(f"{abs(n):.10g}".replace(".", "").strip("0")) for n in written]
    assert sum(digits) < 20


def test_every_final_constant_has_its_standard_error(exact):
    """The errors hold the constants of the final formula, though all of them are simple numbers."""
    x, y = exact.x.T
    slopes = {"x": 1.5 * x - x * y, "y": x * y - 3 * y}
    samples = {s: Samples(exact.x, v, ("x", "y"), s, "given", exact.t) for s, v in slopes.items()}
    rough = {"x": parse("1.49*x - 1.01*x*y"), "y": parse("1.01*x*y - 2.99*y")}
    match = polish(rough, [exact], {}, samples, dict.fromkeys("xy", Noise(1e-6, 500.0)))
    assert match.exprs == {s: parse(e) for s, e in TRUE.items()}
    assert sorted(v for v, _ in match.errors["x"]) == [-1.0, 1.5]
    assert sorted(v for v, _ in match.errors["y"]) == [-3.0, 1.0]
    assert all(0 <= error < 1e-4 for pairs in match.errors.values() for _, error in pairs)


def test_errors_at_given_constants_are_those_of_a_fit(exact):
    """Near the best fit, constants that are only measured have the errors that the fit gives."""
    noisy = with_noise(exact)
    fitted = match_trajectories({s: loosen(parse(e)) for s, e in TRUE.items()}, noisy)
    given = measure_errors({s: loosen(parse(e)) for s, e in TRUE.items()}, [noisy], {})
    for state in TRUE:
        fit = sorted(fitted.errors[state])
        for (_, error), (_, want) in zip(sorted(given[state]), fit, strict=True):
            assert error == pytest.approx(want, rel=0.1)


@pytest.mark.slow
def test_simple_constants_that_the_data_allow_are_kept(exact):
    """The picked simple numbers stay, whatever decimals fit the noise a little better."""
    match = polish({s: rational(e) for s, e in TRUE.items()}, [with_noise(exact, 1)], {}, {}, {})
    assert match.exprs == {s: parse(e) for s, e in TRUE.items()}


@pytest.mark.slow
def test_simple_constants_that_the_data_reject_are_given_up(exact):
    """A simple number that is three percent off gives way, and the true one is found."""
    wrong = {"x": rational("1.55*x - x*y"), "y": rational("x*y - 3*y")}
    match = polish(wrong, [with_noise(exact)], {}, {}, {})
    _, values = free_constants(match.exprs["x"], "c")
    assert pytest.approx(next(v for v in values.values() if v > 0), rel=0.005) == 1.5


def test_the_more_forecasts_the_finer_the_choice():
    """A third more error is nothing among 8 forecasts but is enough among 800 to lose."""
    near, short = (RankedCandidate(None, bits, miss) for bits, miss in ((90.0, 0.03), (60.0, 0.04)))
    assert rank_candidates([near, short], 8)[0] is short
    assert rank_candidates([near, short], 800)[0] is near


@pytest.mark.slow
def test_one_wrong_equation_does_not_bend_the_constants_of_the_others(exact):
    """Beside a line for the predators, the prey's equation keeps its constants to two percent."""
    wrong = {"x": parse("1.4*x - 0.9*x*y"), "y": parse("0.3*x - 0.3*y")}
    found = polish(wrong, [with_noise(exact)], {}, {}, {})
    assert sorted(v for v, _ in found.errors["x"]) == pytest.approx([-1.0, 1.5], rel=0.02)


def test_a_term_stays_however_small():
    """Which terms an equation has is decided by the search; the fit gives the constants."""
    t = np.linspace(0, 6, 100)
    noise = 0.01 * np.random.default_rng(0).normal(size=(100, 2))
    run = Trajectory(t, np.column_stack([np.sin(3 * t), np.exp(-t / 2)]) + noise, ("x", "y"))
    found = polish({"y": parse("0.001*x - 0.49*y")}, [run], {}, {}, {})
    x, y = sympy.symbols("x y")
    assert set(found.exprs["y"].as_coefficients_dict()) == {x, y}
    assert (
        abs(float(found.exprs["y"].coeff(x)))
        < 3 * dict(found.errors["y"])[float(found.exprs["y"].coeff(x))]
    )


def test_a_constant_within_a_function_stays_however_unsure():
    """Of 2/(y + 0.2), where y goes from 1 to 4, the 0.2 is not told from 0 and stays."""
    t = np.linspace(0, 3, 40)
    law = {"y": parse("2/(y + 0.2)")}
    y = predict(law, [1.0], t).x + 0.05 * np.random.default_rng(0).normal(size=(40, 1))
    found = polish({"y": parse("2.1/(y + 0.3)")}, [Trajectory(t, y, ("y",))], {}, {}, {})
    assert sympy.denom(found.exprs["y"]).is_Add
    (value, error), *_ = sorted(found.errors["y"])
    assert abs(value) < 3 * error


def test_a_pick_that_was_put_first_is_explained_beside_a_shorter_rival():
    """Where nothing was held back, an alternative of fewer bits is named, by its bits alone."""
    x = sympy.Symbol("x")
    law, short = Candidate(2 * x, 1e-9, 4.0, "the first look"), Candidate(x, 0.1, 2.0)
    ranked = RankedCandidate(law, 90.0, None), RankedCandidate(short, 60.0, None)
    told = Pick("x", ranked, Noise(1.0, 10.0)).explanation
    assert told.endswith("found by the first look. x takes 30 bits less on the slopes alone.")


@pytest.mark.slow
def test_noise_in_proportion_to_states_shows_that_a_factor_is_not_1():
    """An epidemic with the rate 0.99 in 1 % of noise: 1 is four of its standard errors away."""
    t = np.linspace(0, 12, 150)

    def spread(_, x):
        met = 0.99 * x[0] * x[1] / (x[0] + x[1])
        return [0.26 * x[2] - met, met - 0.16 * x[1], 0.16 * x[1] - 0.26 * x[2]]

    x = solve_ivp(spread, (0, 12), [0.75, 0.02, 0.18], t_eval=t, rtol=1e-10, atol=1e-12).y.T
    x *= 1 + 0.01 * np.random.default_rng(22).standard_normal(x.shape)
    run = Trajectory(t, x, ("s", "i", "r"))
    law = {
        "s": "0.3*r - 1.1*i*s/(i + s)",
        "i": "1.1*i*s/(i + s) - 0.2*i",
        "r": "0.2*i - 0.3*r",
    }
    exprs = {state: parse(text) for state, text in law.items()}
    match = polish(exprs, [run], {}, {}, {}, data=Measurements.of([run], {}, 2000))
    for state in "si":
        value, error = max(match.errors[state], key=lambda pair: abs(pair[0]))
        assert error < 0.003 and abs(abs(value) - 0.99) < 3 * error
