import warnings

import numpy as np
import pandas
import polars
import pyarrow
import pytest

from dynsr.data.columns import load_columns
from dynsr.data.reading import read_trajectories, take_trajectories, write_csv
from dynsr.data.trajectory import Trajectory
from dynsr.errors import DynsrWarning, InputError

T = np.linspace(0.0, 2.0, 21)
X = np.column_stack([np.sin(3 * T), np.cos(T)])


def table_text(header="t,x,y", delimiter=",", rows=None):
    """Write rows as delimited text below a header."""
    rows = np.column_stack([T, X]) if rows is None else rows
    lines = [delimiter.join(str(cell) for cell in row) for row in rows]
    return "\n".join([header.replace(",", delimiter), *lines]) + "\n"


def put(folder, text, name="data.csv"):
    """Write a file and give its path."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_delimiters(tmp_path, delimiter):
    """A table is read to the last bit whatever sign delimits its cells."""
    table = read_trajectories(put(tmp_path, table_text(delimiter=delimiter)))
    (part,) = table.trajectories
    assert part.states == ("x", "y")
    assert np.array_equal(part.t, T) and np.array_equal(part.x, X)


@pytest.mark.parametrize("delimiter", [";", "\t", "|", " "])
@pytest.mark.parametrize("header", ["t,x,y", ""])
def test_decimal_comma(tmp_path, delimiter, header):
    """A table in the European manner, 1,5;2,5, gives the same numbers, with a header or without."""
    text = "\n".join(delimiter.join(map(str, row)) for row in np.column_stack([T, X]))
    text = f"{header.replace(',', delimiter)}\n{text.replace('.', ',')}\n"
    (part,) = read_trajectories(put(tmp_path, text)).trajectories
    assert np.array_equal(part.t, T) and np.array_equal(part.x, X)


def test_a_comment_above_the_rows_names_the_columns(tmp_path):
    """The last comment is the header when it has as many cells; other comments are skipped."""
    rows = table_text(header="").strip()
    named = put(tmp_path, f"# rig 3, May; by A\n# t,a,b\n{rows}\n")
    assert read_trajectories(named).trajectories[0].states == ("a", "b")
    unnamed = put(tmp_path, f"# t,a,b\n# rig 3, new\n{rows}\n")
    assert read_trajectories(unnamed).trajectories[0].states == ("x1", "x2")


def test_delimiters_at_the_end_of_rows(tmp_path):
    """A nameless column without values, which such a delimiter makes, is left out."""
    text = table_text().replace("\n", ",\n")
    assert read_trajectories(put(tmp_path, text)).trajectories[0].states == ("x", "y")


@pytest.mark.parametrize("row", ["2.0,1.0", "2.0,1.0,2.0,4.0"])
def test_a_header_that_does_not_fit_is_refused(tmp_path, row):
    """A header of more or fewer names than the rows have cells is refused with both counts."""
    said = f"names 3 columns but row 1 has {row.count(',') + 1} cells"
    with pytest.raises(InputError, match=said):
        read_trajectories(put(tmp_path, "t,x,y\n" + 20 * f"{row}\n"))


def sources(folder):
    """Make the same table in every form that can be read."""
    columns = {"t": T, "x": X[:, 0], "y": X[:, 1]}
    pandas.DataFrame(columns).to_parquet(folder / "data.parquet")
    np.savez(folder / "data.npz", **columns)
    np.savez(folder / "matrix.npz", t=T, x=X, states=np.array(["x", "y"]))
    np.save(folder / "data.npy", np.column_stack([T, X]))
    return {
        "csv": put(folder, table_text()),
        "text path": str(put(folder, table_text())),
        "parquet": folder / "data.parquet",
        "npz": folder / "data.npz",
        "npz with names": folder / "matrix.npz",
        "npy": folder / "data.npy",
        "pandas": pandas.DataFrame(columns),
        "pandas with the time as index": pandas.DataFrame(columns).set_index("t"),
        "pandas with two levels of index": pandas.DataFrame({"run": "a", **columns}).set_index(
            ["run", "t"]
        ),
        "pandas with missing values": pandas.DataFrame(columns).astype("Float64"),
        "polars": polars.DataFrame(columns),
        "pyarrow": pyarrow.table(columns),
        "mapping": columns,
        "pair": (T, X),
        "array": np.column_stack([T, X]),
        "trajectory": Trajectory(T, X, ("x", "y")),
    }


def test_every_source_gives_the_same(tmp_path):
    """Files, frames, arrays and mappings of the same numbers give the same trajectory."""
    for kind, source in sources(tmp_path).items():
        (part,) = read_trajectories(source, states=["x", "y"]).trajectories
        assert part.states == ("x", "y"), kind
        assert np.array_equal(part.t, T) and np.array_equal(part.x, X), kind


def test_times_apart():
    """An array of states alone takes its times as an argument."""
    (part,) = read_trajectories(X, time=T, states="a, b").trajectories
    assert part.states == ("a", "b") and np.array_equal(part.t, T)


def test_named_trajectories():
    """A column that names the trajectory splits the rows, in their order of appearance."""
    frame = pandas.DataFrame(
        {"run": ["b"] * 21 + ["a"] * 21, "time": [*T, *(T**2 + T)], "x": [*X[:, 0], *X[:, 1]]}
    )
    table = read_trajectories(frame)
    first, second = table.trajectories
    assert np.array_equal(first.x[:, 0], X[:, 0]) and np.array_equal(second.t, T**2 + T)
    assert "2 trajectories named by 'run'" in table.guess
    assert "uneven steps" in table.guess


def test_restarting_time():
    """A time that starts again begins a new trajectory, and the guess says so."""
    table = read_trajectories({"t": [*T, *T], "x": [*X[:, 0], *X[:, 1]]})
    assert [len(part) for part in table.trajectories] == [21, 21]
    assert "2 trajectories, each starting the time again" in table.guess


def test_list_of_sources(tmp_path):
    """A list gives one trajectory a source; those that share a part of their states are refused."""
    table = read_trajectories([put(tmp_path, table_text()), {"t": T, "x": T**3, "y": T**2}])
    assert len(table.trajectories) == 2
    with pytest.raises(InputError, match="different columns"):
        read_trajectories([{"t": T, "x": T}, {"t": T, "x": T, "y": T**2}])


def test_rows_as_json_has_them_are_a_table():
    """A list of mappings of cells is one table; cells may be missing."""
    rows = [{"t": a, "x": b, "run": "a"} for a, b in zip(T.tolist(), (T**2).tolist(), strict=True)]
    del rows[3]["x"]
    (run,) = read_trajectories(rows).trajectories
    assert run.states == ("x",) and len(run) == len(T) - 1
    assert [run.states for run in take_trajectories(rows)[0]] == [("x",)]


def test_files_may_have_their_columns_in_any_order(tmp_path):
    """Each file is read by its names; Trajectory values too."""
    one = pandas.DataFrame({"t": T, "u": np.sign(T - 0.5), "x": T**2, "y": T**3})
    for order in (["y", "x", "t", "u"], ["t", "x", "u", "y"]):
        runs = read_trajectories([one, (one + 1)[order]], inputs=["u"]).trajectories
        assert [run.names for run in runs] == [("x", "y", "u")] * 2
        np.testing.assert_array_equal(runs[1].x, runs[0].x + 1)
        np.testing.assert_array_equal(runs[1].inputs, runs[0].inputs + 1)
    other = runs[0].of_states(["y", "x"])
    assert [run.states for run in take_trajectories([runs[0], other])[0]] == [("x", "y")] * 2


def test_what_is_constant_in_one_file_and_not_in_all_is_kept():
    """A setting of each file is a parameter; an input or a state that rests in one is one there."""
    one = {"t": T, "x": X[:, 0], "D": 0 * T + 0.05, "run": 0 * T + 1, "room": 0 * T + 20}
    two = {**one, "x": X[:, 1], "D": 0 * T + 0.1, "run": 0 * T + 2}
    table = read_trajectories([one, two])
    assert table.description.parameters == ("D",) and list(table.left_out) == ["room"]
    assert [run.inputs[0].tolist() for run in table.trajectories] == [[0.05], [0.1]]
    steps = np.where(np.median(T) > T, 0.0, 2.0)
    one |= {"pump": 0 * T, "z": T**2}
    runs = read_trajectories([one, {**two, "pump": steps, "z": 0 * T}]).trajectories
    assert [run.names for run in runs] == [("x", "z", "D", "pump")] * 2
    assert np.all(runs[0].by_name["pump"] == 0) and np.all(runs[1].by_name["z"] == 0)


def test_inputs_by_name_column_and_formula():
    """Inputs are a guess from the name, named columns, or expressions in t."""
    columns = {"t": T, "x": X[:, 0], "F": X[:, 1]}
    table = read_trajectories(columns)
    assert table.trajectories[0].input_names == ("F",)
    said = "'F' is called as an input, so taken for one; --states says otherwise."
    assert said in table.notes and said not in read_trajectories(columns, inputs=["F"]).notes
    (part,) = read_trajectories(columns, inputs=["F", "G=2*sin(t)"]).trajectories
    assert part.input_names == ("F", "G")
    assert np.allclose(part.inputs[:, 1], 2 * np.sin(T), rtol=1e-15)
    (part,) = read_trajectories(columns, inputs={"F": "t^2"}, states=["x"]).trajectories
    assert np.array_equal(part.inputs[:, 0], T**2)
    assert read_trajectories(columns, inputs=[]).trajectories[0].states == ("x", "F")
    # FitzHugh-Nagumo's states are called u and v.
    assert read_trajectories({"t": T, "u": T**3, "v": T**2}).trajectories[0].states == ("u", "v")


def test_dates_become_seconds():
    """A time column of dates counts in seconds from the first."""
    stamps = [f"2024-01-01T00:00:{second:02d}Z" for second in range(20)]
    (part,) = read_trajectories({"date": np.array(stamps), "x": np.arange(20.0) ** 2}).trajectories
    assert np.array_equal(part.t, np.arange(20.0))


def test_round_trip(tmp_path):
    """What write_csv writes is read back to the last bit: one or many, with inputs."""
    first = Trajectory(T, X, ("x", "y"), T[:, None] ** 2, ("F",))
    second = Trajectory(T[:11], X[5:16], ("x", "y"), X[:11, :1], ("F",))
    for parts in ([first], [first, second]):
        write_csv(parts, tmp_path / "out.csv", force=True)
        back = read_trajectories(tmp_path / "out.csv").trajectories
        assert len(back) == len(parts)
        for ours, theirs in zip(parts, back, strict=True):
            assert theirs.states == ("x", "y") and theirs.input_names == ("F",)
            assert np.array_equal(ours.t, theirs.t)
            assert np.array_equal(ours.columns, theirs.columns)


def bent(row, column, value):
    """Write the table with one cell replaced."""
    rows = np.column_stack([T, X]).astype(object)
    rows[row, column] = value
    return table_text(rows=rows)


REFUSED = {
    "empty file": ("", "is empty"),
    "blank lines": ("\n\n\n", "has no rows"),
    "header alone": ("t,x,y\n", "header but no rows"),
    "three rows": ("t,x\n0,1\n1,2\n2,4\n", "3 rows"),
    "one row": ("t,x\n0,1\n", "1 row,"),
    "unknown delimiter": (table_text(delimiter="!"), "cannot separate the columns"),
    "ragged rows": (table_text() + "3,1,2,4\n", "one cell a column"),
    "duplicate time": (bent(5, 0, T[4]), "time 't' repeats in row 6 of data.csv (0.4 twice)"),
    "unsorted time": (bent(5, 0, 0.1), "runs backwards at row 6 of data.csv (0.4 then 0.1)"),
    "few values": (
        table_text(rows=np.column_stack([T, np.where(T > 0.65, np.nan, T**3), T**2])),
        "'x' has 7 values in the 21 rows of data.csv; at least 8 are needed: give more of them",
    ),
    "infinite value": (bent(7, 2, "inf"), "'y' of data.csv holds inf in row 8"),
    "text cell": (bent(7, 1, "broken"), "'x' of data.csv has the text 'broken' in row 8"),
    "dangerous cell": (bent(7, 1, "__import__('os')"), "has the text"),
    "constant columns": (
        table_text(rows=np.column_stack([T, 0 * T + 2, 0 * T + 3])),
        "'x' of data.csv is 2 in every row",
    ),
    "no time": (
        table_text(header="a,x,y", rows=np.column_stack([X[:, 0], X])),
        "looks like the time",
    ),
    "time alone": ("t\n" + "\n".join(map(str, range(20))), "no column left for a state"),
    "binary": (bytes(range(256)) * 20, "is binary"),
    "picture": (b"\x89PNG\r\n\x1a\n" + bytes(100), "is a picture"),
    "Excel file": (b"PK\x03\x04" + bytes(100), "Excel"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_tables_are_refused(tmp_path, case):
    """A table that cannot be used is refused in one line that names the value and the remedy."""
    text, said = REFUSED[case]
    with pytest.raises(InputError) as caught:
        read_trajectories(put(tmp_path, text))
    message = str(caught.value)
    assert said in message
    assert "\n" not in message and len(message) < 250


OPTIONS = {
    "missing time": ({"time": "tau"}, "no column 'tau' for the time"),
    "missing state": ({"states": ["z"]}, "no column 'z' for the state"),
    "missing input": ({"inputs": ["z"]}, "no column 'z' for the input"),
    "missing trajectory": ({"trajectory": "run"}, "no column 'run' for the trajectory"),
    "two roles": ({"states": ["x"], "inputs": ["x"]}, "both a state and an input"),
    "time as state": ({"states": ["t"]}, "both a state and the time"),
    "named twice": ({"states": ["x", "x"]}, "named twice"),
    "code as input": ({"inputs": "F=__import__('os').system('true')"}, "cannot read expression"),
    "input in a state": ({"inputs": "F=2*x"}, "unknown name 'x'"),
    "infinite input": ({"inputs": "F=1/t"}, "F = 1/t is inf at t = 0"),
}


@pytest.mark.parametrize("case", OPTIONS)
def test_bad_options_are_refused(tmp_path, case):
    """Options that do not fit the table are refused in one line."""
    options, said = OPTIONS[case]
    with pytest.raises(InputError) as caught:
        read_trajectories(put(tmp_path, table_text()), **options)
    assert said in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("missing.csv", None, "there is no file"),
        ("folder", "folder", "is a directory"),
        ("cut.npz", b"PK\x03\x04", "damaged or not a npz archive"),
        ("cut.parquet", b"PAR1", "damaged or not a Parquet file"),
        ("cut.csv.gz", b"\x1f\x8b", "cannot read"),
    ],
)
def test_bad_paths_are_refused(tmp_path, name, content, said):
    """A missing file, a folder and damaged archives are refused in one line."""
    if content == "folder":
        (tmp_path / name).mkdir()
    elif content is not None:
        put(tmp_path, content, name)
    with pytest.raises(InputError, match=said):
        read_trajectories(tmp_path / name)


def test_pickled_objects_are_not_run(tmp_path):
    """An archive of pickled objects is refused, and nothing in it runs."""

    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    np.savez(tmp_path / "trap.npz", t=T, x=np.array([Trap()] * 21, dtype=object))
    with pytest.raises(InputError, match="could run code"):
        read_trajectories(tmp_path / "trap.npz")
    assert not (tmp_path / "sprung").exists()


WARNED = {
    "identical columns": (
        table_text(rows=np.column_stack([T, T**2, T**2])),
        "'x' and 'y' of data.csv are identical",
        ("x", "y"),
    ),
    "units a billion apart": (
        table_text(rows=np.column_stack([T, T**2, 1e9 * X[:, 0]])),
        "vary by 1 and 7e+08",
        ("x", "y"),
    ),
    "function name": (table_text(header="t,sin,y"), "'sin' -> sin_1", ("sin_1", "y")),
    "no identifier": (table_text(header="t,2nd run,x-y"), "'2nd run' -> x2nd_run", None),
    "code as name": (
        table_text(header="t,__import__('os'),y"),
        "\"__import__('os')\" -> import_os",
        ("import_os", "y"),
    ),
    "keyword": (table_text(header="t,lambda,y"), "'lambda' -> lambda_1", ("lambda_1", "y")),
    "clash after change": (table_text(header="t,x!,x"), "'x!' -> x_2", ("x_2", "x")),
    "same name twice": (
        table_text(header="t,x,x"),
        "'x' is used twice in data.csv; one of them is called 'x_2' here",
        ("x", "x_2"),
    ),
    "Latin-1": (table_text(header="t,é,y").encode("latin-1"), "read as Latin-1", ("é", "y")),
}


@pytest.mark.parametrize("case", WARNED)
def test_odd_tables_are_read_with_a_warning(tmp_path, case):
    """A table that is odd but usable is read, and one warning names what is odd."""
    text, said, states = WARNED[case]
    with pytest.warns(DynsrWarning) as caught:
        (part,) = read_trajectories(put(tmp_path, text)).trajectories
    assert any(said in str(warning.message) for warning in caught)
    assert states is None or part.states == states


def test_units_in_names_go_without_loss():
    """Units in brackets leave the name, which is no news; the time is still found."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = read_trajectories({"time [s]": T, "theta (rad)": X[:, 0], "v [m/s]": X[:, 1]})
    assert table.trajectories[0].states == ("theta", "v")


def test_a_constant_state_that_was_asked_for_is_kept():
    """A constant column that the caller names as a state is kept, with a warning."""
    with pytest.warns(DynsrWarning, match="can only be 0"):
        table = read_trajectories({"t": T, "x": T**2, "c": 0 * T}, states=["x", "c"])
    assert table.trajectories[0].states == ("x", "c")


@pytest.mark.slow
def test_a_million_rows_are_thinned():
    """A million rows are thinned evenly to the bound, with a warning that says how."""
    t = np.linspace(0.0, 1e3, 1_000_000)
    with pytest.warns(DynsrWarning, match="1000000 rows; every 5th was kept"):
        (part,) = read_trajectories((t, np.sin(t)), max_rows=200_000).trajectories
    assert len(part) == 200_000
    assert np.array_equal(part.t, t[::5])


def test_row_numbers_are_left_out(tmp_path):
    """The nameless row numbers that pandas writes are not taken for a state."""
    pandas.DataFrame({"t": T, "x": X[:, 0]}).to_csv(tmp_path / "data.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = read_trajectories(tmp_path / "data.csv")
    assert table.trajectories[0].states == ("x",)


@pytest.mark.parametrize("value", [3, None, object()])
def test_things_that_are_no_data(value):
    """What is no table at all is refused by the name of its type."""
    with pytest.raises(InputError, match=f"from a {type(value).__name__}"):
        read_trajectories(value)


def test_a_table_says_the_role_of_each_column():
    """Roles stand beside the sentence, by the names of the source; columns read once are reused."""
    t = np.arange(12.0)
    source = {"t": t, "well": np.repeat("a", 12), "x": t**2, "u": t % 2, "note": np.repeat("b", 12)}
    columns = load_columns(source)
    table = read_trajectories(columns, inputs=["u"], trajectory="well")
    assert (table.roles.time, table.roles.states) == ("t", ("x",))
    assert (table.roles.inputs, table.roles.trajectory) == (("u",), ("well",))
    few = columns.only(["u", "t"])
    assert few.names == ("t", "u")
    assert read_trajectories(few).trajectories[0].states == ("u",)
    assert load_columns(few) is few
    with pytest.raises(InputError, match="has no columns"):
        columns.only(["z"])
