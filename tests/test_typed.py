"""What a user writes against dynsr: types that a checker knows, and names that are misspelt."""

import json
import subprocess
import sys
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

import dynsr
from dynsr.discovery.problem import DiscoverySettings
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import ParetoFront
from dynsr.jobs.store import from_plain, to_plain
from dynsr.selection import ApproximationSettings
from dynsr.verdict.levels import OtherFormula, StateVerdict, Verdict, VerdictSettings

SCRIPT = """
from __future__ import annotations

import numpy as np
import sympy

import dynsr

t = np.linspace(0.0, 3.0, 301)
found = dynsr.discover({"t": t, "x": 2 * np.exp(-0.5 * t)}, preset="quick", jobs=1)
level: str = found.verdict.level
right: sympy.Expr = found.equations["x"]
equations: dict[str, sympy.Expr] = found.equations
best: dynsr.Candidate = found.front["x"][-1]
rate: float = found.parameters["k1"].value
error: float = found.parameters["k1"].error
named: dynsr.Discovery = found.rename({"k1": "rate"}).with_parameters(rate=0.4)
run: dynsr.Trajectory = named.simulate([1.0], np.linspace(0, 1, 11))
last: float = float(run.x[-1, 0])
code: str = named.export("c")
scores: dict[str, dict[str, float]] = found.score()
for state, constants in found.constants.items():
    for constant in constants:
        print(state, constant.value, constant.low, constant.of)
regressor = dynsr.TrajectoryRegressor(preset="quick")
regressor.fit(run.x, t=run.t)
system: dynsr.System = named.system.to_system()
again: dynsr.Trajectory = dynsr.simulate(system)
for point in found.fixed_points():
    stands: str = point.text
matrix: np.ndarray = found.linearise({"x": 0.0}).A
changes: list[tuple[float, str]] = found.bifurcation("k1", np.linspace(0.1, 1.0, 3)).changes()
low: float | None = found.profile("x:0").low
reason: str = found.verdict.states["x"].reason
latex: str = found.latex(names=True)
rows: np.ndarray = found.to_numpy()(0.0, np.array([1.0]))
known: dynsr.Discovery = dynsr.Discovery.from_system(system, [run])
described: dynsr.Description = dynsr.describe(run)
method: dynsr.AbstractMethod = dynsr.make_method("sindy")
noisy: dynsr.Trajectory = dynsr.add_noise(run, 0.1, np.random.default_rng(0))
"""
WRONG = (
    "import dynsr\nlevel: int = dynsr.load('a').verdict.level\ndynsr.load('a').front['x'].bits\n"
)


@pytest.mark.slow
def test_a_users_script_passes_a_type_checker(tmp_path):
    """Strict mypy has nothing to say of a script that uses results without asking for None."""
    (tmp_path / "user.py").write_text(SCRIPT)
    (tmp_path / "mypy.ini").write_text("[mypy-sympy.*]\nignore_missing_imports = true\n")
    command = [sys.executable, "-m", "mypy", "--strict", "user.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["standard", "strict"])
def test_a_users_script_passes_pyright(tmp_path, mode):
    """Pyright has nothing to say of the same script, and sees what is wrong in another."""
    need = "basedpyright is not installed"
    pytest.importorskip("basedpyright", reason=need)
    (tmp_path / "user.py").write_text(SCRIPT)
    (tmp_path / "wrong.py").write_text(WRONG)
    home = str(Path(dynsr.__file__).parents[1])
    settings = {"typeCheckingMode": mode, "extraPaths": [home], "reportMissingTypeStubs": False}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "basedpyright", "--pythonpath", sys.executable]
    done = subprocess.run([*command, "user.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    done = subprocess.run([*command, "wrong.py"], cwd=tmp_path, capture_output=True, text=True)
    assert '"bits"' in done.stdout and '"str" is not assignable to "int"' in done.stdout


@pytest.mark.slow
def test_a_users_script_runs(tmp_path):
    """What passes the checker does what it says."""
    (tmp_path / "user.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, "user.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("x -0.5")


def test_there_is_always_a_verdict(tmp_path):
    """Equations that nobody judged say so; in a file it is nothing, as in those of before."""
    found = Discovery({"x": parse("-x")}, {}, {"x": ParetoFront()}, {}, settings={"engine": "x"})
    assert found.verdict == Verdict("not judged", found.verdict.reason)
    assert not found.verdict.tested and found.heading == "No verdict."
    again = Discovery.load(found.save(tmp_path / "found.json"))
    assert again.verdict == found.verdict and found.as_record()["verdict"] is None


@pytest.mark.parametrize(
    "kind",
    ["equations", "errors", "front", "constants", "explanation", "details", "verdict.states"],
)
def test_a_state_that_is_none_is_a_key_error_with_the_names(kind):
    """The nearest name is offered."""
    front = {"prey": ParetoFront(), "hunters": ParetoFront()}
    said = {"prey": "few terms", "hunters": "few terms"}
    equations = {"prey": parse("-prey"), "hunters": parse("prey")}
    own = dict.fromkeys(equations, StateVerdict("law", "it follows", 1.0))
    nothing = dict.fromkeys(equations, ())
    found = Discovery(
        equations, nothing, front, said, details=said, verdict=Verdict("law", "it follows", own)
    )
    table = attrgetter(kind)(found)
    said = r"no state 'pray' \(did you mean 'prey'\?\); the states are: prey, hunters"
    with pytest.raises(KeyError, match=said):
        table["pray"]
    assert table.get("pray") is None and isinstance(table, dict)


def test_a_keyword_that_is_misspelt_is_told_the_nearest():
    """Functions, estimators and methods of results say which keyword was meant, or all."""
    t = np.linspace(0, 1, 20)
    for call in (
        lambda: dynsr.discover((t, t[:, None]), metho="sindy"),
        lambda: dynsr.TrajectoryRegressor(metho="sindy"),
    ):
        with pytest.raises(TypeError, match=r"keyword argument 'metho'; did you mean 'method'\?"):
            call()
    found = Discovery({"x": parse("-x")}, {}, {}, {})
    with pytest.raises(TypeError, match="'where'; it takes: x0, t, inputs, engine, hold, doses"):
        found.simulate([1.0], t, where=3)
    with pytest.raises(TypeError, match="'begin'; it takes: equations, x0"):
        dynsr.System.from_strings({"x": "-x"}, begin=[1.0])
    with pytest.raises(InputError, match=r"no setting 'treshold' \(did you mean 'thresholds'\?\)"):
        dynsr.make_method("sindy", treshold=0.1)


@pytest.mark.parametrize(
    ("make", "old", "new"),
    [
        (lambda: Verdict("law", "it follows"), "judged", "tested"),
        (lambda: StateVerdict("law", "it follows", 1.0), "rivals", "alternatives"),
        (lambda: ParetoFront(()), "leaders", "best_by_source"),
        (DiscoverySettings, "followers", "approximations"),
        (lambda: Verdict("law", "it follows"), "rivals", "alternatives"),
        (
            lambda: dynsr.Trajectory(np.arange(3.0), np.ones((3, 1)), ("x",)),
            "told_rows",
            "known_rows",
        ),
        (lambda: dynsr.make_samples(decaying(), "x"), "misses", "residuals"),
    ],
)
def test_a_name_of_before_still_works_and_says_what_it_is_now(make, old, new):
    """For one release the old name gives the same, with a warning that names the new one."""
    one = make()
    with pytest.warns(DeprecationWarning, match=rf"\.{old} is now {new}"):
        before = getattr(one, old)
    assert before == getattr(one, new)


@pytest.mark.parametrize(
    ("room", "old", "new"),
    [
        (dynsr.discovery, "Rival", "OtherFormula"),
        (dynsr.selection, "FollowerSettings", "ApproximationSettings"),
    ],
)
def test_an_export_of_before_still_works_and_says_what_it_is_now(room, old, new):
    """For one release the old name of a class gives the same class, with a warning."""
    with pytest.warns(DeprecationWarning, match=rf"\.{old} is now {new}"):
        before = getattr(room, old)
    assert before is getattr(room, new)


def decaying():
    """Give a trajectory."""
    t = np.linspace(0, 2, 30)
    return dynsr.Trajectory(t, np.exp(-t)[:, None], ("x",))


def test_arguments_of_before_are_taken_and_records_of_before_are_read():
    """For one release a renamed setting may be given by its old name; saved verdicts have it."""
    with pytest.warns(DeprecationWarning, match="followers=.* is now approximations="):
        old = DiscoverySettings(followers=ApproximationSettings())
    assert old == DiscoverySettings()
    with pytest.warns(DeprecationWarning, match="rival_bits=.* is now alternative_bits="):
        assert VerdictSettings(rival_bits=9.0) == VerdictSettings(alternative_bits=9.0)
    own = StateVerdict(
        "law", "it follows", 1.0, 1.0, 0.1, alternatives=(OtherFormula("2*x", 20.0),)
    )
    plain = to_plain(own)
    plain["rivals"] = plain.pop("alternatives")
    assert from_plain(StateVerdict, plain) == own
