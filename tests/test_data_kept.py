"""Data are taken as they are, or refused in one line: no value, unit or row changes silently."""

import gzip
import io
import warnings
from datetime import datetime, timedelta

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynsr.data.reading import read_trajectories, take_trajectories
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.search import discover
from dynsr.errors import DynsrWarning, InputError
from dynsr.methods.rational import RationalSearch

QUICK = RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1)
T = np.linspace(0, 5, 101)
X = np.exp(-T)
MILLISECONDS = np.round(T * 1e3).astype("timedelta64[ms]")
DATES = np.datetime64("2020-01-01") + MILLISECONDS


def read(source, **options):
    """Read one trajectory."""
    (run,) = read_trajectories(source, **options).trajectories
    return run


@pytest.mark.parametrize("times", [MILLISECONDS, DATES, MILLISECONDS.astype("timedelta64[ns]")])
def test_durations_and_dates_are_seconds_whatever_their_unit(times, tmp_path):
    """Every source that can hold them gives seconds from the first one on."""
    frame = pd.DataFrame({"t": times, "x": X})
    frame.to_parquet(tmp_path / "d.parquet")
    for run in (
        read(frame),
        read(pl.DataFrame({"t": times, "x": X})),
        read(pl.DataFrame({"t": times, "x": X}).lazy()),
        read(pa.table({"t": times, "x": X})),
        read({"t": times, "x": X}),
        read({"t": list(times.astype("timedelta64[us]").tolist()), "x": X})
        if times.dtype.kind == "m"
        else read({"t": times, "x": X}),
        read(tmp_path / "d.parquet"),
        take_trajectories((times, X[:, None]))[0][0],
        Trajectory(times, X[:, None], ("x",)),
    ):
        np.testing.assert_allclose(run.t, T, atol=1e-12)


def test_objects_of_dates_are_read_too():
    """A list of Python's own dates or durations gives seconds."""
    for first in (datetime(2020, 1, 1), timedelta(0)):  # noqa: DTZ001
        times = [first + timedelta(milliseconds=round(1e3 * t)) for t in T]
        np.testing.assert_allclose(Trajectory(times, X[:, None], ("x",)).t, T, atol=1e-12)


@pytest.mark.parametrize(
    "source",
    [
        (T, X + 1j),
        (T + 0j, X),
        (T, [complex(v, 1) for v in X]),
        {"t": T, "x": X + 1j},
        pd.DataFrame({"t": T, "x": X + 1j}),
        [(T, (X + 1j)[:, None])],
    ],
)
def test_imaginary_parts_are_never_dropped(source):
    """Pairs, lists of pairs, mappings and frames of complex numbers are refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="complex numbers"):
            take_trajectories(source)
        with pytest.raises(InputError, match="complex"):
            Trajectory(T, (X + 1j)[:, None], ("x",))
        with pytest.raises(InputError, match="complex"):
            discover((T, X[:, None]), method=QUICK, jobs=1, slopes={"x": X + 1j})


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ({"t": T, "x": 1.0}, "'x' of the mapping is a float, not a column"),
        ({"t": T, "x": None}, "'x' of the mapping is a NoneType, not a column"),
        ({"t": T, "x": "abc"}, "'x' of the mapping is a str, not a column"),
        ({"t": T, "x": [[1], [2, 3]]}, "'x' of the mapping has rows of different lengths"),
        ({"t": [], "x": []}, "has no rows"),
        (pd.DataFrame({"t": T, "x": X}, index=pd.Index(T, name="t")), "is the index and a column"),
        (pl.DataFrame({"t": [], "x": []}).lazy(), "has no rows"),
        ({"t": T, "x": [10**400] * 101}, "give numbers"),
        ({"t": np.arange(101) + 2**62, "x": X}, "more than 16 digits"),
        ({"t": T, "x": MILLISECONDS.astype("timedelta64[Y]")}, "no numbers"),
    ],
)
def test_what_is_no_table_is_one_line(source, said):
    """Raw exceptions of NumPy, pandas and narwhals never come through."""
    with pytest.raises(InputError, match=said):
        read_trajectories(source)


@pytest.mark.parametrize("suffix", ["parquet", "npz"])
def test_files_without_rows_are_one_line(suffix, tmp_path):
    """Zero rows are refused with the file's name."""
    path = tmp_path / f"empty.{suffix}"
    if suffix == "npz":
        np.savez(path, t=np.array([]), x=np.array([]))
    else:
        pd.DataFrame({"t": [], "x": []}).to_parquet(path)
    with pytest.raises(InputError, match=f"empty.{suffix} has no rows"):
        read_trajectories(path)


def test_single_values_beside_the_columns_of_an_archive_are_told(tmp_path):
    """An archive may hold its step beside its columns; it is left out, with a word."""
    np.savez(tmp_path / "a.npz", t=T, x=X, dt=0.05)
    with pytest.warns(DynsrWarning, match="'dt' of a.npz is no column; left out"):
        assert read(tmp_path / "a.npz").states == ("x",)


ODD = ["\x85", "\x0c", "\x0b", "\x1c", "\x1d", "\x1e", "\u2028", "\u2029", "\u00a0", '"', "'", "''"]


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_odd_characters_in_comments_cost_no_row(odd, end, tmp_path):
    """What ends a line for str.splitlines or begins a quotation ends none here; no row is lost, and
    a remark between the rows is told.
    """
    rows = [f"{t!r},{x!r}" for t, x in zip(T.tolist(), X.tolist(), strict=True)]
    head = [f"# a note{odd}of {odd} it", "# units: s, m", "t,x"]
    middle = [f"# half{odd}way"]
    text = end.join([*head, *rows[:50], *middle, *rows[50:], ""])
    path = tmp_path / "odd.csv"
    path.write_bytes(text.encode())
    with gzip.open(tmp_path / "odd.csv.gz", "wb") as file:
        file.write(text.encode())
    for source in (path, tmp_path / "odd.csv.gz"):
        with pytest.warns(DynsrWarning, match="1 remark was skipped between the rows"):
            run = read(source)
        assert run.t.tolist() == T.tolist() and run.x[:, 0].tolist() == X.tolist()


def test_rows_between_two_quotation_marks_are_not_swallowed(tmp_path):
    """Where the parser would join rows into one cell, the file is refused."""
    lines = ["t,x", *(f"{t},{x}" for t, x in zip(T, X, strict=True))]
    lines[20], lines[30] = '"1,0.5', '2,0.4"'
    (tmp_path / "q.csv").write_text("\n".join(lines))
    with pytest.raises(InputError):
        read_trajectories(tmp_path / "q.csv")


@pytest.mark.slow
def test_a_table_of_five_thousand_columns_is_read(tmp_path):
    """Lines longer than the head that is looked at are read, and a word says how many states."""
    names = ["t", *(f"a_long_name_of_a_column_{j}" for j in range(5000))]
    rng = np.random.default_rng(0)
    t = np.arange(12.0)
    values = np.column_stack([t, np.sin(t[:, None] + rng.normal(size=5000))])
    np.savetxt(tmp_path / "w.csv", values, delimiter=",", header=",".join(names), comments="")
    with pytest.warns(DynsrWarning, match="5000 states.*name those that matter"):
        run = read(tmp_path / "w.csv")
    assert run.x.shape == (12, 5000) and run.states[-1] == names[-1]
    np.testing.assert_allclose(run.x[:, 4999], values[:, -1])


@pytest.mark.parametrize("written", ["\u00b5", "\u03bc"])
@pytest.mark.parametrize("asked", ["\u00b5", "\u03bc"])
@pytest.mark.filterwarnings("ignore:columns were renamed")
def test_the_micro_sign_and_mu_are_one_name(written, asked):
    """Whichever of the two the file has and the user types, the column is found."""
    assert read({"t": T, written: X}, states=[asked]).states == ("\u03bc",)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"seed": -1}, "seed -1 must be a whole number"),
        ({"seed": 1.5}, "seed 1.5 must be a whole number"),
        ({"seed": None}, "seed None must be a whole number"),
        ({"slopes": {"typo": X}}, "slopes of 'typo', which is no state; the states are: x"),
        ({"slopes": {"x": 1.0}}, "must be a mapping of states to arrays"),
        ({"slopes": {"x": None}}, "must be a mapping of states to arrays"),
        ({"slopes": X}, "must be a mapping of states to arrays"),
        ({"known": {"typo": "1"}}, "unknown state 'typo'"),
        ({"known": "x'=1"}, "must be a mapping of states to formulas"),
        ({"engine": "typo"}, "unknown engine 'typo'"),
        ({"engine": None}, "unknown engine None"),
        ({"method": None}, "must be a method, its name, or several"),
        ({"targets": 5}, "must be 'all', a state, or several"),
        ({"scheme": 5}, "must be the name of a scheme"),
        ({"settings": {"rows": 5}}, "must be DiscoverySettings"),
        ({"out": 5}, "must be a folder"),
        ({"progress": 5}, "must be a function"),
        ({"snap": "no"}, "snap 'no' must be True or False"),
        ({"explicit_time": 7}, "explicit_time '7' must be True or False"),
        ({"discrete": "yes"}, "discrete 'yes' must be True or False"),
        ({"stochastic": 5}, "stochastic '5' must be True or False"),
        ({"jobs": "two"}, "jobs two must be a whole number"),
    ],
)
def test_what_discover_is_asked_is_checked(asked, said):
    """Every argument of the wrong kind is refused by its name before anything is searched."""
    with pytest.raises(InputError, match=said):
        discover((T, X[:, None]), **{"method": QUICK, "jobs": 1, **asked})


CELLS = st.floats(-1e300, 1e300, allow_nan=False)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(
    rows=st.lists(st.tuples(CELLS, CELLS), min_size=12, max_size=30),
    delimiter=st.sampled_from([",", ";", "\t", "|", " "]),
    end=st.sampled_from(["\n", "\r\n"]),
    comments=st.lists(st.text(st.characters(exclude_categories=("Cc", "Cs")))),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]),
)
def test_a_table_reads_back_to_the_last_bit(
    rows, delimiter, end, comments, encoding, tmp_path_factory
):
    """Whatever the delimiter, line end, encoding and comments: all rows, all bits, or a refusal."""
    values = np.array(rows)
    lines = [f"# {comment}" for comment in comments] + [delimiter.join(["t", "x", "y"])]
    lines += [delimiter.join(map(repr, (float(i), *row))) for i, row in enumerate(rows)]
    path = tmp_path_factory.mktemp("tables") / "table.txt"
    path.write_bytes((end.join(lines) + end).encode(encoding, errors="replace"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            run = read(path, states=["x", "y"])
        except InputError:
            constant = any(len(set(column)) == 1 for column in values.T)
            assert constant
            return
    assert np.array_equal(run.x, values)


def read_or_one_line(path):
    """Read a file, or see that it is refused in one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read_trajectories(path)
        except InputError as error:
            said = str(error)
            assert "\n" not in said


@settings(max_examples=80, deadline=None)
@given(content=st.binary(max_size=300) | st.text(max_size=200).map(str.encode))
@pytest.mark.slow
def test_any_bytes_are_a_table_or_one_line(content, tmp_path_factory):
    """Whatever a file holds, under whatever suffix, reading it ends in one of the two."""
    folder = tmp_path_factory.mktemp("bytes")
    for suffix in (
        *(".csv", ".npz", ".npy", ".parquet", ".csv.gz"),
        *(".xlsx", ".mat", ".h5", ".nc"),
    ):
        path = folder / f"any{suffix}"
        path.write_bytes(content)
        read_or_one_line(path)


def test_archives_that_are_cut_or_changed_are_one_line(tmp_path):
    """Every 7th prefix and every 7th changed byte of an archive is refused, or read."""
    memory = io.BytesIO()
    np.savez_compressed(memory, t=T[:20], x=X[:20])
    whole = memory.getvalue()
    path = tmp_path / "a.npz"
    for at in range(0, len(whole), 7):
        for content in (whole[:at], whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :]):
            path.write_bytes(content)
            read_or_one_line(path)
