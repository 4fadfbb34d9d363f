"""What columns mean: times, runs, quantities, replicates, inputs; and what is not taken so."""

import warnings

import numpy as np
import pandas as pd
import pytest
from command_line import run as run_command

import dynsr
from dynsr.data import read_trajectories, take_trajectories
from dynsr.data.levels import find_levels
from dynsr.errors import DynsrWarning, InputError
from dynsr.methods import RationalSearch

pytestmark = pytest.mark.filterwarnings("ignore:columns were renamed")
N = 30
QUICK = {
    "method": RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1),
    "jobs": 1,
}
T = np.arange(N) * 0.5
DECAY = 40 * np.exp(-0.2 * T) + 1
RISE = 10 / (1 + 9 * np.exp(-0.5 * T))


def text(cells):
    """Give cells as a column of text."""
    return np.array(list(cells), dtype=object)


def states(source, **options):
    """Give the names of the states of a source."""
    return read_trajectories(source, **options).trajectories[0].states


def one(source, **options):
    """Give the only trajectory of a source."""
    (run,) = read_trajectories(source, **options).trajectories
    return run


STAMPS = pd.date_range("2024-03-12 22:50", periods=N, freq="5min")


@pytest.mark.parametrize(
    ("day", "clock", "names"),
    [
        ("%d.%m.%Y", "%H:%M:%S", ("Datum", "Uhrzeit")),
        ("%m/%d/%Y", "%I:%M %p", ("Date", "Time")),
        ("%Y-%m-%d", "%H:%M", ("fecha", "hora")),
        ("%d/%m/%y", "%H:%M:%S.%f", ("date", "heure")),
        ("%d-%b-%Y", "%I:%M:%S %p", ("day", "clock")),
    ],
)
def test_a_date_and_a_clock_are_one_time(day, clock, names):
    """Whatever they are called: from the first row on, in a unit of their step, past midnight."""
    columns = {
        names[1]: text(STAMPS.strftime(clock)),
        "x": DECAY,
        names[0]: text(STAMPS.strftime(day)),
    }
    table = read_trajectories(columns)
    (run,) = table.trajectories
    assert run.states == ("x",) and run.time_unit == "min"
    assert np.allclose(run.t, 5 * np.arange(N))
    assert (table.roles.time, table.roles.clock) == names
    again = one(columns, time=f"{names[0]},{names[1]}")
    assert np.array_equal(again.t, run.t)


def test_a_date_beside_hours_is_one_time():
    """A number from 0 to 23 beside a date is its clock; hours since the start are a time alone."""
    when = pd.date_range("2024-05-01", periods=72, freq="h")
    columns = {"date": text(when.strftime("%d.%m.%Y")), "hour": when.hour.to_numpy(float)}
    run = one({**columns, "load": np.sin(np.arange(72) / 5)})
    assert np.array_equal(run.t, np.arange(72.0)) and run.time_unit == "h"
    run = one({"date": text(["01.05.2024"] * N), "hours": T, "x": DECAY})
    assert np.array_equal(run.t, T) and run.time_unit == "h"


@pytest.mark.parametrize(
    "form",
    [
        "%m/%d/%Y %I:%M %p",
        "%m/%d/%y %H:%M",
        "%d.%m.%y %H:%M:%S",
        "%d/%m/%Y, %H:%M",
        "%Y-%m-%dT%H:%M:%SZ",
        "%Y-%m-%d %H:%M:%S+02:00",
        "%d %b %Y %H:%M",
        "%Y%m%d%H%M%S",
    ],
)
def test_stamps_of_many_forms(form):
    """AM and PM, two digits of a year, zones, names of months: the same times."""
    run = one({"x": DECAY, "Timestamp": text(STAMPS.strftime(form))})
    assert np.allclose(run.t, 5 * np.arange(N)) and run.time_unit == "min"


@pytest.mark.parametrize("form", ["%b-%y", "%y-%b", "%B %y", "%b '%y"])
@pytest.mark.parametrize("backwards", [False, True])
def test_months_of_years_of_two_digits_are_no_days(form, backwards):
    """Jan-26 follows Dec-25, as a spreadsheet writes months."""
    monthly = pd.date_range("2024-11-01", periods=N, freq="MS")
    cells = text(monthly.strftime(form))[:: -1 if backwards else 1]
    run = one({"Date": cells, "x": DECAY})
    assert run.time_unit == "days" and np.array_equal(run.t, (monthly - monthly[0]).days)
    assert run.origin["table"]["time"]["begins"] == "2024-11-01"


@pytest.mark.parametrize("form", ["%d-%b", "%d. %B", "%b %d"])
def test_days_without_a_year_go_on_after_new_year(form):
    """31-Dec is followed by 1-Jan of the next year, and the 29th of February is there."""
    for first in ("2025-12-20", "2024-02-15"):
        daily = pd.date_range(first, periods=N, freq="D")
        table = read_trajectories({"Date": text(daily.strftime(form)), "x": DECAY})
        assert np.array_equal(table.trajectories[0].t, np.arange(float(N)))
        assert "'Date' holds days without a year" in table.notes


@pytest.mark.parametrize(
    ("form", "frequency"), [("%b", "MS"), ("%B", "MS"), ("%a", "D"), ("%A", "D"), ("Q%q", "QS")]
)
def test_names_of_months_and_days_are_counted_on(form, frequency):
    """Jan, Feb, ... without a year, and Mon, Tue, ... go on where they begin again."""
    dates = pd.period_range("2001-01-01", periods=N, freq=frequency[0])
    table = read_trajectories({"when": text(dates.strftime(form)), "x": DECAY})
    (run,) = table.trajectories
    starts = dates.to_timestamp()
    assert run.time_unit == "days" and np.array_equal(run.t, (starts - starts[0]).days)
    assert any(note.startswith("'when' holds names of ") for note in table.notes)
    assert not run.origin["table"]["time"].get("begins")


def test_names_of_months_next_to_a_time_are_no_time():
    """A number that counts the rows in a unit says more, and so does a year next to a month."""
    months = pd.period_range("2020-01", periods=N, freq="M")
    cells = {"t": 2.5 * np.arange(N), "month": text(months.strftime("%b")), "x": DECAY}
    assert np.array_equal(one(cells).t, cells["t"])
    run = one({"year": months.year, "month": text(months.strftime("%b")), "x": DECAY})
    assert run.origin["table"]["time"]["begins"] == "2020-01-01"
    run = one({"quarter": text([f"Q{p.quarter} {p.year}" for p in months[::3]]), "x": DECAY[::3]})
    assert run.t[1] == 91 and run.origin["table"]["time"]["begins"] == "2020-01-01"


def test_day_and_month_are_told_apart_by_the_whole_column():
    """A day over 12, the order of the rows, or a record without a pause of a month decides."""
    daily = pd.date_range("2024-04-05", periods=N, freq="D")
    for form in ("%d/%m/%Y", "%m/%d/%Y"):
        run = one({"date": text(daily.strftime(form)), "x": DECAY})
        assert np.array_equal(run.t, np.arange(float(N)))
    hourly = pd.date_range("2024-04-05 20:00", periods=N, freq="h")
    for form in ("%d/%m/%Y %H:%M", "%m/%d/%Y %H:%M"):
        run = one({"date": text(hourly.strftime(form)), "x": DECAY})
        assert np.array_equal(run.t, np.arange(float(N)))


def test_a_clock_goes_on_past_midnight():
    """A clock alone that falls back at midnight is of the next day, which is said."""
    table = read_trajectories({"Uhrzeit": text(STAMPS.strftime("%H:%M")), "x": DECAY})
    (run,) = table.trajectories
    assert np.allclose(run.t, 5 * np.arange(N)) and run.time_unit == "min"
    assert any("midnight" in note for note in table.notes)


def test_a_stopwatch_that_starts_again_begins_a_run():
    """A clock that falls back to its start in the middle of a day is no midnight."""
    clock = text([f"00:{m:02d}:00" for m in range(15)] * 2)
    table = read_trajectories({"time": clock, "x": np.tile(DECAY[:15], 2)})
    assert [len(run) for run in table.trajectories] == [15, 15]
    assert not any("midnight" in note for note in table.notes)


@pytest.mark.parametrize(
    ("scale", "name"), [(1, "time"), (1e3, "timestamp"), (1e6, "time_us"), (1e3, "epoch [ms]")]
)
def test_times_since_1970_begin_at_the_first_row(scale, name):
    """Seconds, milli- and microseconds since 1970 are counted from the first row on."""
    name = "timestamp" if name == "epoch [ms]" else name
    run = one({name: (1.7e9 + 0.25 * np.arange(N)) * scale, "x": DECAY})
    assert np.allclose(run.t, 0.25 * np.arange(N), atol=1e-6) and run.time_unit == "s"


def test_large_plain_times_stay_as_they_are():
    """A time that is no date keeps its numbers, and its start."""
    run = one({"t": 5e8 + np.arange(N), "x": DECAY})
    assert run.t[0] == 5e8 and run.time_unit == ""
    assert one({"time": 12.5 + T, "x": DECAY}).t[0] == 12.5


def test_days_of_a_spreadsheet():
    """Days since 1900 in a column of dates begin at the first row."""
    run = one({"Date": 45363.5 + np.arange(N) / 24, "x": DECAY})
    assert np.allclose(run.t, np.arange(N)) and run.time_unit == "h"


def test_the_time_may_stand_anywhere_and_a_temperature_is_none():
    """The third column is the time where it is called so; T beside it is a state."""
    table = read_trajectories({"T": DECAY, "p": RISE, "time": T})
    assert table.roles.time == "time" and table.trajectories[0].states == ("T", "p")


def test_of_two_times_the_finer_is_taken():
    """A second time, rounded or in another unit, is left out and said."""
    stamps = text(pd.date_range("2023-07-12 19:00", periods=N, freq="30s").astype(str))
    table = read_trajectories(
        {"time [h]": np.round(np.arange(N) / 120, 2), "when": stamps, "x": RISE}
    )
    assert table.roles.time == "when" and list(table.left_out) == ["time [h]"]
    table = read_trajectories({"minutes": np.floor(T / 5), "time_s": T, "x": RISE})
    assert table.roles.time == "time_s" and table.trajectories[0].states == ("x",)
    table = read_trajectories({"t": T, "k": 3.0 * T + 2, "x": RISE})
    assert table.trajectories[0].states == ("x",) and table.left_out == {"k": "is a second time"}


def test_a_state_that_nearly_rises_in_a_line_stays_a_state():
    """A slow change that was rounded, noise around a line, and a line that is alone, stay."""
    slow = np.round(21 - 0.03 * np.arange(N), 1)
    noisy = 2 * T + np.random.default_rng(0).normal(0, 0.1, N)
    assert states({"t": T, "slow": slow, "noisy": noisy, "x": RISE}) == ("slow", "noisy", "x")
    assert states({"t": T, "x": 3 * T}) == ("x",)
    assert states({"t": T, "x [mg]": np.arange(N) + 1.0, "y": RISE}) == ("x", "y")
    assert states({"t": T, "k": 3 * T, "x": RISE}, states=["k", "x"]) == ("k", "x")


@pytest.mark.parametrize("name", ["rownames", "No.", "#", "sample_no", "index", "Unnamed: 0", "q"])
def test_row_numbers_are_left_out_under_any_name(name):
    """They rise by one from row to row, or do so in each run, or did before the file was sorted."""
    table = read_trajectories({name: np.arange(N) + 1.0, "time": T, "x": DECAY})
    assert table.trajectories[0].states == ("x",) and name in table.left_out
    runs = {"run": text(["a"] * N + ["b"] * N), "time": np.tile(T, 2), "x": np.tile(DECAY, 2)}
    table = read_trajectories({name: np.tile(np.arange(N), 2), **runs})
    assert len(table.trajectories) == 2 and name in table.left_out
    mixed = np.random.default_rng(1).permutation(2 * N)
    table = read_trajectories({name: mixed + 1.0, **runs})
    assert len(table.trajectories) == 2 and name in table.left_out


@pytest.mark.parametrize("name", ["no", "Sample", "id"])
def test_row_numbers_may_fall_repeat_and_lack_some(name):
    """A table sorted backwards, with a row twice or some deleted; a number of runs is none."""
    table = pd.DataFrame({name: np.arange(N) + 1.0, "time": T, "x": DECAY})
    twice = pd.concat([table, table.iloc[[7]]]).sort_values("time")
    for own in (twice, twice[::-1], table.drop(index=[4, 11]), table.drop(index=4)[::-1]):
        read = read_trajectories(own)
        assert read.trajectories[0].states == ("x",)
        assert read.left_out == {name: "numbers the rows"}
    runs = pd.concat([table.assign(**{name: float(i)}) for i in (1, 2, 3)])
    assert len(read_trajectories(runs).trajectories) == 3


@pytest.mark.parametrize("rows", [[4], [4, 9], range(10, N), range(N)])
def test_rows_that_are_written_again_further_down_are_one(rows):
    """Copies of rows, of a part that a logger gave twice or of the whole table, are left out."""
    table = pd.DataFrame({"time": T, "x": DECAY, "y": RISE})
    again = read_trajectories(pd.concat([table, table.iloc[list(rows)]]))
    (run,) = again.trajectories
    np.testing.assert_array_equal(run.t, T)
    assert any("of the same time" in note and "left out" in note for note in again.notes)
    other = pd.concat([table, table.assign(x=np.where(T > 0, DECAY + T, DECAY))])
    assert [len(run) for run in read_trajectories(other).trajectories] == [N, N]


def test_a_count_is_no_row_number():
    """What rises by one here and not there is a state."""
    count = np.cumsum(np.random.default_rng(2).integers(0, 3, N)).astype(float)
    assert states({"t": T, "count": count, "x": RISE}) == ("count", "x")


def cultures(shuffle=None, **columns):
    """Give a growth for each value of the columns, some with times of their own."""
    frames = []
    for i in range(len(next(iter(columns.values())))):
        own = {name: values[i] for name, values in columns.items()}
        t = T + (0.25 if i % 2 else 0.0)
        frames.append(pd.DataFrame({**own, "hours": t, "n": (1 + i) * 10 / (1 + 9 * np.exp(-t))}))
    data = pd.concat(frames, ignore_index=True)
    if shuffle == "time":
        return data.sort_values("hours", kind="stable")
    return data if shuffle is None else data.sample(frac=1, random_state=shuffle)


@pytest.mark.parametrize("shuffle", [None, "time", 3])
@pytest.mark.parametrize(
    "columns",
    [
        {"treatment": ["warm", "cold", "warm", "cold"], "replicate": [1, 1, 2, 2]},
        {"species": ["a. b.", "c. d.", "a. b.", "c. d."], "experiment": [1, 1, 2, 2]},
        {"strain": ["wt", "mut", "wt", "mut"], "flask": [1, 1, 2, 2]},
        {"site": ["north", "south", "north", "south"], "kind": ["p", "p", "q", "q"]},
    ],
)
def test_all_label_columns_together_name_a_run(columns, shuffle):
    """In blocks, sorted by time or shuffled: four runs, each with its own curve."""
    data = cultures(shuffle, **columns)
    table = read_trajectories(data)
    assert table.roles.trajectory == tuple(columns)
    wanted = {f"{a}, {b}" for a, b in zip(*columns.values(), strict=True)}
    assert set(table.names) == wanted and len(table.trajectories) == 4
    for run in table.trajectories:
        assert len(run) == N and np.all(np.diff(run.x[:, 0]) > 0)
    named = read_trajectories(data, trajectory=list(columns))
    assert set(named.names) == wanted
    assert set(read_trajectories(data, trajectory=",".join(columns)).names) == wanted


def test_rows_in_any_order_are_sorted_where_runs_are_known():
    """Reversed, shuffled, or shuffled within runs: the times increase, and it is said."""
    order = np.random.default_rng(5).permutation(N)
    for rows in (order, np.arange(N)[::-1]):
        table = read_trajectories({"t": T[rows], "x": DECAY[rows]})
        assert np.array_equal(table.trajectories[0].t, T)
        assert np.array_equal(table.trajectories[0].x[:, 0], DECAY)
        assert any("order of 't'" in note for note in table.notes)


def test_rows_that_may_be_of_several_runs_are_not_sorted_into_one():
    """Without a label, rows that jump to and fro in order of time are refused, and not sorted."""
    rng = np.random.default_rng(6)
    both = np.concatenate([T, T + 0.2])
    x = np.concatenate([DECAY, 200 - DECAY])
    order = rng.permutation(2 * N)
    with pytest.raises(InputError, match="which rows belong together") as caught:
        read_trajectories({"t": both[order], "x": x[order]})
    assert "sort" not in str(caught.value)
    once = read_trajectories({"t": both, "x": x})
    assert len(once.trajectories) == 2


@pytest.mark.parametrize("broken", [0.0, 99.0, T[3]])
def test_one_wrong_time_makes_no_second_run(broken):
    """A single time that does not fit is refused with its row, and never begins a run."""
    t = T.copy()
    t[12] = broken
    with pytest.raises(InputError, match=r"runs backwards at row 1[34]"):
        read_trajectories({"t": t, "x": DECAY})


def long_table(name, keys, labels=None, unit=None):
    """Give a long table of a decay and a rise."""
    rows = []
    for label in labels or [None]:
        for key, values in zip(keys, (DECAY, RISE), strict=True):
            own = {} if label is None else {"batch": label}
            for t, v in zip(T, values, strict=True):
                rows.append({**own, name: key, "hours": t, "value": v})
                if unit:
                    rows[-1]["unit"] = unit[key]
    return pd.DataFrame(rows)


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("species", ["prey", "predator"]),
        ("variable", ["S", "P"]),
        ("analyte", ["glucose", "biomass"]),
        ("Messgröße", ["Temp", "Druck"]),
        ("parameter", ["a1", "a2"]),
    ],
)
def test_quantities_of_a_long_table_become_states(name, keys):
    """Where each is there at the same times they are states of one run, and it is said."""
    table = read_trajectories(long_table(name, keys))
    (run,) = table.trajectories
    assert run.states == tuple(keys)
    assert np.array_equal(run.x, np.column_stack([DECAY, RISE]))
    assert table.roles.quantity == name and any(repr(name) in note for note in table.notes)
    runs = read_trajectories(long_table(name, keys), quantity="none").trajectories
    assert len(runs) == 2 and runs[0].states == ("value",)


def test_quantities_within_runs_and_with_units():
    """A column of units goes with its quantity; other labels name the runs."""
    data = long_table("variable", ["S", "P"], ["b1", "b2"], {"S": "g/L", "P": "mol"})
    table = read_trajectories(data)
    assert table.names == ("b1", "b2")
    assert table.trajectories[0].origin["units"] == {"S": "g/L", "P": "mol"}


@pytest.mark.parametrize("codes", [("0x1A0", "0x2B4"), (416.0, 692.0)])
def test_what_each_quantity_has_once_names_no_runs(codes):
    """The number of a signal on a bus says no more than its name, at times of its own too."""
    data = long_table("signal", ["speed", "throttle"], unit={"speed": "km/h", "throttle": "%"})
    data["address"] = np.repeat(np.array(codes, dtype=object), N)
    data.loc[N:, "hours"] += 0.1
    run = one(data)
    assert run.states == ("speed", "throttle") and len(run) == 2 * N
    assert np.array_equal(run.observed[np.isfinite(run.observed[:, 0]), 0], DECAY)


def test_what_all_quantities_share_is_no_quantity_and_errors_go_with_theirs():
    """An input that is the same for all at a time stays a column; an sd becomes that of each."""
    data = long_table("variable", ["S", "P"])
    data["valve"], data["sd"] = np.tile(levels(0, 3, 1, 3, 0), 2), data["value"] / 50
    table = read_trajectories(data)
    (run,) = table.trajectories
    assert (run.states, run.input_names) == (("S", "P"), ("valve",))
    assert table.roles.noise == {"S": "S_sd", "P": "P_sd"}


@pytest.mark.parametrize(
    ("name", "keys"),
    [("replicate", ["A", "B"]), ("culture", ["warm", "cold"]), ("species", ["rep1", "rep2"])],
)
def test_replicates_of_one_quantity_stay_runs(name, keys):
    """A name of runs, or values that are called so, tells."""
    table = read_trajectories(long_table(name, keys))
    assert len(table.trajectories) == 2 and table.trajectories[0].states == ("value",)


def test_what_may_be_quantities_is_said():
    """A column of an unknown name stays the name of runs; a note says how to turn the table."""
    table = read_trajectories(long_table("mode", ["fast", "slow"]))
    assert len(table.trajectories) == 2
    assert any("--quantity mode" in note for note in table.notes)
    assert states(long_table("mode", ["fast", "slow"]), quantity="mode") == ("fast", "slow")
    own = long_table("mode", ["fast", "slow"])
    own.loc[own["mode"] == "slow", "hours"] += 0.1
    assert len(read_trajectories(own).trajectories) == 2


@pytest.mark.parametrize(
    "form",
    [
        "{s}_rep{k}",
        "{s} (run {k})",
        "{s}.trial_{k}",
        "Rep{k} {s}",
        "{s} experiment {k}",
        "{s}_R{k}",
    ],
)
def test_runs_side_by_side(form):
    """The same quantities with the number of a run are runs, and it is said."""
    if form == "{s}_R{k}":
        form = "{s}_run{k}"
    columns = {"time": T}
    for k in (1, 2, 3):
        columns[form.format(s="x1", k=k)] = k * DECAY
        columns[form.format(s="x2", k=k)] = k * RISE
    table = read_trajectories(columns)
    assert len(table.trajectories) == 3 and table.trajectories[0].states == ("x1", "x2")
    assert np.array_equal(table.trajectories[2].x, np.column_stack([3 * DECAY, 3 * RISE]))
    assert any("side by side" in note for note in table.notes)
    names = list(columns)[1:]
    assert len(states(columns, states=names)) == 6


def test_numbers_alone_tell_replicates_only_where_they_are_copies():
    """OD_1, OD_2, OD_3 within noise are three runs; x1, x2, x3 of other curves are states."""
    rng = np.random.default_rng(7)
    copies = {f"OD_{k}": RISE + rng.normal(0, 0.1, N) for k in (1, 2, 3)}
    table = read_trajectories({"time": T, **copies})
    assert len(table.trajectories) == 3 and table.trajectories[0].states == ("OD",)
    assert states({"t": T, "x1": DECAY, "x2": RISE, "x3": np.sin(T)}) == ("x1", "x2", "x3")
    # Two bodies of nearly the same temperature differ smoothly.
    assert states({"t": T, "T_1": DECAY, "T_2": 1 + 40 * np.exp(-0.22 * T)}) == ("T_1", "T_2")
    uneven = {"x1_rep1": DECAY, "x2_rep1": RISE, "x1_rep2": 2 * DECAY}
    assert len(states({"t": T, **uneven})) == 3


@pytest.mark.parametrize("counts", [[2] * N, [3] * N, [3] + [1, 2] * 14 + [1]])
def test_repeated_times_are_averaged_and_their_spread_is_kept(counts):
    """Rows of one moment are replicates: their pooled standard deviation is the noise."""
    rng = np.random.default_rng(8)
    t, x = np.repeat(T, counts), np.repeat(DECAY, counts) + rng.normal(0, 0.3, sum(counts))
    table = read_trajectories({"time": t, "x": x})
    (run,) = table.trajectories
    assert np.array_equal(run.t, T)
    frame = pd.DataFrame({"t": t, "x": x}).groupby("t")["x"]
    assert np.allclose(run.x[:, 0], frame.mean())
    left = frame.count() - 1
    pooled = np.sqrt((frame.var().fillna(0) * left).sum() / left.sum())
    assert run.origin["noise"] == {"x": pytest.approx(pooled)}
    assert any("replicates of one moment" in note for note in table.notes)


@pytest.mark.parametrize(("step", "write"), [(0.25, np.floor), (0.3, np.floor), (0.2, np.round)])
def test_rows_of_a_coarse_clock_are_no_replicates(step, write):
    """Rows that whole seconds write together have the times at which they were taken."""
    rng = np.random.default_rng(0)
    t = np.arange(0, 60, step)
    x = np.column_stack([np.sin(0.7 * t), np.cos(0.7 * t)]) + rng.normal(0, 0.02, (len(t), 2))
    table = read_trajectories({"time": write(t), "x": x[:, 0], "y": x[:, 1]})
    (run,) = table.trajectories
    assert np.array_equal(run.x, x) and np.allclose(run.t, t, atol=0.5 * step)
    assert any("its clock is a coarse one" in note for note in table.notes)


def test_rows_of_one_time_are_of_no_coarse_clock_where_each_has_its_own_distance():
    """Two cups that cool, one 3 degrees above the other, are no later and later rows of one."""
    rng = np.random.default_rng(0)
    both = np.column_stack([DECAY + 3, DECAY]).ravel() + rng.normal(0, 0.5, 2 * N)
    table = read_trajectories({"time": np.repeat(T, 2), "x": both})
    assert {len(run) for run in table.trajectories} == {N}


def test_runs_that_alternate_are_not_averaged():
    """Rows of one time that go on as runs of their own are runs, in their order; it is said."""
    both = np.column_stack([DECAY, RISE + 60]).ravel()
    table = read_trajectories({"time": np.repeat(T, 2), "x": both})
    assert [run.x[0, 0] for run in table.trajectories] == [DECAY[0], RISE[0] + 60]
    assert any("go on as 2 trajectories" in note for note in table.notes)


def test_nanoseconds_keep_their_last_digit():
    """Whole numbers that float64 would round are counted from the first one before they are."""
    when = 1_700_000_000_000_000_000 + np.arange(N, dtype=np.int64) * 1_000_001
    run = one(pd.DataFrame({"timestamp": when, "x": DECAY}))
    assert np.allclose(run.t, np.arange(N) * 1.000001e-3, rtol=1e-12, atol=0)


def test_words_that_were_read_as_numbers_name_runs():
    """A label of low and high, which may be a switch, names its runs by the words."""
    names = {"level": ["low", "high", "low", "high"], "dish": [1, 1, 2, 2]}
    with pytest.warns(DynsrWarning, match="'high' as 1"):
        table = read_trajectories(cultures(**names))
    assert set(table.names) == {"low, 1", "high, 1", "low, 2", "high, 2"}


@pytest.mark.slow
def test_a_score_takes_the_columns_for_what_the_search_took_them_for(tmp_path):
    """A valve that never moves in the new data, and a state that stays, keep their roles."""
    t = np.arange(60) * 0.1
    valve = np.repeat([0.0, 1.0, 0.0, 1.0], 15)
    x = np.exp(-t)
    found = dynsr.discover({"t": t, "x": x, "y": np.exp(-2 * t), "valve": valve}, **QUICK)
    assert found.settings["table"]["inputs"] == ["valve"]
    new = {"t": t, "x": 2 * x, "y": 0.0 * t, "valve": 1.0 + 0 * t}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DynsrWarning)
        scores = found.score(new)
    assert scores["x"]["trajectory_rmse"] < 1e-3
    pd.DataFrame(new).to_csv(tmp_path / "new.csv", index=False)
    found.save(tmp_path / "d.json")
    told = run_command("score", tmp_path / "d.json", tmp_path / "new.csv", "--json").stdout
    assert '"y"' in told


def test_a_single_time_that_repeats_before_a_gap_is_wrong():
    """Where the rows would fill even steps, a time was noted wrongly, and no replicate."""
    t = T.copy()
    t[9] = t[8]
    with pytest.raises(InputError, match="repeats in row 10"):
        read_trajectories({"t": t, "x": DECAY})


@pytest.mark.parametrize(
    "form", ["{}_sd", "{}_se", "{}_std", "{} sem", "sd_{}", "SD {}", "± {}", "{} (SD)"]
)
def test_columns_of_errors_are_the_noise_of_their_column(form):
    """They are left out, and the roles say whose errors they are."""
    columns = {"time": T, "glc": DECAY, form.format("glc"): DECAY / 50, "bm_mean": RISE}
    table = read_trajectories({**columns, form.format("bm"): RISE / 30})
    assert table.trajectories[0].states == ("glc", "bm_mean")
    assert table.roles.noise == {"glc": form.format("glc"), "bm_mean": form.format("bm")}
    assert set(table.left_out) == {form.format("glc"), form.format("bm")}


def test_an_error_alone_and_an_error_that_is_none():
    """sd beside one column is its noise; an error that takes both signs is a state."""
    table = read_trajectories({"t": T, "x": DECAY, "sd": DECAY / 50})
    assert table.roles.noise == {"x": "sd"}
    assert states({"t": T, "pos": DECAY, "pos_err": np.sin(T)}) == ("pos", "pos_err")


def levels(*values, each=6):
    """Give a column that holds each of the values over rows."""
    return np.repeat(np.array(values, dtype=float), each)[:N]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("u9", levels(0, 12, 6, 9, 0)),
        ("relay", np.tile([1.0, 1.0, 0.0], N)[:N]),
        ("Sollwert", levels(60, 40, 60, 50, 40)),
        ("heat", levels(80, 0, 20, 80, 40)),
        ("power", levels(10, 20, 30, 40, 50)),
        ("gear", levels(1, 3, 1, 4, 2)),
        ("valve", levels(0, 1, 2, 1, 0)),
        ("PWM", np.tile([0.0, 128.0, 128.0], N)[:N]),
        ("Current", levels(-1, 0, 1, 0, -1)),
        ("Spannung", levels(0, 1, 2, 1, 0)),
        ("rain_mm", np.where(np.arange(N) % 7 == 2, np.arange(N) % 11 + 0.7, 0.0)),
    ],
)
def test_a_column_that_holds_its_value_and_steps_is_an_input(name, values):
    """It is said so, and states= says otherwise."""
    table = read_trajectories({"t": T, "y": DECAY, name: values})
    (run,) = table.trajectories
    assert (run.states, run.input_names) == (("y",), (name,))
    assert states({"t": T, "y": DECAY, name: values}, states=["y", name]) == ("y", name)


@pytest.mark.parametrize(
    "values",
    [
        np.round(20 + 0.03 * np.arange(N), 1),
        np.round(24 - 4 * np.exp(-T), 1),
        np.minimum(RISE, 6.0),
        np.round(4 * np.sin(T / 3)) / 4,
        np.cumsum(np.random.default_rng(3).poisson(0.4, N)).astype(float),
        np.random.default_rng(4).poisson(1.0, N).astype(float),
        np.round(DECAY),
        0.0488 * np.round((20 + 0.02 * np.arange(N)) / 0.0488),
    ],
    ids=["rounded", "settled", "saturated", "quantised", "counts", "events", "whole", "converter"],
)
def test_a_state_that_repeats_its_value_stays_a_state(values):
    """Rounding, saturation, rest and counts hold a value too, but move by one digit at a time."""
    assert states({"t": T, "y": DECAY, "z": values}) == ("y", "z")


def test_a_voltage_that_falls_slowly_is_a_state():
    """That of a battery is measured, to few digits, whatever its name."""
    t = np.arange(0, 7200, 20.0)
    volts = np.round(4.1 - 0.5 * t / 7200 - 0.1 * np.exp(-t / 100), 2)
    names = states({"t": t, "Voltage(V)": volts, "T (C)": np.round(25 + 3 * np.sin(t / 2000), 3)})
    assert names == ("Voltage", "T")


def test_where_every_column_would_be_an_input_none_is():
    """A state is left, whatever it looks like."""
    assert states({"t": T, "a": levels(0, 1, 0, 1, 0), "b": levels(5, 0, 9, 0, 5)}) == ("a", "b")


def test_a_constant_column_is_left_out():
    """As long as a state is left."""
    table = read_trajectories({"t": T, "x": DECAY, "room": np.full(N, 21.5)})
    assert table.trajectories[0].states == ("x",)
    assert table.left_out == {"room": "is 21.5 in every row"}


def test_rows_with_empty_cells_are_kept_and_counted():
    """Rows where a state has no value are kept, and one note says how many cells are empty."""
    rare = np.where(np.arange(N) % 3 == 0, RISE, np.nan)
    table = read_trajectories({"t": T, "OD": DECAY, "glucose": rare})
    (run,) = table.trajectories
    assert len(run) == N
    assert run.measured.sum(axis=0).tolist() == [N, 10]
    assert np.array_equal(run.observed[:, 1], rare, equal_nan=True)
    note = "Of 30 rows, cells are empty: 'glucose' in 20; each state counts where it was measured."
    assert note in table.notes
    table = read_trajectories({"t": T, "OD": DECAY, "glucose": rare}, states=["OD"])
    assert len(table.trajectories[0]) == N
    with pytest.raises(InputError, match=r"'g' has 5 values in the 30 rows.*--states OD"):
        read_trajectories({"t": T, "OD": DECAY, "g": np.where(np.arange(N) % 6, np.nan, RISE)})


def test_what_is_empty_is_no_fault():
    """A column without a value, and a row without a time, are left out and said."""
    t = T.copy()
    t[4] = np.nan
    table = read_trajectories({"t": t, "x": DECAY, "remark": np.full(N, np.nan)})
    assert len(table.trajectories[0]) == N - 1
    assert table.left_out == {"remark": "has no value in any row"}
    assert any(note.startswith("Row 5 was left out") for note in table.notes)


def test_an_input_that_is_noted_at_its_changes_keeps_its_value():
    """Empty cells of a setpoint hold the value before them."""
    sparse = np.full(N, np.nan)
    sparse[[0, 10, 20]] = 60, 40, 60
    (run,) = read_trajectories({"t": T, "x": DECAY, "setpoint": sparse}).trajectories
    assert len(run) == N and run.inputs[:, 0].tolist() == [60] * 10 + [40] * 10 + [60] * 10


def test_eight_rows_are_enough_everywhere(tmp_path):
    """A table of 8 rows is read and taken; one of 7 is refused, with the number."""
    few = {"t": T[:8], "x": DECAY[:8]}
    pd.DataFrame(few).to_csv(tmp_path / "few.csv", index=False)
    for source in (few, tmp_path / "few.csv", (T[:8], DECAY[:8])):
        assert len(take_trajectories(source)[0][0]) == 8
    for source in ({"t": T[:7], "x": DECAY[:7]}, (T[:7], DECAY[:7])):
        with pytest.raises(InputError, match=r"7 rows.* at least 8"):
            take_trajectories(source)


def test_a_run_of_few_rows_is_left_out():
    """Where the others are most of the table; otherwise it is refused by its name."""
    labels = text(["a"] * 22 + ["b"] * 3 + ["a"] * 5)
    table = read_trajectories({"run": labels, "t": T, "x": DECAY})
    assert table.names == ("a",) and any("Trajectory b was left out" in n for n in table.notes)
    with pytest.raises(InputError, match=r"trajectory . of the mapping has 5 rows"):
        read_trajectories({"run": text("abcdef" * 5), "t": T, "x": DECAY})


def test_the_same_file_twice_is_refused(tmp_path):
    """Its rows are no second measurement, under another name either."""
    for name in ("a.csv", "b.csv"):
        pd.DataFrame({"t": T, "x": DECAY}).to_csv(tmp_path / name, index=False)
    for files in (["a.csv", "a.csv"], ["a.csv", "b.csv"]):
        with pytest.raises(InputError, match="the same rows twice"):
            read_trajectories([tmp_path / name for name in files])


def test_a_plain_table_has_no_notes():
    """Nothing is said where nothing was assumed."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DynsrWarning)
        table = read_trajectories({"t": T, "x": DECAY, "y": RISE})
    assert not table.notes and not table.left_out


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("Zeit (min)", "min"),
        ("Temps_s", "s"),
        ("Elapsed Time (h)", "h"),
        ("run time [ms]", "ms"),
        ("Zeit in Stunden", "h"),
        ("jours", "days"),
        ("dates", ""),
    ],
)
def test_the_unit_of_a_time_is_read_in_names_of_other_languages(name, unit):
    """German, French and longer names of the time say its unit; a plural is no unit of seconds."""
    x = np.round(2.0 ** -np.arange(12), 6)
    table = read_trajectories({name: np.arange(12) / 4, "x": x, "y": 1 - x})
    assert table.trajectories[0].time_unit == unit and table.trajectories[0].states == ("x", "y")


def test_a_text_and_a_number_name_trajectories_together():
    """A dose and a flask name what starts the time again; the dose is a parameter too."""
    rows = [(d, f, k / 2, d * 0.9**k) for d in (10, 20) for f in "ab" for k in range(10)]
    frame = pd.DataFrame(rows, columns=["dose", "flask", "hours", "conc"])
    table = read_trajectories(frame)
    assert table.names == ("10, a", "10, b", "20, a", "20, b")
    assert table.roles.parameters == ("dose",) and table.trajectories[0].states == ("conc",)


def test_numbers_alone_name_no_trajectory():
    """Runs of two doses that start the time again are numbered; the dose stays a parameter."""
    rows = [(d, k / 2, d * 0.9**k) for d in (10, 20) for k in range(10)]
    table = read_trajectories(pd.DataFrame(rows, columns=["dose", "hours", "conc"]))
    assert table.names == ("1", "2") and table.roles.parameters == ("dose",)


@pytest.mark.parametrize(
    ("names", "form", "step", "unit"),
    [
        (("Year", "Month", "Day"), "%Y %m %d", {"days": 1}, "days"),
        (("YYYY", "MM", "DD", "hh", "mm"), "%Y %m %d %H %M", {"minutes": 20}, "min"),
        (("Jahr", "Monat", "Tag", "Stunde"), "%Y %m %d %H", {"hours": 1}, "h"),
        (("year", "doy"), "%Y %j", {"days": 1}, "days"),
    ],
)
def test_a_date_in_columns_of_its_parts_is_one_time(names, form, step, unit):
    """Years, months, days, hours and minutes give one time, over the end of a year too."""
    stamps = pd.date_range("2023-12-25 20:40", periods=24, freq=pd.Timedelta(**step))
    parts = np.array([stamp.strftime(form).split() for stamp in stamps], dtype=float)
    x = np.round(2.0 ** -np.arange(24), 9)
    table = read_trajectories({**dict(zip(names, parts.T, strict=True)), "x": x})
    (run,) = table.trajectories
    wanted = np.arange(24) * next(iter(step.values()))
    np.testing.assert_allclose(run.t, wanted if unit != "h" else np.arange(24))
    assert run.states == ("x",) and run.time_unit == unit


K = np.arange(float(N))


@pytest.mark.parametrize(
    ("names", "parts", "unit", "step"),
    [
        (("hour", "minute"), (K // 2, K % 2 * 30), "min", 30),
        (("day", "hour", "minute"), (0 * K, K // 2, K % 2 * 30), "min", 30),
        (("h", "m", "s"), (K // 120, K // 2 % 60, K % 2 * 30), "s", 30),
        (("min", "sec"), (K // 4, K % 4 * 15), "s", 15),
        (("hour", "minute"), ((21 + K // 2) % 24, K % 2 * 30), "min", 30),
        (("day", "hour"), (K // 24, K % 24), "h", 1),
        (("Day", "Hour", "Min"), (1 + K // 48, K // 2 % 24, K % 2 * 30), "min", 30),
    ],
)
def test_a_clock_in_columns_of_its_parts_is_one_time(names, parts, unit, step):
    """Hours and minutes are one time, without a day too; S next to them stays a state."""
    substrate = {"S": DECAY / 10, "X": RISE}
    table = read_trajectories({**dict(zip(names, parts, strict=True)), **substrate})
    (run,) = table.trajectories
    assert run.states == ("S", "X") and run.time_unit == unit
    np.testing.assert_allclose(run.t - run.t[0], step * K)


def test_minutes_and_a_state_called_s_are_no_clock():
    """Minutes that rise by themselves are the time, and S is measured."""
    table = read_trajectories({"minute": T, "S": DECAY / 10})
    assert table.trajectories[0].states == ("S",)
    assert np.array_equal(table.trajectories[0].t, T)


def test_parts_that_make_no_date_stay_columns():
    """A year with a month that is none, or parts that the caller uses, are columns as any other."""
    t = np.arange(24.0)
    frame = {"t": t, "year": 2000 + t, "month": t % 15, "x": np.exp(-t / 9)}
    assert "month" in read_trajectories(frame).trajectories[0].names
    months = {"year": np.repeat([2001.0, 2002.0], 12), "month": t % 12 + 1, "x": np.exp(-t / 9)}
    assert read_trajectories(months).trajectories[0].time_unit == "days"
    asked = read_trajectories({"t": t, **months}, inputs=["month"]).trajectories[0]
    assert asked.input_names == ("month",)


def test_a_name_that_ends_in_a_word_of_time_may_be_the_time():
    """Where nothing else is the time, visit_day is; temp_min and rain_s are not."""
    days = np.tile([0.0, 1, 3, 7, 14, 21, 28, 35], 4)
    who = np.repeat([f"S{i}" for i in range(4)], 8)
    frame = {"subject": who, "visit_day": days, "marker": np.exp(-days / 9)}
    table = read_trajectories(frame)
    assert len(table.trajectories) == 4 and table.trajectories[0].time_unit == "days"
    with pytest.raises(InputError, match="looks like the time"):
        read_trajectories({"subject": who, "temp_min": days, "marker": np.exp(-days / 9)})


def test_the_mean_and_spread_of_replicates_next_to_them_are_left_out(tmp_path):
    """Columns that follow from the runs side by side are no states of each; others stay."""
    rng = np.random.default_rng(4)
    t = np.arange(0, 15, 0.5)
    runs = (6 - 5 * np.exp(-t / 2))[:, None] + 0.03 * rng.normal(size=(len(t), 3))
    table = {"t(s)": t, **{f"rep{i + 1}": runs[:, i].round(4) for i in range(3)}}
    table |= {"avg": runs.mean(axis=1).round(4), "dev": runs.std(axis=1, ddof=1).round(4)}
    found = dynsr.describe({**table, "heat": np.round(20 + np.sin(t), 2)})
    assert {*found.left_out} == {"avg", "dev"} and {*found.states} == {"heat", "x"}
    assert "mean of rep1, rep2, rep3" in found.left_out["avg"]
    assert "standard deviation of rep1" in found.left_out["dev"]


def test_a_unit_may_stand_behind_a_slash():
    """A column x / m is x in m; what is divided by no unit keeps its name."""
    t = np.arange(0.0, 4, 0.1)
    table = {"t / s": t, "x / m": np.cos(t), "v / (m/s)": -np.sin(t), "gain / loss": np.sin(2 * t)}
    run = dynsr.data.read_trajectories(table).trajectories[0]
    assert run.states == ("x", "v", "gain_loss") and run.time_unit == "s"
    assert run.origin["units"] == {"x": "m", "v": "m/s"}


def test_errors_and_counts_in_wide_tables_are_no_states():
    """Columns called sd, each after its state, and numbers of replicates say nothing of laws."""
    errors = 0.1 + 0.01 * DECAY, 0.1 + 0.02 * RISE
    for word in ("sd", "\u00b1"):
        names = ["t", "x", word, "y", word]
        frame = pd.DataFrame(np.column_stack([T, DECAY, errors[0], RISE, errors[1]]), columns=names)
        with pytest.warns(dynsr.errors.DynsrWarning, match="is used twice"):
            (run,) = read_trajectories(frame).trajectories
        assert run.states == ("x", "y") and not run.input_names
        assert np.allclose(run.noise["y"].sd, errors[1])
    counted = {"t": T, "x_mean": DECAY, "x_sem": errors[0], "x_n": 3.0 + np.arange(N) // 10}
    run = one(counted)
    assert run.names == ("x_mean",)
    run = one({"t": T, "x (mean)": DECAY, "x (sd)": errors[0]})
    assert run.names == ("x",) and not run.origin.get("units")


@pytest.mark.parametrize(
    ("turn", "low"), [(360, 0), (360, -180), (2 * np.pi, 0), (2 * np.pi, -np.pi)]
)
def test_an_angle_that_goes_round_goes_on(turn, low):
    """There are no jumps by a turn, in either direction, over empty cells, in files and arrays."""
    t = np.linspace(0, 10, 101)
    angle = turn * (0.3 + 0.02 * t * (8 - t))
    wrapped = (angle - low) % turn + low
    wrapped[[20, 21]] = np.nan
    for source in ({"t": t, "phi": wrapped, "y": t**2}, (t, np.column_stack([wrapped, t**2]))):
        with pytest.warns(dynsr.errors.DynsrWarning, match="as an angle does") as said:
            (run,), _ = dynsr.data.take_trajectories(source)
        assert ("is searched in radians" in str(said[-1].message)) == (turn == 360)
        offset = run.x[0, 0] - angle[0]
        there = run.measured[:, 0]
        assert there.sum() == 99 and np.allclose(run.x[there, 0], angle[there] + offset)


@pytest.mark.parametrize(
    ("unit", "turn", "digits"),
    [("gon", 400, 3), ("rev", 1, 4), ("", 256, 0), ("", 4096, 0), ("ticks", 65536, 0)],
)
@pytest.mark.parametrize("low", [0, -0.5])
def test_turns_of_other_units_and_counters_that_overflow_go_on(unit, turn, digits, low):
    """A unit says its turn; whole numbers begin again after so many bits. Without these none is."""
    t = np.linspace(0, 10, 201)
    x = np.round(turn * (0.3 + 0.02 * t * (16 - t)), digits)
    wrapped = (x - low * turn) % turn + low * turn
    with pytest.warns(DynsrWarning, match="read as one that goes on"):
        run = one({"t": t, f"phi [{unit}]" if unit else "phi": wrapped, "y": t**2})
    assert np.allclose(run.x[:, 0], x - x[0] + wrapped[0])
    other = one({"t": t, "phi": 1.01 * wrapped + 0.001, "y": t**2})
    assert np.array_equal(other.x[:, 0], 1.01 * wrapped + 0.001)


def test_an_angle_that_rests_where_it_begins_again_goes_on():
    """Noise takes a compass at rest in the north over its end again and again."""
    t, rng = np.linspace(0, 20, 201), np.random.default_rng(0)
    angle = 200 * np.exp(-0.5 * t) * np.cos(2 * t) + rng.normal(0, 1, len(t))
    with pytest.warns(DynsrWarning, match="jumps by a full turn of 360 in"):
        run = one({"t": t, "phi [deg]": angle % 360, "y": t**2})
    assert np.allclose(run.x[:, 0] - run.x[0, 0], angle - angle[0])


def test_an_angle_that_goes_too_far_between_rows_is_named():
    """At 200 degrees a row no one knows the direction; without a unit they are any numbers."""
    t = np.arange(40.0)
    with pytest.warns(DynsrWarning, match="more than a quarter of a turn"):
        one({"t": t, "phi [deg]": 200 * t % 360, "y": t**2})
    with warnings.catch_warnings(record=True) as said:
        one({"t": t, "phi": 200 * t % 360, "y": t**2})
    assert not any("turn" in str(one_.message) for one_ in said)


def test_what_jumps_and_is_no_angle_stays():
    """Switches between 0 and 360, sawteeth with falls of their own, and states as given."""
    t = np.linspace(0, 10, 101)
    switch, saw = 360.0 * (t % 4 > 2), np.abs(360 - (72 * t) % 720) * 0.999
    for x in (switch + 0.001 * t, saw, 50 * t % 300):
        assert np.array_equal(one({"t": t, "x": x, "y": t**2}, states=["x", "y"]).x[:, 0], x)
    rng = np.random.default_rng(0)
    noise = {f"x{k}": rng.normal(size=12) for k in range(500)}
    run = one({"t": t[:12], **noise}, states=list(noise))
    assert np.array_equal(run.x, np.column_stack(list(noise.values())))
    weekdays = np.arange(101.0) * 2 % 7
    assert np.array_equal(one({"t": t, "x": t**2, "d": weekdays}).x[:, 1], weekdays)
    own = dynsr.Trajectory(t, (90 * t % 360)[:, None], ("x",))
    (run,), _ = dynsr.data.take_trajectories(own)
    assert np.array_equal(run.x, own.x)


def test_columns_called_by_concentrations_are_runs():
    """The concentration is a parameter of each run; columns called by depths are states of one."""
    start = {"0.1 mM": 0.1, "0,5 mM": 0.5, "2mM": 2.0}
    runs = read_trajectories({"t (s)": T, **{n: c * DECAY for n, c in start.items()}}).trajectories
    assert [run.states for run in runs] == [("x",)] * 3
    assert [float(run.by_name["mM"][0]) for run in runs] == [0.1, 0.5, 2.0]
    depths = read_trajectories({"t": T, "5 cm": DECAY, "10 cm": RISE}).trajectories
    assert len(depths) == 1 and len(depths[0].states) == 2


@pytest.mark.parametrize("form", ["{} uM rep{}", "{} uM_{}", "{} uM.{}", "rep {} - {} uM"])
def test_replicates_of_a_concentration_are_runs_of_it(form):
    """However the replicates are called, each has the concentration as its parameter."""
    data = {"t (s)": T}
    for c, count in ((10, 3), (50, 2)):
        for k in range(count):
            name = form.format(*((k + 1, c) if form.startswith("rep") else (c, k + ("_" in form))))
            data[name if k or "rep" in form else f"{c} uM"] = c * DECAY + 0.001 * k
    runs = read_trajectories(data).trajectories
    assert [run.states for run in runs] == [("x",)] * 5
    assert [float(run.by_name["uM"][0]) for run in runs] == [10, 10, 10, 50, 50]
    assert np.array_equal(runs[4].x[:, 0], data[list(data)[-1]])


def test_columns_of_one_name_that_differ_by_noise_are_replicates(tmp_path):
    """Three columns called OD are three runs; x and its square are states of one."""
    rng = np.random.default_rng(0)
    copies = [RISE + rng.normal(0, 0.05, N) for _ in range(3)]
    rows = zip(T, *copies, np.cos(T), strict=True)
    lines = [",".join(f"{v:.5f}" for v in row) for row in rows]
    (tmp_path / "plate.csv").write_text("\n".join(["t,OD,OD,OD,temp", *lines]))
    with pytest.warns(DynsrWarning, match=r"used 3 times .* the others are called 'OD_2', 'OD_3'"):
        runs = read_trajectories(tmp_path / "plate.csv").trajectories
    assert [run.states for run in runs] == [("temp", "OD")] * 3
    assert np.allclose(runs[2].x[:, 1], copies[2], atol=1e-5)
    assert states({"t": T, "x": RISE, "x_2": RISE**2}) == ("x", "x_2")


def test_an_input_that_holds_levels_but_for_noise_is_an_input_at_its_levels():
    """What a scope measures of a switch is no state; the mean of each level is what acts."""
    t, rng = np.arange(200) * 0.1, np.random.default_rng(0)
    switch = 5.0 * (np.arange(200) // 33 % 2)
    x = np.exp(-0.3 * t)
    noisy = switch + rng.normal(0, 0.03, 200)
    table = read_trajectories({"t": t, "CH1": noisy, "CH2": x + rng.normal(0, 0.01, 200)})
    assert any("holds its value but for noise of 0.0" in note for note in table.notes)
    (run,) = table.trajectories
    assert run.states == ("CH2",) and run.hold == {"CH1": "previous"}
    levels = np.array([noisy[switch == level].mean() for level in (0, 5)])
    assert np.allclose(run.inputs[:, 0], levels[(switch > 0).astype(int)])


@pytest.mark.parametrize(
    "make",
    [
        lambda t, rng: np.exp(-(t % 4)) + rng.normal(0, 0.01, len(t)),  # rests are none
        lambda t, rng: np.where(t == 5, 9.0, 1.0) + rng.normal(0, 0.1, len(t)),  # one outlier
        lambda t, rng: 5 * np.tanh(8 * np.sin(t)) + rng.normal(0, 0.02, len(t)),  # goes over
        lambda t, rng: rng.standard_t(2, len(t)),
        lambda t, rng: np.cumsum(rng.normal(0, 1, len(t))),
    ],
)
def test_what_moves_between_its_rests_is_a_state(make):
    """Decays that begin again, outliers, smooth switches and heavy noise hold no levels."""
    t = np.round(np.arange(200) * 0.1, 1)
    x = make(t, np.random.default_rng(1))
    run = one({"t": t, "x": x, "y": t**2}, states=["x", "y"])
    table = read_trajectories({"t": t, "x": x, "y": t**2})
    assert table.trajectories[0].states == run.states


def test_few_rows_that_happen_to_look_like_levels_are_a_state():
    """Of short random walks one in 200 at most is taken for a switch that was measured."""
    walks = np.random.default_rng(0).normal(size=(1000, 12)).cumsum(axis=1)
    assert sum(find_levels([walk]) is not None for walk in walks) <= 5
    switch = np.repeat([0.0, 5.0], 6) + np.random.default_rng(0).normal(0, 0.05, 12)
    assert find_levels([switch]) is not None


@pytest.mark.parametrize(("name", "bits", "step"), [("millis", 16, 1000), ("micros", 32, 10**8)])
def test_a_clock_that_overflows_goes_on(name, bits, step):
    """Small computers begin again at 0; runs that each begin at 0 are runs, also of 256 rows."""
    t = 2**bits - 5 * step // 2 + step * np.arange(N)
    table = read_trajectories({name: t % 2**bits, "x": DECAY})
    (run,) = table.trajectories
    assert np.array_equal(np.diff(run.t), np.full(N - 1, step)) and np.array_equal(
        run.x[:, 0], DECAY
    )
    assert any(f"after {bits} bits" in note for note in table.notes)
    twice, size = np.tile(np.arange(256.0), 2), np.repeat([1, 2], 256)
    assert len(read_trajectories({"t": twice, "x": size * np.exp(-0.01 * twice)}).trajectories) == 2


def test_stamps_of_a_beginning_and_an_end_are_one_time():
    """TIMESTAMP_START is the time, TIMESTAMP_END another one, and TS the temperature of soil."""
    stamps = pd.date_range("2024-06-01 13:00", periods=N + 1, freq="30min").strftime("%Y%m%d%H%M")
    stamps = stamps.astype("int64")
    columns = {"TIMESTAMP_START": stamps[:-1], "TIMESTAMP_END": stamps[1:], "TS": DECAY}
    table = read_trajectories(columns)
    (run,) = table.trajectories
    assert run.states == ("TS",) and np.array_equal(run.t, 30.0 * np.arange(N))
    assert "TIMESTAMP_END" in table.left_out


def test_hours_and_minutes_of_four_digits_are_a_clock():
    """1530 next to a day is half past three; 1570 is none."""
    clock = 100 * (np.arange(N) // 2) + 30 * (np.arange(N) % 2)
    own = {"Year": np.full(N, 2024), "DOY": np.full(N, 153), "HHMM": clock}
    run = one({**own, "x": DECAY})
    assert run.states == ("x",) and np.array_equal(run.t, 30.0 * np.arange(N))
    own = {"t": T, "HHMM": clock + 40, "x": DECAY}
    assert states(own) == ("HHMM", "x")


@pytest.mark.parametrize("form", ["{h:d}d {m:02d}:00:00", "P{h}DT{m}H"])
def test_days_and_hours_in_cells_are_durations(form):
    """As loggers and ISO 8601 write them."""
    run = one({"Time": [form.format(h=k // 24, m=k % 24) for k in range(N)], "x": DECAY})
    assert np.array_equal(run.t, np.arange(N)) and run.time_unit == "h"


def test_rows_around_an_event_of_a_model_are_a_step_of_its_input():
    """Programs of Modelica write a time twice where an input steps, and slopes next to states."""
    at, u = 10, np.where(np.arange(N) < 10, 0.5, 2.0)
    rows = np.insert(np.arange(N), at, at)
    source = {"time": T[rows], "x": DECAY[rows], "der(x)": np.gradient(DECAY)[rows], "u": u[rows]}
    source["u"][at] = 0.5
    table = read_trajectories(source)
    (run,) = table.trajectories
    assert run.states == ("x",) and "der(x)" in table.left_out
    assert np.array_equal(run.inputs[:, 0], u) and run.hold == {"u": "previous"}


def test_fields_of_a_database_are_quantities_and_data_sets_are_runs():
    """_field says what _value is; Data Set 2 is the second run."""
    long = {
        "_time": np.tile(T, 2),
        "_value": np.concatenate([DECAY, RISE]),
        "_field": np.repeat(["prey", "cats"], N).astype(object),
    }
    assert states(long) == ("prey", "cats")
    names = [f"Data Set {k}:{q}" for k in (1, 2) for q in ("Time(s)", "Voltage(V)")]
    wide = dict(zip(names, [T, DECAY, T, 2 * DECAY], strict=True))
    with pytest.warns(DynsrWarning, match="2 runs side by side, called Data Set 1, 2"):
        table = read_trajectories(pd.DataFrame(wide))
    assert [run.states for run in table.trajectories] == [("Voltage",)] * 2


@pytest.mark.parametrize("centred", [True, False])
def test_a_moving_mean_of_a_column_is_left_out(centred):
    """Of seven days up to the last, or around each; what is called so and is none stays."""
    cases = np.round(1000 * np.exp(-(((T - 7) / 3) ** 2)))
    means = pd.Series(cases).rolling(7, center=centred).mean().round(1)
    table = read_trajectories(pd.DataFrame({"t": T, "cases": cases, "7-day average": means}))
    assert table.trajectories[0].states == ("cases",)
    assert table.left_out["7-day average"] == "is the mean of 7 rows of 'cases'"
    assert states({"t": T, "cases": cases, "mean": means.fillna(0) + T}) == ("cases", "mean")


def test_frames_that_rise_in_each_track_are_the_time():
    """As programs that follow cells write them: FRAME begins again where TRACK_ID changes."""
    source = {
        "TRACK_ID": np.repeat([4.0, 7.0], N),
        "FRAME": np.tile(np.arange(N) + 5.0, 2),
        "POSITION_X": np.concatenate([DECAY, RISE]),
    }
    table = read_trajectories(source)
    assert table.names == ("4", "7") and table.roles.time == "FRAME"
    assert np.array_equal(table.trajectories[1].x[:, 0], RISE)
    timed = {**source, "POSITION_T": np.tile(T, 2)}
    assert np.array_equal(read_trajectories(timed).trajectories[1].t, T)
