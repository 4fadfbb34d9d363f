"""What cells say: missing and limited values, units, thousands, switches; by evidence, and told."""

import json

import numpy as np
import pandas as pd
import polars as pl
import pytest
from command_line import run

from dynsr.data import read_trajectories, take_trajectories
from dynsr.data.amounts import is_unit, parse_number
from dynsr.data.cells import read_columns
from dynsr.data.columns import load_columns
from dynsr.errors import DynsrWarning, InputError

NAN = float("nan")


def read(*cells, **options):
    """Read one column of text."""
    return read_columns([np.array(cells, dtype=object)], **options)[0]


def table(folder, delimiter, **columns):
    """Write columns of text with a time before them, and give the path."""
    rows = zip(*columns.values(), strict=True)
    lines = [
        delimiter.join(["t", *columns]),
        *(f"{j}{delimiter}{delimiter.join(r)}" for j, r in enumerate(rows)),
    ]
    (folder / "cells.txt").write_text("\n".join(lines))
    return folder / "cells.txt"


MISSING = "n.d.|n.a.|NA|N/A|n/a|NaN|nan|NULL|None|.|..|-|--|\u2013|?|*|BDL|<LOD|#N/A|#DIV/0!|#NV|| "


@pytest.mark.parametrize("mark", MISSING.split("|"))
def test_marks_of_a_missing_value_are_one(mark):
    """In a column of numbers, whatever the others look like, with a point or a comma."""
    for numbers, wanted in ((("4.25", "1e-3"), (4.25, 1e-3)), (("4,25", "-0,5"), (4.25, -0.5))):
        reading = read(numbers[0], mark, numbers[1])
        np.testing.assert_array_equal(reading.values, [wanted[0], NAN, wanted[1]])
        assert not reading.notes and not reading.fault


@pytest.mark.parametrize(
    ("cells", "wanted"),
    [
        (("1.5x10^5", "2 x 10^-3", "7"), (1.5e5, 2e-3, 7)),
        (("1,5\u00b710^5", "2,0*10**6", "7,5"), (1.5e5, 2e6, 7.5)),
        (("1.5 \u00d7 10\u2075", "2 \u00d7 10\u207b\u00b9\u00b2", "7.25"), (1.5e5, 2e-12, 7.25)),
        (("3 \u00d7 10\u2074 cells/mL", "2 \u00d7 10\u2074 cells/mL"), (3e4, 2e4)),
        (("1.5-", "2.25", "1,204.5-"), (-1.5, 2.25, -1204.5)),
        (("*******", "2.25", "3.5"), (NAN, 2.25, 3.5)),
        (("0.1234-101", "-1.500+103", "3.5"), (0.1234e-101, -1.5e103, 3.5)),
    ],
)
def test_powers_signs_and_stars_as_people_and_programs_write_them(cells, wanted):
    """A power of ten, a sign behind its number, and the stars of a number that was too wide."""
    reading = read(*cells)
    np.testing.assert_allclose(reading.values, wanted, rtol=1e-15)
    assert not reading.fault


def test_too_numerous_to_count_is_above_a_limit():
    """A plate of colonies that no one counts has more than the limit that is said."""
    cells = np.array([*map(str, range(10, 100, 10)), "TNTC"], dtype=object)
    found = read_trajectories({"t": np.arange(10.0), "CFU": cells}, limits={"CFU": ">100"})
    assert found.trajectories[0].limits["CFU"].above[-1] == 100


def test_marks_in_a_column_of_labels_are_labels():
    """A treatment may be called none, and a strain NA."""
    assert read("none", "KCl", "none", "NA").values.tolist() == ["none", "KCl", "none", "NA"]


@pytest.mark.parametrize(
    "cell", ["<0.5", "< 0.5", "> 80", ">=80", "\u2264 0.5", "<0.5 mg/L", "<0,5"]
)
def test_a_value_beyond_a_limit_is_missing_and_told(cell):
    """How many cells, and the limit, are told; the limit is kept with its side."""
    others = ("3,5", "4,25") if "," in cell else ("3.5", "4.25")
    reading = read(others[0], cell, others[1], cell)
    np.testing.assert_array_equal(reading.values, [3.5, NAN, 4.25, NAN])
    said = f"2 cells are beyond a limit ({cell}), which counts in place of a value"
    assert reading.notes == (said,)
    limit = 0.5 if "5" in cell else 80.0
    sides = (reading.limits.below, reading.limits.above)
    low, high = sides if limit == 0.5 else sides[::-1]
    np.testing.assert_array_equal(low, [NAN, limit, NAN, limit])
    assert np.isnan(high).all()


def test_a_column_beyond_its_limit_throughout_is_left_out():
    """And one of ranges is text."""
    assert read("<2", "<2", "n.d.").left_out == "is beyond a limit in every row (<2)"
    assert read("<5", "5-10", ">10").values.tolist() == ["<5", "5-10", ">10"]


UNITS = [
    (("38 %", "38.5 %", "40 %"), (38, 38.5, 40), "%"),
    (("38%", "38.5%"), (38, 38.5), "%"),
    (("7 C", "9 C"), (7, 9), "C"),
    (("7.5C", "9.0C"), (7.5, 9), "C"),
    (("1.5 mmol/L", "n.d.", "2 mmol/L"), (1.5, NAN, 2), "mmol/L"),
    (("1,5 m s^-1", "2,25 m s^-1"), (1.5, 2.25), "m s^-1"),
    (("0 h", "2 h", "4 h"), (0, 2, 4), "h"),
    (("$4.50", "$1,200.00"), (4.5, 1200), "$"),
    (("3 [bar]", "4 [bar]"), (3, 4), "bar"),
    (("12 \u00b0C", "13.5"), (12, 13.5), "\u00b0C"),
    (("4 strokes", "9 strokes"), (4, 9), "strokes"),
]


@pytest.mark.parametrize(("cells", "wanted", "unit"), UNITS)
def test_numbers_with_a_unit_are_numbers_and_the_unit_is_kept(cells, wanted, unit):
    """40 % stays 40."""
    reading = read(*cells)
    np.testing.assert_array_equal(reading.values, wanted)
    assert reading.unit == unit


@pytest.mark.parametrize(
    "cells",
    [
        ("1a", "2a"),
        ("1A", "2A", "1A"),
        ("5 Jan", "6 Jan"),
        ("2:05 PM", "2:06 PM"),
        ("12.03.2024", "13.03.2024"),
        ("A1", "B2"),
        ("3-4", "5-6"),
        ("1.2.3", "1.2.4"),
    ],
)
def test_names_dates_and_clocks_are_no_numbers(cells):
    """They stay as they stand."""
    assert read(*cells).values.tolist() == list(cells)


def test_two_units_in_a_column_stop_who_needs_it(tmp_path):
    """5 ms and 2 s are no one column of numbers."""
    path = table(tmp_path, ",", x=["5 ms", "2 s"] * 6, y=[str(j * j) for j in range(12)])
    assert read_trajectories(path, states=["y"]).trajectories[0].states == ("y",)
    with pytest.raises(
        InputError, match=r"'x' of cells.txt holds numbers in 'ms' and in 's'; give it one unit"
    ):
        read_trajectories(path)


THOUSANDS = [
    (("5.000,00", "619,35"), (5000, 619.35)),
    (("1,234,567", "12"), (1234567, 12)),
    (("5,000.00", "619.35"), (5000, 619.35)),
    (("5 000,00", "12 619,35"), (5000, 12619.35)),
    (("5\u00a0000,5", "1"), (5000.5, 1)),
    (("5'000", "619", "12'345.5"), (5000, 619, 12345.5)),
    (("1.234.567", "0,5"), (1234567, 0.5)),
    (("0,125", "1,633"), (0.125, 1.633)),
    (("1633,500", "2,125"), (1633.5, 2.125)),
    (("1.633", "867", "12.25"), (1.633, 867, 12.25)),
    (("1,633e2", "5,1e3"), (163.3, 5100)),
    (("1.5D-03", "2.0d+1"), (1.5e-3, 20)),
    (("\u22121,5", "+2,25"), (-1.5, 2.25)),
]


@pytest.mark.parametrize(("cells", "wanted"), THOUSANDS)
def test_marks_of_decimals_and_thousands_are_told_by_the_cells_that_show_them(cells, wanted):
    """One cell that can only be read in one way decides for its column."""
    reading = read(*cells)
    np.testing.assert_array_equal(reading.values, wanted)
    assert not reading.notes and not reading.fault


@pytest.mark.parametrize("delimiter", ["\t", ";"])
def test_threes_of_digits_beside_whole_numbers_are_thousands(tmp_path, delimiter):
    """1,204 beside 953 and 87 is never 1.204; what was decided is told."""
    counts = ["1,633", "1,204", "953", "867", "433", "100", "87", "60", "41", "25", "12", "7"]
    columns = load_columns(table(tmp_path, delimiter, cells=counts))
    np.testing.assert_array_equal(columns.values[1], [float(c.replace(",", "")) for c in counts])
    assert columns.notes == (
        "column 'cells' of cells.txt: '1,633' was read as 1633; --decimal says the mark",
    )


def test_other_columns_tell_the_mark_too(tmp_path):
    """Where one column shows a decimal comma, another's is one, and a point parts thousands."""
    shown = ["0,5", "1,5", "2,25"]
    path = table(tmp_path, ";", a=shown, b=["1,633", "2,867", "3,125"], c=["1.633", "867", "2.450"])
    columns = load_columns(path)
    assert columns.values[2].tolist() == [1.633, 2.867, 3.125]
    assert columns.values[3].tolist() == [1633.0, 867.0, 2450.0]
    # Nothing was guessed, so that no run repeats it.
    assert not columns.notes


UNDECIDED = {
    "threes throughout": ["1,633", "2,450", "3,125"] * 4,
    "both marks": ["1,5", "2.5", "3,5"] * 4,
}


@pytest.mark.parametrize("case", UNDECIDED)
def test_what_nothing_decides_is_refused_only_where_it_is_needed(tmp_path, case):
    """One line names the column, the value and the remedy; other columns are read."""
    path = table(tmp_path, "\t", x=UNDECIDED[case], y=[str(j * j) for j in range(12)])
    assert read_trajectories(path, states=["y"]).trajectories[0].states == ("y",)
    with pytest.raises(InputError, match=r"'x' of cells.txt holds .*'1,.*--decimal"):
        read_trajectories(path)


def test_the_user_may_say_the_decimal_mark(tmp_path):
    """Then it is that one; anything else is refused."""
    path = table(tmp_path, "\t", x=UNDECIDED["threes throughout"])
    assert load_columns(path, decimal=",").values[1][0] == 1.633
    assert load_columns(path, decimal=".").values[1][0] == 1633
    with pytest.raises(InputError, match=r"decimal ';' must be '.' or ','"):
        load_columns(path, decimal=";")


SWITCHES = [
    ("ON", "OFF"),
    ("on", "Off"),
    ("yes", "no"),
    ("TRUE", "FALSE"),
    ("True", "False"),
    ("true", "false"),
    ("open", "closed"),
    ("Yes", "NO"),
    ("ein", "aus"),
    ("Ja", "Nein"),
    ("enabled", "disabled"),
]


@pytest.mark.parametrize(("high", "low"), SWITCHES)
def test_words_of_a_switch_are_one_and_zero_and_it_is_told(tmp_path, high, low):
    """From a file as from frames; an empty cell is missing."""
    cells = [high, low, low, high, "", high]
    path = table(tmp_path, ",", valve=cells, x=[str(j) for j in range(6)])
    arrays = {"x": np.arange(6.0), "valve": np.array(cells)}
    for source in (path, pd.DataFrame(arrays), pl.DataFrame(arrays), arrays):
        columns = load_columns(source)
        place = columns.names.index("valve")
        np.testing.assert_array_equal(columns.values[place], [1, 0, 0, 1, NAN, 1])
        assert len(columns.notes) == 1 and "1" in columns.notes[0]


def test_a_switch_is_a_column_of_numbers(tmp_path):
    """It is an input or a state, no label and no text that is refused."""
    path = table(tmp_path, ",", x=[f"{j * j}" for j in range(12)], pump=["on", "off", "off"] * 4)
    with pytest.warns(DynsrWarning, match="'off' as 0 and 'on' as 1"):
        (run,) = read_trajectories(path, inputs=["pump"]).trajectories
    assert run.inputs[:4, 0].tolist() == [1, 0, 0, 1]


def test_units_and_numbers_of_one_cell():
    """Units that are known, powers and compounds; words are none."""
    known = [
        "mg/L",
        "1/s",
        "W/m^2",
        "m s\u207b\u00b9",
        "degC",
        "\u00b0F",
        "\u00b5M",
        "kWh",
        "cells/mL",
        "rpm",
        "mmHg",
    ]
    assert all(map(is_unit, known))
    assert not any(map(is_unit, ["biomass", "tank A", "x", "t2", "a", "control"]))
    assert parse_number("1.2.3") is None and parse_number("0x12") is None
    assert parse_number("1_000") is None and parse_number("12 34") is None


def test_frames_whose_columns_share_a_name_or_have_levels():
    """A second column of a name is renamed; levels are joined; an arrow table is refused."""
    rows = [[0.0, 1.0, 2.0], [1.0, 3.0, 5.0]]
    assert load_columns(pd.DataFrame(rows, columns=["t", "x", "x"])).names == ("t", "x", "x_2")
    levels = pd.MultiIndex.from_tuples([("t", ""), ("x", "a"), ("x", "b")])
    assert load_columns(pd.DataFrame(rows, columns=levels)).names == ("t", "x_a", "x_b")
    same = pd.DataFrame([[0.0, 1.0, 1.0], [1.0, 3.0, 3.0]], columns=["t", "x", "x"])
    assert load_columns(same).left_out == {"column 3": "repeats column 'x'"}


@pytest.mark.parametrize(
    "source",
    [
        np.empty((5, 0)),
        np.empty((0, 3)),
        np.array(3.0),
        pd.DataFrame(index=range(3)),
        pl.DataFrame({"t": [1.0]}).lazy().select(pl.col("none")),
        pl.DataFrame(),
        {},
        {"t": [], "x": []},
        (np.arange(3), np.empty((3, 0))),
    ],
    ids=lambda source: f"{type(source).__name__}-{getattr(source, 'shape', ())}",
)
def test_what_holds_no_columns_is_one_line(source):
    """No error of NumPy, pandas or narwhals comes through."""
    with pytest.raises(InputError) as caught:
        read_trajectories(source)
    assert "\n" not in str(caught.value)


def test_digits_that_float64_would_round_stop_only_who_needs_them(tmp_path):
    """An identity of nineteen digits is no number; the others are read."""
    ids = [str(2**60 + j % 2) for j in range(12)]
    path = table(tmp_path, ",", device=ids, x=[str(j * j) for j in range(12)])
    assert read_trajectories(path, states=["x"]).trajectories[0].states == ("x",)
    with pytest.raises(
        InputError, match=r"'device' of cells.txt holds whole numbers of more than 16"
    ):
        read_trajectories(path, states=["device"])


@pytest.mark.parametrize(
    ("on", "off"), [("AUF", "ZU"), ("ja", "nein"), ("an", "aus"), ("ouvert", "fermé"), ("Sí", "No")]
)
def test_a_switch_is_one_in_other_languages(on, off):
    """German, French and Spanish words of a switch are 1 and 0; two other words stay text."""
    cells = np.array([on, off, on, "", off], dtype=object)
    np.testing.assert_array_equal(read_columns([cells])[0].values, [1, 0, 1, np.nan, 0])
    other = np.array([on, "rot", on, off], dtype=object)
    assert read_columns([other])[0].values.dtype.kind == "O"


def test_semicolons_between_cells_say_that_a_comma_is_the_decimal_mark():
    """Three decimals behind a comma are no thousands where semicolons stand between the cells."""
    cells = np.array(["41,000", "37,193", "33,749"], dtype=object)
    values = read_columns([cells], delimiter=";")[0].values
    np.testing.assert_allclose(values, [41, 37.193, 33.749])
    assert "--decimal" in read_columns([cells], delimiter="\t")[0].fault


def test_a_decimal_comma_of_one_column_is_that_of_quoted_cells_too():
    """Commas between quoted cells set no thousands apart where another column shows decimals."""
    time, cells = (np.array(c, dtype=object) for c in (["0,0", "0,5"], ["41,000", "37,193"]))
    np.testing.assert_allclose(read_columns([time, cells], delimiter=",")[1].values, [41, 37.193])
    np.testing.assert_allclose(read_columns([cells], delimiter=",")[0].values, [41000, 37193])


def test_a_number_in_brackets_is_an_error_where_it_has_decimals(tmp_path):
    """1.2 (0.1) has its error; 1.2 (3) may be a count, and is never a number with the unit 3."""
    rows = {"y": [f"{2.0**-k:.3f}" for k in range(12)]}
    columns = load_columns(table(tmp_path, ";", **rows, x=[f"{k}.5 (0.2)" for k in range(12)]))
    x, errors = (columns.values[columns.names.index(name)] for name in ("x", "x_sd"))
    assert x.tolist() == [k + 0.5 for k in range(12)] and set(errors) == {0.2}
    odd = read_trajectories(table(tmp_path, ";", **rows, x=[f"{k}.5 (3)" for k in range(12)]))
    assert odd.trajectories[0].states == ("y",) and odd.left_out == {"x": "holds text"}


@pytest.mark.parametrize("form", ['="{}"', "'{}"])
def test_numbers_that_were_kept_as_text_are_numbers(tmp_path, form):
    """Spreadsheets are made to do so by an equals sign with quotation marks, or an apostrophe."""
    path = table(tmp_path, ";", x=[form.format(k * k / 4) for k in range(12)])
    assert read_trajectories(path).trajectories[0].x[:, 0].tolist() == [
        k * k / 4 for k in range(12)
    ]


def test_a_table_of_text_says_why_no_column_is_a_state(tmp_path):
    """One cell of the text is shown."""
    path = table(tmp_path, ";", x=[f"10^{k}" for k in range(12)])
    with pytest.raises(
        InputError, match=r"left for a state .*since 'x' holds text such as '10\^0'"
    ):
        read_trajectories(path)


@pytest.mark.parametrize("sign", [" ± ", "±", " +/- "])
def test_an_error_behind_a_value_gets_a_column_of_its_own(tmp_path, sign):
    """A cell 1.2 ± 0.1 is 1.2, with 0.1 in a column beside it; a lone sign in text does nothing."""
    cells = [f"{k + 1.5}{sign}{k / 8 + 0.25}" for k in range(11)] + ["n.d."]
    columns = load_columns(table(tmp_path, ";", **{"x [g]": cells, "what": ["a"] * 11 + ["± b"]}))
    assert columns.names == ("t", "x [g]", "x_sd", "what")
    np.testing.assert_array_equal(columns.values[1], [*np.arange(1.5, 12), np.nan])
    np.testing.assert_array_equal(columns.values[2], [*np.arange(11) / 8 + 0.25, np.nan])


def test_the_shell_and_discover_take_the_decimal_mark(tmp_path):
    """What is refused names the option, and the option settles it."""
    path = table(tmp_path, "\t", x=[f"{j * j + 1},{j:03d}" for j in range(12)])
    for words in (["describe", path], ["discover", path]):
        assert "say the decimal mark (--decimal)" in run(*words, code=2).output
    told = run("describe", path, "--decimal", ",", "--json")
    assert json.loads(told.stdout)["states"] == ["x"]
    runs, _ = take_trajectories(path, decimal=",")
    assert runs[0].x[1, 0] == 2.001
    assert read_trajectories([path], decimal=".").trajectories[0].x[1, 0] == 2001
