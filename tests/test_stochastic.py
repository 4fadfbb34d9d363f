"""Noise in the motion: drift and diffusion, against closed forms and known stochastic systems."""

import numpy as np
import pytest
import sympy
from command_line import run as run_command
from scipy.stats import binom, multivariate_normal

import dynsr
from dynsr.data import Trajectory, measure_motion_noise, write_csv
from dynsr.discovery import Discovery
from dynsr.errors import InputError
from dynsr.fit import Series, StochasticSystem, interval_reach
from dynsr.parameters import Diffusion, DiffusionTerm, cells_of

X, Y = sympy.symbols("x y")
RATE, LEVEL = 1.2, 0.5


def paths(drift, diffusion, start, t, seed, error=0.0, root=None):
    """Draw a path (n, k) by steps of a twentieth of a row (Euler and Maruyama)."""
    rng, x, parts = np.random.default_rng(seed), np.array(start, dtype=float), 20
    step, rows = (t[1] - t[0]) / parts, [x]
    for _ in t[1:]:
        for _ in range(parts):
            chance = rng.standard_normal(len(x))
            chance = chance if root is None else root @ chance
            x = x + step * np.array(drift(*x)) + np.sqrt(step * np.array(diffusion(*x))) * chance
        rows.append(x)
    true = np.array(rows)
    return true + error * rng.standard_normal(true.shape)


def relaxing(seed=1, end=60.0, rows=1201, error=0.0):
    """Give a path of Ornstein and Uhlenbeck's process."""
    t = np.linspace(0, end, rows)
    x = paths(lambda x: [-RATE * x], lambda x: [LEVEL], [2.0], t, seed, error)
    return Trajectory(t, x, ("x",))


def eaten(seed=1, error=0.0):
    """Give a path of prey and predator, each with noise in proportion to its size."""
    t = np.linspace(0, 30, 901)
    x = paths(
        lambda x, y: [1.1 * x - 0.5 * x * y, 0.4 * x * y - 0.8 * y],
        lambda x, y: [0.002 * x**2, 0.002 * y**2],
        [2.0, 1.0],
        t,
        seed,
        error,
    )
    return Trajectory(t, x, ("x", "y"))


@pytest.fixture(scope="module")
def found():
    """Give what is found of the process of Ornstein and Uhlenbeck."""
    return dynsr.discover(relaxing(), stochastic=True, jobs=1)


def bodies(expr):
    """Give the terms of a sum without their factors."""
    return {term.as_coeff_Mul()[1] for term in sympy.Add.make_args(sympy.expand(expr))}


@pytest.mark.parametrize("h", [0.05, 0.5])
def test_a_linear_step_has_its_exact_mean_and_variance(h):
    """x exp(-a h) and D (1 - exp(-2 a h)) / (2 a) of Ornstein and Uhlenbeck's process."""
    run = Trajectory([0.0, h], [[1.5], [0.0]], ("x",))
    system = StochasticSystem({"x": -RATE * X}, {"x": sympy.Float(LEVEL)}, Series.of([run]))
    step = system.innovations(system.start[None])
    mean, variance = -step.misses[0, 0, 0, 0], step.covariance[0, 0, 0, 0, 0]
    # The rule is of order 4.
    assert mean == pytest.approx(1.5 * np.exp(-RATE * h), rel=(RATE * h) ** 5 / 60 + 1e-9)
    exact = LEVEL / (2 * RATE) * (1 - np.exp(-2 * RATE * h))
    assert variance == pytest.approx(exact, rel=(2 * RATE * h) ** 4 / 60 + 1e-9)


def test_noise_of_one_state_reaches_another_that_it_moves():
    """Of x' = v with noise D in v alone, x has the variance D h^3 / 3; they share D h^2 / 2."""
    run = Trajectory([0.0, 0.4], np.zeros((2, 2)), ("x", "y"))
    tiny = sympy.Float(1e-300)
    system = StochasticSystem(
        {"x": Y, "y": tiny}, {"x": tiny, "y": sympy.Float(3.0)}, Series.of([run])
    )
    found = system.innovations(system.start[None]).covariance[0, 0, 0]
    exact = 3.0 * np.array([[0.4**3 / 3, 0.4**2 / 2], [0.4**2 / 2, 0.4]])
    assert found == pytest.approx(exact, rel=1e-6, abs=1e-9)


def test_the_likelihood_is_that_of_a_gaussian_process():
    """With errors of measurement, of all rows together given the first one."""
    run, error = relaxing(rows=31, end=3.0, error=0.1), 0.1
    system = StochasticSystem(
        {"x": -RATE * X}, {"x": sympy.Float(LEVEL)}, Series.of([run]), {"x": error}
    )
    t, y = run.t[1:], run.x[1:, 0]
    decay = np.exp(-RATE * np.abs(t[:, None] - t))
    both = np.exp(-RATE * (t[:, None] + t))
    covariance = LEVEL / (2 * RATE) * (decay - both) + error**2 * (both + np.eye(len(t)))
    exact = multivariate_normal(run.x[0, 0] * np.exp(-RATE * t), covariance).logpdf(y)
    assert system.log_likelihood(system.start) == pytest.approx(exact, abs=1e-3)


@pytest.mark.slow
def test_constants_are_within_their_errors():
    """Over 20 paths the errors of rate and variance are as large as their standard errors say."""
    ratios = []
    for seed in range(20):
        system = StochasticSystem(
            {"x": -0.5 * X}, {"x": sympy.Float(1.0)}, Series.of([relaxing(seed)]).apart()
        )
        fit = system.fit()
        ratios.append((fit.values - [-RATE, np.log(LEVEL)]) / fit.sizes)
    assert 0.5 < np.std(ratios) < 1.5 and np.max(np.abs(ratios)) < 4


@pytest.mark.slow
@pytest.mark.parametrize("errors", [(0.0, 0.0), (0.01, 0.05)])
def test_intervals_hold_the_truth_in_90_to_98_percent(errors):
    """Over 16 paths, of rate and variance, with errors of measurement of a share of the spread."""
    inside = []
    for seed in range(16):
        error = errors[seed % 2]
        run = relaxing(seed, rows=201, error=error * np.sqrt(LEVEL / (2 * RATE)))
        series = Series.of([run]) if error else Series.of([run]).apart()
        size = {"x": 0.5 * error} if error else {}
        system = StochasticSystem({"x": -1.1 * X}, {"x": sympy.Float(0.6)}, series, size)
        fit = system.fit()
        missed = np.abs(fit.values[:2] - [-RATE, np.log(LEVEL)])
        inside.append(missed <= interval_reach(len(run) - 2) * fit.sizes[:2])
    low, high = binom.ppf([0.01, 0.99], np.size(inside), [0.90, 0.98])
    assert low <= np.sum(inside) <= high


@pytest.mark.parametrize("start", [(5.0, 0.1, -2.0), (-3.0, 2.0, 4.0), (0.1, -5.0, 1.0)])
def test_each_term_has_its_own_constant(start):
    """SymPy orders the terms of a formula by its numbers; what is said of each stays with it."""
    one, two, three = map(sympy.Float, start)
    drift = {"x": one + two * X + three * X**3}
    noise = {"x": sympy.Float(abs(start[0])) * X**2 + sympy.Float(abs(start[1]))}
    fit = StochasticSystem(drift, noise, Series.of([relaxing()]).apart()).fit()
    for parts, whole in ((fit.parts("x"), fit.drift), (fit.noise_parts("x"), fit.diffusion)):
        assert len(parts) == len(sympy.Add.make_args(whole["x"]))
        for part in parts:
            own = float(whole["x"].coeff(X, sympy.degree(part.body, X)))
            assert part.factor == pytest.approx(own)
            (place,) = part.outside
            assert own in (fit.values[place], pytest.approx(np.exp(fit.values[place])))


@pytest.mark.slow
def test_noise_in_the_motion_is_found(found):
    """Drift, variance and verdict, with intervals that hold the truth."""
    assert bodies(found.equations["x"]) == {X} and found.verdict.level == "law"
    assert str(found).startswith("Law: with noise in the motion")
    (rate,), (noise,) = found.constants["x"], found.diffusion["x"].terms
    assert rate.low < -RATE < rate.high
    assert noise.body == "1" and noise.low < LEVEL < noise.high
    assert "Noise in the motion of x: variance 0.4937 in unit" in str(found)


def test_errors_of_measurement_are_no_noise_in_the_motion():
    """A decay measured with errors has none; a process with noise in its motion has, for sure."""
    t = np.linspace(0, 4, 401)
    x = np.exp(-t) + 0.02 * np.random.default_rng(0).standard_normal(401)
    measured = measure_motion_noise([Trajectory(t, x[:, None], ("x",))], "x")
    assert not measured.is_sure and measured.error == pytest.approx(0.02, rel=0.2)
    moved = measure_motion_noise([relaxing()], "x")
    assert moved.is_sure and moved.diffusion == pytest.approx(LEVEL, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("error", [0.0, 0.02])
def test_two_states_have_noise_in_proportion_to_their_size(error):
    """Prey and predator: both drifts, and variances that grow as the squares."""
    found = dynsr.discover(eaten(error=error), stochastic=True, jobs=1)
    assert bodies(found.equations["x"]) == {X, X * Y}
    assert bodies(found.equations["y"]) == {Y, X * Y}
    for state, own in found.diffusion.items():
        middle = float(own.expr.subs(state, 2.0))
        assert middle == pytest.approx(0.002 * 2.0**2, rel=0.4)
        if not error:
            assert [term.body for term in own.terms] == [f"{state}**2"]
            assert own.terms[0].low < 0.002 < own.terms[0].high
        assert own.error == pytest.approx(error, rel=0.5, abs=0.002)


@pytest.mark.slow
def test_noise_of_a_velocity_is_none_of_the_position():
    """Of x' = v the position has no noise of its own, and its equation is bare."""
    t = np.linspace(0, 40, 1201)
    x = paths(lambda x, v: [v, -x - 0.4 * v], lambda x, v: [0.0, 0.1], [1.0, 0.0], t, 3)
    found = dynsr.discover(Trajectory(t, x, ("x", "v")), stochastic=True, jobs=1)
    assert str(found.equations["x"]) == "v" and not found.diffusion["x"].is_seen
    assert "No noise in the motion of x is seen." in str(found)


@pytest.mark.slow
def test_noises_that_go_together_are_correlated():
    """Two walks whose steps are drawn together."""
    root = np.linalg.cholesky([[1.0, 0.7], [0.7, 1.0]])
    t = np.linspace(0, 50, 1001)
    x = paths(lambda x, y: [-x, -y], lambda x, y: [0.5, 0.5], [1.0, 1.0], t, 2, root=root)
    found = dynsr.discover(Trajectory(t, x, ("x", "y")), stochastic=True, jobs=1)
    assert found.diffusion["x"].correlations["y"] == pytest.approx(0.7, abs=0.06)


@pytest.mark.slow
def test_a_walk_without_a_drift_moves_by_chance_alone():
    """Nothing but noise is a drift of 0, and no formula is made of it."""
    walk = np.cumsum(np.random.default_rng(5).standard_normal(2000))
    found = dynsr.discover(
        Trajectory(np.arange(2000.0), walk[:, None], ("x",)), stochastic=True, jobs=1
    )
    assert found.equations == {"x": 0}
    assert found.diffusion["x"].terms[0].value == pytest.approx(1.0, rel=0.1)


@pytest.mark.slow
def test_noise_with_a_memory_is_no_law():
    """Of one column of two, neighbouring steps are missed by the same, and that is said."""
    t = np.linspace(0, 100, 1001)
    x = paths(lambda x, y: [y - x, -2 * y], lambda x, y: [0.05, 2.0], [0.0, 0.0], t, 4)
    found = dynsr.discover(Trajectory(t, x[:, :1], ("x",)), stochastic=True, jobs=1)
    assert found.verdict.level != "law"
    assert "the motion remembers more than its state" in found.verdict.reason


def test_paths_have_the_variance_of_the_process(found):
    """In rest it is D / (2 a); the same seed gives the same paths."""
    drawn = found.simulate_paths(2000, [0.0], [0.0, 2.0, 4.0], seed=1)
    rate, level = -found.constants["x"][0].value, found.diffusion["x"].terms[0].value
    spread = np.var([path.x[-1, 0] for path in drawn])
    assert spread == pytest.approx(level / (2 * rate), rel=0.1)
    again = found.simulate_paths(2000, [0.0], [0.0, 2.0, 4.0], seed=1)
    assert np.array_equal(drawn[7].x, again[7].x)


@pytest.mark.slow
def test_other_units_give_the_same_equations(found):
    """In days and in thousandths, rates and variances are in these units."""
    run = relaxing()
    other = Trajectory(86400 * run.t, 1000 * run.x, ("x",))
    both = found, dynsr.discover(other, stochastic=True, jobs=1)
    rates = [own.constants["x"][0].fitted for own in both]
    levels = [own.diffusion["x"].terms[0].value for own in both]
    assert rates[1] * 86400 == pytest.approx(rates[0], rel=1e-3)
    assert levels[1] * 86400 / 1e6 == pytest.approx(levels[0], rel=1e-3)


@pytest.mark.slow
def test_it_is_kept_and_shown(found, tmp_path):
    """The record has the noise, and so have the report, its pictures and the scores."""
    again = dynsr.load(found.save(tmp_path / "d.json"))
    assert again.diffusion == dict(found.diffusion)
    page = found.report(tmp_path / "report.html").read_text("utf-8")
    assert "Noise in the motion of x: variance" in page and 'id="noise"' in page
    assert found.score()["x"]["step_size"] == pytest.approx(1.0, abs=0.1)
    (cells,) = cells_of(found.steps_of())
    off = (cells.slope - cells.drift) / cells.error
    assert np.sqrt(np.mean(off**2)) < 2
    found.plot()
    assert "Noise in the motion of x: variance" in found.to_python()
    for ask in (found.profiles, found.suggest, found.identifiability):
        with pytest.raises(InputError, match="the motion has noise"):
            ask()


@pytest.mark.slow
def test_empty_cells_are_left_out():
    """Steps between rows that were measured are all that counts."""
    run = relaxing()
    x = run.x.copy()
    x[::10] = np.nan
    found = dynsr.discover(Trajectory(run.t, x, ("x",)), stochastic=True, jobs=1)
    assert bodies(found.equations["x"]) == {X}


def test_what_does_not_go_together_is_refused():
    """One line names what to leave out."""
    run = relaxing(rows=101)
    for more in ({"delays": True}, {"order": 2}, {"known": {"x": "-x"}}):
        with pytest.raises(InputError, match=f"{next(iter(more))} does not go with stochastic"):
            dynsr.discover(run, stochastic=True, **more)
    columns = {"t": run.t, "x": run.x[:, 0], "x_sd": np.full(len(run), 0.1)}
    for source, more in ((run, {"noise": {"x": 0.1}}), (columns, {})):
        with pytest.raises(InputError, match=r"^the known measurement errors of x do not .*states"):
            dynsr.discover(source, stochastic=True, **more)
    with pytest.raises(InputError, match="have no noise in the motion"):
        Discovery({"x": -X}, {"x": ()}, {}, {}).simulate_paths()


def test_other_units_of_a_diffusion():
    """D of x in thousandths and seconds, from D in ones and minutes."""
    own = Diffusion((DiffusionTerm("x**2", 2.0, 1.0, 3.0), DiffusionTerm("1", 4.0)), ("x",), 0.5)
    new = own.in_units("x", {"x": sympy.Integer(1000)}, sympy.Integer(60))
    assert [term.value for term in new.terms] == pytest.approx([2 / 60, 4e6 / 60])
    assert new.terms[0].high == pytest.approx(3 / 60) and new.error == 500.0


@pytest.mark.slow
def test_the_shell_finds_and_shows_it(tmp_path):
    """The command says what the noise is, and which options do not go together."""
    write_csv(relaxing(rows=601, end=30.0), tmp_path / "walk.csv")
    own = ("--stochastic", "-j", "1", "-o", tmp_path / "out")
    said = run_command("discover", tmp_path / "walk.csv", *own).stdout
    assert "Noise in the motion of x: variance" in said and "x' = -" in said
    asked = ("discover", tmp_path / "walk.csv", "--stochastic", "--delays", "auto")
    assert "delays does not go with stochastic" in run_command(*asked, code=2).output
