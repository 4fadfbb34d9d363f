"""Scientific formats: MATLAB, HDF5, NetCDF and datasets of xarray; none runs what it holds."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np

from dynsr.data.assembling import (
    LABELS,
    MAX_BYTES,
    Columns,
    assemble,
    check_size,
    load_mapping,
    unreadable,
)
from dynsr.data.foreign import group_mat
from dynsr.errors import InputError, need

# Seconds after which a file that is still being read is damaged: a gigabyte takes a few.
_PATIENCE = 60
_TIME = re.compile(r"t|tout|time\w*|times?|\w*_time|zeit|seconds|hours|days", re.IGNORECASE)
# A number that says how far rows are apart, or how many there are in a second.
_STEP = re.compile(r"ts|dt|delta_?t|samp(le|ling)_?(time|period|interval)", re.IGNORECASE)
_RATE = re.compile(r"fs|srate|samp(le|ling)_?(rate|freq(uency)?)", re.IGNORECASE)
# A dimension of a dataset that counts runs of the same system.
_RUNS = re.compile(
    r"(runs?|trials?|replicates?|reps?|experiments?|batch(es)?|samples?|wells?|subjects?|stations?|"
    r"members?|ensemble|series|traj(ectory|ectories)?|realizations?)(_?(id|no|nr|number))?",
    re.IGNORECASE,
)


def fit_rows(arrays: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Keep the arrays that have a value for each row of a table, turned where rows lie sideways.

    Parameters
    ----------
    arrays : name -> array of any shape, or anything else, which stays.

    Gives the arrays, and name -> why it was left out. The rows are those of an array that is
    called a time, or else those that most arrays have. Without such an array, a number such as
    ``Ts`` or ``Fs`` gives the times, from 0 on.

    >>> found, left_out = fit_rows({"t": np.arange(5.0), "x": np.ones((2, 5)), "p": np.ones(3)})
    >>> found["x"].shape, left_out
    ((5, 2), {'p': 'has the shape (3,) where the table has 5 rows'})
    """
    shapes = {k: v.shape for k, v in arrays.items() if isinstance(v, np.ndarray) and 0 < v.ndim < 3}
    times = [max(shape) for key, shape in shapes.items() if _TIME.fullmatch(key)]
    counts = Counter(shape[0] for shape in shapes.values() if max(shape) > 1)
    if not counts:
        return dict(arrays), {}
    rows = times[0] if times else max(counts, key=lambda n: (counts[n], n))
    kept: dict[str, Any] = {}
    left_out: dict[str, str] = {}
    named = _with_names(arrays, shapes, rows)
    if (step := None if times else _step_of(arrays)) is not None:
        left_out[step[0]] = "says the step of the times"
        named = {"t": step[1] * np.arange(rows), **{k: v for k, v in named.items() if k != step[0]}}
    for key, value in named.items():
        shape = value.shape if isinstance(value, np.ndarray) and 0 < value.ndim < 3 else None
        if isinstance(value, np.ndarray) and value.ndim > 2:
            left_out[key] = f"has {value.ndim} dimensions"
        elif shape is None or shape[0] == rows or (key in LABELS and value.dtype.kind in "US"):
            kept[key] = value
        elif len(shape) == 2 and shape[1] == rows:
            kept[key] = value.T
        else:
            left_out[key] = f"has the shape {shape} where the table has {rows} rows"
    return kept, left_out


def _step_of(arrays: Mapping[str, Any]) -> tuple[str, float] | None:
    """Give the name of the number that says the step of the rows, and the step."""
    for key, value in arrays.items():
        said = _STEP.fullmatch(key), _RATE.fullmatch(key)
        if not any(said) or np.size(value) != 1 or np.asarray(value).dtype.kind not in "fiu":
            continue
        number = float(np.asarray(value).reshape(-1)[0])
        if 0 < number < np.inf:
            return key, number if said[0] else 1 / number
    return None


def _is_time(name: str) -> bool:
    return _TIME.fullmatch(name) is not None


def _with_names(
    arrays: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]], rows: int
) -> dict[str, Any]:
    """Let a list of texts name the columns of the one matrix that has as many."""
    found = dict(arrays)
    for key, value in arrays.items():
        if key not in shapes or key in LABELS or value.dtype.kind not in "US" or value.ndim > 1:
            continue
        fits = [k for k, shape in shapes.items() if sorted(shape) == sorted((rows, len(value)))]
        if len(fits) == 1 and len(value) != rows and fits[0] in found:
            matrix = found.pop(fits[0])
            matrix = matrix if matrix.shape[0] == rows else matrix.T
            del found[key]
            found.update({str(name): matrix[:, j] for j, name in enumerate(value)})
    return found


def without(columns: Columns, left_out: Mapping[str, str]) -> Columns:
    """Add what was left out before the columns were put together."""
    return replace(columns, left_out={**columns.left_out, **left_out})


def load_mat(path: Path, decimal: str | None = None) -> Columns:
    """Load the numbers of a MATLAB file of version 4, 5 or 7.3; its objects and functions stay."""
    with open(path, "rb") as file:
        if b"MATLAB 7.3" in file.read(128) or (file.seek(512) and file.read(4) == b"\x89HDF"):
            return load_hdf5(path, decimal)
        _check_version(file, path)
    return _from_groups(_read_apart("mat", path, "MATLAB file"), path.name, decimal)


def _check_version(file: BinaryIO, path: Path) -> None:
    """Refuse a file whose first bytes are those of no version, before a process is started."""
    from scipy.io.matlab import MatReadError, matfile_version

    file.seek(0)
    try:
        matfile_version(file)
    except (ValueError, IndexError, MatReadError) as error:
        raise unreadable(path, "MATLAB file", error) from None


def from_mat(arrays: Mapping[str, Any], label: str, decimal: str | None = None) -> Columns:
    """Give the columns of what scipy.io.loadmat read: vectors, matrices, and structures of them."""
    return _from_groups(group_mat(arrays), label, decimal)


def _from_groups(
    groups: Mapping[str, Mapping[str, np.ndarray]], label: str, decimal: str | None
) -> Columns:
    """Give the columns of groups of arrays: those of the same names are runs, others are joined."""
    tables = {n: dict(g) for n, g in groups.items() if any(v.ndim for v in g.values())}
    if not tables:
        raise InputError(f"{label} has no columns of numbers; it needs times and states")
    names = {frozenset(table) for table in tables.values()}
    # Beside runs there may be values that belong to none.
    alike = [n for n in tables if n]
    if len(alike) > 1 and len({frozenset(tables[n]) for n in alike}) == 1:
        return _stack({name: tables[name] for name in alike}, label, decimal)
    if len(names) > 1 or len(tables) > 1:
        often = Counter(key for table in tables.values() for key in table)
        joined = {
            key if often[key] == 1 else f"{name}_{key}".strip("_").replace("/", "_"): value
            for name, table in tables.items()
            for key, value in table.items()
        }
    else:
        joined = next(iter(tables.values()))
    # Names have no order there; a time stands first in all other sources.
    arrays, left_out = fit_rows(
        dict(sorted(joined.items(), key=lambda item: not _is_time(item[0])))
    )
    return without(load_mapping(arrays, label, decimal), left_out)


def _stack(
    tables: Mapping[str, Mapping[str, np.ndarray]], label: str, decimal: str | None
) -> Columns:
    """Put runs below each other, with a first column that names them."""
    parts = []
    for name, table in tables.items():
        arrays, left_out = fit_rows(table)
        single = {key: value for key, value in arrays.items() if value.ndim == 0}
        part = load_mapping({k: v for k, v in arrays.items() if k not in single}, label, decimal)
        # A single value of a run is a parameter of it.
        rows = len(part.values[0])
        extra = {k: np.full(rows, v[()]) for k, v in single.items() if v.dtype.kind in "fiub"}
        parts.append((name, {**dict(zip(part.names, part.values, strict=True)), **extra}, left_out))
    shared = [key for key in parts[0][1] if all(key in columns for _, columns, _ in parts)]
    labels = np.array([n for n, columns, _ in parts for _ in columns[shared[0]]], dtype=object)
    columns = [np.concatenate([columns[key] for _, columns, _ in parts]) for key in shared]
    found = assemble(["run", *shared], [labels, *columns], label, decimal=decimal)
    return without(found, parts[0][2])


def load_hdf5(path: Path, decimal: str | None = None) -> Columns:
    """Load the numbers of an HDF5 file, or of a MATLAB file of version 7.3; links stay closed."""
    need("h5py", "tables", f"reading {path.name!r}")
    _check_mark(path, "HDF5 file")
    return _from_groups(_read_apart("hdf5", path, "HDF5 file"), path.name, decimal)


def _check_mark(path: Path, what: str) -> None:
    """Refuse a file that does not begin as HDF5 does, there or behind a block of the user's."""
    with open(path, "rb") as file:
        for place in (0, 512, 1024, 2048):
            file.seek(place)
            if file.read(8) == b"\x89HDF\r\n\x1a\n":
                return
    raise unreadable(path, what, ValueError("no mark"))


def _read_apart(kind: str, path: Path, what: str) -> dict[str, dict[str, np.ndarray]]:
    """Read the groups of arrays of a file in a process of its own.

    What is damaged, by chance or on purpose, ends the libraries that read these files or keeps them
    waiting for ever; here it ends that process.
    """
    with TemporaryDirectory() as folder:
        kept = Path(folder) / "arrays.npz"
        places = [place for place in sys.path if place]
        order = json.dumps([kind, str(path.absolute()), str(kept), MAX_BYTES])
        start = f"import sys; sys.path[:] = {places!r}; from dynsr.data.foreign import main; main()"
        try:
            done = subprocess.run(
                [sys.executable, "-I", "-c", start],
                input=order.encode(),
                capture_output=True,
                timeout=_PATIENCE,
                check=True,
            )
            told = json.loads(done.stdout)
            check_size(path, told["size"])
            with np.load(kept, allow_pickle=False) as arrays:
                return {
                    group: {name: arrays[place] for name, place in names.items()}
                    for group, names in told["groups"].items()
                }
        except InputError:
            raise
        except (OSError, ValueError, KeyError, subprocess.SubprocessError) as error:
            raise unreadable(path, what, error) from None


def load_netcdf(path: Path, decimal: str | None = None) -> Columns:
    """Load the variables of a NetCDF file that have the dimension of the time."""
    need("xarray", "tables", f"reading {path.name!r}")
    import xarray

    with open(path, "rb") as file:
        classic = file.read(3) == b"CDF"
    if not classic:
        need("h5netcdf", "tables", f"reading {path.name!r}")
        _check_mark(path, "NetCDF file")
        _read_apart("look", path, "NetCDF file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            engine: Any = "scipy" if classic else "h5netcdf"
            with xarray.open_dataset(path, engine=engine) as dataset:
                check_size(path, int(dataset.nbytes))
                dataset.load()
    except InputError:
        raise
    except Exception as error:  # h5netcdf, scipy and xarray each have their own
        raise unreadable(path, "NetCDF file", error) from None
    return from_xarray(dataset, path.name)


def from_xarray(source: Any, label: str) -> Columns:
    """Give the columns of a Dataset or DataArray of xarray.

    Parameters
    ----------
    source : its rows are the dimension that is called a time or holds dates, or the longest one.
        Along a dimension that counts runs there is one trajectory a value, and what runs along it
        alone has one value in each; along other dimensions there is one column a value.
    label : what messages call it.

    Raises InputError when no variable has rows.
    """
    if hasattr(source, "to_dataset"):
        source = source.to_dataset(name=str(source.name or "x"))
    if not source.sizes:
        raise InputError(f"{label} has no dimensions; it needs times and states")
    rows = _row_dimension(source)
    if not source.sizes[rows]:
        raise InputError(f"{label} has no rows; it needs rows of times and states")
    along = {d for value in source.variables.values() if rows in value.dims for d in value.dims}
    over = [d for d in source.sizes if d in along - {rows} and _RUNS.fullmatch(str(d))]
    others = [
        n for n, v in source.variables.items() if rows not in v.dims and n not in source.sizes
    ]
    # What has one value for each run, such as what was set in it.
    each = [n for n in others if source[n].dims and set(source[n].dims) <= set(over)]
    left_out = {str(n): f"does not run along {rows!r}" for n in others if n not in each}
    blocks: list[dict[str, np.ndarray]] = []
    for chosen in np.ndindex(*(source.sizes[d] for d in over)):
        block = source.isel(dict(zip(over, chosen, strict=True)))
        named = {
            str(d): block[d].item() if d in source.coords else int(i) + 1
            for d, i in zip(over, chosen, strict=True)
        }
        columns = _block_columns(block, rows)
        count = source.sizes[rows]
        named |= {str(name): block[name].item() for name in each}
        blocks.append({**{k: np.full(count, v) for k, v in named.items()}, **columns})
    names = list(blocks[0])
    if len(names) <= len(over) + len(each):
        raise InputError(f"{label} has no variables along {rows!r}; it needs times and states")
    units = [str(source[n].attrs.get("units", "")) if n in source else "" for n in names]
    found = assemble(
        names, [np.concatenate([b[n] for b in blocks]) for n in names], label, units=units
    )
    return without(found, left_out)


def _row_dimension(source: Any) -> Any:
    dates = [d for d in source.sizes if d in source.coords and source[d].dtype.kind in "mM"]
    called = [d for d in source.sizes if _TIME.fullmatch(str(d))]
    return (dates or called or [max(source.sizes, key=lambda d: source.sizes[d])])[0]


def _block_columns(block: Any, rows: Any) -> dict[str, np.ndarray]:
    """Give the columns of one run: the row coordinate first, then each variable along the rows."""
    found: dict[str, np.ndarray] = {}
    if rows in block.coords:
        found[str(rows)] = block[rows].to_numpy()
    several = sum(rows in value.dims and value.ndim > 1 for value in block.data_vars.values())
    for name in [*block.coords, *block.data_vars]:
        value = block[name]
        if rows not in value.dims or name == rows:
            continue
        others = [d for d in value.dims if d != rows]
        table = value.transpose(rows, *others).to_numpy().reshape(block.sizes[rows], -1)
        for j, index in enumerate(np.ndindex(*(block.sizes[d] for d in others))):
            parts = [
                str(block[d].to_numpy()[i]) if d in block.coords else str(i + 1)
                for d, i in zip(others, index, strict=True)
            ]
            bare = not any(d in block.coords for d in others)
            text = all(d in block.coords and block[d].dtype.kind in "OUT" for d in others)
            alone = bool(others) and text and several == 1
            own = "_".join(parts if alone else [str(name), *parts])
            own = f"{name}{'_'.join(parts)}" if bare else own
            found[own] = table[:, j]
    return found
