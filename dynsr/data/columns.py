"""Columns: what a file, a frame or arrays hold, before anyone decides what a column means."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.data.assembling import (
    Columns,
    beside,
    generated_names,
    load_array,
    load_frame,
    load_mapping,
    names_of_states,
    with_times,
)
from dynsr.data.codes import Missing, without_codes
from dynsr.data.trajectory import Trajectory
from dynsr.data.usual_forms import as_array
from dynsr.errors import InputError

__all__ = [
    "Columns",
    "beside",
    "generated_names",
    "load_columns",
    "names_of_states",
    "read_names_only",
    "with_times",
]


# Documents, in which numbers stand among other things.
_PAGES = (".html", ".htm")
_NO_TABLES = (".yaml", ".yml", ".xml", ".pdf", ".doc", ".docx", ".rtf", ".png")


def load_columns(
    source: Any, decimal: str | None = None, missing: Missing | None = None
) -> Columns:
    """Load the columns of a file, a frame, a mapping of arrays, a Trajectory or a 2-D array.

    Files are recognised by their suffix: Excel and its kin (``.xlsx``, ``.xls``, ``.ods``), MATLAB
    (``.mat``), HDF5 (``.h5``, ``.hdf5``), NetCDF (``.nc``), Parquet, JSON, Stata (``.dta``),
    ``.npz``, ``.npy``; anything else is delimited text, which may be packed (``.gz``, ``.bz2``,
    ``.xz``, ``.zip``).
    ``book.xlsx:Sheet 2`` is one sheet of a spreadsheet. Frames are those that narwhals knows, such
    as pandas, polars and pyarrow, and those of xarray; a series of pandas has its times as the
    index. An array has the time as its first column; a pair ``(t, x)`` is taken apart, and so is
    what ``scipy.integrate.solve_ivp`` gives. What cells say is read
    (:func:`dynsr.data.cells.read_columns`); columns without a value are left out.

    Parameters
    ----------
    source : any of these.
    decimal : the decimal mark of text in it, "." or ","; found by default.
    missing : numbers that stand for no value, such as -999; "none" for no number. By default usual
        ones that are far from all others of their column, but not in a Trajectory.

    Raises InputError when the source is not one of these or cannot be read.

    >>> load_columns({"t": [0, 1], "x": [2.0, 3.0]}).names
    ('t', 'x')
    """
    found = _load(source, decimal)
    return without_codes(found, missing, guess=not isinstance(source, Trajectory))


def _load(source: Any, decimal: str | None) -> Columns:
    if decimal not in (None, ".", ","):
        raise InputError(f"decimal {decimal!r} must be '.' or ','")
    if isinstance(source, Columns):
        return source
    source = as_array(source)
    if isinstance(source, (str, os.PathLike)):
        return _load_file(Path(source), decimal)
    if isinstance(source, Trajectory):
        values = (source.t, *source.columns.T)
        return Columns(
            ("t", *source.names),
            values,
            "the trajectory",
            inputs=tuple(source.input_names),
            time_unit=source.time_unit,
            limits=source.limits,
        )
    if _is_xarray(source):
        from dynsr.data.scientific import from_xarray

        return from_xarray(source, "the dataset")
    if isinstance(source, Mapping) and "__globals__" in source:  # what scipy.io.loadmat gives
        from dynsr.data.scientific import from_mat

        return from_mat(source, "the mapping", decimal)
    if isinstance(source, Mapping):
        return load_mapping(source, "the mapping", decimal)
    if _is_series(source):
        return load_frame(source.to_frame(source.name or "x"), "the series", decimal)
    if _is_frame(source):
        return load_frame(source, "the data frame", decimal)
    if isinstance(source, tuple) and len(source) == 2:
        table, unit = beside(*source)
        found = load_array(table, "the arrays")
        names = ("t", *names_of_states(len(found.names) - 1))
        return replace(found, names=names, time_unit=unit)
    if isinstance(source, np.ndarray):
        return load_array(source, "the array")
    raise InputError(
        f"cannot read data from a {type(source).__name__}; "
        "give a file, a data frame, a (t, x) pair of arrays, a mapping of columns or a Trajectory"
    )


def read_names_only(path: Path) -> tuple[str, ...]:
    """Give the names of the columns of a file; of delimited text only its first lines are read.

    Parameters
    ----------
    path : the file.

    Raises InputError when it cannot be read.
    """
    from dynsr.data.formats import READERS, split_sheet
    from dynsr.data.text import read_header

    if split_sheet(path)[0].suffix.lower() in READERS:
        return load_columns(path).names
    _check_file(path)
    return read_header(path)


def _is_xarray(source: Any) -> bool:
    xarray = sys.modules.get("xarray")
    return xarray is not None and isinstance(source, (xarray.Dataset, xarray.DataArray))


def _is_series(source: Any) -> bool:
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(source, pandas.Series)


def _is_frame(source: Any) -> bool:
    import narwhals

    pandas = sys.modules.get("pandas")
    if pandas is not None and isinstance(source, pandas.DataFrame):
        return True
    try:
        known = narwhals.from_native(source, pass_through=True)
    except narwhals.exceptions.NarwhalsError:
        return True  # a frame, whose fault is told where it is taken apart
    return isinstance(known, (narwhals.DataFrame, narwhals.LazyFrame))


def _load_file(path: Path, decimal: str | None) -> Columns:
    from dynsr.data.formats import READERS, load_excel, split_sheet
    from dynsr.data.text import load_delimited

    file, sheet = split_sheet(path)
    _check_file(file)
    if sheet:
        return load_excel(file, decimal, sheet)
    page = path.suffix.lower() in _PAGES
    if path.suffix.lower() in _NO_TABLES or (page and b"<table" not in path.read_bytes().lower()):
        raise InputError(f"{path.name!r} is no table; save its rows as CSV, and give that file")
    reader = None if _is_other_text(path) else READERS.get(path.suffix.lower())
    return load_delimited(path, decimal) if reader is None else reader(path, decimal)


def _is_other_text(path: Path) -> bool:
    """Whether a file called as one of Stata is text, as potentiostats write it."""
    if path.suffix.lower() != ".dta":
        return False
    with path.open("rb") as file:
        return file.read(7) == b"EXPLAIN"


def _check_file(path: Path) -> None:
    """Raise InputError, with the reason, when a path is no file with something in it."""
    if path.is_dir():
        raise InputError(f"{str(path)!r} is a directory; give a file with the trajectory in it")
    if path.parts and path.parts[0].lower() in ("http:", "https:", "ftp:", "s3:"):
        raise InputError("an address of the web is no file; download it, and give the file")
    if not path.exists():
        raise InputError(f"there is no file {str(path)!r}; check the name")
    if not path.is_file():
        raise InputError(f"{str(path)!r} is not a regular file; give a file of data")
    if not os.access(path, os.R_OK):
        raise InputError(f"file {str(path)!r} may not be read; change its permissions")
    if path.stat().st_size == 0:
        raise InputError(f"file {str(path)!r} is empty; it needs rows of times and states")
