import numpy as np
import pytest

from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.discovery.uncertainty import bootstrap, intervals
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront


@pytest.fixture(scope="module")
def noisy():
    """Give a noisy decay, x' = -x/2 + 1, with a false rival term beside the true ones."""
    t = np.linspace(0, 8, 801)
    x = 2 + 3 * np.exp(-0.5 * t) + np.random.default_rng(0).normal(0, 0.005, len(t))
    front = ParetoFront(
        [
            Candidate(parse("1 - 0.5*x"), 0.1, 10.0),
            Candidate(parse("1 - 0.5*x + 0.001*sin(9*x)"), 0.09, 20.0),
        ]
    )
    run = Trajectory(t, x[:, None], ("x",))
    return Discovery({"x": parse("1 - 0.5*x")}, {"x": ()}, {"x": front}, {"x": ""}, (run,))


def test_true_terms_are_sure_and_false_ones_are_not(noisy):
    """The terms of the law are in nearly every member, a rival's extra term is in few."""
    probability = {str(t.expr): t.probability for t in bootstrap(noisy, members=40)["x"]}
    assert probability["x"] > 0.95
    assert probability["1"] > 0.95
    assert probability["sin(9*x)"] < 0.5


def test_intervals_hold_the_true_constants(noisy):
    """The 95 % intervals hold -0.5 and 1, and are not so wide that they say nothing."""
    rows = {term: (low, high) for _, term, _, low, high in intervals(bootstrap(noisy, members=60))}
    assert rows["x"][0] < -0.5 < rows["x"][1]
    assert rows["1"][0] < 1 < rows["1"][1]
    assert rows["x"][1] - rows["x"][0] < 0.1


def test_the_same_seed_gives_the_same_ensemble(noisy):
    """Seed 3 gives the same twice, whatever the jobs are."""
    first = bootstrap(noisy, members=10, seed=3)
    assert first == bootstrap(noisy, members=10, seed=3, jobs=2)


def test_data_are_needed(noisy, tmp_path):
    """A loaded discovery has no data, and says so."""
    loaded = Discovery.load(noisy.save(tmp_path / "d.json"))
    with pytest.raises(InputError, match="data are not here"):
        bootstrap(loaded)
