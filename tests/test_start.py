"""Start: an earlier discovery goes on with more data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy
from command_line import run
from scipy.integrate import solve_ivp

import dynsr
from dynsr.errors import InputError
from dynsr.fit import ParetoFront

X, Y = sympy.symbols("x y")


def prey(rows: int, until: float, noise: float = 0.0, begin: tuple = (2, 1)) -> dynsr.Trajectory:
    """Prey and predators, with noise as a share of their spread."""
    t = np.linspace(0, until, rows)
    x = solve_ivp(
        lambda _, v: [1.5 * v[0] - v[0] * v[1], v[0] * v[1] - 3 * v[1]],
        (0, until),
        begin,
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    ).y.T
    x += noise * x.std(axis=0) * np.random.default_rng(rows).normal(size=x.shape)
    return dynsr.Trajectory(t, x, ("x", "y"))


@pytest.fixture(scope="module")
def earlier() -> dynsr.Discovery:
    """Find the equations of clean data once, and shift their constants by a thousandth.

    Of the front a few formulas stay: each of them is fitted to whatever data go on.
    """
    found = dynsr.discover(prey(100, 6), preset="quick", functions=(), jobs=1)
    shifted = {"x": 1.5015 * X - 1.001 * X * Y, "y": 0.999 * X * Y - 3.003 * Y}
    few = {state: ParetoFront(list(front)[:4]) for state, front in found.front.items()}
    return replace(found, equations=shifted, front=few)


@pytest.mark.slow
def test_a_search_goes_on_from_the_folder_that_another_one_left(tmp_path: Path) -> None:
    """What out= leaves is enough for start=, and a folder without a result is told apart."""
    data = prey(60, 4)
    found = dynsr.discover(data, preset="quick", functions=(), jobs=1, out=tmp_path / "a")
    kept = dynsr.load(tmp_path / "a" / "discovery.json")
    assert kept.equations == found.equations
    again = dynsr.discover(data, preset="quick", functions=(), jobs=1, start=tmp_path / "a")
    assert again.equations == found.equations
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"without discovery\.json: its discovery has not ended"):
        dynsr.discover(data, jobs=1, start=tmp_path / "empty")


@pytest.mark.slow
def test_a_result_that_cannot_be_saved_is_returned_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk costs the file and not the equations; a warning says so in one line."""

    def full(*_: object) -> None:
        raise InputError("cannot write discovery.json: no space left on device")

    monkeypatch.setattr("dynsr.discovery.stages.keep", full)
    with pytest.warns(UserWarning, match="no space left on device; the result is returned"):
        found = dynsr.discover(
            prey(60, 4), preset="quick", functions=(), jobs=1, out=tmp_path / "a"
        )
    assert set(found.equations) == {"x", "y"}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_law_of_the_new_data_too_ends_the_search(
    noise: float, earlier: dynsr.Discovery, tmp_path: Path
) -> None:
    """From the file no method runs; constants are those of the new data, by any worker."""
    path = earlier.save(tmp_path / "discovery.json")
    data = prey(100, 6, noise, (1, 1.5))
    found = dynsr.discover(data, jobs=1, start=path)
    assert found.settings["methods"] == ["start"]
    assert found.verdict.tested
    assert found.verdict.level == "law"
    for state, expr in {"x": 1.5 * X - X * Y, "y": X * Y - 3 * Y}.items():
        gap = sympy.Poly(found.equations[state] - expr, X, Y).coeffs()
        assert max(abs(float(c)) for c in gap) <= 1e-9 + 5 * noise
    assert "Found by the earlier discovery" in found.explanation["x"]
    if not noise:
        again = dynsr.discover(data, jobs=2, start=tmp_path)
        assert again.as_record()["front"] == found.as_record()["front"]
        assert again.equations == found.equations


@pytest.mark.slow
def test_what_is_no_law_of_the_new_data_is_one_formula_among_others(
    earlier: dynsr.Discovery,
) -> None:
    """A wrong start ends nothing: the equations are those of a search without it."""
    wrong = {"x": -0.3 * X, "y": 0.4 * X}
    poor = replace(earlier, equations=wrong, front={})
    options = {"method": "sindy", "preset": "quick", "functions": (), "jobs": 1}
    found = dynsr.discover(prey(120, 6), targets="x", start=poor, **options)
    assert found.settings["methods"] == ["sindy"]
    assert found.equations == {"x": 1.5 * X - X * Y}
    assert found.settings["start"]["equations"] == {"x": "-0.3*x", "y": "0.4*x"}


@pytest.mark.slow
def test_a_part_that_is_given_now_is_taken_off(earlier: dynsr.Discovery) -> None:
    """With 1.5 x known, the start's whole equation is still the law."""
    data = prey(150, 6)
    found = dynsr.discover(data, jobs=1, start=earlier, known={"x": "1.5*x"})
    assert found.settings["methods"] == ["start"]
    assert found.equations["x"] == 1.5 * X - X * Y


@pytest.mark.slow
def test_a_map_goes_on_as_well() -> None:
    """The logistic map of 40 rows is that of 200."""

    def rows(count: int) -> dynsr.Trajectory:
        x = [0.3]
        for _ in range(count - 1):
            x.append(3.7 * x[-1] * (1 - x[-1]))
        return dynsr.Trajectory(np.arange(float(count)), np.array(x)[:, None], ("x",))

    options = {"discrete": True, "preset": "quick", "functions": (), "jobs": 1}
    few = dynsr.discover(rows(40), **options)
    found = dynsr.discover(rows(200), start=few, **options)
    assert found.settings["methods"] == ["start"]
    assert sympy.expand(found.equations["x"]) == sympy.expand(3.7 * X * (1 - X))
    with pytest.raises(InputError, match="start found a map, but here one asks for equations of"):
        dynsr.discover(rows(200), jobs=1, start=few)


@pytest.mark.slow
def test_data_in_large_units_go_on(earlier: dynsr.Discovery) -> None:
    """Where columns are scaled inside, the start is scaled with them."""
    data = prey(150, 6)
    large = dynsr.Trajectory(data.t, data.x * 1e9, ("x", "y"))
    scaled = {s: (1e9 * e.subs({X: X / 1e9, Y: Y / 1e9})) for s, e in earlier.equations.items()}
    begun = replace(earlier, equations=scaled, front={})
    found = dynsr.discover(large, jobs=1, start=begun)
    assert found.settings["methods"] == ["start"]
    assert float(found.equations["x"].coeff(X * Y)) == pytest.approx(-1e-9, rel=1e-6)


def test_what_does_not_fit_is_one_line(earlier: dynsr.Discovery, tmp_path: Path) -> None:
    """Other columns, no discovery, and no file are named with the remedy."""
    data = prey(60, 3)
    other = dynsr.Trajectory(data.t, data.x, ("x", "z"))
    with pytest.raises(InputError) as error:
        dynsr.discover(other, jobs=1, start=earlier)
    assert str(error.value) == (
        "start has 'y' in its equations, which these data do not have so; they have the states "
        "x, z; give data of the same columns and kind"
    )
    with pytest.raises(InputError, match="start '7' must be a Discovery, or the file that one was"):
        dynsr.discover(data, jobs=1, start=7)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"nothing\.json"):
        dynsr.discover(data, jobs=1, start=tmp_path / "nothing.json")


@pytest.mark.slow
def test_another_start_is_another_discovery(earlier: dynsr.Discovery, tmp_path: Path) -> None:
    """A folder takes up its own start and refuses another."""
    options = {"method": "sindy", "jobs": 1, "out": tmp_path / "out"}
    dynsr.discover(prey(150, 6), start=earlier, **options)
    assert dynsr.discover(prey(150, 6), start=earlier, **options).settings["methods"] == ["start"]
    with pytest.raises(InputError, match=r"holds results with start .*; give another folder"):
        dynsr.discover(prey(150, 6), **options)


@pytest.mark.slow
def test_the_shell_goes_on(earlier: dynsr.Discovery, tmp_path: Path) -> None:
    """--start takes the file, and the folder that a discovery was kept in."""
    own = prey(200, 8)
    data = tmp_path / "prey.csv"
    np.savetxt(data, np.column_stack([own.t, own.x]), delimiter=",", header="t,x,y", comments="")
    earlier.save(tmp_path / "discovery.json")
    words = ("discover", data, "--json", "--quiet", "--jobs", "1")
    for start in (tmp_path, tmp_path / "discovery.json"):
        told = json.loads(run(*words, "--start", start).stdout)
        assert told["settings"]["methods"] == ["start"]
    assert "--states" not in run(*words, "--start", tmp_path / "no.json", code=2).output
