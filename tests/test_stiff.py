import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.samples import Samples
from dynsr.data.slopes import choose_samples, find_layers
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.search import discover
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import score_candidate
from dynsr.fit.shooting import build_shooting, prepare
from dynsr.methods import RationalSearch
from dynsr.selection.pick import explains_all, forecast_errors
from dynsr.verdict import layers
from dynsr.verdict.flow_verdict import give_verdict

MU = 50.0


def relaxation(t=None, end=150, tolerance=1e-9):
    """Give Van der Pol's oscillator at mu = 50 to an end, at these times or at Radau's own."""
    solved = solve_ivp(
        lambda t, x: [x[1], MU * (1 - x[0] ** 2) * x[1] - x[0]],
        (0, end),
        [2.0, 0.0],
        "Radau",
        t,
        rtol=tolerance,
        atol=tolerance / 100,
    )
    return Trajectory(solved.t, solved.y.T, ("x", "y"))


@pytest.fixture(scope="module")
def even():
    """Give 1000 even rows: a jump takes a tenth of the time from one row to the next."""
    return relaxation(np.linspace(0, 150, 1000))


def law(samples):
    """Give the true slopes of y at the rows of samples."""
    x, y = samples.X.T
    return MU * (1 - x**2) * y - x


@pytest.mark.slow
def test_rows_in_unresolved_jumps_have_no_slope(even):
    """The rows kept, most of all, have slopes exact to 1e-6; those beside jumps are left out."""
    samples = choose_samples(even, "y")
    assert samples.layers and samples.scheme == "central8"
    assert 0.8 * len(even) < len(samples) < len(even) - 8
    assert np.abs(samples.y - law(samples)).max() < 1e-6
    left_out = ~np.isin(even.t[4:-4], samples.t)
    assert np.abs(even.x[4:-4, 1][left_out]).max() == np.abs(even.x[4:-4, 1]).max()


@pytest.fixture(scope="module")
def own():
    """Give Radau's own rows, close in the jumps and far apart between them."""
    return relaxation(tolerance=1e-8)


@pytest.mark.slow
def test_rows_in_resolved_jumps_keep_their_slope(own):
    """Radau's own rows resolve every jump: none is a layer, and the steepest slope is there."""
    samples = choose_samples(own, "y")
    assert not samples.layers
    assert np.abs(samples.y).max() > 0.9 * np.abs(law(samples)).max()


@pytest.mark.parametrize(
    "x",
    [
        lambda t: np.exp(-0.5 * t),
        np.sin,
        lambda t: 1 / (1 + np.exp(-3 * (t - 5))),
        lambda t: np.sin(t) + np.random.default_rng(0).normal(0, 1e-3, len(t)),
    ],
    ids=["decay", "oscillation", "growth", "noise"],
)
def test_what_moves_smoothly_has_no_layers(x):
    """Decays, oscillations, saturating growth and noise keep all their rows."""
    t = np.linspace(0, 10, 400)
    assert find_layers(t, x(t)) is None


def test_nothing_explains_jumps_by_being_small_elsewhere(even):
    """0 misses most rows by little, and all that the slopes are made of."""
    t, y = even.t[1:-1], np.gradient(even.x[:, 1], even.t)[1:-1]
    samples = Samples(even.x[1:-1], y, ("x", "y"), "y", "given", t)
    assert np.median(np.abs(y)) < 5e-4 * np.sqrt(np.mean(y**2))
    assert not explains_all(score_candidate(sympy.S.Zero, samples), samples)


@pytest.mark.slow
@pytest.mark.parametrize("rows", ["even", "adaptive"])
def test_a_stiff_law_is_found_exactly(rows):
    """Both equations of Van der Pol at mu = 50, from even rows and from the solver's own."""
    # Even rows as far apart as above, over one jump; the solver needs 561 of its own for it.
    run = relaxation(np.linspace(0, 60, 400), 60) if rows == "even" else relaxation(None, 60, 1e-7)
    method = RationalSearch(costs=(3,), max_terms=3, denominators=False, rounds=1)
    found = discover(run, method=method, jobs=1)
    assert found.equations == {"x": parse("y"), "y": parse("50*y - 50*x^2*y - x")}


@pytest.mark.slow
def test_forecasts_of_the_true_law_stay_stable_between_coarse_rows():
    """At 200 even rows an explicit step of a row is unstable; the true law still follows most."""
    run = relaxation(np.linspace(0, 150, 200))
    rhs = {"x": parse("y"), "y": parse("50*y - 50*x^2*y - x")}
    misses = forecast_errors(rhs, run, window=3)
    assert np.isfinite(misses).all()
    assert np.median(misses) < 1e-6


def test_stiffness_is_the_largest_eigenvalue_times_the_interval():
    """A linear system with eigenvalues -1 and -1000 on rows 0.01 s apart is stiff by 10."""
    t = np.linspace(0, 1, 101)
    run = Trajectory(t, np.column_stack([np.exp(-t), 0 * t]), ("a", "b"))
    flow, values, _ = prepare({"a": parse("-a"), "b": parse("a - 1000*b")}, [run], {})
    shooting = build_shooting(flow, [run], {}, 10, False)
    assert flow.stiffness(shooting.windows, np.array(values)) == pytest.approx(10.0)
    slow = prepare({"a": parse("-a")}, [run], {})[0]
    assert slow.stiffness(
        build_shooting(slow, [run], {}, 10, False).windows, np.zeros(0)
    ) == pytest.approx(0.01)


@pytest.mark.slow
def test_a_law_across_layers_is_judged_by_an_implicit_integration():
    """The exact oscillator is a law from 500 even rows; a term beside it, or one less, is none."""
    run = relaxation(np.linspace(0, 200, 500), 200)
    exact = {"x": parse("y"), "y": parse("50*y - 50*x**2*y - x")}
    found = give_verdict(exact, [run])
    assert found.level == "law" and "integrated implicitly" in found.states["y"].reason
    more = give_verdict({**exact, "y": exact["y"] + parse("1e-9*x**3")}, [run])
    assert more.level == "approximation" and "do not need x**3" in more.states["y"].reason
    assert give_verdict({**exact, "y": parse("50*y - 50*x**2*y")}, [run]).level == "not found"


@pytest.mark.slow
def test_a_law_is_judged_on_the_rows_of_its_own_solver(own):
    """Rows close in the layers and far apart between them: the law is one there too, and with
    another damping it is none.
    """
    for damping, law in ((50, True), (55, False)):
        found = give_verdict({"x": parse("y"), "y": parse(f"{damping}*y*(1 - x**2) - x")}, [own])
        assert (found.level == "law") == law, found.reason


def test_a_term_is_left_out_of_a_product_without_a_rest(monkeypatch):
    """Of b (1 - x^2) y without b x^2 y is left b y, and not the difference of two huge numbers."""
    tried = []
    monkeypatch.setattr(layers, "predict", lambda rhs, x0, t, inputs: tried.append(rhs) or run)
    run = Trajectory([0.0, 1.0], np.ones((2, 1)), ("y",))
    layers.cross_layers({"y": 3 * (1 - parse("t^2")) * parse("y")}, [run], {})
    assert tried[1:] == [{"y": parse("-3*t^2*y")}, {"y": parse("3*y")}]
