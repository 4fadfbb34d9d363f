import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
import sympy

from dynsr.data.system import CART_POLE, LORENZ, LOTKA_VOLTERRA, PENDULUM
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.engines.simulation import add_noise, simulate, training_trajectory
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.fit.polishing import polish
from dynsr.fit.shooting import is_noisy
from dynsr.jobs import spread
from dynsr.jobs.store import RecordWarning
from dynsr.methods.rational import RationalSearch

QUICK = RationalSearch(costs=(2,), max_terms=3, denominators=False, rounds=1)


def same(expr, text):
    """Say whether two formulas are the same function of their symbols."""
    return sympy.simplify(sympy.nsimplify(expr, rational=True) - sympy.nsimplify(parse(text))) == 0


@pytest.fixture(scope="module")
def decay():
    """Two coupled linear states, solved in closed form: a cheap system to search."""
    t = np.linspace(0, 6, 121)
    x = np.column_stack([np.exp(-0.5 * t), np.exp(-0.5 * t) * t + np.exp(-0.5 * t)])
    return t, x


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Give the folder of that discovery."""
    return tmp_path_factory.mktemp("found")


@pytest.fixture(scope="module")
def found(decay, folder):
    """Give the discovery of that system."""
    return discover(decay, method=QUICK, jobs=1, out=folder)


@pytest.mark.slow
def test_every_state_gets_its_equation_with_round_constants(found):
    """x' = -x/2 and y' = x - y/2 are found exactly, with constants as they were meant."""
    assert found.equations == {"x": parse("-0.5*x"), "y": parse("x - 0.5*y")}


def test_the_choice_is_explained(found):
    """The explanation is of the printed equation, in plain words; bits are in the details."""
    assert found.explanation["y"].startswith("y' = x - 0.5*y: law; ")
    assert "bits" not in found.explanation["y"]
    assert "bits" in found.details["y"] and "held-back" in found.details["y"]


@pytest.mark.slow
def test_the_number_of_jobs_does_not_change_the_result(decay, found):
    """Two processes give exactly what one gives."""
    twice = discover(decay, method=QUICK, jobs=2)
    first, second = found.as_record(), twice.as_record()
    assert {**first, "seconds": 0} == {**second, "seconds": 0}


@pytest.mark.slow
def test_the_papers_pendulum_is_found_exactly():
    """Both equations and their constants come out as they are, theta1' = theta2 as a column."""
    data = training_trajectory(PENDULUM)
    result = discover(data, method="rational", preset="quick", jobs=1)
    for state, truth in zip(PENDULUM.states, PENDULUM.rhs, strict=True):
        assert same(result.equations[state], truth)
    assert "every column" in result.explanation["theta1"]


@pytest.mark.slow
def test_the_papers_predators_are_found_exactly():
    """From the paper's training data alone their equation comes out as it is."""
    data = training_trajectory(LOTKA_VOLTERRA)
    result = discover(data, method="rational", preset="quick", targets="y", jobs=1)
    assert same(result.equations["y"], LOTKA_VOLTERRA.rhs[1])


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9])
def test_the_bias_of_clean_slopes_is_not_followed(tolerance):
    """However exact the data are, no long formula is built on what the differences miss."""
    data = simulate(LOTKA_VOLTERRA, t=np.arange(500) * 0.01, reltol=tolerance, abstol=1e-12)
    result = discover(data, method="rational", preset="quick", targets="x", jobs=1)
    assert same(result.equations["x"], LOTKA_VOLTERRA.rhs[0])


@pytest.mark.slow
def test_the_cart_pole_is_found_exactly_with_its_force_as_input():
    """The rational form of the cart's acceleration is found with F given as an expression."""
    data = simulate(CART_POLE, t=np.arange(250) * 0.02, reltol=1e-10, abstol=1e-12)
    result = discover(data, method="rational", preset="quick", targets="z", jobs=1)
    assert same(result.equations["z"], CART_POLE.rhs[3])


@pytest.mark.slow
def test_lorenz_with_noise_is_found_within_two_percent():
    """With 1 % noise on the states all seven constants of Lorenz are within 2 %."""
    clean = simulate(LORENZ, t=np.arange(200) * 0.01, reltol=1e-9, abstol=1e-9)
    noisy = add_noise(clean, 0.01, np.random.default_rng(0))
    result = discover(noisy, method=QUICK, functions=(), jobs=1)
    x, y, z = sympy.symbols("x y z")
    truth = {
        "x": {x: -10, y: 10},
        "y": {x: 28, x * z: -1, y: -1},
        "z": {x * y: 1, z: -8 / 3},
    }
    for state, terms in truth.items():
        coefficients = sympy.expand(result.equations[state]).as_coefficients_dict()
        assert set(coefficients) == set(terms)
        for term, value in terms.items():
            assert float(coefficients[term]) == pytest.approx(value, rel=0.02)


@pytest.mark.slow
def test_a_known_part_is_left_to_the_user(decay):
    """With x given as part of y', only -y/2 is searched, and the sum is reported."""
    result = discover(decay, method=QUICK, targets="y", known={"y": "x"}, jobs=1)
    assert result.equations["y"] == parse("x - 0.5*y")


@pytest.mark.slow
def test_several_trajectories_with_their_own_times_are_taken():
    """Trajectories of different length and sampling are one discovery."""
    runs = [(t, np.exp(-0.5 * t)[:, None]) for t in (np.linspace(0, 3, 200), np.linspace(1, 3, 90))]
    assert discover(runs, method=QUICK, jobs=1).equations == {"x": parse("-0.5*x")}


def test_own_slopes_are_used(decay):
    """Slopes that the user gives stand in for those the data would give."""
    _t, x = decay
    slopes = {"x": -0.5 * x[:, 0], "y": x[:, 0] - 0.5 * x[:, 1]}
    result = discover(decay, method=QUICK, targets="y", slopes=slopes, jobs=1)
    assert result.equations["y"] == parse("x - 0.5*y")


def test_noisy_constants_are_fitted_to_the_states():
    """Constants that noise has moved come back within their standard errors, and snap."""
    t = np.linspace(0, 10, 1001)
    clean = simulate(LOTKA_VOLTERRA, t=t, reltol=1e-9, abstol=1e-9)
    noisy = add_noise(clean, 0.01, np.random.default_rng(1))
    assert is_noisy([noisy])
    rough = {"x": parse("1.47*x - 0.97*x*y"), "y": parse("-2.9*y + 1.04*x*y")}
    match = polish(rough, [noisy], {}, {}, {})
    assert match.exprs == {"x": parse("1.5*x - x*y"), "y": parse("x*y - 3*y")}
    for value, error in match.errors["y"]:
        assert abs(abs(value) - (3 if abs(value) > 2 else 1)) < 4 * error


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"targets": "q"}, "unknown state 'q'; the states are: x, y"),
        ({"method": "magic"}, "unknown method 'magic'"),
        ({"preset": "magic"}, "unknown preset 'magic'"),
        ({"known": {"q": "x"}}, "unknown state 'q'"),
        ({"inputs": {"x": "sin(t)"}}, "input 'x' is already a state"),
        ({"inputs": {"F": "sin(q)"}}, "unknown name 'q'"),
        ({"inputs": ["x", "y"]}, "leave at least one state"),
    ],
)
def test_bad_settings_are_one_clear_line(decay, arguments, message):
    """A setting that cannot be used is an input error that names it."""
    with pytest.raises(InputError, match=message):
        discover(decay, jobs=1, **arguments)


def test_too_few_rows_are_refused():
    """Three rows are refused with the number that is needed."""
    with pytest.raises(InputError, match="3 rows are too few"):
        discover((np.arange(3.0), np.ones((3, 1))), jobs=1)


@pytest.mark.slow
def test_finished_tasks_are_not_done_again(decay, found, folder):
    """A second run in the same folder reads every record and gives the same discovery."""
    before = {p: p.stat().st_mtime_ns for p in (folder / "records").iterdir()}
    again = discover(decay, method=QUICK, jobs=1, out=folder)
    assert {p: p.stat().st_mtime_ns for p in (folder / "records").iterdir()} == before != {}
    assert {**again.as_record(), "seconds": 0} == {**found.as_record(), "seconds": 0}


@pytest.mark.slow
def test_a_damaged_record_is_done_again(decay, found, folder, tmp_path):
    """A record that is cut short counts as unfinished."""
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    for path in (tmp_path / "records").iterdir():
        path.write_text(path.read_text()[: -len(path.read_text()) // 2])
    with pytest.warns(RecordWarning, match="no whole JSON file; computing it again"):
        again = discover(decay, method=QUICK, jobs=1, out=tmp_path)
    assert again.equations == found.equations


def test_a_saved_discovery_loads_as_it_was(found, tmp_path):
    """Saving and loading gives the same equations, fronts, reasons and settings."""
    unsure = replace(found, errors={**found.errors, "x": ((-0.5, np.inf),)})
    for kept in (found, unsure):
        again = Discovery.load(kept.save(tmp_path / "d.json"))
        assert again.as_record() == kept.as_record()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "dynsr discovery 1"}'])
def test_a_broken_file_is_refused(tmp_path, text):
    """A file that is no whole discovery is an input error, not a traceback."""
    path = tmp_path / "d.json"
    path.write_text(text)
    with pytest.raises(InputError):
        Discovery.load(path)


def test_a_file_that_is_not_there_is_said_so(tmp_path):
    """The remedy is its name, not to save it again."""
    with pytest.raises(InputError, match=r"nowhere.json'.*; check its name"):
        Discovery.load(tmp_path / "nowhere.json")


def test_code_in_a_saved_file_is_never_run(found, tmp_path):
    """An equation that is Python code is refused by the parser."""
    record = found.as_record()
    record["equations"]["x"] = "__import__('os').getcwd()"
    path = tmp_path / "d.json"
    path.write_text(json.dumps(record))
    with pytest.raises(InputError):
        Discovery.load(path)


@pytest.mark.slow
def test_a_relative_folder_is_that_of_the_caller(decay, tmp_path, monkeypatch):
    """Workers kept from an earlier call write where the caller stands now, not where it stood."""
    folders = [tmp_path / name for name in ("first", "second")]
    for folder in folders:
        folder.mkdir()
    monkeypatch.chdir(folders[0])
    assert str(folders[1]) not in dict(spread(os.getcwd, [()] * 2, 2)).values()
    monkeypatch.chdir(folders[1])
    discover(decay, method=QUICK, jobs=2, out="kept")
    assert list((folders[1] / "kept" / "records").glob("search-*"))


def test_other_constants_are_put_in_the_order_of_the_printed_formula():
    """with_constants takes numbers as constants lists them, and says what does not fit."""
    texts = {"x": "2*x - 3*x*y", "y": "4.5*y/(5.5*x + 7.5) - 6.5*x"}
    found = Discovery({s: parse(text) for s, text in texts.items()}, {}, {}, {})
    assert [c.of for c in found.constants["x"]] == ["x*y", "x"]
    moved = found.with_constants({"x": [-1.5, 0.25]})
    assert same(moved.equations["x"], "0.25*x - 1.5*x*y")
    assert moved.equations["y"] == found.equations["y"] and not moved.verdict.tested
    twice = found.with_constants({"y": [2 * c.value for c in found.constants["y"]]})
    assert same(twice.equations["y"], "9*y/(11*x + 15) - 13*x")
    with pytest.raises(InputError, match="are not 2 finite numbers; give one a constant"):
        found.with_constants({"x": [1.0, np.inf]})
    with pytest.raises(InputError, match="'z' has no equation; those that have: x, y"):
        found.with_constants({"z": [1.0]})
