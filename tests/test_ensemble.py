from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from dynsr.cli.app import app
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.discovery.uncertainty import bootstrap
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.report.discovery import render_discovery


@pytest.fixture(scope="module")
def noisy():
    """Give a noisy decay, x' = -x/2 + 1, with a false alternative term beside the true ones."""
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
    """The terms of the law are in nearly every member, an alternative's extra term is in few."""
    probability = {str(t.expr): t.probability for t in bootstrap(noisy, members=40)["x"]}
    assert probability["x"] > 0.95
    assert probability["1"] > 0.95
    assert probability["sin(9*x)"] < 0.5


def test_intervals_hold_the_true_constants(noisy):
    """The 95 % intervals hold -0.5 and 1, and are not so wide that they say nothing."""
    rows = {str(term.expr): term.interval for term in bootstrap(noisy, members=60)["x"]}
    assert rows["x"][0] < -0.5 < rows["x"][1]
    assert rows["1"][0] < 1 < rows["1"][1]
    assert rows["x"][1] - rows["x"][0] < 0.1


@pytest.mark.slow
def test_the_same_seed_gives_the_same_ensemble(noisy):
    """Seed 3 gives the same twice, whatever the jobs are."""
    first = bootstrap(noisy, members=10, seed=3)
    assert first == bootstrap(noisy, members=10, seed=3, jobs=2)


def test_data_are_needed(noisy, tmp_path):
    """A loaded discovery has no data, and says so."""
    loaded = Discovery.load(noisy.save(tmp_path / "d.json"))
    with pytest.raises(InputError, match="data are not here"):
        bootstrap(loaded)


@pytest.mark.slow
def test_a_discovery_with_an_ensemble(tmp_path):
    """Asked for, it stands in the result, the saved file, the report, and what the shell prints."""
    t = np.linspace(0, 4, 100)
    data = np.column_stack([t, np.exp(-t) + np.random.default_rng(0).normal(0, 1e-3, 100)])
    quick = {"preset": "quick", "functions": [], "jobs": 1}
    found = discover((data[:, 0], data[:, 1]), ensemble=20, **quick)
    (term,) = [one for one in found.ensemble["x"] if one.term == "x"]
    assert term.probability > 0.9 and -1.2 < term.low < -1 < term.high < -0.8
    again = Discovery.load(found.save(tmp_path / "found.json"))
    assert again.ensemble == found.ensemble
    page = render_discovery(found)
    assert "An ensemble of fits" in page
    assert "An ensemble of fits" not in render_discovery(replace(found, ensemble={}))
    np.savetxt(tmp_path / "decay.csv", data, header="t,x", comments="", delimiter=",")
    words = [
        *("--preset", "quick", "-j", "1"),
        "--functions",
        "none",
        "-o",
        str(tmp_path / "out"),
    ]
    done = CliRunner().invoke(app, ["discover", str(tmp_path / "decay.csv"), "--ensemble", *words])
    assert done.exit_code == 0 and "x', ensemble: x: 100%, -1.0" in done.stdout


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"ensemble": 1}, "must be True, or a number of draws"),
        ({"ensemble": "yes"}, "must be True, or a number of draws"),
        ({"ensemble": True, "discrete": True}, "a map has none"),
        ({"ensemble": True}, "20 rows are too few for an ensemble"),
    ],
)
def test_an_ensemble_that_cannot_be_is_refused_before_the_search(asked, said):
    """A wrong number, a map and few rows are one line each, and no method runs."""
    t = np.linspace(0, 1, 20)
    with pytest.raises(InputError, match=said):
        discover((t, np.exp(-t)), method=None, **asked)
