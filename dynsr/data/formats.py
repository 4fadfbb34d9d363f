"""Formats: tables in files that are no text, and datasets of xarray; none runs what it holds."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.data.assembling import (
    Columns,
    assemble,
    check_size,
    load_array,
    load_frame,
    load_mapping,
    unreadable,
)
from dynsr.data.layout import Row, rows_that_are_none, search_layout
from dynsr.data.scientific import fit_rows, load_hdf5, load_mat, load_netcdf, without
from dynsr.data.text import is_comment
from dynsr.errors import InputError, need

_FEWEST = 8


def load_numpy(path: Path, decimal: str | None = None) -> Columns:
    """Load an ``.npz`` archive or an ``.npy`` array of plain numbers or text."""
    kind = "NumPy array" if path.suffix.lower() == ".npy" else "npz archive"
    try:
        with open(path, "rb") as file:
            if path.suffix.lower() == ".npy":
                check_size(path, _array_size(file, path.stat().st_size))
                file.seek(0)
                return load_array(np.load(file, allow_pickle=False), path.name)
            check_size(path, _zip_size(file))
            file.seek(0)
            with zipfile.ZipFile(file) as members:
                for member in members.infolist():
                    with members.open(member) as inside:
                        check_size(path, _array_size(inside, member.file_size))
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
    except InputError:
        raise
    except Exception as error:  # zip, zlib, NumPy and tokenize each have their own
        raise unreadable(path, kind, error) from None
    arrays, left_out = fit_rows(arrays)
    return without(load_mapping(arrays, path.name, decimal), left_out)


def _zip_size(file: Any) -> int:
    with zipfile.ZipFile(file) as archive:
        return sum(member.file_size for member in archive.infolist())


def _array_size(file: Any, size: int) -> int:
    """Give the bytes that the header of an array promises; raises ValueError beyond the file."""
    version = np.lib.format.read_magic(file)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(file)
    promised = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if promised > size and not dtype.hasobject:
        raise ValueError("the array is cut")
    return promised


def load_excel(path: Path, decimal: str | None = None) -> Columns:
    """Load the first sheet of a spreadsheet that has a table."""
    need("python_calamine", "tables", f"reading {path.name!r}")
    import python_calamine

    try:
        if zipfile.is_zipfile(path):
            check_size(path, _zip_size(path))
        with python_calamine.CalamineWorkbook.from_path(path) as book:
            sheets = {name: book.get_sheet_by_name(name).to_python() for name in book.sheet_names}
    except InputError:
        raise
    except Exception as error:  # zip, XML and calamine each have their own
        raise unreadable(path, "spreadsheet", error) from None
    tables = {name: found for name, rows in sheets.items() if (found := _sheet(rows)) is not None}
    if not tables:
        raise InputError(f"no sheet of {path.name!r} contains a table; it needs times and states")
    large = [name for name, (_, rows) in tables.items() if len(rows) >= _FEWEST]
    chosen = large[0] if large else max(tables, key=lambda name: len(tables[name][1]))
    layout, rows = tables[chosen]
    notes = []
    if len(tables) > 1:
        others = ", ".join(repr(name) for name in tables if name != chosen)
        notes.append(f"sheet {chosen!r} of {path.name} was read, not {others}")
    if layout.skipped:
        first, last = layout.skipped[0] + 1, layout.skipped[-1] + 1
        count = f"row {first}" if first == last else f"rows {first} to {last}"
        notes.append(f"{count} of {path.name} above its table have no data; skipped")
    width = max(len(layout.names), *map(len, rows))
    columns = [
        np.array([_cell(row[j]) if j < len(row) else None for row in rows] + [None], dtype=object)
        for j in range(width)
    ]
    columns = [column[:-1] for column in columns]
    names = [*layout.names, *[""] * (width - len(layout.names))] if layout.names else []
    none, said = rows_that_are_none(columns, path.name)
    return assemble(
        names,
        [column[~none] for column in columns],
        path.name,
        units=layout.units,
        notes=(*notes, *said),
        decimal=decimal,
    )


def _sheet(rows: Sequence[Sequence[Any]]) -> tuple[Any, Sequence[Sequence[Any]]] | None:
    """Find the table in a sheet; None where there is none of two columns."""

    def row(place: int) -> Row:
        cells = list(rows[place])
        comment = bool(cells) and isinstance(cells[0], str) and is_comment(cells[0])
        if comment and cells[0].strip() != "#":
            cells[0] = cells[0].lstrip("#%/ ")
        return Row(cells, place, comment and cells[0].strip() != "#")

    places = [j for j, cells in enumerate(rows) if any(cell not in ("", None) for cell in cells)]
    found = search_layout(row, places)
    if found is None or found.first >= len(rows):
        return None
    body = rows[found.first :]
    return (found, body) if max(map(len, body)) > 1 else None


def _cell(cell: Any) -> Any:
    return None if cell == "" else cell


def load_parquet(path: Path, decimal: str | None = None) -> Columns:
    """Load the columns of a Parquet file."""
    need("pyarrow", "tables", f"reading {path.name!r}")
    import pandas
    import pyarrow.parquet

    try:
        meta = pyarrow.parquet.ParquetFile(path).metadata
        # Runs of one value need no room in the file.
        check_size(path, 8 * meta.num_rows * meta.num_columns)
        check_size(path, sum(meta.row_group(j).total_byte_size for j in range(meta.num_row_groups)))
        frame = pandas.read_parquet(path)
    except InputError:
        raise
    except Exception as error:  # pyarrow raises a family of its own for damaged files
        raise unreadable(path, "Parquet file", error) from None
    return load_frame(frame, path.name, decimal)


READERS: Mapping[str, Callable[[Path, str | None], Columns]] = {
    **dict.fromkeys((".npz", ".npy"), load_numpy),
    **dict.fromkeys((".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"), load_excel),
    ".mat": load_mat,
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".he5"), load_hdf5),
    **dict.fromkeys((".nc", ".nc4", ".cdf", ".netcdf"), load_netcdf),
    **dict.fromkeys((".parquet", ".pq"), load_parquet),
}
