"""Hidden: equations with one state that nobody measured."""

from __future__ import annotations

import json

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.stats import binom

from dynsr import Discovery, DiscoverySettings, InputError, Trajectory, discover
from dynsr.discovery.uncertainty import bootstrap
from dynsr.discovery.unmeasured import (
    coupling_of,
    describe_hidden,
    estimate_hidden,
    number_runs,
)
from dynsr.errors import DynsrWarning
from dynsr.expression import evaluate
from dynsr.fit import Measurements, fit_along, interval_reach, residual_bits
from dynsr.fit.collocation import covariance_of
from dynsr.jobs import FolderTaken
from dynsr.selection import (
    ComparisonSettings,
    Coupling,
    HiddenSettings,
    best_alone,
    find_hidden,
    law_of,
)
from dynsr.selection.hidden import HiddenComparison, first_curve, write_law
from tests.command_line import run

X, Y = sympy.symbols("x y")
# A hidden state that multiplies nothing, or a column too: whatever else it may multiply takes as
# long to be tried.
PLAIN, FEW = (
    DiscoverySettings(hidden=HiddenSettings(couplings=count, improved=1)) for count in (1, 2)
)


def follow(slopes, start, end, rows):
    """Give times, and the states of an exact solution."""
    t = np.linspace(0, end, rows)
    return t, solve_ivp(slopes, (0, end), start, t_eval=t, rtol=1e-10, atol=1e-12).y.T


def see(pair, noise=0.0, seed=0, names=("x",), columns=(0,)):
    """Give some of the states as they are measured."""
    t, whole = pair
    x = whole[:, list(columns)]
    errors = np.random.default_rng(seed).normal(size=x.shape)
    return Trajectory(t, x + noise * x.std(axis=0) * errors, names)


def pendulum(noise=0.0, seed=0):
    """Give the angle of a pendulum with friction: x'' = -2 sin(x) - 0.3 x'."""
    pair = follow(lambda t, z: [z[1], -2 * np.sin(z[0]) - 0.3 * z[1]], [2.0, 0.0], 12, 200)
    return see(pair, noise, seed)


def prey(noise=0.0, seed=0):
    """Give the prey of Lotka and Volterra's equations, without the predator."""
    pair = follow(
        lambda t, z: [1.1 * z[0] - 0.4 * z[0] * z[1], 0.1 * z[0] * z[1] - 0.4 * z[1]],
        [10.0, 5.0],
        30,
        200,
    )
    return see(pair, noise, seed)


def fit_prey(noise, seed=0):
    """Give a fit of the law of the prey, and of a predator in the scale of its factor."""
    law = {"x": 1.1 * X - X * Y, "y": 0.1 * X * Y - 0.4 * Y}
    data = Measurements.of(number_runs([prey(noise, seed)]), {}, 2000)
    coupling = Coupling("y", "x", X, sympy.S.NegativeOne)
    return fit_along(law, first_curve(data, coupling, law))


def terms(expr):
    """Give the terms of an equation without their factors."""
    return {term.as_coeff_Mul()[1] for term in sympy.Add.make_args(sympy.expand(expr))}


def holds(found, state, term, truth):
    """Whether the interval of a constant holds its true value."""
    (own,) = [c for c in found.constants[state] if c.of == term]
    return own.low <= truth <= own.high


@pytest.mark.slow
def test_many_rows_with_a_hidden_state_are_said_to_take_long():
    """All of them are fitted at once, and how many would do is said before the search."""
    t = np.linspace(0, 20, 6000)
    run = Trajectory(t, np.cos(t)[:, None], ("x",))
    with pytest.warns(DynsrWarning, match=r"all 6,000 rows are fitted .* y, .*one row in 6 shows"):
        discover(run, hidden="y", time_budget=0.5, jobs=1)


@pytest.mark.slow
def test_the_law_is_the_same_however_a_hidden_state_is_written():
    """h + p(x) in the place of h changes both equations, and x'' not: 20 random shifts."""
    rng = np.random.default_rng(3)
    coupling = Coupling("y", "x", X, -1)
    exprs = {"x": 1.1 * X - X * Y, "y": 0.1 * X * Y - 0.4 * Y}
    law = law_of(exprs, coupling)["y"]
    for a, b in rng.normal(size=(20, 2)):
        moved = coupling.shifted(exprs, sympy.Float(a) + sympy.Float(b) * X)
        difference = sympy.expand(law_of(moved, coupling)["y"] - law)
        assert max(abs(float(c)) for c in difference.as_coefficients_dict().values()) < 1e-12


def test_a_power_of_a_size_has_a_law():
    """Of x' = y - |x| the law has the sign of x, which is a number in every row."""
    exprs = {"x": Y - abs(X), "y": -2.0 * X * abs(X) ** 0.5}
    law = law_of(exprs, Coupling("y", "x"))["y"]
    assert law.free_symbols == {X, sympy.Symbol("x'")} and not law.has(sympy.Derivative)
    columns = {"x": np.array([-4.0, 4.0]), "x'": np.array([1.0, 1.0])}
    # y' less what |x| changes: 2*4*2 + 1, and -2*4*2 - 1.
    assert evaluate(law, columns) == pytest.approx([17.0, -17.0])


def test_a_law_is_written_with_the_equation_of_another_system():
    """x'' = -4 x with x' = y - x instead of x' = y: the same law, by other equations."""
    other = {"x": Y - X, "y": 0.5 * X}
    law = law_of({"x": Y, "y": -4.0 * X}, Coupling("y", "x"))
    moved = write_law(law, other, Coupling("y", "x"))
    assert moved["x"] == other["x"]
    assert sympy.expand(law_of(moved, Coupling("y", "x"))["y"] + 4 * X) == 0


def test_what_an_unmeasured_state_misses_of_its_equation_takes_bits():
    """Its defects are Gaussian of known size: a sum of squares of 6 is 3 / ln 2 bits."""
    squares, rows = np.array([1.0, 6.0]), np.array([100.0, 0.0])
    assert residual_bits(squares, rows) == pytest.approx(3 / np.log(2))
    assert residual_bits(np.array([1.0, np.inf]), rows) == np.inf


@pytest.mark.slow
def test_small_defects_of_a_hidden_state_are_no_way_to_follow_noise():
    """The law misses noise alone, as its own solution does; what follows the data by small defects
    of a state that nothing measures misses far more, and no more than its own solution.
    """
    run = pendulum(0.05)
    data = first_curve(Measurements.of([run], {}, 2000), Coupling("y", "x"))
    mesh, settings = data.mesh(("x", "y")), ComparisonSettings()

    def missed(slope):
        """Mean squared misses: of the states, as they count, and of an independent solution."""
        exprs = {"x": Y, "y": slope}
        found = HiddenComparison(mesh, settings, coupling=Coupling("y", "x")).fit(exprs)
        own, start = sympy.lambdify([X, Y], found.exprs["y"]), found.fit.states[0]
        span = (0, run.t[-1])
        solved = solve_ivp(lambda t, z: [z[1], own(*z)], span, start, t_eval=mesh.t, rtol=1e-8)
        apart = ((solved.y[0] - mesh.x[:, 0]) * mesh.weights[:, 0])[mesh.measured]
        states = np.sum(found.fit.misses[:, 0] ** 2) / mesh.rows[0]
        return states, found.fit.mean_squares[0], np.mean(apart**2)

    followed, counted, solved = missed(-2.0 * sympy.sin(X) - 0.3 * Y)
    assert followed <= counted < 1.1 and counted == pytest.approx(solved, rel=1e-3)
    followed, counted, solved = missed(3.0 * sympy.sin(20.0 * X))
    assert followed < 15 and 5 * followed < counted <= solved


def test_a_constant_that_says_nothing_is_unknown_and_no_fault():
    """An information of 0 next to huge numbers is no error of linear algebra: inf, others stay."""
    found = covariance_of(np.array([[0.0, 1e139, 0.0], [1e139, 4.0, 0.0], [0.0, 0.0, 9.0]]))
    assert np.isinf(found[0]).all()
    assert found[1:, 1:] == pytest.approx(np.diag([0.25, 1 / 9]))


@pytest.mark.slow
def test_what_changes_sign_multiplies_no_hidden_state():
    """Where x passes 0, x' = x**2 y shows nothing of y: such systems are not proposed."""
    data = Measurements.of([pendulum(0.05)], {}, 2000)
    settings = ComparisonSettings()
    found = find_hidden(data, "y", "x", best_alone(data, settings)["x"], settings)
    assert {one.coupling.body for one in found} == {sympy.S.One}


def test_a_turned_sign_is_the_same_law():
    """-h in the place of h: the factor changes its sign, and x'' stays."""
    coupling, exprs = Coupling("y", "x"), {"x": Y + X, "y": -4.0 * X + Y**2}
    other, turned = coupling.turned(exprs)
    assert turned == {"x": X - Y, "y": 4.0 * X - Y**2}
    assert other.keeps(turned["x"]) and not coupling.keeps(turned["x"])
    assert sympy.expand(law_of(turned, other)["y"] - law_of(exprs, coupling)["y"]) == 0


@pytest.mark.slow
def test_a_hidden_state_adds_nothing_to_the_measurements():
    """Its curve has no weight, its noise no size, and the other state is as it was."""
    data = Measurements.of([pendulum(0.01)], {}, 2000)
    wider = data.with_hidden("y", [data.smoothed[0].slope[:, 0]])
    own, mesh = data.mesh(("x",)), wider.mesh(("x", "y"))
    assert mesh.rows.tolist() == [200.0, 0.0]
    assert np.array_equal(mesh.weights[:, 0], own.weights[:, 0])
    assert wider.noise_share == data.noise_share
    assert wider.known(("x", "y")).tolist() == [False, True]


@pytest.mark.slow
def test_a_pendulum_is_found_from_its_angle_alone():
    """Clean: x'' = -2 sin(x) - 0.3 x', a law; the constants to five digits."""
    found = discover(pendulum(), hidden="y", jobs=1)
    assert found.verdict.level == "law"
    assert found.equations["x"] == Y
    assert terms(found.equations["y"]) == {Y, sympy.sin(X)}
    values = {str(k): float(v) for k, v in found.equations["y"].as_coefficients_dict().items()}
    assert values == pytest.approx({"sin(x)": -2.0, "y": -0.3}, rel=1e-5)


@pytest.mark.slow
def test_a_pendulum_is_found_in_noise():
    """In 5 % noise: the same law, and the intervals hold the truth."""
    found = discover(pendulum(0.05), hidden="y", jobs=1)
    assert found.verdict.level == "law"
    assert terms(found.equations["y"]) == {Y, sympy.sin(X)}
    assert holds(found, "y", "sin(x)", -2.0) and holds(found, "y", "y", -0.3)


@pytest.mark.slow
def test_a_predator_is_found_from_its_prey():
    """Of prey in billions; the scale of the predator is chosen, 0.4 y here; the other constants are
    the true ones. In the units of the search, 1e-10 is a factor of 1, and it has an interval too.
    """
    seen = prey(0.05)
    found = discover(Trajectory(seen.t, 1e9 * seen.x, ("x",)), hidden="y", jobs=1)
    assert found.verdict.level == "law"
    assert found.hidden == {"y": -X * Y}
    assert terms(found.equations["x"]) == {X, X * Y}
    assert terms(found.equations["y"]) == {Y, X * Y}
    assert found.trajectories[0].x[:, 1].min() > 0
    assert holds(found, "x", "x", 1.1)
    assert holds(found, "y", "x*y", 0.1e-9) and holds(found, "y", "y", -0.4)


@pytest.mark.slow
def test_intervals_hold_the_truth_in_90_to_98_percent():
    """Over 40 draws, at 1 % and 5 % in turn, of the three constants that the prey determines."""
    truth, inside = np.array([1.1, 0.1, -0.4]), []
    for seed in range(40):
        fit = fit_prey((0.01, 0.05)[seed % 2], seed)
        near = truth[np.argmin(np.abs(fit.constants[:, None] - truth), axis=1)]
        inside.append(np.abs(fit.constants - near) <= interval_reach(fit.freedom) * fit.errors)
    # The errors of the three go together, so a draw counts once.
    low, high = binom.ppf([0.01, 0.99], len(inside), [0.90, 0.98])
    assert low <= np.mean(inside) * len(inside) <= high


@pytest.mark.slow
def test_the_start_of_the_hidden_state_is_fitted():
    """The predator begins at 5, which is 2 in the chosen scale; the curve is that of the truth."""
    fit = fit_prey(0.01)
    truth = follow(
        lambda t, z: [1.1 * z[0] - 0.4 * z[0] * z[1], 0.1 * z[0] * z[1] - 0.4 * z[1]],
        [10.0, 5.0],
        30,
        200,
    )[1][:, 1]
    missed = fit.found.states[:, 1] - 0.4 * truth
    assert np.sqrt(np.mean(missed**2)) < 0.02 * np.std(0.4 * truth)


@pytest.mark.slow
def test_two_compartments_have_no_more_constants_than_one_of_them_shows():
    """Of three rates the measured compartment shows two: the sum, and a product; both are found."""
    pair = follow(
        lambda t, z: [-1.1 * z[0] + 0.3 * z[1], 0.5 * z[0] - 0.3 * z[1]], [10.0, 0.0], 10, 200
    )
    found = discover(see(pair), hidden="y", settings=PLAIN, jobs=1)
    (term,) = found.hidden.values()
    law = law_of(found.equations, coupling_of("y", term, found.equations))["y"]
    shown = {str(k): float(v) for k, v in law.as_coefficients_dict().items()}
    assert found.verdict.level == "law"
    assert shown == pytest.approx({"x": -0.6 * 0.3, "x'": -1.4}, rel=1e-3)


@pytest.mark.slow
def test_what_five_percent_of_noise_do_not_tell_is_no_law():
    """Two exponentials in 5 % noise: other systems fit as well, and the verdict says so."""
    pair = follow(
        lambda t, z: [-1.1 * z[0] + 0.3 * z[1], 0.5 * z[0] - 0.3 * z[1]], [10.0, 0.0], 10, 200
    )
    found = discover(see(pair, 0.05), hidden="y", jobs=1)
    assert found.verdict.level != "law"


@pytest.mark.slow
def test_a_chain_is_found_from_its_ends():
    """a -> b -> c with b not measured: c'' = 0.15 a - 0.03 c - 0.4 c', and a' = -0.5 a."""
    pair = follow(
        lambda t, z: [-0.5 * z[0], 0.5 * z[0] - 0.3 * z[1], 0.3 * z[1] - 0.1 * z[2]],
        [10.0, 0.0, 0.0],
        20,
        201,
    )
    run = see(pair, 0.01, 0, ("a", "c"), (0, 2))
    found = discover(run, hidden="b", settings=PLAIN, jobs=1)
    assert found.verdict.level == "law"
    assert "c'' = 0.15*a - 0.03*c - 0.4*c'" in found.hidden_notes["b"]


@pytest.mark.slow
def test_empty_cells_and_two_runs_have_one_law():
    """Three of ten angles are empty, and another run begins elsewhere: one law, and two starts."""
    first, second = pendulum(0.01), pendulum(0.01, 7)
    gaps = np.where(np.random.default_rng(0).random((200, 1)) < 0.3, np.nan, first.x)
    runs = [Trajectory(first.t, gaps, ("x",)), second.select(np.arange(60, 200))]
    found = discover(runs, hidden="y", jobs=1)
    assert found.verdict.level == "law"
    assert found.equations == {"x": Y, "y": -0.3 * Y - 2 * sympy.sin(X)}
    assert np.array_equal(np.isnan(found.trajectories[0].observed[:, 0]), np.isnan(gaps[:, 0]))
    truth = np.gradient(pendulum().x[:, 0], first.t)[60]
    assert found.trajectories[1].x[0, 1] == pytest.approx(truth, rel=0.02)


@pytest.mark.slow
def test_an_input_acts_on_the_hidden_state():
    """A measured force on an oscillator with friction: x'' = u - 4 x - 0.3 x'."""
    t = np.linspace(0, 20, 300)
    u = np.sin(1.3 * t) + 0.5 * np.sin(0.4 * t)
    _, w = follow(
        lambda t, z: [
            z[1],
            np.sin(1.3 * t) + 0.5 * np.sin(0.4 * t) - 4 * z[0] - 0.3 * z[1],
        ],
        [1.0, 0.0],
        20,
        300,
    )
    noisy = w[:, 0] + 0.005 * np.random.default_rng(1).normal(size=300)
    table = {"t": t, "x": noisy, "u": u}
    found = discover(table, inputs=["u"], hidden="y", settings=PLAIN, jobs=1)
    assert "x'' = u - 4*x - 0.3*x'" in found.hidden_notes["y"]
    assert found.verdict.level == "law" and found.hold == {"u": "smooth"}


@pytest.mark.slow
def test_an_input_acts_on_the_state_that_hides_another():
    """An infusion into the compartment that is measured: what the data determine has its slope.

    x' = u - 0.5 x + 0.2 y, y' = 0.3 x - 0.2 y, so that x'' = u' + 0.2 u - 0.7 x' - 0.04 x.
    """
    t = np.linspace(0, 20, 150)
    _, w = follow(
        lambda t, z: [np.sin(t) - 0.5 * z[0] + 0.2 * z[1], 0.3 * z[0] - 0.2 * z[1]],
        [1.0, 0.5],
        20,
        150,
    )
    table = {"t": t, "x": w[:, 0]}
    found = discover(table, inputs={"u": "sin(t)"}, hidden="y", settings=PLAIN, jobs=1)
    assert found.verdict.level == "law"
    law = law_of(found.equations, coupling_of("y", found.hidden["y"], found.equations))["y"]
    slopes = {name: float(law.coeff(sympy.Symbol(name))) for name in ("u'", "u", "x'", "x")}
    assert slopes == pytest.approx({"u'": 1.0, "u": 0.2, "x'": -0.7, "x": -0.04}, rel=1e-3)
    assert "x'' = u' + 0.2*u" in found.hidden_notes["y"].replace("0.2*u + u'", "u' + 0.2*u")


@pytest.mark.slow
def test_data_that_need_no_hidden_state_get_none():
    """Logistic growth: its own equation takes fewer bits, and the explanation says so."""
    t = np.linspace(0, 10, 100)
    x = 4 / (1 + 7 * np.exp(-0.9 * t))
    noisy = x + 0.02 * np.random.default_rng(0).normal(size=100)
    found = discover((t, noisy[:, None]), hidden="y", jobs=1)
    assert list(found.equations) == ["x"] and not found.hidden
    assert found.verdict.level == "law"
    assert found.explanation["x"].endswith("No y is needed.")


@pytest.mark.slow
def test_a_discovery_with_a_hidden_state_is_kept_whole(tmp_path):
    """Of 1 % noise: saved and loaded it is the same; it is drawn, reported and simulated, and its
    profiles are bounded.
    """
    found = discover(pendulum(0.01), hidden="y", jobs=1, out=tmp_path / "out")
    assert found.verdict.level == "law"
    assert terms(found.equations["y"]) == {Y, sympy.sin(X)}
    assert holds(found, "y", "sin(x)", -2.0) and holds(found, "y", "y", -0.3)
    again = Discovery.load(tmp_path / "out" / "discovery.json")
    assert again.equations == found.equations and again.hidden == found.hidden
    assert found.simulate().x.shape == (200, 2)
    assert [profile.bounded for profile in found.profiles()] == [(True, True)] * 2
    assert found.identifiability().unknown == ()
    assert list(found.score()) == ["x"]
    page = found.report(tmp_path / "page.html").read_text()
    assert "Nobody measured y" in page
    assert found.plot().axes[1].get_ylabel() == "y, not measured"
    for ask in (found.suggest, found.hybrid, found.vary, lambda: bootstrap(found)):
        with pytest.raises(InputError, match="every state was measured, and y was not"):
            ask()
    with pytest.raises(FolderTaken, match="give another folder"):
        discover(pendulum(0.02), hidden="y", jobs=1, out=tmp_path / "out")
    found.export("petab", tmp_path / "petab")
    # What nobody measured is no measurement of a problem.
    for name in ("measurements.tsv", "observables.tsv", "parameters.tsv"):
        assert "_x" in (text := (tmp_path / "petab" / name).read_text()) and "_y" not in text


@pytest.mark.slow
def test_huge_numbers_change_the_scale_alone(tmp_path):
    """Clean prey counted in billions: the factor of the hidden state stays -1, the rates as they
    are, and the equations are a law.
    """
    run_ = prey()
    data = Trajectory(run_.t, 1e9 * run_.x, ("x",))
    found = discover(data, hidden="y", settings=FEW, jobs=1, out=tmp_path)
    assert Discovery.load(tmp_path / "discovery.json").equations == found.equations
    assert found.verdict.level == "law"
    assert found.hidden == {"y": -X * Y}
    assert terms(found.equations["y"]) == {Y, X * Y}
    rates = found.equations["x"].as_coefficients_dict()
    assert float(rates[X]) == pytest.approx(1.1, rel=1e-4)
    assert float(rates[X * Y]) == -1


@pytest.mark.slow
def test_the_shell_finds_a_hidden_state(tmp_path):
    """--hidden y prints both equations and what the data determine; JSON has it."""
    angle = pendulum(0.01)
    table = tmp_path / "angle.csv"
    rows = np.column_stack([angle.t, angle.x])
    np.savetxt(table, rows, delimiter=",", header="t,x", comments="")
    said = run("discover", table, "--hidden", "y", "--out", tmp_path / "out")
    assert "x' = y" in said.stdout and "Nobody measured y." in " ".join(said.stdout.split())
    # The second time nothing is searched.
    again = run("discover", table, "--hidden", "y", "--json", "--out", tmp_path / "out")
    assert "x'' = " in json.loads(again.stdout)["hidden"]["y"]


def test_the_hidden_state_of_other_data_follows_from_the_equations():
    """Known equations and another angle: the velocity is fitted, and nothing else is."""
    equations = {"x": Y, "y": -2.0 * sympy.sin(X) - 0.3 * Y}
    t, truth = follow(lambda t, z: [z[1], -2 * np.sin(z[0]) - 0.3 * z[1]], [1.0, 1.0], 8, 150)
    found = estimate_hidden([see((t, truth), 0.01, 5)], "y", Y, equations, {}, 2000)
    missed = found[0].x[:, 1] - truth[:, 1]
    assert np.sqrt(np.mean(missed**2)) < 0.01 * truth[:, 1].std()
    assert found[0].measured[:, 0].all() and not found[0].measured[:, 1].any()


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"hidden": "x"}, "'x' is a column of the data"),
        ({"hidden": 2}, "one state can be hidden"),
        ({"hidden": "2y"}, "2y"),
        ({"hidden": "y", "order": 2}, "order does not go with a hidden state"),
        ({"hidden": True, "delays": True}, "delays does not go with a hidden state"),
        ({"hidden": 1, "known": {"x": "x"}}, "known does not go with a hidden state"),
        ({"hidden": "y", "must": "x: x*y"}, "must has 'x\\*y' of 'x', but nobody measured y"),
        ({"hidden": "y", "must": {"y": "x"}}, "must has 'x' of 'y', but nobody measured y"),
        ({"hidden": "y", "terms": ["x*y**2"]}, "terms has 'x\\*y\\*\\*2', but nobody measured y"),
        ({"hidden": "y", "preset": "fast"}, "unknown preset 'fast'"),
        ({"hidden": "y", "engine": "fast"}, "unknown engine 'fast'"),
    ],
)
def test_what_does_not_go_with_a_hidden_state_is_refused(asked, words):
    """One line that names the option, before anything is searched."""
    t = np.linspace(0, 1, 20)
    with pytest.raises(InputError, match=words) as refused:
        discover((t, np.exp(-t)[:, None]), **asked)
    assert "\n" not in str(refused.value)


def test_what_is_said_of_a_hidden_state_names_its_law():
    """The note has the chosen term, and the equation of x'' without the hidden state."""
    said = describe_hidden("y", -X * Y, {"x": 2.0 * X - X * Y, "y": -3.0 * Y})
    assert "so that x' contains -x*y" in said
    assert "x'' = 6*x - 3*x' + x'**2/x" in said


@pytest.mark.slow
def test_noise_around_0_hides_no_factor_of_a_hidden_state():
    """An epidemic of which few are ill first and last: 5 % of noise takes some rows below 0.

    Those who may fall ill are hidden, and multiplied with those who are. Without that product
    another system followed as well and was called a law.
    """
    pair = follow(
        lambda t, z: [0.6 * z[0] * z[1] - 0.2 * z[0], -0.6 * z[0] * z[1]], [0.01, 1.5], 40, 201
    )
    data = see(pair, 0.05, 1, ("I",))
    assert np.sum(data.x < 0) > 5
    found = discover(data, hidden="S", preset="quick", jobs=1)
    i, s = sympy.symbols("I S")
    shapes = {name: set(expr.as_coefficients_dict()) for name, expr in found.equations.items()}
    assert shapes == {"I": {i * s, i}, "S": {i * s}}
    assert found.verdict.level == "law"
    assert found.equations["S"].coeff(i * s) == pytest.approx(-0.6, rel=0.1)
