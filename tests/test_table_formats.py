"""Files that are no text, datasets of xarray, and sizes that are looked at before they are read."""

import bz2
import datetime
import gzip
import json
import lzma
import sys
import zipfile

import h5py
import numpy as np
import openpyxl
import pandas as pd
import pytest
import scipy.io
import xarray as xr
from scipy.integrate import solve_ivp

from dynsr.data import assembling, describe, read_trajectories, text
from dynsr.data.columns import load_columns, read_names_only
from dynsr.errors import DynsrWarning, InputError, MissingExtra

T = np.arange(16) * 0.5
A, B = np.exp(-T), np.cos(T)
X = np.column_stack([A, B])


def check(columns, names=("t", "a", "b")):
    """See that a table holds these numbers."""
    assert columns.names == names
    for found, wanted in zip(columns.values, (T, A, B), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-15)


def write_book(path, **sheets):
    """Write rows as the sheets of a workbook."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    book.save(path)
    return path


TABLE = [("t", "a", "b"), *zip(T.tolist(), A.tolist(), B.tolist(), strict=True)]


def test_a_sheet_of_a_workbook_is_read(tmp_path):
    """Plain, below other lines with units and a summary, and away from the corner."""
    check(load_columns(write_book(tmp_path / "a.xlsx", Sheet=TABLE)))
    assert read_names_only(tmp_path / "a.xlsx") == ("t", "a", "b")
    rows = [("Logger 5",), (), TABLE[0], ("h", "mg/L", "%"), *TABLE[1:], (), ("Mean", 3, 4)]
    columns = load_columns(write_book(tmp_path / "b.xlsx", Notes=[("made", "by NN")], Data=rows))
    check(columns)
    assert describe(tmp_path / "b.xlsx").source == "b.xlsx:Data"
    assert columns.units == {"t": "h", "a": "mg/L", "b": "%"}
    assert "sheet 'Data'" not in str(columns.left_out)
    aside = [(), *((None, None, *row) for row in TABLE)]
    check(load_columns(write_book(tmp_path / "c.xlsx", Sheet=aside)))


def test_of_several_sheets_the_first_with_a_table_is_read_and_told(tmp_path):
    """The others are named."""
    sheets = {"About": [("by", "NN"), ("in", 2024)], "First": TABLE, "Second": TABLE[:12]}
    columns = load_columns(write_book(tmp_path / "d.xlsx", **sheets))
    check(columns)
    assert any("sheet 'First' of d.xlsx was read, not" in note for note in columns.notes)


def test_a_sheet_is_chosen_behind_a_colon(tmp_path):
    """book.xlsx:Name is one sheet; the sheets of a book are runs where each is given."""
    path = tmp_path / "book.xlsx"
    t = np.arange(0.0, 12.0)
    with pd.ExcelWriter(path) as book:
        for name, start in (("run 1", 1.0), ("run 2", 3.0)):
            frame = pd.DataFrame({"t": t, "x": start * np.exp(-t / 5)})
            frame.to_excel(book, sheet_name=name, index=False)
    assert load_columns(f"{path}:run 2").values[1][0] == 3.0
    both = describe([f"{path}:run 1", f"{path}:run 2"])
    assert [run.name for run in both.trajectories] == ["book.xlsx:run 1", "book.xlsx:run 2"]
    assert any("'book.xlsx:run 2' is read as one more run" in n for n in describe(path).notes)
    with pytest.raises(InputError, match="no sheet 'run 3'; the sheets are: run 1, run 2"):
        describe(f"{path}:run 3")


@pytest.mark.parametrize("form", ["rows", "columns", "lines", "pandas"])
def test_tables_in_json_are_read(tmp_path, form):
    """JSON holds columns by name, or an object for each row or line."""
    frame = pd.DataFrame({"t": np.arange(0.0, 12.0), "x": np.arange(12.0) ** 2})
    path = tmp_path / ("table.jsonl" if form == "lines" else "table.json")
    text = {
        "rows": frame.to_json(orient="records"),
        "columns": frame.to_json(orient="columns"),
        "lines": frame.to_json(orient="records", lines=True),
        "pandas": json.dumps({n: frame[n].tolist() for n in frame}),
    }[form]
    path.write_text(text)
    found = describe(path)
    assert found.states == ("x",) and found.rows == 12


def test_json_of_rows_by_number_of_values_below_columns_and_of_runs_is_read(tmp_path):
    """As pandas writes an index, databases a series, and programs a list of runs."""
    frame, path = pd.DataFrame({"t": T, "a": A, "b": B}), tmp_path / "table.json"
    path.write_text(frame.to_json(orient="index", double_precision=15))
    for found, wanted in zip(load_columns(path).values, (T, A, B), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-12)
    series = {"name": "pond", "columns": ["t", "a", "b"], "values": frame.to_numpy().tolist()}
    path.write_text(json.dumps({"results": [{"statement_id": 0, "series": [series]}]}))
    check(load_columns(path))
    runs = [
        {"dish": name, "t": T.tolist(), "a": (k * A).tolist()} for k, name in ((1, "p"), (2, "q"))
    ]
    path.write_text(json.dumps({"runs": runs}))
    table = read_trajectories(str(path))
    assert table.names == ("p", "q")
    for k, run in enumerate(table.trajectories, 1):
        np.testing.assert_array_equal(run.x[:, 0], k * A)


def test_feather_is_read(tmp_path):
    """As Parquet is; a damaged file is refused as such."""
    path = tmp_path / "table.feather"
    pd.DataFrame({"t": T, "a": A, "b": B}).to_feather(path)
    check(load_columns(path))
    path.write_bytes(b"ARROW1\0\0")
    with pytest.raises(InputError, match="Feather file"):
        load_columns(path)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value"), [("Ts", 0.5), ("dt", 0.5), ("Fs", 2.0)])
def test_a_number_says_the_step_of_rows_without_times(tmp_path, name, value):
    """As engineers keep signals in MATLAB; next to a time it says nothing new."""
    scipy.io.savemat(tmp_path / "signals.mat", {"a": A, "b": B, name: value})
    check(load_columns(tmp_path / "signals.mat"))
    scipy.io.savemat(tmp_path / "signals.mat", {"t": 3 * T, "a": A, "b": B, name: value})
    np.testing.assert_array_equal(load_columns(tmp_path / "signals.mat").values[0], 3 * T)


def test_objects_in_cells_of_json_are_columns_of_their_own(tmp_path):
    """Messages of a sensor have its values in an object."""
    rows = [{"t": t, "sensor": {"x": t**2, "of": {"y": -t}}} for t in range(12)]
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, rows)))
    columns = load_columns(tmp_path / "log.jsonl")
    assert columns.names == ("t", "sensor_x", "sensor_of_y")
    assert columns.values[2].tolist() == [-t for t in range(12)]


ROWS = [{"t": float(t), "x": float(t) ** 2} for t in range(12)]
COLUMNS = {name: [row[name] for row in ROWS] for name in ("t", "x")}


@pytest.mark.parametrize(
    "found",
    [
        {"status": "ok", "results": ROWS},
        {"meta": {"unit": "mM"}, "data": COLUMNS},
        {"unit": "mM", **COLUMNS},
        {"schema": {"fields": [{"name": "t"}, {"name": "x"}]}, "data": ROWS},
        {"columns": ["t", "x"], "index": [0], "data": [[r["t"], r["x"]] for r in ROWS]},
    ],
    ids=["results", "data", "next to texts", "schema", "split"],
)
def test_a_table_may_be_in_an_object_of_json(tmp_path, found):
    """Services and pandas say more than the table, next to it."""
    (tmp_path / "answer.json").write_text(json.dumps(found))
    columns = load_columns(tmp_path / "answer.json")
    assert columns.names == ("t", "x") and columns.values[1].tolist() == COLUMNS["x"]


SERIES = [
    {"metric": {"__name__": n}, "values": [[15 * t, str(t**p)] for t in range(12)]}
    for n, p in (("queue", 2), ("load", 3))
]
GRAPHS = [
    {"target": n, "datapoints": [[t**p, 15 * t] for t in range(12)]}
    for n, p in (("queue", 2), ("load", 3))
]


@pytest.mark.parametrize(
    "found", [{"data": {"result": SERIES}}, GRAPHS], ids=["time first", "last"]
)
def test_pairs_of_times_and_values_in_json_are_rows(tmp_path, found):
    """As databases of monitors answer; which of a pair is the time is that which rises in all."""
    (tmp_path / "answer.json").write_text(json.dumps(found))
    columns = load_columns(tmp_path / "answer.json")
    own = dict(zip(columns.names, columns.values, strict=True))
    assert own["time"].tolist() == [15 * t for t in range(12)] * 2
    assert own["value"].tolist() == [t**p for p in (2, 3) for t in range(12)]
    assert read_trajectories(tmp_path / "answer.json").trajectories[1].x[2].tolist() == [8]


def test_json_of_rows_and_of_a_row_for_each_state_is_read(tmp_path):
    """Lists of numbers have the time first; a solver's states are turned."""
    (tmp_path / "rows.json").write_text(json.dumps(np.column_stack([T, A, B]).tolist()))
    check(load_columns(tmp_path / "rows.json"), ("t", "x1", "x2"))
    (tmp_path / "solved.json").write_text(json.dumps({"t": T.tolist(), "y": X.T.tolist()}))
    check(load_columns(tmp_path / "solved.json"), ("t", "y1", "y2"))


def test_what_solvers_give_is_read_whichever_way_round():
    """SciPy has a row for each state: alone, with its times, and as the whole solution."""
    solution = solve_ivp(lambda _, y: -y, (0.0, T[-1]), [1.0, 2.0], t_eval=T)
    for source in (solution, (solution.t, solution.y), np.vstack([solution.t, solution.y])):
        (run,) = read_trajectories(source).trajectories
        np.testing.assert_array_equal(run.t, T)
        np.testing.assert_array_equal(run.x, solution.y.T)
    check(load_columns({"t": T, "y": X.T}), ("t", "y1", "y2"))
    square = np.array([[0.0, 1.0], [1.0, 3.0]])
    assert load_columns((square[0], square)).values[1].tolist() == [0.0, 1.0]
    with pytest.raises(InputError, match="do not fit"):
        read_trajectories((T, X[:5]))


@pytest.mark.parametrize(
    "found", [{"type": "FeatureCollection", "features": []}, {"a": ROWS, "b": ROWS}]
)
def test_json_of_no_table_or_of_two_is_refused(tmp_path, found):
    """In one line that says what a table is."""
    (tmp_path / "answer.json").write_text(json.dumps(found))
    with pytest.raises(InputError, match="has no table; give columns of equal length"):
        load_columns(tmp_path / "answer.json")


def test_rows_of_objects_in_python_are_read_as_in_json():
    """A list of messages needs no file."""
    rows = [{"t": row["t"], "sensor": {"x": row["x"]}} for row in ROWS]
    assert describe(rows).states == ("sensor_x",)


@pytest.mark.parametrize("pack", [bz2, lzma, gzip])
def test_packed_text_is_read(tmp_path, pack):
    """As the ending of its name says; a damaged one is refused."""
    ending = {bz2: "bz2", lzma: "xz", gzip: "gz"}[pack]
    text = "t,x\n" + "".join(f"{row['t']},{row['x']}\n" for row in ROWS)
    packed = pack.compress(text.encode())
    path = tmp_path / f"data.csv.{ending}"
    path.write_bytes(packed)
    assert load_columns(path).values[1].tolist() == COLUMNS["x"]
    path.write_bytes(packed[: len(packed) // 2])
    with pytest.raises(InputError):
        load_columns(path)


def test_an_address_is_no_file():
    """A path would lose one of its strokes."""
    with pytest.raises(InputError, match="an address of the web is no file; download it"):
        load_columns("https://example.org/data.csv")


@pytest.mark.parametrize("name", ["runs.yaml", "page.html", "paper.pdf"])
def test_a_document_is_no_table(tmp_path, name):
    """Its numbers stand among other things: the remedy is said, and none of them is read."""
    (tmp_path / name).write_text("t: [0.0, 0.1]\nx: [1.0, 2.0]\n" * 9)
    with pytest.raises(InputError, match=f"'{name}' is no table; save its rows as CSV"):
        describe(tmp_path / name)


def test_json_without_a_table_and_stata_files(tmp_path):
    """What is no table is refused in one line; a file of Stata is read."""
    path = tmp_path / "list.json"
    path.write_text("[1, 2, 3]")
    with pytest.raises(InputError, match="has no table"):
        describe(path)
    frame = pd.DataFrame({"t": np.arange(0.0, 12.0), "x": np.arange(12.0) ** 2})
    frame.to_stata(tmp_path / "table.dta", write_index=False)
    assert describe(tmp_path / "table.dta").states == ("x",)


def test_cells_of_a_workbook_have_their_kinds(tmp_path):
    """Dates, clocks, switches, and text among numbers."""
    start = datetime.datetime(2024, 3, 1, 7, 0)  # noqa: DTZ001
    rows = [
        (start + datetime.timedelta(minutes=j), j % 2 == 0, "n.d." if j == 3 else j * 1.5, f"{j},5")
        for j in range(12)
    ]
    columns = load_columns(write_book(tmp_path / "e.xlsx", S=[("when", "on", "x", "y"), *rows]))
    assert columns.values[0].dtype.kind == "M"
    assert columns.values[1].tolist()[:2] == [1, 0]
    np.testing.assert_array_equal(columns.values[2][2:5], [3, np.nan, 6])
    assert columns.values[3].tolist()[:2] == [0.5, 1.5]
    with pytest.warns(DynsrWarning, match="true and false"):
        (run,) = read_trajectories(columns, states=["y"]).trajectories
    assert run.time_unit == "min"


MATLAB = {
    "columns": {"t": T, "a": A, "b": B},
    "rows": {"t": T[None], "a": A[None], "b": B[None]},
    "a matrix and its names": {"t": T, "X": X, "names": np.array(["a", "b"], dtype=object)},
    "a matrix that lies": {"t": T, "X": X.T, "names": np.array(["a", "b"], dtype=object)},
    "a structure": {"run": {"t": T, "a": A, "b": B}},
    "other things beside": {
        "t": T,
        "a": A,
        "b": B,
        "p": np.ones(3),
        "note": "by NN",
        "cube": np.ones((2, 2, 2)),
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("form", MATLAB)
def test_matlab_files_are_read(tmp_path, form):
    """Vectors either way round, matrices and structures; what has other sizes is left out."""
    packed = form in {"rows", "a structure"}
    scipy.io.savemat(tmp_path / "a.mat", MATLAB[form], do_compression=packed, oned_as="column")
    check(load_columns(tmp_path / "a.mat"))
    check(load_columns(scipy.io.loadmat(tmp_path / "a.mat")))


@pytest.mark.slow
def test_structures_of_the_same_fields_are_runs(tmp_path):
    """Each element is a trajectory; a single value of it is a parameter."""
    kinds = [("t", object), ("x", object), ("rate", object)]
    runs = np.array([(T, A, 1.0), (T[:12], 2 * A[:12], 2.0)], dtype=kinds)
    scipy.io.savemat(tmp_path / "r.mat", {"runs": runs})
    table = read_trajectories(tmp_path / "r.mat")
    assert [len(run) for run in table.trajectories] == [16, 12]
    assert table.trajectories[0].states == ("x",)


def test_structures_in_a_structure_are_its_columns(tmp_path):
    """Simulink writes signals so, each with a label."""
    kinds = [("values", object), ("label", object)]
    signals = np.array([(A[:, None], "a"), (B[:, None], "b")], dtype=kinds)
    logged = {"time": T[:, None], "signals": signals, "blockName": "rig/To Workspace"}
    scipy.io.savemat(tmp_path / "s.mat", {"simout": logged})
    columns = load_columns(tmp_path / "s.mat")
    assert columns.names == ("time", "signals1_values", "signals2_values")
    np.testing.assert_array_equal(columns.values[2], B)


def write_matlab_73(path, **arrays):
    """Write arrays as MATLAB 7.3 does: HDF5 with a header, turned, each with its class."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            file[name] = np.atleast_2d(array)
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["title"] = np.array([[ord(c)] for c in "by NN"], dtype="u2")
        file["title"].attrs["MATLAB_class"] = np.bytes_("char")
    content = bytearray(path.read_bytes())
    content[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM"
    path.write_bytes(content)
    return path


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::dynsr.errors.DynsrWarning")
def test_matlab_files_of_version_7_3_are_read(tmp_path):
    """A column of n values stands there as one row, a matrix turned."""
    check(load_columns(write_matlab_73(tmp_path / "n.mat", t=T, a=A, b=B)))
    found = load_columns(write_matlab_73(tmp_path / "m.mat", t=T, X=X.T))
    np.testing.assert_array_equal(found.values[2], B)


@pytest.mark.slow
def test_hdf5_files_are_read(tmp_path):
    """Data sets, a group of them, a compound one, and groups that are runs."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.update({"t": T, "a": A, "b": B})
    with h5py.File(tmp_path / "b.hdf5", "w") as file:
        file.update({"log/t": T, "log/a": A, "log/b": B, "log/gain": np.ones(2)})
    with h5py.File(tmp_path / "c.h5", "w") as file:
        kinds = [("t", float), ("a", float), ("b", float)]
        file["table"] = np.array(list(zip(T, A, B, strict=True)), dtype=kinds)
    for name in ("a.h5", "b.hdf5", "c.h5"):
        check(load_columns(tmp_path / name))
    with h5py.File(tmp_path / "d.h5", "w") as file:
        for number in (1, 2):
            file.update({f"run_{number}/time": T, f"run_{number}/x": number * A})
    first, second = read_trajectories(tmp_path / "d.h5").trajectories
    np.testing.assert_array_equal(second.x, 2 * first.x)


def test_hdf5_opens_no_other_file(tmp_path):
    """Links and data kept elsewhere stay closed."""
    (tmp_path / "secret").write_bytes(T.tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = A
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = T
        file["a"] = h5py.ExternalLink("other.h5", "/a")
        file.create_dataset("b", (16,), "f8", external=[("secret", 0, 128)])
        layout = h5py.VirtualLayout((16,), "f8")
        layout[:] = h5py.VirtualSource("other.h5", "a", (16,))
        file.create_virtual_dataset("c", layout)
    assert load_columns(tmp_path / "a.h5").names == ("t",)


def dataset(**extra):
    """Give a Dataset with a unit, a value apart and another dimension."""
    return xr.Dataset(
        {
            "a": ("t", A, {"units": "mg/L"}),
            "b": ("t", B),
            "k": 3.0,
            "depths": ("depth", [1.0, 2.0]),
            **extra,
        },
        {"t": ("t", T, {"units": "h"})},
    )


@pytest.mark.slow
def test_netcdf_and_xarray_are_read(tmp_path):
    """Variables along the time are columns, with their units; the others are left out."""
    dataset().to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    dataset().to_netcdf(tmp_path / "b.nc", engine="scipy")
    for source in (dataset(), tmp_path / "a.nc", tmp_path / "b.nc"):
        columns = load_columns(source)
        check(columns)
        assert columns.units == {"t": "h", "a": "mg/L"} and set(columns.left_out) == {"k", "depths"}
    assert read_trajectories(dataset()).trajectories[0].time_unit == "h"


def test_dates_of_a_dataset_are_times(tmp_path):
    """Decoded as xarray does, from a file too."""
    dates = pd.date_range("2024-02-28", periods=16, freq="D")
    days = xr.Dataset({"x": ("when", A)}, {"when": dates})
    days.to_netcdf(tmp_path / "d.nc", engine="scipy")
    for source in (days, tmp_path / "d.nc"):
        (run,) = read_trajectories(source).trajectories
        assert run.time_unit == "days" and run.t.tolist() == list(range(16))


def test_what_runs_along_the_runs_of_a_dataset_is_a_parameter():
    """One value for each run is a column of that run; what has no such dimension is left out."""
    both = np.column_stack([A, A**2]).T
    runs = xr.Dataset({"x": (("run", "t"), both), "D": ("run", [0.1, 0.2]), "k": 3.0}, {"t": T})
    table = read_trajectories(runs)
    assert table.description.parameters == ("D",) and list(table.left_out) == ["k"]
    assert [run.by_name["D"][0] for run in table.trajectories] == [0.1, 0.2]


def test_a_text_alone_in_an_archive_is_read(tmp_path):
    """Other archives are refused with what they hold; a damaged one is said to be so."""
    rows = "t,a,b\n" + "\n".join(f"{t!r},{a!r},{b!r}" for t, a, b in TABLE[1:])
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("deep/a.csv", rows)
        archive.writestr("__MACOSX/a.csv", "what a Mac adds")
    check(load_columns(path))
    assert read_names_only(path) == ("t", "a", "b")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("b.csv", rows)
    with pytest.raises(InputError, match=r"holds 2 files \(deep/a.csv, b.csv\); unpack it"):
        load_columns(path)
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(InputError, match=r"^'a.zip' is damaged or not a zip archive"):
        load_columns(path)


def test_a_dataset_without_rows_is_one_line():
    """A dimension of no length holds nothing."""
    with pytest.raises(InputError, match="has no rows"):
        load_columns(dataset().isel(t=slice(0, 0)))


def test_a_dataarray_has_columns_and_runs(tmp_path):
    """Names along a dimension are states; a dimension that counts runs gives trajectories."""
    array = xr.DataArray(X, dims=("t", "species"), coords={"t": T, "species": ["a", "b"]})
    check(load_columns(array))
    both = xr.concat([array, 2 * array], pd.Index(["one", "two"], name="replicate"))
    first, second = read_trajectories(both).trajectories
    assert first.states == ("a", "b")
    np.testing.assert_array_equal(second.x, 2 * first.x)


def test_cells_of_parquet_and_npz_are_read_as_others(tmp_path):
    """Text in them is read; an array of another length is left out with the reason."""
    pd.DataFrame({"t": T, "v": ["on", "off"] * 8}).to_parquet(tmp_path / "a.parquet")
    assert load_columns(tmp_path / "a.parquet").values[1].tolist()[:2] == [1, 0]
    np.savez(tmp_path / "a.npz", t=T, a=A, b=B, weights=np.ones(3))
    columns = load_columns(tmp_path / "a.npz")
    check(columns)
    assert columns.left_out == {"weights": "has the shape (3,) where the table has 16 rows"}


SUFFIXES = [".xlsx", ".xls", ".ods", ".mat", ".h5", ".nc", ".parquet", ".npz", ".npy"]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "content",
    [
        b"PK\3\4" + bytes(60),
        b"\x89HDF\r\n\x1a\n" + bytes(90),
        b"CDF\1" + bytes(9),
        b"t,x\n0,1\n",
        b"MATLAB 5.0" + bytes(300),
    ],
)
def test_damaged_files_are_one_line(tmp_path, suffix, content):
    """Whatever stands under the suffix: no error of a library, no traceback."""
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_columns(path)
    assert "\n" not in str(caught.value) and "bad" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "module"),
    [("a.xlsx", "python_calamine"), ("a.h5", "h5py"), ("a.nc", "xarray"), ("a.parquet", "pyarrow")],
)
def test_what_is_not_installed_is_one_line(tmp_path, monkeypatch, name, module):
    """It names the extra that brings it."""
    (tmp_path / name).write_bytes(b"something")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtra, match=rf"reading '{name}' needs {module}.*\[tables\]"):
        load_columns(tmp_path / name)


def large(folder, form):
    """Write a small file that holds much."""
    path = folder / f"bomb.{form}"
    zeros = bytes(1 << 20)
    if form == "npz":
        np.savez_compressed(path, t=np.zeros(1 << 18), x=np.zeros(1 << 18))
    elif form == "npy":
        head = (
            b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117)
            + b"\n"
        )
        path.write_bytes(b"\x93NUMPY\1\0" + len(head).to_bytes(2, "little") + head + bytes(80))
    elif form == "csv.gz":
        with gzip.open(path, "wb", 1) as file:
            file.write(b"t,x\n" + b"1.5,2.5\n" * (1 << 18))
    elif form == "xlsx":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("xl/worksheets/sheet1.xml", zeros * 4)
    elif form == "mat":
        scipy.io.savemat(path, {"t": np.zeros(1 << 18)}, do_compression=True)
    elif form in {"h5", "nc"}:
        with h5py.File(path, "w") as file:
            file.create_dataset("t", (1 << 40,), "f8", chunks=True)
    else:
        pd.DataFrame({"t": np.zeros(1 << 18)}).to_parquet(path)
    return path


@pytest.mark.parametrize("form", ["npz", "npy", "csv.gz", "xlsx", "mat", "h5", "nc", "parquet"])
def test_sizes_are_looked_at_before_anything_is_unpacked(tmp_path, monkeypatch, form):
    """A file that holds more than is read is refused in one line; here the bound is a megabyte."""
    path = large(tmp_path, form)
    for module in (assembling, text, sys.modules["dynsr.data.scientific"]):
        monkeypatch.setattr(module, "MAX_BYTES", 1 << 20)
    with pytest.raises(InputError) as caught:
        load_columns(path)
    said = str(caught.value)
    assert ("that are read; give fewer rows" in said) or (
        form in ("npy", "nc") and "damaged" in said
    )


def test_a_line_without_an_end_is_one_line(tmp_path):
    """No line of more than 16 MB is taken into memory whole, at the beginning or later."""
    for start in (b"", b"t,x\n0,1\n1,2\n" * 3000):
        with open(tmp_path / "long.csv", "wb") as file:
            file.write(start + b"1" * 100)
            file.write(b"1,2," * (5 << 20))
        with pytest.raises(InputError, match="longer than 16 MB"):
            load_columns(tmp_path / "long.csv")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::dynsr.errors.DynsrWarning")
def test_what_would_end_or_hold_up_a_library_is_one_line(tmp_path):
    """Of files with a few wrong bytes each is read or refused, and this process goes on."""
    scipy.io.savemat(tmp_path / "a.mat", {"t": T, "a": A, "run": {"b": B}})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.update({"t": T, "log/a": A, "title": "by NN"})
    draw = np.random.default_rng(3)
    for path in (tmp_path / "a.mat", tmp_path / "a.h5"):
        whole = np.frombuffer(path.read_bytes(), np.uint8)
        for _ in range(10):
            broken = whole.copy()
            broken[draw.integers(0, len(whole), 3)] = draw.integers(0, 256, 3)
            path.write_bytes(broken.tobytes())
            assert read_or_one_line(path)


def read_or_one_line(path):
    """Whether a file is read, or refused in one line."""
    try:
        return bool(load_columns(path).names)
    except InputError as error:
        return "\n" not in str(error)
