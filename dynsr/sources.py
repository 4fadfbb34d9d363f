"""Sources of columns: files, frames, mappings and arrays, each as named columns of equal length.

Nothing here decides what a column means; :mod:`dynsr.tabular` does.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.columns import Columns, generated_names
from dynsr.delimited import read_delimited
from dynsr.errors import InputError
from dynsr.trajectory import Trajectory


def load_columns(source: Any) -> Columns:
    """Load the columns of a file, a frame, a mapping of arrays, a Trajectory or a 2-D array.

    Files are told by their suffix: ``.npz``, ``.npy``, ``.parquet`` or ``.pq``; anything else is
    delimited text. An array has the time as its first column; a pair ``(t, x)`` is taken apart.

    Raises InputError when the source is none of these or cannot be read.

    >>> load_columns({"t": [0, 1], "x": [2.0, 3.0]}).names
    ('t', 'x')
    """
    if isinstance(source, (str, os.PathLike)):
        return _load_file(Path(source))
    if isinstance(source, Trajectory):
        values = (source.t, *source.columns.T)
        return Columns(
            ("t", *source.names), values, "the trajectory", inputs=tuple(source.input_names)
        )
    if isinstance(source, Mapping):
        return _load_mapping(source, "the mapping")
    if hasattr(source, "columns") and hasattr(source, "__getitem__"):
        return _load_frame(source)
    if isinstance(source, tuple) and len(source) == 2:
        return _load_array(_beside(*source), "the arrays")
    if isinstance(source, np.ndarray):
        return _load_array(source, "the array")
    raise InputError(
        f"cannot read data from a {type(source).__name__}; "
        "give a file, a data frame, a (t, x) pair of arrays, a mapping of columns or a Trajectory"
    )


def _load_file(path: Path) -> Columns:
    _check_file(path)
    suffix = path.suffix.lower()
    if suffix in (".parquet", ".pq"):
        return _load_parquet(path)
    if suffix == ".npz":
        return _load_npz(path)
    if suffix == ".npy":
        try:
            return _load_array(np.load(path, allow_pickle=False), path.name)
        except (ValueError, OSError, EOFError) as error:
            raise _unreadable(path, "array file", error) from None
    return read_delimited(path)


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{str(path)!r} is a directory; give a file with the trajectory in it")
    if not path.exists():
        raise InputError(f"there is no file {str(path)!r}; check the name")
    if not path.is_file():
        raise InputError(f"{str(path)!r} is not a regular file; give a file of data")
    if not os.access(path, os.R_OK):
        raise InputError(f"file {str(path)!r} may not be read; change its permissions")
    if path.stat().st_size == 0:
        raise InputError(f"file {str(path)!r} is empty; it needs rows of times and states")


def _unreadable(path: Path, kind: str, error: Exception) -> InputError:
    if "pickle" in str(error).lower() or "object array" in str(error).lower():
        return InputError(
            f"{path.name!r} holds Python objects, which could run code when read; "
            "save plain numbers (dtype float64) instead"
        )
    return InputError(f"{path.name!r} is damaged or not a {kind}; write it again and retry")


def _load_parquet(path: Path) -> Columns:
    import pandas

    try:
        frame = pandas.read_parquet(path)
    except ImportError:
        raise InputError(
            f"reading {path.name!r} needs pyarrow; run: pip install pyarrow, or save it as CSV"
        ) from None
    except Exception as error:  # pyarrow raises a family of its own for damaged files
        raise _unreadable(path, "Parquet file", error) from None
    return _load_frame(frame, path.name)


def _load_npz(path: Path) -> Columns:
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, TypeError, AttributeError) as error:
        raise _unreadable(path, "npz archive", error) from None
    return _load_mapping(arrays, path.name)


def _load_mapping(arrays: Mapping[str, Any], label: str) -> Columns:
    """Spread matrices over columns; an array of strings names the columns of the one before."""
    labels = {k: tuple(map(str, v)) for k, v in arrays.items() if _is_text(v) and k in _LABELS}
    names: list[str] = []
    values: list[np.ndarray] = []
    for key, value in arrays.items():
        if key in labels:
            continue
        array = np.asarray(value)
        if array.ndim == 1:
            names.append(str(key))
            values.append(_plain(array))
        elif array.ndim == 2:
            names += _matrix_names(str(key), array, labels)
            values += [_plain(column) for column in array.T]
        elif array.ndim > 2:
            raise InputError(
                f"array {key!r} of {label} has {array.ndim} dimensions; "
                "give one column (n,) or a table (n, k), one row a time"
            )
    _check_lengths(names, values, label)
    inputs = labels.get("input_names", ())
    return Columns(tuple(names), tuple(values), label, inputs=tuple(n for n in inputs if n))


# Array of names in an archive -> the matrix whose columns they name.
_LABELS = {"states": "x", "input_names": "inputs", "columns": "data"}


def _matrix_names(
    key: str, matrix: np.ndarray, labels: Mapping[str, tuple[str, ...]]
) -> Sequence[str]:
    for label, named in _LABELS.items():
        if key == named and len(labels.get(label, ())) == matrix.shape[1]:
            return labels[label]
    return [f"{key}{j + 1}" for j in range(matrix.shape[1])]


def _is_text(value: Any) -> bool:
    array = np.asarray(value)
    return array.ndim == 1 and array.dtype.kind in "US"


def _plain(array: np.ndarray) -> np.ndarray:
    """Give numbers as float64 and everything else as objects."""
    if array.dtype.kind == "M":
        return array
    if array.dtype.kind == "c":
        raise InputError("the data holds complex numbers; give the real and imaginary parts apart")
    return array.astype(float) if array.dtype.kind in "fiub" else array.astype(object)


def _check_lengths(names: Sequence[str], values: Sequence[np.ndarray], label: str) -> None:
    if not names:
        raise InputError(f"{label} holds no columns; it needs times and states")
    for name, value in zip(names, values, strict=True):
        if len(value) != len(values[0]):
            raise InputError(
                f"column {name!r} of {label} has {len(value)} rows but {names[0]!r} has "
                f"{len(values[0])}; give all columns the same length"
            )


def _load_frame(frame: Any, label: str = "the data frame") -> Columns:
    index = getattr(frame, "index", None)
    if getattr(index, "name", None) is not None:  # pandas: a named index is a column too
        frame = frame.reset_index()
    names = [str(name) for name in frame.columns]
    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise InputError(f"column name {duplicates[0]!r} is used twice in {label}; rename one")
    values = [_plain(np.asarray(frame[name].to_numpy())) for name in frame.columns]
    _check_lengths(names, values, label)
    return Columns(tuple(names), tuple(values), label)


def _beside(t: Any, x: Any) -> np.ndarray:
    """Put times and states beside each other."""
    try:
        t, x = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    except (TypeError, ValueError):
        raise InputError("t and x must be arrays of numbers") from None
    if t.ndim != 1 or x.ndim not in (1, 2) or len(x) != len(t):
        raise InputError(f"t {t.shape} and x {x.shape} do not fit; give t (n,) and x (n, k)")
    return np.column_stack([t, x])


def _load_array(array: np.ndarray, label: str) -> Columns:
    if array.dtype.names:
        return _load_mapping({name: array[name] for name in array.dtype.names}, label)
    if array.ndim != 2:
        raise InputError(
            f"{label} has shape {array.shape}; give (n, 1 + k) with the time as first column, "
            "or pass the times as time="
        )
    names = generated_names(array.shape[1])
    return Columns(names, tuple(_plain(c) for c in array.T), label, named=False)
