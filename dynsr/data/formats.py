"""Formats: tables in files that are no text, and datasets of xarray; none runs what it holds."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
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
    upright,
)
from dynsr.data.layout import Row, rows_that_are_none, search_layout, settings_of_wells
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


_BOOKS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")


def split_sheet(path: Path) -> tuple[Path, str]:
    """Give the file and the sheet that ``book.xlsx:Sheet 2`` names; "" where it names none.

    >>> split_sheet(Path("data/book.xlsx:Sheet 2"))[1], split_sheet(Path("book.xlsx"))[1]
    ('Sheet 2', '')
    """
    file, colon, sheet = path.name.partition(":")
    named = bool(colon) and Path(file).suffix.lower() in _BOOKS and not path.exists()
    return (path.with_name(file), sheet) if named else (path, "")


def load_excel(path: Path, decimal: str | None = None, sheet: str = "") -> Columns:
    """Load a sheet of a spreadsheet; by default the first one that has a table."""
    need("python_calamine", "tables", f"reading {path.name!r}")
    import python_calamine

    try:
        if zipfile.is_zipfile(path):
            check_size(path, _zip_size(path))
        with python_calamine.CalamineWorkbook.from_path(path) as book:
            names = list(book.sheet_names)
            if sheet and sheet not in names:
                raise InputError(
                    f"{path.name!r} has no sheet {sheet!r}; the sheets are: {', '.join(names)}"
                )
            wanted = [sheet] if sheet else names
            sheets = {name: book.get_sheet_by_name(name).to_python() for name in wanted}
    except InputError:
        raise
    except Exception as error:  # zip, XML and calamine each have their own
        raise unreadable(path, "spreadsheet", error) from None
    tables = {name: found for name, rows in sheets.items() if (found := _sheet(rows)) is not None}
    if not tables:
        which = f"sheet {sheet!r} of {path.name!r} does not contain" if sheet else ""
        which = which or f"no sheet of {path.name!r} contains"
        raise InputError(f"{which} a table; it needs times and states")
    large = [name for name, (_, rows) in tables.items() if len(rows) >= _FEWEST]
    chosen = large[0] if large else max(tables, key=lambda name: len(tables[name][1]))
    layout, rows = tables[chosen]
    above, skipped = settings_of_wells(lambda j: sheets[chosen][j], layout)
    notes = []
    if len(tables) > 1:
        others = ", ".join(repr(name) for name in tables if name != chosen)
        own = [n for n, (found, _) in tables.items() if n != chosen and found.names == layout.names]
        other = own[0] if own else next(name for name in tables if name != chosen)
        again = "read as one more run" if own else "read"
        notes.append(
            f"sheet {chosen!r} of {path.name} was read, not {others}; {path.name + ':' + other!r} "
            f"is {again} where it is given as a file"
        )
    if skipped:
        first, last = skipped[0] + 1, skipped[-1] + 1
        count = f"row {first}" if first == last else f"rows {first} to {last}"
        have = "has" if first == last else "have"
        notes.append(f"{count} of {path.name} above its table {have} no data; skipped")
    width = max(len(layout.names), *map(len, rows))
    columns = [
        np.array([_cell(row[j]) if j < len(row) else None for row in rows] + [None], dtype=object)
        for j in range(width)
    ]
    columns = [column[:-1] for column in columns]
    names = [*layout.names, *[""] * (width - len(layout.names))] if layout.names else []
    # Of a book with one sheet the name of the file says all.
    label = f"{path.name}:{chosen}" if len(names) > 1 else path.name
    none, said = rows_that_are_none(columns, label)
    table = assemble(
        names,
        [column[~none] for column in columns],
        label,
        units=layout.units,
        notes=(*notes, *said),
        decimal=decimal,
    )
    return replace(table, above=above)


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

    def read() -> Any:
        import pandas
        import pyarrow.parquet

        meta = pyarrow.parquet.ParquetFile(path).metadata
        # Runs of one value need no room in the file.
        check_size(path, 8 * meta.num_rows * meta.num_columns)
        check_size(path, sum(meta.row_group(j).total_byte_size for j in range(meta.num_row_groups)))
        return pandas.read_parquet(path)

    return _load_arrow(path, "Parquet file", read, decimal)


def load_feather(path: Path, decimal: str | None = None) -> Columns:
    """Load the columns of a Feather file."""

    def read() -> Any:
        import pandas

        check_size(path, path.stat().st_size)
        return pandas.read_feather(path)

    return _load_arrow(path, "Feather file", read, decimal)


def _load_arrow(path: Path, what: str, read: Callable[[], Any], decimal: str | None) -> Columns:
    """Load the columns of the frame that pyarrow reads."""
    need("pyarrow", "tables", f"reading {path.name!r}")
    try:
        frame = read()
    except InputError:
        raise
    except Exception as error:  # pyarrow raises a family of its own for damaged files
        raise unreadable(path, what, error) from None
    return load_frame(frame, path.name, decimal)


def load_stata(path: Path, decimal: str | None = None) -> Columns:
    """Load the columns of a Stata file."""
    import pandas

    try:
        frame = pandas.read_stata(path, convert_categoricals=False)
    except Exception as error:  # struct, Unicode and pandas each have their own
        raise unreadable(path, "Stata file", error) from None
    return load_frame(frame, path.name, decimal)


def load_json(path: Path, decimal: str | None = None) -> Columns:
    """Load a table in JSON: columns by name, or one object for each row, or for each line.

    It may be in an object next to what else is said of it.
    """
    try:
        text = path.read_text("utf-8-sig")
        if path.suffix.lower() in (".jsonl", ".ndjson"):
            found = [json.loads(line) for line in text.splitlines() if line.strip()]
        else:
            found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise unreadable(path, "JSON file", error) from None
    columns = _table_in(found, path.name, decimal)
    if columns is None:
        raise InputError(
            f"{path.name!r} has no table; give columns of equal length by name, or a list of "
            "objects, one for each row"
        )
    return columns


def _table_in(found: Any, label: str, decimal: str | None) -> Columns | None:
    """Give the table that is in a value of JSON, or in the one of its values that has one."""
    import pandas

    if isinstance(found, list) and found and all(isinstance(row, list) for row in found):
        widths = {*map(len, found)}
        flat = not any(isinstance(cell, (list, dict)) for row in found for cell in row)
        return load_array(np.array(found), label) if flat and len(widths) == 1 else None
    if isinstance(found, list):
        rows = bool(found) and all(isinstance(row, dict) for row in found)
        if rows and len(found) == 1 and (own := _table_in(found[0], label, decimal)) is not None:
            return own
        return load_frame(frame_of_rows(found), label, decimal) if rows else None
    if not isinstance(found, dict):
        return None
    parts = list(found.values())
    names, cells = found.get("columns"), found.get("data", found.get("values"))
    if isinstance(names, list) and isinstance(cells, list):  # as pandas, and databases, write it
        same = all(isinstance(row, list) and len(row) == len(names) for row in cells)
        return load_frame(pandas.DataFrame(cells, columns=names), label, decimal) if same else None
    lists = {name: part for name, part in found.items() if isinstance(part, list) and part}
    lists = upright(lists)
    cells = [cell for part in lists.values() for cell in part]
    if len({*map(len, lists.values())}) == 1 and not any(isinstance(c, dict) for c in cells):
        return load_mapping(lists, label, decimal)
    inside = [cell for part in parts if isinstance(part, dict) for cell in part.values()]
    plain = inside and not any(isinstance(cell, (list, dict)) for cell in inside)
    if plain and all(isinstance(part, dict) for part in parts):
        # Rows have numbers, columns names.
        by_row = all(map(str.isdigit, found)) and not any(map(str.isdigit, parts[0]))
        frame = pandas.DataFrame.from_dict(found, orient="index" if by_row else "columns")
        return load_frame(frame.reset_index(drop=True) if by_row else frame, label, decimal)
    tables = [own for part in parts if (own := _table_in(part, label, decimal)) is not None]
    long = [own for own in tables if own.rows >= _FEWEST] or tables
    return long[0] if len(long) == 1 else None


def frame_of_rows(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Give a frame of rows by name; an object in a cell is columns of its own.

    Parameters
    ----------
    rows : name -> cell, such as ``{"t": 0, "sensor": {"x": 1}}``, which has the columns t and
        sensor_x. Where cells are lists of one length, each is a row of its own, next to the other
        cells, as ``{"run": "a", "t": [0, 1], "x": [5, 3]}``. So are pairs of a time and a value,
        as databases of monitors write them: ``{"name": "load", "values": [[0, 5], [15, 3]]}``.
    """
    import pandas

    nested = any(isinstance(cell, Mapping) for row in rows for cell in row.values())
    frame = pandas.json_normalize(list(rows), sep="_") if nested else pandas.DataFrame(rows)
    frame = _with_pairs_apart(frame)
    lists = [n for n in frame if all(isinstance(cell, list) for cell in frame[n])]
    alike = all(len({*map(len, own)}) == 1 for own in zip(*(frame[n] for n in lists), strict=True))
    return frame.explode(lists, ignore_index=True).infer_objects() if lists and alike else frame


def _with_pairs_apart(frame: Any) -> Any:
    """Give a frame with times and values in the place of the one column of lists of pairs."""

    def is_pairs(cell: Any) -> bool:
        own = isinstance(cell, list) and bool(cell)
        return own and all(isinstance(pair, list) and len(pair) == 2 for pair in cell)

    def unevenness(place: int) -> float:
        """How many times the least step between numbers the largest is; inf for no times."""
        steps = [b - a for cell in cells for a, b in pairwise(pair[place] for pair in cell)]
        return max(steps) / min(steps) if steps and min(steps) > 0 else math.inf

    names = [name for name in frame if all(map(is_pairs, frame[name]))]
    if len(names) != 1 or {"time", "value"} & {*frame}:
        return frame
    cells = frame[names[0]]
    numbers = [
        place
        for place in (0, 1)
        if all(isinstance(pair[place], (int, float)) for cell in cells for pair in cell)
    ]
    # Values may rise too; times have steps that are more even.
    first = min(numbers, key=unevenness, default=0)
    if not numbers or math.isinf(unevenness(first)):
        return frame
    sides = {"time": first, "value": 1 - first}
    apart = {n: [[pair[j] for pair in cell] for cell in cells] for n, j in sides.items()}
    return frame.drop(columns=names).assign(**apart)


READERS: Mapping[str, Callable[[Path, str | None], Columns]] = {
    **dict.fromkeys((".npz", ".npy"), load_numpy),
    **dict.fromkeys(_BOOKS, load_excel),
    ".mat": load_mat,
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".he5"), load_hdf5),
    **dict.fromkeys((".nc", ".nc4", ".cdf", ".netcdf"), load_netcdf),
    **dict.fromkeys((".parquet", ".pq"), load_parquet),
    ".feather": load_feather,
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), load_json),
    ".dta": load_stata,
}
