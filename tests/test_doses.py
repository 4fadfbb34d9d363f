"""Doses: a state jumps by the amount given right after a row, in every fit and integration."""

import json
from dataclasses import replace
from pathlib import Path

import command_line
import numpy as np
import pytest

import dynsr
from dynsr.data import (
    Trajectory,
    choose_samples,
    column_units,
    cut_at_doses,
    read_trajectories,
    take_trajectories,
)
from dynsr.errors import DynsrWarning, InputError

RATE = 0.6


def course(level: float = 0.0) -> Trajectory:
    """Give a drug that is eliminated by V x/(K + x), five doses, rows of uneven times."""
    from scipy.integrate import solve_ivp

    def slope(_: float, c: np.ndarray) -> np.ndarray:
        return np.asarray(-2.0 * c / (3.0 + c))

    rng = np.random.default_rng(5)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 0.3, 149))])
    dose = np.zeros(len(t))
    dose[[0, 30, 60, 90, 120]] = [10.0, 6.0, 8.0, 12.0, 5.0]
    x = [0.0]
    for i in range(len(t) - 1):
        start = [x[-1] + dose[i]]
        found = solve_ivp(slope, t[i : i + 2], start, rtol=1e-11, atol=1e-12)
        x.append(found.y[0, -1])
    noise = rng.normal(size=len(t)) * level * np.std(x)
    return Trajectory(t, (np.array(x) + noise)[:, None], ("c",), dose[:, None], ("dose",))


def test_no_slope_reaches_over_a_dose() -> None:
    """Slopes between doses are those of the law, from the first row after each on."""
    parts = cut_at_doses([course()], {"c": "dose"})
    assert [len(part) for part in parts] == [31, 31, 31, 31, 30]
    samples = choose_samples(parts, "c")
    c = samples.columns["c"]
    assert samples.y == pytest.approx(-2 * c / (3 + c), abs=1e-4)
    assert parts[0].names == ("c",)


@pytest.mark.slow
def test_a_simulation_jumps_at_each_dose() -> None:
    """The law with the doses of the data gives the data, from the first row to the last."""
    run = course()
    law = dynsr.discover([run], doses={"c": "dose"}, preset="quick", jobs=1)
    assert law.settings["doses"] == {"c": "dose"}
    found = law.simulate(run.x[0], run.t, doses={"c": run.inputs[:, 0]})
    assert np.max(np.abs(found.x - run.x)) < 1e-3
    without = law.simulate(run.x[0], run.t)
    assert np.max(np.abs(without.x - run.x)) > 5
    assert law.score([run])["c"]["trajectory_rmse"] < 1e-3
    assert law.score(list(law.trajectories)) == law.score()


def test_a_state_column_may_hold_the_amounts() -> None:
    """What was read as a state is none where it holds doses."""
    run = course()
    both = Trajectory(run.t, np.column_stack([run.x, run.inputs]), ("c", "dose"))
    parts = cut_at_doses([both], {"c": "dose"})
    assert parts[0].states == ("c",)
    assert parts[1].x[0, 0] == pytest.approx(run.x[30, 0] + 6.0)


def test_short_parts_are_left_out_and_said() -> None:
    """Two doses close together leave a part of too few rows between them."""
    run = course()
    close = run.inputs.copy()
    close[33] = 1.0
    said = r"^1 of 6 parts between doses have fewer than 8 rows and are left out: \d of \d+ rows;"
    with pytest.warns(DynsrWarning, match=said):
        assert len(cut_at_doses([replace(run, inputs=close)], {"c": "dose"})) == 5


@pytest.mark.parametrize(
    ("doses", "says"),
    [
        ({"c": "pill"}, "there is no column 'pill'; the columns are: c, dose"),
        ({"b": "dose"}, "doses are given to a state, and 'b' is no state; the states are: c"),
        ("dose", "must say state -> column of amounts"),
    ],
)
def test_wrong_names_are_one_line(doses: object, says: str) -> None:
    """An unknown state or column is answered with those that there are."""
    with pytest.raises(dynsr.InputError, match=says):
        dynsr.discover([course()], doses=doses, jobs=1)  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_command_line_takes_doses(tmp_path: Path) -> None:
    """--dose c=dose finds the law of what is eliminated; what is no pair is one line."""
    run = course()
    file = tmp_path / "drug.csv"
    rows = [
        f"{t!r},{c!r},{d!r}"
        for t, c, d in zip(*map(np.ndarray.tolist, (run.t, *run.columns.T)), strict=True)
    ]
    file.write_text("\n".join(["t,c,dose", *rows]) + "\n")
    wrong = command_line.run("discover", file, "--dose", "dose", code=2)
    assert "must be a state and a column, such as x=dose" in wrong.output
    found = command_line.run(
        "discover", file, "--dose", "c=dose", "--preset", "quick", "-q", "-j", 1
    )
    assert "c' = -2*c/(c + 3)" in found.output


@pytest.mark.slow
def test_the_law_of_noisy_doses_is_found() -> None:
    """With 1 % noise the constants are within 5 %, in intervals that hold the truth."""
    found = dynsr.discover([course(0.01)], doses={"c": "dose"}, jobs=1)
    assert found.verdict.tested
    assert found.verdict.level == "law"
    by_size = sorted(found.constants["c"], key=lambda c: abs(c.value))
    two, three = by_size[-2:]
    assert abs(two.value) == pytest.approx(2.0, rel=0.05)
    assert three.value == pytest.approx(3.0, rel=0.05)
    assert three.low <= 3.0 <= three.high


def given_at(times, given):
    """Give a concentration that falls by 0.3 per hour, with these doses of 10 in it already."""
    return sum(np.where(times >= at, 10 * np.exp(-0.3 * (times - at)), 0.0) for at in given)


def write_doses(path, empty):
    """Write a table with doses at 0, 8 and 16, each measured before it; other cells are empty."""
    t = np.arange(0, 24.5, 0.5)
    x = given_at(t - 1e-9, (0, 8, 16))
    cells = [f"{a},{b:.5f},{10 if a in (0, 8, 16) else empty}" for a, b in zip(t, x, strict=True)]
    path.write_text("\n".join(["time,conc,dose", *cells]))
    return path


def test_amounts_that_nobody_explained_are_refused(tmp_path):
    """A column of amounts with empty cells elsewhere is no input: the message shows the option."""
    path = write_doses(tmp_path / "doses.csv", "")
    with pytest.raises(InputError) as caught:
        dynsr.describe(path)
    assert "amounts in 3 rows of 49" in str(caught.value)
    assert "--dose conc=dose" in str(caught.value) and "--states conc" in str(caught.value)
    assert dynsr.describe(path, states=["conc"]).inputs == ()


def test_amounts_with_zeros_elsewhere_are_an_input_and_it_is_said(tmp_path):
    """A pulse may be an input or a dose: the note and the options show both."""
    found = dynsr.describe(write_doses(tmp_path / "doses.csv", "0"))
    assert found.inputs == ("dose",) and "--dose conc=dose" in found.options
    assert any("'dose' is 0 but in 3 rows" in note for note in found.notes)


def test_doses_are_described(tmp_path):
    """A description shows which state jumps, by which column and how often; JSON has it."""
    path = write_doses(tmp_path / "doses.csv", "")
    found = dynsr.describe(path, doses={"conc": "dose"})
    assert found.states == ("conc",) and found.inputs == ()
    assert "conc jumps by dose after 3 rows" in str(found)
    assert found.to_dict()["doses"] == {"conc": "dose"}
    shell = command_line.run("describe", str(path), "--dose", "conc=dose").stdout
    assert "conc jumps by dose after 3 rows" in shell


def test_units_of_the_columns_go_with_doses():
    """The unit of the amounts is that of no column of an equation."""
    t = np.arange(0, 24.5, 0.5)
    dose = np.where(np.isin(t, (0, 8, 16)), 10.0, 0.0)
    table = {"time [h]": t, "conc [mg/L]": given_at(t - 1e-9, (0, 8, 16)), "dose [mg]": dose}
    runs, _ = take_trajectories(table, doses={"conc": "dose/2"})
    assert column_units(runs[0], "columns") == {"t": "h", "conc": "mg/L"}


def test_a_table_of_nonmem_is_cut_at_its_doses(tmp_path):
    """Codes are left out, and a measurement written below a dose of its time is one after it."""
    t = np.arange(0, 24.5, 0.5)
    lines = ["ID,TIME,AMT,DV,EVID"]
    for run in (1, 2):
        for a, x in zip(t, given_at(t, (0, 8, 16)), strict=True):
            lines += [f"{run},{a},10,.,1"] if a in (0, 8, 16) else []
            lines.append(f"{run},{a},.,{run * x:.5f},0")
    path = tmp_path / "pk.csv"
    path.write_text("\n".join(lines))
    found = dynsr.describe(path, doses={"DV": "AMT"})
    assert set(found.left_out) == {"EVID"}
    assert [run.rows for run in found.trajectories] == [16, 16, 17] * 2
    assert [run.first for run in found.trajectories] == [0, 8, 16] * 2
    parts, _ = take_trajectories(path, doses={"DV": "AMT"})
    for part in parts:
        slopes = np.diff(np.log(part.x[:, 0])) / np.diff(part.t)
        assert np.all(slopes < 0)  # no part has a jump inside


def test_doses_that_last_are_refused(tmp_path):
    """A column of rates cannot be left out without a word."""
    path = tmp_path / "pk.csv"
    rows = "\n".join(f"{a},{10 if a == 0 else '.'},{20 - a},{1 - (a > 0)},-2" for a in range(12))
    for key in ("RATE", "SS"):
        path.write_text(f"TIME,AMT,DV,EVID,{key}\n{rows}")
        with pytest.raises(InputError, match=rf"'{key}' of pk\.csv is -2 in row 1"):
            dynsr.describe(path, doses={"DV": "AMT"})


def nonmem(**columns):
    """Give a table of NONMEM of two subjects: a dose at 0 with DV = 0, and twelve measurements."""
    t = np.tile(np.arange(0.0, 13), 2)
    given = t == 0
    known = {
        "ID": np.repeat([7.0, 12], 13),
        "TIME": t,
        "AMT": np.where(given, 10.0, 0.0),
        "DV": np.where(given, 0.0, 5 * np.exp(-0.3 * t)),
        "EVID": given.astype(float),
        "MDV": given.astype(float),
    }
    return known | {name: own(t) for name, own in columns.items()}


def test_a_row_of_a_dose_has_no_measurement():
    """DV is 0 there by habit, and AMT is 0 elsewhere: neither is a value."""
    runs, _ = take_trajectories(nonmem(), doses={"DV": "AMT/V"})
    assert not any(np.any(run.x[run.measured] == 0) for run in runs)
    with pytest.raises(InputError, match="say which state jumps by them"):
        take_trajectories(nonmem())


def test_censored_values_are_limits():
    """CENS says below, or above, what DV has; LLOQ is then no input."""
    table = nonmem(CENS=lambda t: np.where(t > 8, 1.0, 0.0), LLOQ=lambda t: 0 * t + 0.4)
    table["DV"] = np.where(table["CENS"] > 0, 0.4, table["DV"])
    found = dynsr.describe(table, doses={"DV": "AMT/V"})
    assert found.states == ("DV",) and not found.inputs
    runs, _ = take_trajectories(table, doses={"DV": "AMT/V"})
    assert sum(int(run.limits["DV"].there.sum()) for run in runs) == 8
    below = np.concatenate([run.limits["DV"].below for run in runs])
    assert np.unique(below[np.isfinite(below)]).tolist() == [0.4]


def test_doses_that_are_given_again_have_rows():
    """ADDL doses follow, II apart: each cuts the run, and the other subject keeps its one."""
    table = nonmem(
        ADDL=lambda t: np.where(np.arange(26) == 0, 2.0, 0.0),
        II=lambda t: np.where(np.arange(26) == 0, 4.0, 0.0),
    )
    given = dynsr.describe(table, doses={"DV": "AMT/V"})
    assert given.given == {"DV": 4}
    (first, other) = read_trajectories(table, doses={"DV": "AMT/V"}).trajectories
    assert first.t[first.by_name["AMT"] == 10].tolist() == [0, 4, 8]
    assert other.t[other.by_name["AMT"] == 10].tolist() == [0]


def test_a_dose_with_a_rate_is_an_infusion():
    """The rate is an input that ends where the amount is given, in a row of its own or not."""
    dose = np.tile(np.arange(13.0) == 0, 2)
    table = nonmem(RATE=lambda t: np.where(dose, 4.0, 0.0))  # 10 at 4 an hour end after 2.5 h
    table["AMT"] = np.where(dose, [10.0] * 13 + [20.0] * 13, 0.0)
    found = read_trajectories(table)
    assert found.description.inputs == ("RATE",) and not found.description.doses
    short, long = found.trajectories
    assert short.hold == {"RATE": "previous"} and not short.measured[short.t == 2.5].any()
    assert short.by_name["RATE"].tolist() == [4.0 * (t < 2.5) for t in short.t]
    assert long.by_name["RATE"].tolist() == [4.0 * (t < 5) for t in long.t]
    assert sorted(set(short.t)) == [1, 2, 2.5, *range(3, 13)]
    with pytest.raises(InputError, match="all doses of 'AMT' in the mapping are infusions"):
        read_trajectories(table, doses={"DV": "AMT/V"})
    both = {**table, "RATE": np.where(np.arange(26) == 0, 4.0, 0.0)}
    infused, given = read_trajectories(both, doses={"DV": "AMT/V"}).trajectories
    assert not infused.by_name["AMT"].any() and given.by_name["AMT"].max() == 20


@pytest.mark.parametrize("which", ["DVID", "CMT"])
def test_each_quantity_of_nonmem_is_a_state(which):
    """A drug and its metabolite are no replicates of one moment."""
    both = {name: np.repeat(own, 2) for name, own in nonmem().items()}
    number = np.tile([1.0, 2.0], 26)
    both |= {which: number, "DV": both["DV"] * np.where(number == 2, 0.1, 1)}
    once = (both["EVID"] == 0) | (number == 1)
    found = dynsr.describe({n: own[once] for n, own in both.items()}, doses={"DV_1": "AMT/V"})
    assert found.states == ("DV_1", "DV_2") and not found.inputs
    assert any("24 rows had other columns filled" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.parametrize("empty", ["", "0"])
def test_a_result_reads_further_tables_with_their_doses(tmp_path, empty):
    """Score and export take the same columns for doses as the search did."""
    path = write_doses(tmp_path / "doses.csv", empty)
    found = dynsr.discover(path, doses={"conc": "dose"}, preset="quick", jobs=1)
    assert found.doses == {"conc": "dose"} and found.verdict.level == "law"
    assert found.score(path)["conc"]["trajectory_rmse"] < 1e-3
    found.save(tmp_path / "found.json")
    shell = command_line.run("score", str(tmp_path / "found.json"), str(path), "--json").stdout
    assert json.loads(shell)["conc"]["trajectory_rmse"] < 1e-3


# Five subjects, two doses each; the volume is 25 and the rate of decay 0.25.
AMOUNTS = (100, 150, 200, 120, 80)
TIMES = (0, 0.5, 1, 2, 3, 4, 6, 8, 10, 11.9, 12.5, 13, 14, 15, 16, 18, 20, 22, 24)


def write_subjects(folder, unit=""):
    """Write concentrations of five subjects with 2 % noise, and a table of their doses."""
    rng = np.random.default_rng(2)
    rows, doses = (
        [f"subject,time,conc{unit and f' [{unit}/L]'}"],
        [f"subject,time,amount{unit and f' [{unit}]'}"],
    )
    for place, amount in enumerate(AMOUNTS, 1):
        doses += [f"S{place},{at},{amount}" for at in (0, 12)]
        for t in TIMES:
            level = sum(amount / 25 * np.exp(-0.25 * (t - at)) for at in (0, 12) if t > at)
            rows.append(f"S{place},{t},{level * (1 + 0.02 * rng.normal()):.4f}")
    (folder / "pk.csv").write_text("\n".join(rows))
    (folder / "given.csv").write_text("\n".join(doses))
    return folder / "pk.csv", folder / "given.csv"


@pytest.mark.slow
def test_the_volume_of_doses_in_a_table_of_their_own_is_fitted(tmp_path):
    """--doses given.csv --dose conc=amount/V finds law, rate and volume; the result keeps them."""
    data, doses = write_subjects(tmp_path)
    out = tmp_path / "out"
    asked = ("--doses", doses, "--dose", "conc=amount/V", "-j", 1, "-o", out)
    shown = command_line.run("discover", data, *asked).stdout
    assert "the volume of doses of conc" in shown
    found = dynsr.load(out / "discovery.json")
    volume = found.volumes["V"]
    assert volume.low < 25 < volume.high and volume.high - volume.low < 1
    assert found.parameters["k1"].value == pytest.approx(0.25, rel=0.02)
    # Amounts are divided by the volume in a simulation too.
    run = found.simulate([0.0], [0.0, 1e-6], doses={"conc": [100.0, 0.0]})
    assert run.x[-1, 0] == pytest.approx(100 / volume.value, rel=1e-5)


@pytest.mark.slow
def test_doses_that_are_kept_back_leave_no_law(tmp_path):
    """Few rows that decay and jump look like noise; they are not at rest for that."""
    data, _ = write_subjects(tmp_path)
    found = dynsr.discover(data, preset="quick", jobs=1)
    assert found.verdict.level == "not found"
    assert "the data need no term of its equation" in found.verdict.states["conc"].reason


def test_doses_become_rows_of_the_data(tmp_path):
    """A dose between rows gets a row; one at the time of a row is in it, measured before."""
    data, doses = write_subjects(tmp_path)
    merged = dynsr.add_doses(data, doses)
    assert len(merged["time"]) == 5 * (len(TIMES) + 1)
    first = merged["subject"] == "S1"
    at = dict(zip(merged["time"][first].tolist(), merged["amount"][first].tolist(), strict=True))
    assert {t: a for t, a in at.items() if a} == {0.0: 100.0, 12.0: 100.0}
    assert np.isnan(merged["conc"][first][merged["time"][first] == 12.0]).all()
    said = str(dynsr.describe(merged, doses={"conc": "amount/V"}))
    assert "conc jumps by amount/V (the volume V is fitted) after 10 rows" in said


def test_a_table_of_doses_may_name_states_and_count_in_another_unit(tmp_path):
    """A column of states gives each a column of amounts; minutes become the hours of the data."""
    data = {"t [h]": np.arange(10.0), "a": np.arange(10.0), "b": np.arange(10.0) ** 2}
    doses = {"t [min]": [60.0, 150.0], "state": ["a", "b"], "amount": [5.0, 7.0]}
    merged = dynsr.add_doses(data, doses)
    assert merged["t [h]"].tolist() == [0, 1, 2, 2.5, *range(3, 10)]
    assert merged["amount_a"].tolist() == [0, 5] + [0] * 9
    assert merged["amount_b"].tolist() == [0, 0, 0, 7] + [0] * 7


@pytest.mark.slow
def test_a_volume_before_is_used_where_rows_are_below_their_dose(tmp_path):
    """Of measurements written below a dose of their time, the doses are known nonetheless."""
    lines = ["ID,TIME,AMT,DV,EVID"]
    for run in (1, 2):
        for a, x in zip(
            np.arange(0, 24.5, 0.5), given_at(np.arange(0, 24.5, 0.5), (0, 8)), strict=True
        ):
            lines += [f"{run},{a},{run * 40},.,1"] if a in (0, 8) else []
            lines.append(f"{run},{a},.,{run * x:.5f},0")
    path = tmp_path / "pk.csv"
    path.write_text("\n".join(lines))
    found = dynsr.discover(path, doses={"DV": "AMT/V"}, preset="quick", jobs=1)
    assert found.volumes["V"].value == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize(
    ("doses", "says"),
    [
        ({"time": [0.0], "who": ["S1"]}, "needs one column of amounts"),
        ({"subject": ["S9"], "time": [0.0], "amount": [1.0]}, "has doses of subject S9"),
        ({"subject": ["S1"], "amount": [1.0]}, "has no column of times"),
        ({"time": [0.0], "state": ["x"], "amount": [1.0]}, "no column 'x' for the state of a dose"),
    ],
)
def test_what_does_not_fit_the_data_is_one_line(tmp_path, doses, says):
    """A table without amounts or times, of an unknown subject or state, says what it needs."""
    data, _ = write_subjects(tmp_path)
    with pytest.raises(InputError, match=says):
        dynsr.add_doses(data, doses)


def test_amounts_in_another_unit_than_the_state_are_refused(tmp_path):
    """mg does not become mg/L without a volume; the line shows how to fit one."""
    data, doses = write_subjects(tmp_path, "mg")
    wrong = command_line.run("describe", data, "--doses", doses, code=2)
    assert "doses are in mg and conc is in mg/L" in wrong.output
    assert "--dose conc=amount/V" in wrong.output
    command_line.run("describe", data, "--doses", doses, "--dose", "conc=amount/V")


def test_a_description_shows_by_which_volume_amounts_are_divided(tmp_path):
    """A volume that is fitted is named, a number is shown, and JSON has both."""
    path = write_doses(tmp_path / "doses.csv", "0")
    shown = command_line.run("describe", path, "--dose", "conc=dose/V").stdout
    assert "conc jumps by dose/V (the volume V is fitted) after 3 rows" in shown
    found = dynsr.describe(path, doses={"conc": "dose/2.5"})
    assert "conc jumps by dose/2.5 after" in str(found)
    assert found.to_dict()["volumes"] == {"conc": "2.5"}


def write_files(folder):
    """Write the five subjects as files of their own, with a table of doses that names subjects."""
    data, doses = write_subjects(folder)
    head, *rows = data.read_text().split("\n")
    files = []
    for place in range(1, 6):
        own = [row for row in rows if row.startswith(f"S{place},")]
        files.append(folder / f"S{place}.csv")
        files[-1].write_text("\n".join([head, *own]))
    return files, doses


def test_each_of_several_files_gets_the_doses_of_its_subject(tmp_path):
    """The subjects of a table are in several files; one that no file has is named."""
    files, doses = write_files(tmp_path)
    asked = ("--doses", doses, "--dose", "conc=amount")
    shown = command_line.run("describe", *files, *asked).stdout
    assert "conc jumps by amount after 10 rows" in shown
    lost = command_line.run("describe", *files[:4], *asked, code=2).output
    assert "has doses of subject S5, of which no file has a row" in " ".join(lost.split())


def test_a_table_of_doses_may_name_files(tmp_path):
    """A column of files says where each dose belongs, where files have no column of subjects."""
    files, doses = write_files(tmp_path)
    for file in files:
        rows = file.read_text().split("\n")
        file.write_text("\n".join(row.split(",", 1)[1] for row in rows))
    doses.write_text(doses.read_text().replace("subject", "file", 1))
    found = dynsr.describe(tmp_path / "S2.csv")
    assert found.states == ("conc",)
    shown = command_line.run("describe", *files, "--doses", doses).stdout
    assert "conc jumps by amount after 10 rows" in shown
    lost = command_line.run("describe", *files[1:], "--doses", doses, code=2).output
    assert "has doses of file 'S1', which is not given" in " ".join(lost.split())


def test_files_that_name_no_state_are_told_the_column_that_was_added(tmp_path):
    """The remedy names the column of amounts, whichever of the files was read last."""
    for name, states in (("a", "x,y"), ("b", "x,y")):
        rows = [f"{t},{np.exp(-t)},{np.exp(-2 * t)}" for t in np.arange(10)]
        (tmp_path / f"{name}.csv").write_text("\n".join([f"t,{states}", *rows]))
    (tmp_path / "given.csv").write_text("t,amount\n2,5\n")
    files = (tmp_path / "a.csv", tmp_path / "b.csv")
    shown = command_line.run("describe", *files, "--doses", tmp_path / "given.csv", code=2).output
    assert "--dose x=amount, or --dose x=amount/V" in " ".join(shown.split())


@pytest.mark.slow
def test_a_batch_takes_a_table_of_doses(tmp_path):
    """Each file of a batch gets its own doses, by the column of files or else all of them."""
    rates = {"slow": 0.3, "fast": 0.6}
    for name, rate in rates.items():
        t = np.arange(0, 24.5, 0.5)
        x = sum(np.where(t > at, 10 * np.exp(-rate * (t - at)), 0.0) for at in (0, 8))
        rows = [f"{a},{b!r}" for a, b in zip(t.tolist(), x.tolist(), strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["time,conc", *rows]))
    given = [f"{name},{at},10" for name in rates for at in (0, 8)]
    (tmp_path / "given.csv").write_text("\n".join(["file,time,amount", *given]))
    files = [tmp_path / f"{name}.csv" for name in rates]
    asked = ("--preset", "quick", "-q", "-j", 1, "-o", tmp_path / "out", "--json")
    shown = command_line.run(
        "discover", *files, "--batch", "--doses", tmp_path / "given.csv", *asked
    ).stdout
    assert [row["equations"] for row in json.loads(shown)] == [
        ["conc' = -0.3*conc"],
        ["conc' = -0.6*conc"],
    ]


@pytest.mark.slow
def test_a_column_of_doses_may_have_another_name_in_further_data(tmp_path):
    """--dose says the column without a table of doses, also for score."""
    path = write_doses(tmp_path / "doses.csv", "0")
    found = dynsr.discover(path, doses={"conc": "dose"}, preset="quick", jobs=1)
    found.save(tmp_path / "found.json")
    other = tmp_path / "other.csv"
    other.write_text(path.read_text().replace("dose", "bolus"))
    asked = ("score", tmp_path / "found.json", other, "--json", "--dose", "conc=bolus")
    shown = command_line.run(*asked).stdout
    assert json.loads(shown)["conc"]["trajectory_rmse"] < 1e-3
