"""Delimited text as instruments, programs and people write it: what is in it is read and told."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynsr.data import read_trajectories
from dynsr.data.codes import is_code
from dynsr.data.columns import load_columns, read_names_only
from dynsr.data.monitor import read_monitor
from dynsr.errors import DynsrWarning, InputError

T = np.arange(14) * 0.25
FILL = np.round(3 + np.cos(T), 4)
FLOW = np.round(40 * np.exp(-T), 3)
ROWS = [f"{t},{a},{b}" for t, a, b in zip(T, FILL, FLOW, strict=True)]
BODY = "\n".join(ROWS) + "\n"


def put(folder, text, name="pump.csv"):
    """Write a file and give its path."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def european(text):
    """Write a text with semicolons and decimal commas."""
    return text.replace(",", ";").replace(".", ",")


def check_body(columns, names=("hours", "fill", "flow")):
    """See that a table holds the numbers of this file and no others."""
    assert columns.names == names
    for found, wanted in zip(columns.values, (T, FILL, FLOW), strict=True):
        np.testing.assert_array_equal(found, wanted)


HEAD = "hours,fill,flow\n"
ABOVE = {
    "key: value": "Serial: 778\nStarted: 2023-05-01 07:00\nRate: 4 Hz\n\n",
    "key,value": "Serial,778\nOperator,NN\nGain,2.5\n\n",
    "padded by a spreadsheet": "Pump station,,\nread by NN,,\n,,\n",
    "one sentence": "Exported with the program, version 3, of May\n",
    "many lines": "".join(f"setting {j} = {j * j}\n" for j in range(300)),
    "sep=": "sep=,\n",
    "sep= quoted": '"sep=,"\n',
    "comments": "# pump\n# by NN, in May\n% and more\n",
    "comment and remark": "# pump\nserial 778\n\n\n",
    "rule between names and rows": "",
}


@pytest.mark.parametrize("form", ABOVE)
@pytest.mark.parametrize("write", [str, european], ids=["point", "comma"])
def test_lines_above_the_names_are_skipped_and_told(tmp_path, form, write):
    """Names and numbers are those of the table; comments and sep= alone are no news."""
    head = HEAD + ("-----,-----,-----\n" if "rule" in form else "")
    text = write(ABOVE[form] + head + BODY)
    if form.startswith("sep="):
        text = text.replace("sep=,", "sep=;") if write is european else text
    columns = load_columns(put(tmp_path, text))
    check_body(columns)
    assert read_names_only(tmp_path / "pump.csv") == columns.names
    silent = form.startswith("sep=") or form == "comments"
    assert len(columns.notes) == (not silent)
    assert silent or re.search(r"above its table ha(s|ve) no data; skipped", columns.notes[0])


UNITS = {
    "brackets": ("(h),(m),(L/min)", {"hours": "h", "fill": "m", "flow": "L/min"}),
    "bare": ("h,m,L/min", {"hours": "h", "fill": "m", "flow": "L/min"}),
    "square, some without": ("[h],[-],[mL]", {"hours": "h", "flow": "mL"}),
    "dashes": ("h,-,-", {"hours": "h"}),
    "one cell empty": ("h,,°C", {"hours": "h", "flow": "°C"}),
    "words": ("hours,metres,Celsius", {"hours": "hours", "fill": "metres", "flow": "Celsius"}),
    "percent": ("h,%,a.u.", {"hours": "h", "fill": "%", "flow": "a.u."}),
}


@pytest.mark.parametrize("form", UNITS)
def test_a_row_of_units_is_read_as_such(tmp_path, form):
    """Units below the names stand in the columns and in the trajectories, the time's too."""
    line, units = UNITS[form]
    columns = load_columns(put(tmp_path, f"{HEAD}{line}\n{BODY}"))
    check_body(columns)
    assert columns.units == units and not columns.notes
    (run,) = read_trajectories(tmp_path / "pump.csv").trajectories
    assert run.time_unit == "h"
    assert run.origin.get("units", {}) == {k: u for k, u in units.items() if k != "hours"}


LONG = {
    "long below": "h,fill,flow\nhours since start,level in the tank,flow out of it\n",
    "long above": "hours since start,level in the tank,flow out of it\nh,fill,flow\n",
    "long, then units": "h,fill,flow\nhours since start,level in the tank,flow out of it\nh,m,L\n",
}


@pytest.mark.parametrize("form", LONG)
def test_of_two_rows_of_names_the_short_one_is_taken(tmp_path, form):
    """A name and a longer one, in either order: names are what stands in formulas."""
    names = load_columns(put(tmp_path, LONG[form] + BODY)).names
    if form == "long above":  # both are names; the nearer one or the one with a time
        assert names[1:] in (("fill", "flow"), ("level in the tank", "flow out of it"))
    else:
        assert names == ("h", "fill", "flow")


def test_names_of_groups_of_columns_are_joined(tmp_path):
    """A group above its columns makes their names differ."""
    rows = "".join(f"{t},{t},{t + 1},{t + 2},{t + 5}\n" for t in T)
    for head in (
        "time,tank A,,tank B,\n,x,y,x,y\n",
        ",tank A,tank A,tank B,tank B\ntime,x,y,x,y\n",
    ):
        names = load_columns(put(tmp_path, head + rows)).names
        assert names[0].startswith("time")
        assert names[1:] == ("x_tank A", "y_tank A", "x_tank B", "y_tank B")


BELOW = {
    "summary": "Mean,3.2,8.1\n",
    "two summaries": "Mean,3.2,8.1\nSum,44,112\n",
    "end": "\nend of file\n",
    "remark": "# switched off\n",
    "blank, then text": ",,\n,,\nread by NN,,\n",
}


@pytest.mark.parametrize("form", BELOW)
def test_lines_below_the_table_are_skipped_and_told(tmp_path, form):
    """A summary or a sentence at the end is no row."""
    columns = load_columns(put(tmp_path, HEAD + BODY + BELOW[form]))
    check_body(columns)
    assert len(columns.notes) == 1 and "skipped" in columns.notes[0]


@pytest.mark.parametrize("name", ["Weekly total", "Summe", "Mean of 7"])
def test_sums_and_means_between_the_rows_are_skipped(tmp_path, name):
    """A table of weeks has them, with numbers in each column."""
    rows = [row + (f"\n{name},44,112" if j % 7 == 6 else "") for j, row in enumerate(ROWS)]
    columns = load_columns(put(tmp_path, HEAD + "\n".join(rows)))
    check_body(columns)
    assert columns.notes == (f"2 rows of pump.csv have no data ({name!r}); skipped",)


@pytest.mark.parametrize("blank", [",,", " , , ", "", ";;".replace(";", ","), '"","",""'])
def test_blank_rows_anywhere_are_no_rows(tmp_path, blank):
    """Rows of delimiters, as spreadsheets write them, at the end and in between."""
    text = HEAD + "\n".join([*ROWS[:5], blank, *ROWS[5:], blank, blank]) + "\n"
    check_body(load_columns(put(tmp_path, text)))


def test_names_repeated_between_rows_and_remarks_are_skipped(tmp_path):
    """Files put together have their names again; a logger writes a word in between."""
    text = HEAD + "\n".join([*ROWS[:5], HEAD.strip(), "pause", *ROWS[5:]])
    columns = load_columns(put(tmp_path, text))
    check_body(columns)
    assert len(columns.notes) == 2


def test_a_column_without_a_value_is_left_out_with_the_reason(tmp_path):
    """Named or not, in the middle or at the end; asked for, the reason comes."""
    rows = "".join(f"{row},,{'-' if j % 2 else ''},\n" for j, row in enumerate(ROWS))
    path = put(tmp_path, "hours,fill,flow,,guessed,\n" + rows)
    columns = load_columns(path)
    check_body(columns)
    assert columns.left_out == {"guessed": "has no value in any row"}
    with pytest.raises(
        InputError, match=r"'guessed' of pump.csv was left out since it has no value"
    ):
        read_trajectories(path, states=["guessed"])


def test_remarks_in_a_few_rows_are_left_out_with_the_reason(tmp_path):
    """A column of them with a name, and words behind the last column."""
    said = {3: "valve stuck", 9: "new hose"}
    with_name = (
        HEAD.strip() + ",remark\n" + "".join(f"{r},{said.get(j, '')}\n" for j, r in enumerate(ROWS))
    )
    behind = HEAD + "".join(
        f"{r}{',' + said[j] if j in said else ''}\n" for j, r in enumerate(ROWS)
    )
    for text, name in ((with_name, "remark"), (behind, "column 4")):
        columns = load_columns(put(tmp_path, text))
        check_body(columns)
        assert columns.left_out == {name: "holds remarks in 2 of 14 rows"}


def test_a_name_used_twice_stops_only_who_asks_for_it(tmp_path):
    """The second is renamed, and told; where it repeats the first it is left out."""
    path = put(
        tmp_path, "hours,fill,flow,fill\n" + "".join(f"{r},{j}\n" for j, r in enumerate(ROWS))
    )
    columns = load_columns(path)
    assert columns.names == ("hours", "fill", "flow", "fill_2")
    assert (
        "'fill' is used twice in pump.csv; one of them is called 'fill_2' here" in columns.notes[0]
    )
    with pytest.warns(DynsrWarning, match="is used twice"):
        assert read_trajectories(path, states=["flow"]).trajectories[0].states == ("flow",)
    with (
        pytest.warns(DynsrWarning),
        pytest.raises(InputError, match="'fill' for the state is used twice"),
    ):
        read_trajectories(path, states=["fill"])
    same = load_columns(
        put(
            tmp_path,
            "hours,fill,hours,flow\n"
            + "".join(f"{t},{a},{t},{b}\n" for t, a, b in zip(T, FILL, FLOW, strict=True)),
        )
    )
    check_body(same)
    assert same.left_out == {"column 3": "repeats column 'hours'"}


ODD = {
    "quoted": "\n".join(
        ",".join(f'"{c}"' for c in row.split(",")) for row in [HEAD.strip(), *ROWS]
    ),
    "BOM": b"\xef\xbb\xbf" + (HEAD + BODY).encode(),
    "UTF-16": (HEAD + BODY).encode("utf-16"),
    "CR": (HEAD + BODY).replace("\n", "\r"),
    "CRLF": (HEAD + BODY).replace("\n", "\r\n"),
    "delimiters at the end": (HEAD + BODY).replace("\n", ",,\n"),
    "ragged delimiters": HEAD + "".join(f"{r}{',' * (j % 4)}\n" for j, r in enumerate(ROWS)),
    "blanks": (HEAD + BODY).replace(",", " , "),
    "markdown": "".join(f"| {r.replace(',', ' | ')} |\n" for r in [HEAD.strip(), *ROWS]),
    "aligned": "".join(
        "".join(f"{c:>14}" for c in r.split(",")) + "\n" for r in [HEAD.strip(), *ROWS]
    ),
    "names in a comment": "# " + HEAD + BODY,
    "names above a comment": HEAD + "# taken in May\n" + BODY,
    "a name over two lines": '"hours",fill,"flow"\n' + BODY,
}


@pytest.mark.parametrize("form", ODD)
def test_odd_ways_to_write_a_table(tmp_path, form):
    """Quotation marks, marks of the encoding, line ends and delimiters change no number."""
    check_body(load_columns(put(tmp_path, ODD[form])))


def test_cells_over_several_lines(tmp_path):
    """A name with its unit below it, and a remark of two lines, as spreadsheets write them."""
    text = '"hours",fill,"flow\n[L]",remark\n' + "".join(
        f"{r},{chr(34) + 'hose' + chr(10) + 'new' + chr(34) if j == 4 else ''}\n"
        for j, r in enumerate(ROWS)
    )
    check_body(load_columns(put(tmp_path, text)), ("hours", "fill", "flow [L]"))


def test_names_with_blanks_in_a_table_of_blanks(tmp_path):
    """Units in brackets, or two blanks between names, tell where a name ends."""
    body = BODY.replace(",", "  ")
    for head in ("hours [h] fill (m) flow", "run time [h]   tank fill   flow"):
        assert len(load_columns(put(tmp_path, f"{head}\n{body}")).names) == 3


def test_units_may_stand_above_the_names(tmp_path):
    """Then they are units too."""
    columns = load_columns(put(tmp_path, "h,mm,mL/s\n" + HEAD + BODY))
    check_body(columns)
    assert columns.units == {"hours": "h", "fill": "mm", "flow": "mL/s"}


def test_numbers_of_rows_without_a_name_are_no_shift(tmp_path):
    """R writes one name less than there are columns."""
    rows = "".join(f'"{j}" {r.replace(",", " ")}\n' for j, r in enumerate(ROWS, start=1))
    columns = load_columns(put(tmp_path, '"hours" "fill" "flow"\n' + rows))
    assert columns.names == ("", "hours", "fill", "flow")
    np.testing.assert_array_equal(columns.values[1], T)


def test_numbers_may_be_names(tmp_path):
    """Concentrations as names stand beside a time, and are no row."""
    columns = load_columns(put(tmp_path, "time,0.5,2.0\n" + BODY))
    check_body(columns, ("time", "0.5", "2.0"))


SPREADSHEET_ERRORS = ["#N/A", "#DIV/0!", "#REF!", "#NAME?", "#NUM!", "#VALUE!"]


@pytest.mark.parametrize("cell", SPREADSHEET_ERRORS)
def test_rows_that_begin_with_an_error_of_a_spreadsheet_are_rows(tmp_path, cell):
    """Comments stand above the first row; such a cell is one without a value."""
    rows = [*ROWS[:6], f"{cell},{FILL[6]},{FLOW[6]}", *ROWS[7:]]
    columns = load_columns(put(tmp_path, HEAD + "\n".join(rows)))
    assert len(columns.values[0]) == 14 and np.isnan(columns.values[0][6])
    assert columns.values[2][6] == FLOW[6]


@pytest.mark.parametrize("row", ["1.5,81#7,2", "1.5,8x1,2", "#1.5,3,2"])
def test_a_cell_that_cannot_be_read_is_named_once_it_is_needed(tmp_path, row):
    """Nothing behind # is dropped in a row; who does not need the column is not stopped."""
    path = put(tmp_path, HEAD + "\n".join([*ROWS[:6], row, *ROWS[7:]]))
    wrong = next(cell for cell in row.split(",") if "#" in cell or "x" in cell)
    with pytest.raises(InputError, match=f"has the text '{wrong}' in row 7"):
        read_trajectories(path)
    if not row.startswith("#"):
        assert len(read_trajectories(path, states=["flow"]).trajectories[0]) == 14


NUMBERS = st.floats(-1e6, 1e6).map(lambda v: round(v, 4)).filter(lambda v: not is_code(v))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_mix_of_dialects_reads_back_the_same_numbers(tmp_path_factory, data):
    """Delimiter, decimal mark, lines above, units, blank rows and missing marks: one table."""
    pick = lambda *options: data.draw(st.sampled_from(options))  # noqa: E731
    delimiter = pick(",", ";", "\t", "|")
    mark = "." if delimiter == "," else pick(".", ",")
    missing = pick("", "n.d.", "NA", "-", "?", ".", "#N/A", "NaN")
    rows = data.draw(st.lists(st.tuples(NUMBERS, st.none() | NUMBERS), min_size=6, max_size=20))
    # Time and first column show the decimal mark.
    cells = [
        [f"{j / 10:.2f}", f"{a:.4f}", missing if b is None else repr(b)]
        for j, (a, b) in enumerate(rows)
    ]
    lines = [
        delimiter.join(row).replace(".", mark)
        if missing != "."
        else delimiter.join(c if c == "." else c.replace(".", mark) for c in row)
        for row in cells
    ]
    if missing not in ("", ".", "NA", "-", "?", "#N/A", "NaN"):
        lines = [ln.replace(missing.replace(".", mark), missing) for ln in lines]
    blank = delimiter * 2
    for place in data.draw(st.lists(st.integers(1, len(lines)), max_size=3)):
        lines.insert(place, pick(blank, ""))
    head = [*pick([], ["Device: logger"], ["Device: logger", "", "Rate: 5 Hz"], ["# by NN"])]
    head.append(delimiter.join(("time", "level", "rate")))
    head += pick([], [delimiter.join(("s", "m", "m/s"))], [delimiter.join(("[s]", "[m]", "[-]"))])
    end = pick("\n", "\r\n", "\r")
    path = tmp_path_factory.mktemp("mix") / "mix.txt"
    path.write_text(end.join([*head, *lines]) + end, newline="", encoding=pick("utf-8", "utf-16"))
    columns = load_columns(path)
    some = any(b is not None for _, b in rows)
    assert columns.names == (("time", "level", "rate") if some else ("time", "level"))
    wanted = [
        [j / 10 for j in range(len(rows))],
        [a for a, _ in rows],
        [np.nan if b is None else b for _, b in rows],
    ]
    for found, own in zip(columns.values, wanted, strict=False):
        np.testing.assert_array_equal(found, np.array(own))


@pytest.mark.parametrize(
    "names", [[f'"{k}"' for k in range(1, 13)], [f'"a{k}"' for k in range(12)]]
)
def test_row_names_of_r_have_no_name_themselves(tmp_path, names):
    """write.table writes one name less than cells: the first column names or counts the rows."""
    rows = [f"{name} {k / 2} {2.0**-k!r}" for k, name in enumerate(names)]
    path = tmp_path / "r.txt"
    path.write_text("\n".join(['"t" "x"', *rows]))
    columns = load_columns(path)
    assert columns.names[-2:] == ("t", "x")
    np.testing.assert_allclose(columns.values[-1], 2.0 ** -np.arange(12))


def test_a_name_that_is_missing_is_refused(tmp_path):
    """One name less than cells, above numbers that count nothing, is a fault of the header."""
    path = tmp_path / "short.txt"
    path.write_text("\n".join(["t x", *(f"{k / 2} {k} {k * k}" for k in range(12))]))
    with pytest.raises(InputError, match="names 2 columns but row 1 has 3"):
        load_columns(path)


def test_a_comment_names_columns_with_their_units(tmp_path):
    """Blanks before a bracket in a comment above columns of blanks tear no name from its unit."""
    rows = [f"{k / 2} {2.0**-k!r} {k * k}.5" for k in range(12)]
    path = tmp_path / "rig.dat"
    path.write_text("\n".join(["# rig 4", "# t [s]  x [m]  v [m/s]", *rows]))
    assert load_columns(path).names == ("t [s]", "x [m]", "v [m/s]")


def test_hours_and_minutes_with_an_h_are_a_clock(tmp_path):
    """14h05 in a French table is a time of the day and no number with a unit."""
    rows = [f"03/11/2023;{9 + k // 6}h{k % 6}5;{k * k}" for k in range(12)]
    path = tmp_path / "debit.csv"
    path.write_text("\n".join(["Date;Heure;Debit", *rows]))
    (run,) = read_trajectories(path).trajectories
    assert run.time_unit == "min" and run.t.tolist() == [10.0 * k for k in range(12)]


def test_a_stopwatch_may_run_for_more_than_99_hours(tmp_path):
    """Rows of 100:00:00 and more are rows, not remarks below the table."""
    rows = [f"{k * 5}:00:00,{2.0**-k:.6f}" for k in range(30)]
    (tmp_path / "long.csv").write_text("\n".join(["elapsed,x", *rows]))
    (run,) = read_trajectories(tmp_path / "long.csv").trajectories
    assert np.array_equal(run.t, 5 * np.arange(30)) and run.time_unit == "h"


@pytest.mark.parametrize(
    "write", [str, lambda text: text.replace(".", ",")], ids=["point", "comma"]
)
def test_settings_with_a_number_for_each_column_are_above_the_table(tmp_path, write):
    """LabVIEW writes samples, dates and starts of the channels, and a last column of no cells."""
    above = (
        "LabVIEW Measurement\nSeparator\tTab\nTime_Pref\tRelative\nDate\t2024/01/12\n"
        "Time\t11:12:13\n***End_of_Header***\t\n\t\nChannels\t2\nSamples\t14\t14\n"
        "Date\t2024/01/12\t2024/01/12\nTime\t11:12:13\t11:12:13\nY_Unit_Label\tVolts\tVolts\n"
        "X0\t0.0E+0\t0.0E+0\nDelta_X\t0.25\t0.25\n***End_of_Header***\t\t\n"
    )
    text = f"{above}X_Value\tfill\tflow\tComment\n{BODY}".replace(",", "\t")
    columns = load_columns(put(tmp_path, write(text), "rig.lvm"))
    check_body(columns, ("X_Value", "fill", "flow"))
    assert columns.notes[0] == "lines 1 to 15 of rig.lvm above its table have no data; skipped"


@pytest.mark.parametrize(
    "form",
    ["hours:{} fill:{} flow:{}", "hours={}, fill = {} , flow={}", "hours: {}|fill: {}|flow: {}"],
)
def test_lines_with_a_name_before_each_value_are_a_table(tmp_path, form):
    """As programs print them while they run; other lines are skipped, which is said."""
    lines = ["Booting", *(form.format(*row) for row in zip(T, FILL, FLOW, strict=True))]
    path = put(tmp_path, "\n".join(lines), "serial.log")
    found = load_columns(path)
    check_body(found)
    assert read_names_only(path) == found.names and "'Booting'" in found.notes[0]


def test_a_clock_before_an_arrow_is_the_time(tmp_path):
    """As the monitor of an Arduino has it, with names and units or without."""
    stamps = [
        f"23:59:{56 + k / 4:06.3f}" if k < 16 else f"00:00:{k / 4 - 4:06.3f}" for k in range(14)
    ]
    cells = [f"{a},{b}" for a, b in zip(FILL, FLOW, strict=True)]
    bare = "\n".join(f"{s} -> {c}" for s, c in zip(stamps, cells, strict=True))
    run = read_trajectories(put(tmp_path, bare)).trajectories[0]
    assert np.allclose(run.t, T) and np.array_equal(run.x, np.column_stack([FILL, FLOW]))
    own = [f"fill: {a} cm flow: {b} L/min" for a, b in zip(FILL, FLOW, strict=True)]
    named = "\n".join(f"{s} -> {c}" for s, c in zip(stamps, own, strict=True))
    run = read_trajectories(put(tmp_path, named)).trajectories[0]
    assert run.states == ("fill", "flow") and run.origin["units"] == {"fill": "cm", "flow": "L/min"}


def test_remarks_of_names_and_values_above_a_table_are_no_table(tmp_path):
    """Nor are settings of other names in each line."""
    above = "".join(f"gain {k}: 2 V\n" for k in range(5))
    check_body(load_columns(put(tmp_path, f"{above}hours,fill,flow\n{BODY}")))
    assert read_monitor([f"gain_{k}: {k}, x: 2" for k in range(20)], "settings.txt") is None
