"""What columns mean without a word from the user: labels, parameters, dates, and arrays alone."""

import numpy as np
import pandas as pd
import pytest
import sympy

import dynsr
from dynsr.app.fields import in_fields
from dynsr.data import Trajectory, in_formulas, read_trajectories, take_trajectories
from dynsr.data.times import count_times, unit_in_name
from dynsr.errors import DynsrWarning, InputError
from dynsr.methods import RationalSearch

T = np.arange(0, 5, 0.1)
QUICK = {
    "method": RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1),
    "jobs": 1,
}
DAYS = pd.date_range("2024-01-01", periods=60, freq="D")
DECAY = np.exp(-np.arange(60) / 20)


def experiments(**columns):
    """Give one decay for each value of the columns, one below the other."""
    count = len(next(iter(columns.values())))
    frames = [
        pd.DataFrame({**{n: own[i] for n, own in columns.items()}, "t": T, "x": (i + 1) / (1 + T)})
        for i in range(count)
    ]
    return pd.concat(frames, ignore_index=True)


@pytest.mark.parametrize("name", ["well", "subject", "mouse", "whatever"])
@pytest.mark.parametrize("interleaved", [False, True])
def test_a_text_column_names_the_trajectories(name, interleaved):
    """A text column within which times increase is taken for the trajectory, and said to be."""
    data = experiments(**{name: ["A1", "B2", "C3"]})
    table = read_trajectories(data.sort_values("t", kind="stable") if interleaved else data)
    assert f"3 trajectories named by {name!r}" in table.guess
    assert [run.x[0, 0] for run in table.trajectories] == [1.0, 2.0, 3.0]


def test_a_text_column_that_names_no_trajectory_is_refused_with_both_remedies():
    """A text that changes to and fro is neither left out nor taken for a name."""
    data = pd.DataFrame({"t": T, "light": ["day", "night"] * 25, "x": T**2})
    with pytest.raises(InputError, match="leave the column out, or say --trajectory light"):
        read_trajectories(data)
    assert read_trajectories(data, states=["x"]).trajectories[0].states == ("x",)


def test_text_that_is_constant_within_trajectories_is_no_state():
    """A second label is left out, and the guess names it; labels that split together are both."""
    data = experiments(drug=["KCl", "KCl", "none"], well=["A", "B", "C"])
    table = read_trajectories(data)
    assert "named by 'well'" in table.guess
    assert "labels of trajectories, not used: 'drug'" in table.guess
    table = read_trajectories(
        experiments(drug=["x", "x", "y", "y"], animal=["1a", "2a", "1a", "2a"])
    )
    assert table.names == ("x, 1a", "x, 2a", "y, 1a", "y, 2a")
    assert "4 trajectories named by 'drug', 'animal'" in table.guess


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("mouse", [11, 12, 17], "3 trajectories named by 'mouse'"),
        ("number", [1, 2, 3], "3 trajectories named by 'number'"),
        ("dose", [5, 10, 10], "constant within each trajectory, so taken for parameters: dose"),
        ("k", [0.5, 1.0, 2.0], "constant within each trajectory, so taken for parameters: k"),
    ],
)
def test_a_number_that_is_constant_within_runs_is_a_label_or_a_parameter(name, values, said):
    """It is never a state, and the guess says which of the two was assumed."""
    table = read_trajectories(experiments(**{name: values}))
    assert said in table.guess
    assert table.trajectories[0].states == ("x",)
    assert table.trajectories[0].input_names == ((name,) if "parameters" in said else ())


def test_a_parameter_stays_one_where_an_input_is_named():
    """The input that is named is no reason to leave out a number that differs from run to run."""
    table = experiments(kelvin=[280, 300, 320]).assign(u=lambda own: np.sin(own["t"]))
    read = read_trajectories(table, inputs=["u"])
    assert read.description.states == ("x",) and read.description.parameters == ("kelvin",)
    assert set(read.trajectories[0].input_names) == {"u", "kelvin"}
    alone = read_trajectories(table, states=["x"], inputs=["u"])
    assert alone.trajectories[0].input_names == ("u",)


def test_a_sum_that_differs_in_its_last_digits_is_constant():
    """N = S + I + R is left out in one run and a parameter of several, whatever its rounding."""
    parts = (np.exp(-T), 1 / 3 + T / 9 - np.exp(-T) / 3)
    table = {"t": T, "S": parts[0], "I": parts[1]}
    total = 1 + np.finfo(float).eps * (np.arange(len(T)) // 7 % 2)
    read = read_trajectories({**table, "N": total})
    assert read.trajectories[0].names == ("S", "I") and read.left_out == {"N": "is 1 in every row"}
    both = pd.concat([pd.DataFrame({"run": f"r{k}", **table, "N": k * total}) for k in (1, 2)])
    assert read_trajectories(both).description.parameters == ("N",)


def test_whole_numbers_that_alone_keep_the_times_in_order_name_the_trajectories():
    """Rows sorted by time are told apart by the one column that can."""
    data = experiments(house=[7, 3, 5]).sort_values("t", kind="stable")
    table = read_trajectories(data)
    assert "3 trajectories named by 'house'" in table.guess


@pytest.mark.slow
def test_a_parameter_stands_in_the_equation():
    """The rate of a decay that a column holds, another in each run, is found as that column."""
    t = np.arange(0, 3, 0.05)
    data = pd.concat(
        [pd.DataFrame({"k": k, "t": t, "x": np.exp(-k * t)}) for k in (0.5, 0.9, 1.4, 2.0)],
        ignore_index=True,
    )
    found = dynsr.discover(data, **QUICK)
    assert str(found).partition("\n")[2] == "x' = -k*x"
    assert "taken for parameters: k" in found.settings["columns"]


@pytest.mark.parametrize(
    ("step", "unit", "size"),
    [
        ("D", "days", 1.0),
        ("W", "days", 7.0),
        ("h", "h", 1.0),
        ("15min", "min", 15.0),
        ("10s", "s", 10.0),
        ("100ms", "s", 0.1),
        ("YS", "years", 1.0),
    ],
)
def test_dates_are_counted_in_a_unit_of_the_size_of_their_steps(step, unit, size):
    """Dates and durations are counted in days for daily data, and so on, as the guess says."""
    dates = pd.date_range("2021-01-01", periods=40, freq=step)
    for times in (dates, dates - dates[0]):
        table = read_trajectories(pd.DataFrame({"when": times, "x": DECAY[:40]}))
        (run,) = table.trajectories
        assert run.time_unit == unit
        assert np.allclose(np.diff(run.t), size, rtol=3e-3)
        words = {"h": "hours", "min": "minutes", "s": "seconds"}.get(unit, unit)
        assert f"time 'when' in {words}" in table.guess


@pytest.mark.parametrize("form", ["%Y-%m-%d", "%d.%m.%Y", "%m/%d/%Y", "%d/%m/%Y", "%Y/%m/%d"])
def test_dates_as_text(tmp_path, form):
    """Dates of one form throughout are read, day first or month first where only one fits."""
    frame = pd.DataFrame({"date": DAYS.strftime(form), "x": DECAY})
    frame.to_csv(tmp_path / "data.csv", index=False)
    (run,) = read_trajectories(tmp_path / "data.csv").trajectories
    assert np.array_equal(run.t, np.arange(60)) and run.time_unit == "days"


@pytest.mark.parametrize(
    ("form", "name"),
    [("%y%b%d", "date"), ("%d-%b-%y", "date"), ("%Y%b%d", "date"), ("%d%b%Y:%H:%M", "date"),
     ("%y%b%d", "YYMMMDD")],
)  # fmt: skip
def test_a_month_by_its_name_may_be_between_a_day_and_a_year(form, name):
    """11MAR14 is of 2011 where the dates rise so, or where the name of the column says it."""
    days = pd.date_range("2011-03-14", periods=11 if name != "date" else 60)
    dates = np.array([day.strftime(form).upper() for day in days])
    table = read_trajectories({name: dates, "x": DECAY[: len(days)]})
    (run,) = table.trajectories
    assert np.array_equal(run.t, np.arange(len(days))) and run.time_unit == "days"
    assert table.description.time.begins == "2011-03-14"


def test_a_day_or_a_year_before_a_month_is_said():
    """Where both rise the first number is the day, and a note says how one of them was read."""
    dates = np.array([f"{day}-Mar-14" for day in range(10, 22)])
    table = read_trajectories({"date": dates, "x": DECAY[:12]})
    assert table.trajectories[0].time_unit == "days"
    assert any("'10-Mar-14', which was read as 2014-03-10" in note for note in table.notes)
    dates = np.array([f"Mar{day}14" for day in range(10, 22)])
    with pytest.raises(InputError, match="dates such as 2024-12-31"):
        read_trajectories({"date": dates, "x": DECAY[:12]})


def test_dates_that_may_be_read_in_two_ways_are_refused():
    """Nobody guesses whether 01/02/2024 is in January."""
    dates = [f"{day:02d}/{day % 12 + 1:02d}/2024" for day in range(1, 12)]
    with pytest.raises(InputError, match="dates such as 2024-12-31"):
        read_trajectories({"date": np.array(dates), "x": DECAY[:11]})


def test_durations_as_text(tmp_path):
    """Durations as pandas writes them, and times of a clock, are times."""
    hours = pd.to_timedelta(np.arange(60), unit="h")
    pd.DataFrame({"t": hours, "x": DECAY}).to_csv(tmp_path / "data.csv", index=False)
    (run,) = read_trajectories(tmp_path / "data.csv").trajectories
    assert np.array_equal(run.t, np.arange(60)) and run.time_unit == "h"
    clock = np.array([f"00:{minute:02d}" for minute in range(60)])
    (run,) = read_trajectories({"t": clock, "x": DECAY}).trajectories
    assert np.array_equal(run.t, np.arange(60)) and run.time_unit == "min"


@pytest.mark.parametrize(
    "times",
    [DAYS, DAYS - DAYS[0], DAYS.tz_localize("Europe/Berlin"), np.arange(60) * 0.1],
    ids=["dates", "durations", "zone", "fractions"],
)
def test_the_index_of_a_frame_is_the_time(times):
    """An index of dates, durations or rising fractions is the time, named or not."""
    frame = pd.DataFrame({"x": DECAY}, index=times)
    for named in (frame, frame.rename_axis(index="when")):
        (run,) = read_trajectories(named).trajectories
        assert run.states == ("x",) and run.t[-1] == pytest.approx(59 * run.t[1])
        (other,) = read_trajectories(named["x"]).trajectories
        assert other.states == ("x",) and np.array_equal(other.t, run.t)
    for frame in (pd.DataFrame({"x": DECAY}), pd.Series(DECAY)):
        with pytest.raises(InputError, match="looks like the time"):
            read_trajectories(frame)


def test_periods_are_times():
    """Months of pandas, in a column or as the index."""
    months = pd.period_range("2024-01", periods=60, freq="M")
    for frame in (pd.DataFrame({"m": months, "x": DECAY}), pd.Series(DECAY, index=months)):
        (run,) = read_trajectories(frame).trajectories
        assert run.time_unit == "days" and run.t[:3].tolist() == [0, 31, 60]


def test_frames_by_name_are_a_list():
    """A mapping holds columns; runs are given as a list, which the message says."""
    frame = pd.DataFrame({"t": T, "x": T**2})
    with pytest.raises(InputError, match=r"'a' of the mapping is a data frame; give a list"):
        read_trajectories({"a": frame, "b": frame})


def test_ts_may_be_the_time():
    """Milliseconds since 1970 under that name are times."""
    table = read_trajectories({"ts": 1.77e12 + 500 * np.arange(60.0), "x": DECAY})
    (run,) = table.trajectories
    assert run.time_unit == "s" and run.t[-1] == 29.5
    assert "'ts' holds milliseconds since 1970" in table.notes


def test_dates_under_any_name_are_the_time():
    """A column of dates as text or objects is found though it is called otherwise."""
    for dates in (DAYS.strftime("%Y-%m-%d").to_numpy(dtype=object), list(DAYS.to_pydatetime())):
        (run,) = read_trajectories({"seen": dates, "x": DECAY}).trajectories
        assert run.time_unit == "days" and run.states == ("x",)


def test_dates_as_whole_numbers():
    """20240131 and 20240201 are a day apart where the column is one of dates."""
    compact = DAYS.strftime("%Y%m%d").astype(int).to_numpy()
    (run,) = read_trajectories({"date": compact, "x": DECAY}).trajectories
    assert np.array_equal(run.t, np.arange(60)) and run.time_unit == "days"
    (run,) = read_trajectories({"t": np.arange(2e7, 2e7 + 60), "x": DECAY}).trajectories
    assert run.t[0] == 2e7 and run.time_unit == ""


def test_the_name_of_the_time_says_its_unit():
    """A unit in the name is known; a letter alone, or no unit, is none."""
    names = ["t [s]", "time (ms)", "t_h", "hours", "Day", "t", "y", "temperature"]
    assert [unit_in_name(n) for n in names] == ["s", "ms", "h", "h", "days", "", "", ""]
    table = read_trajectories({"hours": T, "x": T**2})
    assert table.trajectories[0].time_unit == "h" and "time 'hours' in hours" in table.guess


def test_files_in_several_units_are_counted_in_the_first_one():
    """A list of hourly and daily data has one unit."""
    hourly = pd.DataFrame({"t": pd.date_range("2024-01-01", periods=48, freq="h"), "x": DECAY[:48]})
    daily = pd.DataFrame({"t": DAYS, "x": DECAY})
    first, second = read_trajectories([hourly, daily]).trajectories
    assert first.time_unit == second.time_unit == "h"
    assert np.array_equal(second.t, 24.0 * np.arange(60))
    for mixed in ([hourly, {"t": T, "x": T**2}], [{"t": T, "x": T**2}, hourly]):
        with pytest.raises(InputError, match=r"times are counted in .* and in .*; give all"):
            read_trajectories(mixed)
    with pytest.raises(InputError, match="times are counted in h and in weeks"):
        read_trajectories([hourly, {"weeks": T, "x": T**2}])


def test_trajectories_of_dates_have_a_unit_too():
    """A Trajectory, and a pair of arrays, count dates as tables do."""
    assert Trajectory(DAYS, DECAY[:, None], ("x",)).time_unit == "days"
    runs, _ = take_trajectories((DAYS.to_numpy(), DECAY))
    assert runs[0].time_unit == "days" and runs[0].t[-1] == 59.0
    assert count_times(DAYS.to_numpy()[::-1])[1] == "s"


def test_a_rate_is_in_the_unit_of_the_data():
    """Daily data that decay by a twentieth a day have the rate 0.05, and the record says days."""
    found = dynsr.discover(pd.DataFrame({"date": DAYS, "x": DECAY}), **QUICK)
    assert str(found).partition("\n")[2] == "x' = -0.05*x"
    assert found.settings["time_unit"] == "days"


def test_a_score_counts_times_as_the_discovery_does():
    """A rate a day found in daily data is as good on hourly data of the same decay."""
    found = dynsr.discover(pd.DataFrame({"date": DAYS, "x": DECAY}), **QUICK)
    hours = pd.date_range("2024-05-01", periods=200, freq="h")
    hourly = pd.DataFrame({"date": hours, "x": np.exp(-np.arange(200) / 480)})
    assert read_trajectories(hourly).trajectories[0].time_unit == "h"
    assert found.score(hourly)["x"]["trajectory_rmse"] < 1e-6


@pytest.mark.slow
def test_discover_takes_the_roles_of_columns():
    """time, states, trajectory and inputs mean in Python what they mean in the shell."""
    other = np.sin(T)
    frame = pd.DataFrame({"z": T, "a": np.exp(-T), "b": other, "n": 1})
    assert dynsr.discover(frame, time="z", states=["a"], **QUICK).equations.keys() == {"a"}
    assert dynsr.discover(np.exp(-T), time=T, **QUICK).equations.keys() == {"x"}
    assert dynsr.discover((T, np.exp(-T)), states="c", **QUICK).equations.keys() == {"c"}
    rows = pd.DataFrame(
        {"t": [*T, *T], "a": [*np.exp(-T), *np.exp(-T) * 2], "n": [1.0] * 50 + [4] * 50}
    )
    found = dynsr.discover(rows, trajectory="n", inputs=[], **QUICK)
    assert len(found.trajectories) == 2
    table = read_trajectories(rows)
    assert str(dynsr.discover(table, **QUICK)) == str(found)
    assert str(found).endswith("\na' = -a")


@pytest.mark.filterwarnings("ignore:columns were renamed")
def test_every_option_takes_the_names_of_the_table():
    """A column is called as in the table, with its unit or without, or as in formulas."""
    t = np.linspace(0, 6, 41)
    table = {"t": t, "heat flow [W]": np.sin(t), "Bath temp. [K]": 300 + np.exp(-t)}
    table["Room (K)"] = 290 + np.exp(-t / 2)
    for inputs, state in (
        (["heat flow [W]"], "Bath temp. [K]"),
        (["heat flow"], "Bath temp."),
        (["heat_flow"], "Bath_temp"),
    ):
        runs, _ = take_trajectories(
            table, inputs, hold={inputs[0]: "linear"}, noise={state: 0.1}, limits={state: 200}
        )
        (run,) = runs
        assert run.names == ("Bath_temp", "Room", "heat_flow") and list(run.noise) == ["Bath_temp"]
        assert run.hold == {"heat_flow": "linear"}
        asked = in_formulas({state: 1, "all": 2}, run), in_formulas([state, "x"], run)
        assert asked == ({"Bath_temp": 1, "all": 2}, ["Bath_temp", "x"])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:columns were renamed")
def test_a_search_takes_the_names_of_the_table():
    """Targets, known parts, signs, slopes and sums name columns as the table does."""
    t = np.linspace(0, 6, 41)
    table = {"t": t, "a cell": np.exp(-t), "all cells": 3 * np.exp(-t / 2), "pump (V)": 0 * t + 1}
    found = dynsr.discover(
        {**table, "pump (V)": np.sin(t)},
        inputs=["pump (V)"],
        targets=["a cell"],
        known={"a cell": "-a_cell/2"},
        must={"a cell": "a_cell"},
        nonnegative=["a cell"],
        slopes={"a cell": -np.exp(-t)},
        order={"a cell": 1},
        observed={"all cells": "a_cell + b"},
        **QUICK,
    )
    assert sympy.simplify(found.equations["a_cell"] + sympy.Symbol("a_cell")) == 0


@pytest.mark.slow
def test_an_input_may_be_a_function_or_values():
    """A callable of one time or of all, and an array, are inputs as a column is."""
    x = np.exp(-T) + np.sin(T)
    drive = np.cos(T) + np.sin(T)
    given = [lambda t: np.cos(t) + np.sin(t), lambda t: float(np.cos(t) + np.sin(t)), drive]
    for value in given:
        found = dynsr.discover({"t": T, "x": x}, inputs={"F": value}, **QUICK)
        assert str(found).partition("\n")[2] == "x' = F - x"
        assert np.allclose(found.simulate().x[:, 0], x, atol=1e-5)
    later = np.linspace(0, 20, 30)
    beyond = found.simulate([1.0], later, inputs={"F": given[0]})
    assert np.allclose(beyond.x[:, 0], np.exp(-later) + np.sin(later), atol=1e-4)
    with pytest.raises(InputError, match="one value a time"):
        dynsr.discover({"t": T, "x": x}, inputs={"F": drive[:9]}, **QUICK)
    with pytest.raises(InputError, match="is inf at t = 0"):
        take_trajectories({"t": T, "x": x}, {"F": lambda t: 1.0 / t if t else np.inf})


def test_an_array_without_times_is_told_to_bring_them():
    """States alone are refused in words that ask for t; what may be states is warned about."""
    for states in (np.exp(-T), np.exp(-T)[:, None], np.column_stack([np.cos(T), np.sin(T)])):
        with pytest.raises(InputError, match=r"give (them|the times) too: \(t, x\)"):
            dynsr.discover(states, **QUICK)
    growth = np.column_stack([np.exp(T), np.sin(T)])
    with pytest.warns(DynsrWarning, match="taken for the time, in uneven steps"):
        read_trajectories(growth)


def test_a_name_that_can_stand_in_a_formula_is_kept():
    """Only what cannot be used in a formula is renamed."""
    columns = {"t": T, "inf_": np.exp(-T), "_a": T**2, "a__b": T**3}
    assert read_trajectories(columns).trajectories[0].states == ("inf_", "_a", "a__b")


@pytest.mark.parametrize("zone", ["Europe/Berlin", "Europe/London", "America/New_York"])
@pytest.mark.parametrize("step", ["15min", "1h"])
@pytest.mark.parametrize("first", ["2025-03-07", "2025-03-28", "2025-10-24", "2025-10-31"])
def test_a_clock_of_summer_time_is_counted_as_it_passed(zone, step, first):
    """The hour that is left out, or comes twice, is no gap and no second run, and it is said."""
    passed = pd.date_range(first, periods=400, freq=step, tz="UTC")
    local = passed.tz_convert(zone).tz_localize(None)
    x = np.cos(np.arange(400) / 30)
    table = read_trajectories({"when": local.strftime("%Y-%m-%d %H:%M").to_numpy(object), "x": x})
    (run,) = table.trajectories
    hours = (passed - passed[0]).total_seconds() / 3600
    assert np.allclose(run.t * {"min": 1 / 60, "h": 1.0}[run.time_unit], hours)
    jumps = len(set(passed.tz_convert(zone).tz_localize(None) - passed.tz_localize(None))) > 1
    assert any("summer time" in note for note in table.notes) == jumps


def test_a_gap_of_an_hour_stays_a_gap():
    """One on another day, or at another time of the day, is no summer time."""
    for first in ("2025-03-31 01:00", "2025-03-30 10:00"):
        clock = pd.date_range(first, periods=60, freq="15min").delete([8, 9, 10, 11])
        cells = clock.strftime("%Y-%m-%d %H:%M").to_numpy(object)
        (run,) = read_trajectories({"when": cells, "x": np.arange(56.0) ** 2}).trajectories
        assert np.ptp(run.t) == 59 * 15


def test_a_row_for_each_year_and_a_column_for_each_month_is_one_series():
    """Tables of climate have the months of a year in a row, and means behind them."""
    months = pd.date_range("1990-01-01", periods=240, freq="MS")
    x = np.cos(np.arange(240) / 9)
    frame = pd.DataFrame(x.reshape(20, 12), columns=months[:12].strftime("%b"))
    frame.insert(0, "Year", np.arange(1990, 2010))
    frame["J-D"] = frame.iloc[:, 1:].mean(axis=1)
    table = read_trajectories(frame.iloc[::-1])
    (run,) = table.trajectories
    assert run.states == ("value",) and np.array_equal(run.x[:, 0], x)
    assert np.array_equal(run.t, (months - months[0]).days)
    assert "J-D" in table.left_out and any("column for each month" in n for n in table.notes)
    apart = read_trajectories(frame, states=["Jan", "Feb"]).trajectories
    assert apart[0].states == ("Jan", "Feb")


@pytest.mark.parametrize("unit", ["M", "Y"])
def test_months_and_years_of_numpy_are_dates(unit):
    """They have no fixed length, and are the days that they begin at."""
    months = np.datetime64("2001", unit) + np.arange(24)
    (run,) = read_trajectories({"when": months, "x": np.arange(24.0) ** 2}).trajectories
    days = (months.astype("datetime64[D]") - months[0].astype("datetime64[D]")).astype(float)
    assert np.allclose(run.t * {"days": 1.0, "years": 365.25}[run.time_unit], days)


@pytest.mark.parametrize("name", ["week", "ISO week", "epi_week", "KW"])
def test_a_year_and_a_week_are_one_time(name):
    """Weeks go on in the next year, whatever else rises in the table."""
    weeks = pd.date_range("2020-10-05", periods=60, freq="7D")
    iso = weeks.isocalendar()
    x = 1000 / (1 + 50 * np.exp(-0.15 * np.arange(60)))
    table = {"year": iso.year.to_numpy(float), name: iso.week.to_numpy(float), "cases": x}
    (run,) = read_trajectories(table).trajectories
    assert run.states == ("cases",) and np.array_equal(run.t, 7.0 * np.arange(60))
    both = 100 * table["year"] + table[name]
    (run,) = read_trajectories({f"{name} week": both, "cases": x}).trajectories
    assert run.states == ("cases",) and np.array_equal(run.t, 7.0 * np.arange(60))


@pytest.mark.parametrize("name", ["yyyy.yyyy", "decimal_year", "Year (dec)"])
def test_a_decimal_year_next_to_dates_is_a_second_time(name):
    """Leap years keep it off a line in days."""
    days = pd.date_range("2011-03-14", periods=60, freq="30D")
    years = days.year + (days.day_of_year - 1) / np.where(days.is_leap_year, 366, 365)
    data = {"date": days.strftime("%Y-%m-%d").to_numpy(), name: np.round(years, 4), "x": DECAY}
    table = read_trajectories(data)
    assert table.trajectories[0].states == ("x",)
    assert "a second time" in table.left_out[name]


@pytest.mark.parametrize("name", ["month", "yyyymm", "period", "date"])
def test_six_digits_are_a_year_and_a_month(name):
    """202012 is followed by 202101."""
    months = pd.date_range("2020-07-01", periods=30, freq="MS")
    cells = (100 * months.year + months.month).to_numpy(float)
    (run,) = read_trajectories({name: cells, "x": np.arange(30.0) ** 2}).trajectories
    assert np.array_equal(run.t, (months - months[0]).days)


def test_a_column_that_is_no_time_by_name_is_said_where_it_is_taken_for_it():
    """Down a profile the pressure is the first that rises, though it counts by 1."""
    depth = np.arange(1.0, 61.0)
    profile = {"P [dbar]": depth, "T [degC]": 4 + np.exp(-depth / 9), "S [PSU]": 35 - 9 / depth}
    table = read_trajectories(profile)
    assert table.roles.time == "P [dbar]" and table.trajectories[0].states == ("T", "S")
    (note,) = table.notes
    assert "'P [dbar]' rises from row to row and was taken" in note
    assert in_fields(note).endswith("if it is another one, name that (the role 'time').")
    assert not read_trajectories({"t": depth, "x": DECAY}).notes
    for name, back in {"age_ka": True, "Age (yr BP)": True, "Karma": False}.items():
        (note,) = read_trajectories({name: depth, "x": DECAY}).notes
        assert ("counts back from now" in note) == back


def test_dates_that_are_written_in_two_ways_are_refused_as_such():
    """No other column that rises takes their place without a word."""
    days = pd.date_range("2020-01-14", periods=30, freq="30D")
    cells = [f"{d:%d/%m/%Y}" if k < 5 else f"{d:%Y-%m-%d}" for k, d in enumerate(days)]
    with pytest.raises(InputError, match="'date' of the mapping is written in two ways"):
        read_trajectories({"date": np.array(cells, dtype=object), "N": np.arange(30.0) ** 2})


def test_a_column_of_one_number_in_few_rows_says_how_few():
    """What is given four times is no constant, and how it can be used is said."""
    t = np.arange(60.0)
    given = np.where(t % 15 == 4, 5.0, np.nan)
    table = read_trajectories({"t": t, "glucose": np.cos(t / 9), "insulin": given})
    assert "is 5 in 4 of 60 rows, empty in all others" in table.left_out["insulin"]
    assert "--dose" in table.left_out["insulin"]
