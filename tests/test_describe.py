"""Describe: how a table is understood, as a value, as text, as JSON, and in a record."""

import json
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from command_line import run

import dynsr
from dynsr.data import read_trajectories, take_trajectories

# Names with units are renamed, which reading warns of.
pytestmark = pytest.mark.filterwarnings("ignore:columns were renamed")
T = np.linspace(0, 10, 60)
KEYS = {"time", "trajectories", "states", "inputs", "parameters", "noise", "left_out", "notes"}


@pytest.fixture
def table(tmp_path):
    """Give a file of two runs with a valve that is opened once in each."""
    rows = ["run,time [h],level [m],valve,leak"]
    for name, leak in (("a", 0.5), ("b", 0.8)):
        for t in T:
            rows.append(f"{name},{t:.4f},{2 * np.exp(-leak * t):.6f},{int(t > 4)},{leak}")
    path = tmp_path / "tank.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_description_says_what_each_column_is(table):
    """Time with unit and step, runs with rows, states with units, inputs, parameters: all stand."""
    found = dynsr.describe(table, inputs=["valve"])
    assert (found.source, found.time.column, found.time.unit) == ("tank.csv", "time [h]", "h")
    assert found.time.step == pytest.approx(10 / 59, rel=1e-3) and found.time.even
    assert [(r.name, r.rows, r.first, r.last) for r in found.trajectories] == [
        ("a", 60, 0.0, 10.0),
        ("b", 60, 0.0, 10.0),
    ]
    assert (found.states, found.units) == (("level",), {"level": "m"})
    assert found.inputs == ("valve",) and found.hold == {"valve": "previous"}
    assert found.named_by == ("run",)
    with pytest.raises(FrozenInstanceError):
        found.states = ()


def test_a_parameter_is_one_and_no_input(table):
    """A number that is constant within runs is among the parameters alone."""
    found = dynsr.describe(table)
    assert found.parameters == ("leak",) and "leak" not in (*found.inputs, *found.states)


def test_the_arguments_are_those_of_reading(table):
    """What a caller says to read_trajectories means the same here, and the same is read."""
    said = {
        "time": "time [h]",
        "states": "level",
        "inputs": ["valve", "F=sin(t)"],
        "trajectory": "run",
    }
    found = dynsr.describe(table, **said)
    read = read_trajectories(table, **said)
    assert found.sentence == read.guess
    assert found.inputs == read.trajectories[0].input_names == ("valve", "F")
    assert found.formulas == {"F": "sin(t)"}
    assert "F = sin(t)" in str(found)


def test_json_has_the_keys_and_plain_values(table):
    """--json prints one object: names as in formulas, times as numbers, sentences as notes."""
    plain = json.loads(run("describe", table, "--inputs", "valve", "--json").stdout)
    assert set(plain) >= KEYS
    assert plain["time"]["column"] == "time [h]" and plain["time"]["unit"] == "h"
    assert plain["trajectories"][1] == {"name": "b", "rows": 60, "from": 0.0, "to": 10.0}
    assert plain["states"] == ["level"] and plain["inputs"] == ["valve"]
    assert plain == json.loads(json.dumps(dynsr.describe(table, inputs=["valve"]).to_dict()))


def test_the_text_shows_every_role_and_the_options(table):
    """A line a role, and options that can be typed as they stand."""
    text = run("describe", table, "--inputs", "valve").stdout
    for words in (
        "'time [h]' in hours",
        "2, named by 'run'",
        "level [m]\n",
        "valve: held until the next row",
        "--states level,valve",
        "--hold valve=linear",
    ):
        assert words in text, words
    assert "<pre>tank.csv" in dynsr.describe(table)._repr_html_()


def test_the_guess_says_what_an_input_does_and_why_a_column_is_left_out(table):
    """What a search prints and keeps of the table is one sentence with both."""
    guess = read_trajectories(table, inputs=["valve"], states=["level"]).guess
    assert "inputs valve (held)" in guess
    assert "not used: 'leak' (is not among the states asked for)" in guess


def test_an_option_that_is_offered_does_what_it_says(table):
    """The states that --states would give are those that it gives."""
    offered = dynsr.describe(table, inputs=["valve"]).options
    (option,) = [o for o in offered if o.startswith("--states")]
    assert offered[option] == "valve is a state too"
    assert dynsr.describe(table, states=option.split()[1]).states == ("level", "valve")
    assert "--units columns" in offered
    assert "--units columns" not in dynsr.describe({"t": T, "x": np.exp(-T)}).options


@pytest.mark.parametrize("count", [1, 3, 4])
def test_arrays_and_trajectories_are_described_as_a_search_takes_them(count):
    """Names, inputs and what these do between rows are those that discover has of the same data."""
    x = np.exp(-np.outer(T, np.arange(1, count + 1)))
    steps = np.floor(T / 4)[:, None]
    run = dynsr.Trajectory(T, x, tuple("abcd"[:count]), steps, ("u",), hold={"u": "linear"})
    for source in ((T, x), [(T, x), (T, x / 2)], run, [run, run.select(slice(0, 40))]):
        taken = take_trajectories(source)[0]
        found = dynsr.describe(source)
        assert (found.states, found.inputs) == (taken[0].states, taken[0].input_names)
        assert found.hold == taken[0].holds
        assert [own.rows for own in found.trajectories] == list(map(len, taken))


def test_new_names_are_shown_and_no_note(table):
    """A name that lost its unit stands with it; one that is renamed further shows its column."""
    found = dynsr.describe(table, inputs=["valve"])
    assert found.renamed == {"level [m]": "level"} and found.notes == ()
    other = dynsr.describe({"t": T, "a b [kg]": np.exp(-T)})
    assert "a_b [kg] (column 'a b [kg]')" in str(other)


def test_what_is_odd_is_a_note_with_the_column_and_its_run(table):
    """A spike is told with its column, its row and its trajectory; a sound table has no notes."""
    lines = table.read_text().splitlines()
    assert [n for n in dynsr.describe(table, inputs=["valve"]).notes if "level" in n[:6]] == []
    cells = lines[1 + 60 + 20].split(",")
    lines[1 + 60 + 20] = ",".join([*cells[:2], "9.5", *cells[3:]])
    table.write_text("\n".join(lines))
    (note,) = [n for n in dynsr.describe(table, inputs=["valve"]).notes if n.startswith("level")]
    assert note.startswith("level is 9.5 in row 21, between ") and "(trajectory b)" in note


def test_a_sum_that_does_not_change_is_a_note():
    """A state that is one less the others is told, with the option that says so."""
    s = np.exp(-T / 5)
    i = s * (1 - s)
    notes = dynsr.describe({"t": T, "S": s, "I": i, "R": 1 - s - i}).notes
    assert any(note.startswith("R is 1 - S - I in every row") for note in notes)
    assert not any("in every row" in n for n in dynsr.describe({"t": T, "S": s, "I": i}).notes)


def test_several_files_are_described_together(tmp_path):
    """Each file is a trajectory, called as the file is."""
    for k in (1, 2):
        rows = [f"{t},{k * np.exp(-t)}" for t in T]
        (tmp_path / f"day{k}.csv").write_text("\n".join(["t,c", *rows]))
    found = dynsr.describe([tmp_path / "day1.csv", tmp_path / "day2.csv"])
    assert [run.name for run in found.trajectories] == ["day1.csv", "day2.csv"]
    assert found.rows == 120 and found.states == ("c",)


def test_a_table_that_cannot_be_read_is_one_line(tmp_path):
    """Exit code 2, one line on stderr, nothing on stdout."""
    path = tmp_path / "no.csv"
    path.write_text("t,x\n0,1\n1,2\n")
    done = run("describe", path, "--json", code=2)
    assert done.stdout == "" and done.stderr.startswith("error: no.csv has 2 rows")
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
def test_what_was_assumed_stands_in_the_record(table, tmp_path):
    """A discovery and its file hold the description that the search went out from."""
    found = dynsr.discover(table, inputs=["valve"], preset="quick", method="sindy", jobs=1)
    plain = dynsr.describe(table, inputs=["valve"]).to_dict()
    assert found.settings["table"]["states"] == plain["states"]
    found.save(tmp_path / "d.json")
    kept = dynsr.Discovery.load(tmp_path / "d.json").settings["table"]
    assert {k: kept[k] for k in KEYS - {"notes"}} == {k: plain[k] for k in KEYS - {"notes"}}
