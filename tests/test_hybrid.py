import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.errors import EngineError, InputError
from dynsr.expression.evaluation import evaluate
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import ParetoFront, rmse
from dynsr.methods.rational import RationalSearch


@pytest.fixture(scope="module")
def lacking():
    """Give an oscillator whose cubic spring, -0.8 q^3, is missing from its equations."""
    t = np.linspace(0, 20, 1001)
    x = solve_ivp(
        lambda t, u: [u[1], -u[0] - 0.8 * u[0] ** 3 - 0.1 * u[1]],
        (0, 20),
        [1.5, 0.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-10,
    ).y.T
    run = Trajectory(t, x, ("q", "v"))
    equations = {"q": parse("v"), "v": parse("-q - 0.1*v")}
    none = {"q": (), "v": ()}
    fronts = {"q": ParetoFront(), "v": ParetoFront()}
    return Discovery(equations, none, fronts, {}, (run,))


@pytest.fixture(scope="module")
def model(lacking):
    """Train the hybrid once."""
    return lacking.hybrid(epochs=300)


@pytest.mark.slow
def test_the_network_learns_the_missing_term(model, lacking):
    """The network of v follows -0.8 q^3 to a few per cent of its size."""
    samples = model.residual_samples("v")
    missing = -0.8 * samples.columns["q"] ** 3
    assert rmse(samples.y, missing) < 0.1 * np.std(missing)


@pytest.mark.slow
def test_it_says_how_much_the_network_carries(model):
    """The complete equation leaves nothing to carry, the incomplete one much."""
    assert model.shares["q"] < 0.001
    assert model.shares["v"] > 0.05


def test_prediction_with_both_parts_is_far_better(model, lacking):
    """The trajectory of both parts misses the data far less than the equations alone."""
    run = lacking.trajectories[0]
    times = run.t[:501]
    both = model.simulate(t=times)
    alone = lacking.simulate(t=times)
    assert rmse(both.x, run.x[:501]) < 0.2 * rmse(alone.x, run.x[:501])


def test_the_residual_goes_back_to_the_symbolic_search(model):
    """A search on what the network learned gives the cubic term."""
    search = RationalSearch(costs=(3,), max_terms=1, denominators=False, rounds=1)
    expr = model.explain("v", search).best_fit.expr
    q = np.linspace(-1.2, 1.2, 50)
    assert rmse(evaluate(expr, {"q": q, "v": 0 * q}), -0.8 * q**3) < 0.1


def test_the_same_seed_gives_the_same_network(lacking):
    """Two trainings with one seed agree to the last digit."""
    X = lacking.trajectories[0].columns[:10]
    first, second = (lacking.hybrid(epochs=5, seed=1).residuals["v"] for _ in range(2))
    assert np.array_equal(first.evaluate(X), second.evaluate(X))


def test_data_are_needed(lacking, tmp_path):
    """A loaded discovery has no data to train on, and says so."""
    loaded = Discovery.load(lacking.save(tmp_path / "d.json"))
    with pytest.raises(InputError, match="data are not here"):
        loaded.hybrid()


def test_a_model_that_diverges_says_when():
    """x' = x^2 from 1 is 1 / (1 - t): met at 0.9, and refused by the first time after t = 1."""
    t = np.linspace(0.0, 0.9, 91)
    run = Trajectory(t, 1 / (1 - t[:, None]), ("x",))
    square = {"x": parse("x^2")}
    model = Discovery(square, {"x": ()}, {}, {}, (run,)).hybrid(epochs=2)
    assert model.simulate().x[-1, 0] == pytest.approx(10.0, rel=1e-3)
    with pytest.raises(EngineError, match=r"no solution at t = 1.*ends at t = 1, x = .*shorten"):
        model.simulate(t=np.linspace(0.0, 2.0, 21))


def test_a_model_is_not_integrated_beyond_its_measured_input():
    """What the input was after the last row is not known, so a later time is refused."""
    t = np.linspace(0.0, 3.0, 61)
    run = Trajectory(t, np.exp(-t)[:, None], ("x",), np.zeros((61, 1)), ("u",))
    model = Discovery({"x": parse("u - x")}, {"x": ()}, {}, {}, (run,)).hybrid(epochs=2)
    with pytest.raises(InputError, match=r"'u' was measured from t = 0 to 3, and t = 4 lies"):
        model.simulate(t=np.linspace(0.0, 4.0, 5))
