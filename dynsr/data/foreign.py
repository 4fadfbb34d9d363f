"""Foreign: what libraries read of files of MATLAB and HDF5, in a process that they may end."""

from __future__ import annotations

import json
import re
import struct
import sys
import warnings
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

# Name of a group -> name of an array -> the array.
Groups = dict[str, dict[str, np.ndarray]]


class TooLarge(Exception):
    """A file holds more bytes, unpacked, than are read."""


def main() -> None:
    """Read a file as a line of JSON on stdin says; arrays go to a file, their names to stdout."""
    kind, path, kept, most = json.loads(sys.stdin.read())
    warnings.simplefilter("ignore")
    try:
        groups = read_mat(path, most) if kind == "mat" else read_hdf5(path, most)
    except TooLarge as error:
        sys.stdout.write(json.dumps({"size": error.args[0]}))
        return
    if kind == "look":
        groups = {}
    arrays: list[np.ndarray] = []
    told: dict[str, dict[str, str]] = {}
    for group, own in groups.items():
        for name, array in own.items():
            told.setdefault(group, {})[name] = f"a{len(arrays)}"
            arrays.append(array)
    np.savez(kept, **{f"a{j}": array for j, array in enumerate(arrays)})  # type: ignore[arg-type]
    sys.stdout.write(json.dumps({"size": 0, "groups": told}))


def _check(size: int, most: int) -> None:
    if size > most:
        raise TooLarge(size)


def read_mat(path: str, most: int) -> Groups:
    """Read the numbers and texts of a MATLAB file of version 4 or 5."""
    import scipy.io

    _check(sum(_mat_sizes(path, most)), most)
    there = scipy.io.whosmat(path)
    _check(sum(8 * int(np.prod(s, dtype=object)) for _, s, kind in there if kind != "cell"), most)
    wanted = [name for name, _, kind in there if kind not in ("object", "function", "opaque")]
    return group_mat(scipy.io.loadmat(path, variable_names=wanted, chars_as_strings=True))


def group_mat(arrays: Mapping[str, Any]) -> Groups:
    """Give the numbers and texts of what scipy.io.loadmat read; each structure is a group."""
    found = {name: value for name, value in arrays.items() if not name.startswith("__")}
    structures = {n: v for n, v in found.items() if isinstance(v, np.ndarray) and v.dtype.names}
    plain = {name: value for name, value in found.items() if name not in structures}
    groups = {"": _numbers(plain)}
    for name, value in structures.items():
        for number, one in enumerate(value.ravel(), start=1):
            fields = dict(_fields(one))
            groups[name if value.size == 1 else f"{name}({number})"] = _numbers(fields)
    return groups


def _fields(structure: Any) -> Iterator[tuple[str, Any]]:
    """Give the fields of a structure, and those of structures in it, as Simulink writes signals."""
    for key in structure.dtype.names:
        value = structure[key]
        if not isinstance(value, np.ndarray) or not value.dtype.names:
            yield key, value
            continue
        for number, one in enumerate(value.ravel(), start=1):
            place = f"{key}{number}" if value.size > 1 else key
            yield from ((f"{place}_{name}", inner) for name, inner in _fields(one))


def _mat_sizes(path: str, most: int) -> Iterator[int]:
    """Give the unpacked sizes of the packed elements of a MATLAB 5 file."""
    with open(path, "rb") as file:
        order = {b"IM": "<", b"MI": ">"}.get(file.read(128)[126:])
        while order and len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind != 15:  # miCOMPRESSED
                file.seek(size, 1)
                continue
            unpack, total, left = zlib.decompressobj(), 0, size
            while left > 0 and total <= most and (chunk := file.read(min(left, 1 << 16))):
                left -= len(chunk)
                while chunk and total <= most:
                    total += len(unpack.decompress(chunk, 1 << 20))
                    chunk = unpack.unconsumed_tail
            yield total


def _numbers(arrays: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Keep numbers and text of a MATLAB file, vectors as such."""
    kept = {}
    for name, value in arrays.items():
        array = np.asarray(value)
        if (
            array.dtype.kind == "O"
            and array.size
            and all(
                isinstance(cell, np.ndarray) and cell.dtype.kind == "U" for cell in array.ravel()
            )
        ):
            array = np.array([str(cell.ravel()[0]) if cell.size else "" for cell in array.ravel()])
        if array.dtype.kind not in "fiubcU" or array.ndim > 2:
            continue
        if array.dtype.kind == "U":
            array = np.array([str(text).strip() for text in array.ravel()])
        kept[name] = array.ravel() if 1 in array.shape and array.size > 1 else array
    return {k: v.reshape(()) if v.size == 1 else v for k, v in kept.items() if v.size}


def read_hdf5(path: str, most: int) -> Groups:
    """Read the numbers and texts of an HDF5 file, group by group; links stay closed."""
    import h5py

    with h5py.File(path, "r") as file:
        return _read_groups(file, most)


def _read_groups(file: Any, most: int) -> Groups:
    import h5py

    datasets: list[tuple[str, Any]] = []
    # Neither links to other files nor what is stored in them.
    file.visititems(lambda name, item: datasets.append((name, item)))
    kept = []
    for name, item in datasets:
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            continue
        if item.external or item.is_virtual or item.shape is None or item.ndim > 2:
            continue
        # A single text of any length is no column, and a damaged one makes the library wait.
        if item.dtype.kind == "O" and item.size == 1 and not _is_reference(item):
            continue
        kept.append((name, item))
    _check(sum(int(item.size) * item.dtype.itemsize for _, item in kept), most)
    groups: dict[str, dict[str, np.ndarray]] = {}
    for name, item in kept:
        group, _, key = name.rpartition("/")
        for own, array in _read_dataset(file, key, item):
            groups.setdefault(group, {})[own] = array
    return {name: _pandas_blocks(group) for name, group in groups.items()}


def _read_dataset(file: Any, key: str, item: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Give the arrays of a dataset: fields of a compound, text of bytes, MATLAB's way round."""
    import h5py

    matlab = item.attrs.get("MATLAB_class", b"") if file.userblock_size else b""
    matlab = matlab.decode() if isinstance(matlab, bytes) else str(matlab)
    if (matlab and item.attrs.get("MATLAB_empty", 0)) or matlab in ("function_handle", "struct"):
        return
    if _is_reference(item):
        texts = [_characters(file[one]) for one in item[()].ravel()] if matlab == "cell" else []
        if texts and all(text is not None for text in texts):
            yield key, np.array(texts)
        return
    if matlab == "char":
        yield key, np.array(_characters(item))
        return
    values = item.asstr()[()] if h5py.check_string_dtype(item.dtype) else item[()]
    array = np.asarray(values)
    if array.dtype.names:
        for name in array.dtype.names:
            part = array[name]
            yield name, part.astype(str) if part.dtype.kind in "SO" else part
        return
    if array.dtype.kind in "SO":
        array = array.astype(str)
    if matlab:
        array = array.T
    if array.ndim == 2 and 1 in array.shape and array.size > 1:
        array = array.ravel()
    if array.dtype.kind in "fiubcU":
        yield key, array.reshape(()) if array.size == 1 and matlab else array


def _is_reference(item: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(item.dtype) is not None


def _characters(item: Any) -> str | None:
    """Give the text of a MATLAB array of characters."""
    if item.dtype.kind != "u" or item.size > 1 << 10:
        return None
    return "".join(map(chr, np.asarray(item[()]).T.ravel()))


def _pandas_blocks(group: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Give the columns of a frame that pandas wrote in its fixed form; other groups as they are."""
    if not {"axis0", "axis1"} <= set(group):
        return group
    columns = {"index": group["axis1"]}
    for key, values in group.items():
        block = re.fullmatch(r"block(\d+)_values", key)
        items = group.get(f"block{block[1]}_items") if block else None
        if items is not None and values.ndim == 2:
            columns.update({str(name): values[:, j] for j, name in enumerate(items)})
        elif items is not None:
            columns[str(items.ravel()[0])] = values
    return columns
