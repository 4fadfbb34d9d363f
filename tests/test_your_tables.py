"""Your table: each form in which people have tables is read as they mean it, and it is said."""

from datetime import datetime, timedelta

import numpy as np
import pytest

import dynsr
from dynsr.errors import DynsrWarning, InputError

pytestmark = pytest.mark.filterwarnings("ignore::dynsr.errors.DynsrWarning")
N = 24
K = range(N)
FALL = 1 + 40 * np.exp(-0.1 * np.arange(N))
RISE = 0.5 * np.exp(0.08 * np.arange(N))
EACH = np.random.default_rng(0).normal(0, 0.5, (2, N, 3))
START = datetime(2023, 11, 4, 21, 40)  # noqa: DTZ001 (a clock on a wall has no zone)


def rows(line, numbers=K):
    """Give a line for each number."""
    return "".join(f"{line(k)}\n" for k in numbers)


def comma(value, digits=3):
    """Write a number with a decimal comma."""
    return f"{value:.{digits}f}".replace(".", ",")


def at(k, form, **step):
    """Write the time of a row."""
    return (START + k * timedelta(**step)).strftime(form)


# name of a file -> (its text, what is right of it).
FORMS = {
    "lines above the header.csv": (
        "Bioreactor 3\nBatch: 17\nOperator,AB\n\nt [h],cells [g/L],sugar [g/L]\n"
        + rows(lambda k: f"{k / 2},{RISE[k]:.4f},{FALL[k]:.3f}"),
        {"time": ("t [h]", "h"), "states": ["cells", "sugar"]},
    ),
    "a row of units.csv": (
        "t;p;T\n(min);(bar);(K)\n" + rows(lambda k: f"{k};{comma(RISE[k])};{comma(FALL[k])}"),
        {"time": ("t", "min"), "states": ["p", "T"], "units": {"p": "bar", "T": "K"}},
    ),
    "remarks over empty columns.csv": (
        "t,x,,see lab book,\n" + rows(lambda k: f"{k},{FALL[k]:.3f},,,"),
        {"states": ["x"], "left out": ["see lab book"]},
    ),
    "blank rows at the end.csv": (
        "t;x;y\n" + rows(lambda k: f"{k};{FALL[k]:.3f};{RISE[k]:.3f}") + ";;\n;;\n;;\n",
        {"states": ["x", "y"], "rows": N},
    ),
    "an unused name twice.csv": (
        "t,x,flag,flag\n" + rows(lambda k: f"{k},{FALL[k]:.3f},,"),
        {"states": ["x"]},
    ),
    "German numbers.csv": (
        "Zeit [s];Masse [g]\n"
        + rows(lambda k: f"{k};{1 + k // 12}.{comma(100 + 30 * RISE[k % 12], 2)}"),
        {"time": ("Zeit [s]", "s"), "states": ["Masse"]},
    ),
    "percent and degrees.csv": (
        "t,turned,T\n" + rows(lambda k: f"{k},{100 / FALL[k]:.2f} %,{FALL[k]:.2f} C"),
        {"states": ["turned", "T"], "units": {"turned": "%", "T": "C"}},
    ),
    "remarks in one row.csv": (
        "t,T,Comment\n" + rows(lambda k: f"{k},{FALL[k]:.3f},{'start' if k == 3 else ''}"),
        {"states": ["T"], "left out": ["Comment"]},
    ),
    "steps of a program.csv": (
        "Test_Time(s),Step_Time(s),Step_Index,Cycle_Index,T\n"
        + rows(lambda k: f"{k},{k % 4},{1 + k // 4},{1 + k // 12},{FALL[k]:.3f}"),
        {"states": ["T"], "left out": ["Step_Time(s)", "Step_Index", "Cycle_Index"]},
    ),
    "a clock with points.csv": (
        "Tid;T\n" + rows(lambda k: f"{at(k, '%H.%M', minutes=5)};{comma(FALL[k])}"),
        {
            "time": ("Tid", "min"),
            "states": ["T"],
            "to": 115.0,
            "note": "hours and minutes, such as",
        },
    ),
    "a clock of three numbers with points.csv": (
        "Kl.;T\n" + rows(lambda k: f"{at(k, '%H.%M.%S', seconds=5)};{comma(FALL[k])}"),
        {"time": ("Kl.", "s"), "states": ["T"], "to": 115.0},
    ),
    "a date and a clock with points.csv": (
        "Tidspunkt;T\n" + rows(lambda k: f"{at(k, '%d-%m-%Y %H.%M', minutes=5)};{comma(FALL[k])}"),
        {"time": ("Tidspunkt", "min"), "states": ["T"], "to": 115.0},
    ),
    "runs side by side.csv": (
        "Time (min),S (mM),,Time (min),S (mM),\n"
        + rows(lambda k: f"{k},{FALL[k]:.3f},,{k / 2},{FALL[k] / 2:.3f},"),
        {"time": ("Time (min)", "min"), "states": ["S"], "runs": 2, "note": "2 runs side by side"},
    ),
    "runs side by side below their names.csv": (
        "Run 1,,Run 2,\nTime,S,Time,S\n"
        + rows(lambda k: f"{k},{FALL[k]:.3f},{k / 2},{FALL[k] / 2:.3f}"),
        {"states": ["S"], "runs": 2},
    ),
    "numbered runs side by side.csv": (
        "t1,S1,t2,S2\n" + rows(lambda k: f"{k},{FALL[k]:.3f},{k / 2},{FALL[k] / 2:.3f}"),
        {"states": ["S"], "runs": 2},
    ),
    "runs by their start.csv": (
        'Time,"S, S0 = 41","S, S0 = 20.5"\n'
        + rows(lambda k: f"{k},{FALL[k]:.3f},{FALL[k] / 2:.3f}"),
        {"states": ["S"], "runs": 2, "note": "called S0 41, 20.5"},
    ),
    "quantities with times of their own.csv": (
        "Time,T,Time,p\n" + rows(lambda k: f"{k},{FALL[k]:.3f},{k + 0.5},{RISE[k]:.3f}"),
        {"states": ["T", "p"], "rows": 2 * N, "note": "2 columns of times"},
    ),
    "a reader of plates.csv": (
        "Application: i-control;;;\nSerial;1304003456\nPlate;96 flat\nWavelength;600;nm\n\n"
        + "\n".join(
            f"{name};" + ";".join(map(str, cells))
            for name, cells in {
                "Cycle Nr.": range(1, N + 1),
                "Time [s]": np.arange(0.0, 900 * N, 900),
                **{f"{row}{j}": (RISE * j).round(4) for row in "AB" for j in (1, 2, 3)},
            }.items()
        )
        + "\n\nEnd Time:;26-11-2025 04:00\n",
        {"time": ("Time [s]", "s"), "states": ["x"], "runs": 6, "note": "called well A1, A2"},
    ),
    "an oscilloscope with its settings on the left.csv": (
        "Record Length,24,,0,1.5\nInterval,1e-06,,1e-06,1.4\n"
        + rows(lambda k: f",,,{(k + 2) * 1e-6:.6g},{FALL[k]:.3f}"),
        {"time": ("t", ""), "states": ["x"], "rows": N + 2, "note": "columns 1 to 3"},
    ),
    "an oscilloscope whose rows are short.csv": (
        "X,CH1,Start,Increment,\nSequence,Volt,-6.0e-03,1.0e-03\n"
        + rows(lambda k: f"{k},{FALL[k]:.3f},"),
        {"time": ("t [s]", "s"), "states": ["CH1"], "rows": N, "to": -6e-3 + (N - 1) * 1e-3},
    ),
    "a simulator that writes the time twice.dat": (
        rows(lambda k: f" {k / 1e6:.8e}  {FALL[k]:.8e}  {k / 1e6:.8e}  {RISE[k]:.8e} "),
        {"time": ("t", ""), "states": ["x1", "x3"], "rows": N},
    ),
    "years, months and years with a fraction.txt": (
        "# year month decimal\n"
        + rows(
            lambda k: f"{1958 + k // 12} {k % 12 + 1} {1958 + (k + 0.5) / 12:.4f} {FALL[k]:.2f}"
        ),
        {"time": ("x2", ""), "states": ["x3"], "rows": N},
    ),
    "a potentiostat.DTA": (
        "EXPLAIN\nTAG\tCV\nCURVE\tTABLE\n\tPt\tT\tVf\n\t#\ts\tV vs. Ref.\n"
        + rows(lambda k: f"\t{k}\t{k / 10}\t{FALL[k]:.5E}"),
        {"time": ("T", ""), "states": ["Vf"], "rows": N, "to": (N - 1) / 10},
    ),
    "an oscilloscope.csv": (
        "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-1.0e-03,2.0e-04,\n"
        + rows(lambda k: f"{k},{FALL[k]:.2e},{RISE[k]:.2e},,,"),
        {
            "time": ("t [s]", "s"),
            "states": ["CH1", "CH2"],
            "to": -1e-3 + 2e-4 * (N - 1),
            "note": "'X' counts rows of 0.0002 s",
        },
    ),
    "on and off.csv": (
        "t,T,pump,lid\n"
        + rows(
            lambda k: f"{k},{FALL[k]:.3f},{('on', 'off')[k // 6 % 2]},{('yes', 'no')[k // 8 % 2]}"
        ),
        {"states": ["T"], "inputs": {"pump": "previous", "lid": "previous"}},
    ),
    "a date and a clock.csv": (
        "day;clock;T\n"
        + rows(lambda k: f"{at(k, '%d.%m.%Y;%H:%M', minutes=15)};{comma(FALL[k], 1)}"),
        {"unit": "min", "states": ["T"], "to": 15.0 * (N - 1)},
    ),
    "AM and PM.csv": (
        "when,T\n" + rows(lambda k: f"{at(k, '%m/%d/%Y %I:%M %p', minutes=10)},{FALL[k]:.3f}"),
        {"time": ("when", "min"), "states": ["T"], "to": 10.0 * (N - 1)},
    ),
    "milliseconds since 1970.csv": (
        "timestamp,T\n" + rows(lambda k: f"{1_650_000_000_000 + 500 * k},{FALL[k]:.3f}"),
        {"time": ("timestamp", "s"), "states": ["T"], "to": 0.5 * (N - 1)},
    ),
    "a clock past midnight.csv": (
        "time,T\n" + rows(lambda k: f"{at(k, '%H:%M:%S', minutes=20)},{FALL[k]:.3f}"),
        {"time": ("time", "min"), "states": ["T"], "to": 20.0 * (N - 1)},
    ),
    "rows in any order.csv": (
        "time [s],x\n" + rows(lambda k: f"{7 * k % N},{FALL[7 * k % N]:.3f}"),
        {"time": ("time [s]", "s"), "states": ["x"], "note": "in order of 'time [s]'"},
    ),
    "the time in the third column.csv": (
        "x,y,seconds\n" + rows(lambda k: f"{RISE[k]:.3f},{FALL[k]:.3f},{2 * k}"),
        {"time": ("seconds", "s"), "states": ["x", "y"]},
    ),
    "two labels.csv": (
        "strain,flask,hours,OD\n"
        + "".join(
            rows(
                lambda k, s=s, f=f: f"{s},{f},{k / 2 + s / 10},{s * f * RISE[k] / 9:.5f}", range(12)
            )
            for s in (3, 5)
            for f in (1, 2)
        ),
        {"runs": 4, "states": ["OD"]},
    ),
    "a long table.csv": (
        "what,hours,number\n"
        + rows(lambda k: f"cells,{k},{RISE[k]:.4f}")
        + rows(lambda k: f"sugar,{k},{FALL[k]:.4f}"),
        {"time": ("hours", "h"), "states": ["cells", "sugar"], "runs": 1, "note": "what"},
    ),
    "replicates side by side.csv": (
        "t,OD_1,OD_2,OD_3,sugar_1,sugar_2,sugar_3\n"
        + rows(
            lambda k: (
                f"{k},"
                + ",".join(f"{RISE[k] + EACH[0, k, r] / 50:.4f}" for r in range(3))
                + ","
                + ",".join(f"{FALL[k] + EACH[1, k, r]:.4f}" for r in range(3))
            )
        ),
        {"states": ["OD", "sugar"], "runs": 3},
    ),
    "repeated times.csv": (
        "t,x\n" + rows(lambda k: f"{k // 3},{FALL[k // 3] * (1 + 0.01 * (k % 3)):.4f}", range(60)),
        {"states": ["x"], "runs": 1, "rows": 20},
    ),
    "spreads beside means.csv": (
        "t,x_mean,x_se,y_mean,y_se\n"
        + rows(
            lambda k: (
                f"{k},{FALL[k]:.3f},{0.3 + k % 3 / 50:.3f},{RISE[k]:.4f},{k % 4 / 99 + 0.1:.4f}"
            )
        ),
        {"states": ["x_mean", "y_mean"], "noise": {"x_mean": "x_se", "y_mean": "y_se"}},
    ),
    "row numbers.csv": (
        "Nr.;t;x\n" + rows(lambda k: f"{k + 1};{comma(k / 2, 1)};{comma(FALL[k])}"),
        {"time": ("t", ""), "states": ["x"], "left out": ["Nr."]},
    ),
    "a second time.csv": (
        "date,hours,x\n"
        + rows(lambda k: f"{at(k, '%Y-%m-%d %H:%M:%S', minutes=6)},{k / 10:.1f},{FALL[k]:.3f}"),
        {"states": ["x"]},
    ),
    "minutes and seconds.csv": (
        "elapsed (min:s),x\n" + rows(lambda k: f"{k // 2}:{k % 2 * 30:02d},{FALL[k]:.3f}"),
        {"unit": "s", "states": ["x"], "to": 30.0 * (N - 1), "note": "minutes and seconds"},
    ),
    "hours and minutes.csv": (
        "time,x\n" + rows(lambda k: f"{k // 2}:{k % 2 * 30:02d},{FALL[k]:.3f}"),
        {"unit": "min", "states": ["x"], "to": 30.0 * (N - 1), "note": "hours and minutes"},
    ),
    "days with a word.csv": (
        "time,x\n" + rows(lambda k: f"Day {k},{FALL[k]:.3f}"),
        {"time": ("time", "days"), "states": ["x"], "to": N - 1.0},
    ),
    "numbered moments.csv": (
        "timepoint,x\n" + rows(lambda k: f"T{2 * k},{FALL[k]:.3f}"),
        {"time": ("timepoint", ""), "states": ["x"], "to": 2.0 * (N - 1)},
    ),
    "minutes, then hours.csv": (
        "time,x\n" + rows(lambda k: f"{30 * k} min,{FALL[k]:.3f}" if k < 4 else f"{k / 2} h,1.5"),
        {"time": ("time", "min"), "states": ["x"], "to": 30.0 * (N - 1)},
    ),
    "weeks of a year.csv": (
        "week,x\n" + rows(lambda k: f"2021-W{k + 1:02d},{FALL[k]:.3f}"),
        {"time": ("week", "days"), "states": ["x"], "to": 7.0 * (N - 1)},
    ),
    "years and quarters.csv": (
        "year,quarter,x\n" + rows(lambda k: f"{2000 + k // 4},Q{k % 4 + 1},{FALL[k]:.3f}"),
        {"time": ("year, quarter", "days"), "states": ["x"], "runs": 1, "rows": N},
    ),
    "days and hours.csv": (
        "day,hour,x\n" + rows(lambda k: f"{k // 8 + 1},{k % 8 * 3},{FALL[k]:.3f}"),
        {"time": ("day, hour", "h"), "states": ["x"], "runs": 1, "to": 24 + 3.0 * (N - 1)},
    ),
    "a long table whose quantities have their own times.csv": (
        "time,analyte,value\n"
        + rows(lambda k: f"{k},sugar,{FALL[k]:.3f}")
        + rows(lambda k: f"{k + 0.5},cells,{RISE[k]:.4f}"),
        {"states": ["sugar", "cells"], "runs": 1, "rows": 2 * N},
    ),
    "numbers that name patients.csv": (
        "Patient no.,t,x\n"
        + "".join(
            rows(lambda k, i=i: f"{i},{k},{i * FALL[k]:.3f}", range(12)) for i in (12, 7, 33)
        ),
        {"states": ["x"], "runs": 3},
    ),
    "a row of groups above the names.csv": (
        "Time,Rep 1,,Rep 2,\nh,cells,sugar,cells,sugar\n"
        + rows(lambda k: f"{k},{RISE[k]:.3f},{FALL[k]:.3f},{2 * RISE[k]:.3f},{FALL[k] + 1:.3f}"),
        {"time": ("Time [h]", "h"), "states": ["cells", "sugar"], "runs": 2},
    ),
    "replicates with letters.csv": (
        "t,OD A,OD B,OD C\n"
        + rows(
            lambda k: f"{k}," + ",".join(f"{RISE[k] + EACH[0, k, r] / 50:.4f}" for r in range(3))
        ),
        {"states": ["OD"], "runs": 3},
    ),
    "rows written twice.csv": (
        "t,x\n" + rows(lambda k: f"{k},{FALL[k]:.3f}" + f"\n{k},{FALL[k]:.3f}" * (k in (5, 9))),
        {"states": ["x"], "rows": N, "note": "2 rows are copies"},
    ),
    "times from left to right.csv": (
        "time,"
        + ",".join(map(str, K))
        + "\n"
        + "cells,"
        + ",".join(f"{v:.4f}" for v in RISE)
        + "\n"
        + "sugar,"
        + ",".join(f"{v:.3f}" for v in FALL)
        + "\n",
        {"states": ["cells", "sugar"], "rows": N, "to": N - 1.0, "note": "the table was turned"},
    ),
    "dates from left to right.csv": (
        "country,"
        + ",".join(at(k, "%m/%d/%y", days=1) for k in K)
        + "\n"
        + "Chile,"
        + ",".join(f"{v:.4f}" for v in RISE)
        + "\n"
        + "Peru,"
        + ",".join(f"{v:.3f}" for v in FALL)
        + "\n",
        {"unit": "days", "states": ["Chile", "Peru"], "rows": N, "note": "the table was turned"},
    ),
    "dates from left to right behind places.csv": (
        "Province/State,Country/Region,Lat,Long,"
        + ",".join(at(k, "%m/%d/%y", days=1) for k in K)
        + "\n"
        + ",Chile,-35.7,-71.5,"
        + ",".join(f"{v:.4f}" for v in RISE)
        + "\n"
        + "Victoria,Australia,-37.8,145,"
        + ",".join(f"{v:.3f}" for v in FALL)
        + "\n",
        {"unit": "days", "states": ["value"], "runs": 2, "rows": N, "note": "the table was turned"},
    ),
    "years and days in one number.csv": (
        "yyyyddd,x\n" + rows(lambda k: f"{2023355 + k if k < 11 else 2023990 + k},{FALL[k]:.3f}"),
        {"time": ("yyyyddd", "days"), "states": ["x"], "to": N - 1.0},
    ),
    "names of some columns above those of the others.trc": (
        "DataRate\tUnits\n100\tmm\nFrame#\tTime\tknee\t\thip\t\n\t\tX1\tY1\tX2\tY2\n\n"
        + rows(lambda k: f"{k + 1}\t{k / 100}\t" + f"{FALL[k]:.3f}\t{RISE[k]:.4f}\t" * 2),
        {"time": ("Time", ""), "states": ["X1", "Y1", "X2", "Y2"], "rows": N, "to": (N - 1) / 100},
    ),
    "sensors called T1 to T8.csv": (
        "when,"
        + ",".join(f"T{k}" for k in range(1, 9))
        + "\n"
        + rows(lambda k: at(k, "%Y-%m-%d %H:%M", minutes=5) + f",{FALL[k]:.3f}" * 8).replace(
            ",5.", ",5.1"
        ),
        {"time": ("when", "min"), "states": [f"T{k}" for k in range(1, 9)], "rows": N},
    ),
    "footnotes behind numbers.csv": (
        "t,x\n" + rows(lambda k: f"{k},{'~' * (k == 3)}{FALL[k]:.3f}{'*' * (k % 5 == 4)}"),
        {"states": ["x"], "rows": N, "note": "have a mark ('~30.633') and were read without it"},
    ),
    "words for no value.csv": (
        "t,x,y\n"
        + rows(
            lambda k: (
                f"{k},{'below LOD' if k == 5 else f'{FALL[k]:.3f}'},"
                f"{'***' if k == 7 else 'not sampled' if k == 9 else f'{RISE[k]:.3f}'}"
            )
        ),
        {"states": ["x", "y"], "rows": N, "note": "cells are empty: 'y' in 2, 'x' in 1"},
    ),
    "a code for no value.csv": (
        "t,x\n" + rows(lambda k: f"{k},{-999 if k % 9 == 4 else round(FALL[k], 3)}"),
        {"states": ["x"], "note": "x is -999 in 3 of 24 rows"},
    ),
    "a valve.csv": (
        "t,level,valve [V]\n" + rows(lambda k: f"{k},{FALL[k]:.3f},{(0, 5, 2.5)[k // 8]}"),
        {"states": ["level"], "inputs": {"valve": "previous"}},
    ),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_table_is_read_as_it_is_meant(name, tmp_path):
    """Time, runs, states, inputs, noise and what is left out are those that the table shows."""
    text, right = FORMS[name]
    path = tmp_path / name
    path.write_text(text, "utf-8")
    found = dynsr.describe(path)
    said = found.to_dict()
    if "time" in right:
        assert (said["time"]["column"], said["time"]["unit"]) == right["time"]
    if "unit" in right:
        assert said["time"]["unit"] == right["unit"]
    assert said["states"] == right["states"]
    assert said["hold"] == right.get("inputs", {}) and set(said["inputs"]) == set(said["hold"])
    assert said["noise"] == right.get("noise", {})
    assert len(said["trajectories"]) == right.get("runs", 1)
    assert said["trajectories"][0]["rows"] == right.get("rows", said["trajectories"][0]["rows"])
    if "to" in right:
        assert said["trajectories"][0]["to"] == pytest.approx(right["to"])
    assert set(right.get("left out", ())) <= set(said["left_out"])
    assert all(said["left_out"].values())
    assert right.get("units", {}).items() <= said["units"].items()
    assert any(right.get("note", "") in note for note in [*said["notes"], ""])


def test_copies_of_rows_say_nothing_of_the_noise(tmp_path):
    """A row that is there twice is left out; it does not mean that there is no noise."""
    path = tmp_path / "twice.csv"
    path.write_text(FORMS["rows written twice.csv"][0], "utf-8")
    assert "noise" not in dynsr.data.read_trajectories(path).trajectories[0].origin


def test_dates_in_two_forms_are_refused_with_both(tmp_path):
    """The message shows a date of each form, with its row."""
    path = tmp_path / "mixed.csv"
    form = ("%d.%m.%Y", "%Y-%m-%d")
    path.write_text("date,x\n" + rows(lambda k: f"{at(k, form[k > 15], days=1)},{FALL[k]:.3f}"))
    with pytest.raises(InputError) as caught:
        dynsr.describe(path)
    assert "'04.11.2023' in row 1 and '2023-11-20' in row 17" in str(caught.value)


def test_numbers_of_runs_that_are_taken_for_a_parameter_can_be_named(tmp_path):
    """The description shows the option that says that they only name the runs."""
    path = tmp_path / "dose.csv"
    runs = "".join(rows(lambda k, d=d: f"{d},{k},{d * FALL[k]:.3f}", range(12)) for d in (2, 5, 9))
    path.write_text("dose,t,x\n" + runs, "utf-8")
    found = dynsr.describe(path)
    assert found.parameters == ("dose",) and "--trajectory dose" in found.options
    assert dynsr.describe(path, trajectory="dose").parameters == ()


def test_the_date_that_is_counted_from_is_shown(tmp_path):
    """Whether the day or the month comes first can be seen in the description."""
    path = tmp_path / "dates.csv"
    path.write_text("date,x\n" + rows(lambda k: f"{at(k, '%d/%m/%Y', days=1)},{FALL[k]:.3f}"))
    found = dynsr.describe(path)
    assert found.time.begins == "2023-11-04" and "in days since 2023-11-04" in str(found)
    assert found.to_dict()["time"]["begins"] == "2023-11-04"


@pytest.mark.parametrize("code", [-999, -9999.0, -99.99, 9999, 1e30, -32768, 9.96921e36])
@pytest.mark.parametrize("rows", [[4], [4, 13, 22], [*range(1, 15)]])
def test_a_code_for_no_value_is_an_empty_cell(code, rows):
    """Usual codes far from all others are read so with a warning, in files and in arrays."""
    t, x = np.arange(24.0), np.array(FALL[:24])
    x[rows] = code
    for source in ({"t": t, "x": x, "y": t**2}, (t, np.column_stack([x, t**2]))):
        with pytest.warns(DynsrWarning, match=r"in \d+ of 24 rows and else .* read as no value"):
            (run,), _ = dynsr.data.take_trajectories(source)
        assert np.flatnonzero(~run.measured[:, 0]).tolist() == rows
        (kept,), _ = dynsr.data.take_trajectories(source, missing="none")
        assert kept.measured.all() and kept.x[rows[0], 0] == code


def test_numbers_that_may_be_values_are_kept_until_the_caller_says_otherwise():
    """Neither 999 among hundreds nor a number that is no code is lost; missing= names any."""
    t = np.arange(24.0)
    for code in (999.0, -7.0, 0.0):
        x = np.where(t % 9 == 4, code, 500.0 + 20 * t)
        (run,), _ = dynsr.data.take_trajectories({"t": t, "x": x, "y": t**2})
        assert run.measured.all()
        for said in (code, [code], f"{code:g}"):
            (run,), _ = dynsr.data.take_trajectories({"t": t, "x": x, "y": t**2}, missing=said)
            assert np.flatnonzero(~run.measured[:, 0]).tolist() == [4, 13, 22]
        assert run.t[0] == 0
    subject = np.repeat([1.0, 2, 3, 4, 999], 24)
    found = {"ID": subject, "t": np.tile(t, 5), "x": np.tile(FALL[:24], 5) * (1 + subject / 1e4)}
    assert len(dynsr.data.read_trajectories(found).trajectories) == 5


@pytest.mark.parametrize("said", ["x", [], [np.nan], {"x": 1}])
def test_missing_takes_numbers(said):
    """One line says what it takes."""
    with pytest.raises(InputError, match="must be the numbers that stand for no value"):
        dynsr.data.take_trajectories((np.arange(9.0), np.ones((9, 1))), missing=said)


def test_a_number_that_is_far_from_all_others_is_reported_by_every_reading():
    """It spoils a search, and the option that makes it an empty cell is named."""
    x = np.where(np.arange(24) % 9 == 4, -7e3, FALL[:24])
    with pytest.warns(DynsrWarning, match="x is -7000 in 3 of 24 rows.*--missing -7000"):
        dynsr.data.read_trajectories({"t": np.arange(24.0), "x": x})
