"""Delimited text: guess encoding, delimiter, decimal mark and header; read in chunks."""

from __future__ import annotations

import codecs
import csv
import gzip
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.data.columns import Columns, generated_names
from dynsr.errors import InputError

_HEAD_BYTES = 1 << 16
_CHUNK_ROWS = 500_000
# The comma comes last: it may be the decimal mark of a table that another sign delimits.
_DELIMITERS = ("\t", ";", "|", ",")
_MAGIC = {b"PK\x03\x04": "a zip or Excel file", b"\x89PNG": "a picture", b"%PDF": "a PDF"}


@dataclass(frozen=True)
class Layout:
    """How a table is written: delimiter, decimal mark, names (or None), rows before the data."""

    delimiter: str
    decimal: str
    names: tuple[str, ...] | None
    skip: int
    width: int


def read_delimited(path: Path) -> Columns:
    """Read a table of delimited text; every cell that is no number stays as text.

    Raises InputError, in one line, when the file is binary, has no rows, or its rows differ in
    length.
    """
    head, whole = _read_head(path)
    encoding, note = _guess_encoding(head, path)
    text = head.decode(encoding, errors="replace")
    lines = text.splitlines() if whole else text.splitlines()[:-1]
    layout = guess_layout(lines, path.name)
    try:
        values = _read_values(path, layout, encoding)
    except UnicodeDecodeError:
        note = f"{path.name!r} is not UTF-8; it was read as Latin-1, so check the names"
        values = _read_values(path, layout, "latin-1")
    names = layout.names or generated_names(layout.width)
    kept, values = _drop_empty(names, values)
    _check_duplicates(kept, path.name)
    return Columns(
        tuple(kept),
        tuple(values),
        path.name,
        notes=(note,) if note else (),
        named=layout.names is not None,
    )


def _read_head(path: Path) -> tuple[bytes, bool]:
    opener: Any = gzip.open if path.suffix.lower() == ".gz" else open
    try:
        with opener(path, "rb") as file:
            head = file.read(_HEAD_BYTES)
            return head, not file.read(1)
    except (OSError, EOFError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot read {str(path)!r}: {reason}") from None


def _guess_encoding(head: bytes, path: Path) -> tuple[str, str]:
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            raise InputError(f"{path.name!r} is {kind}, not a table; save the data as CSV")
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16", ""
    if b"\0" in head or sum(byte < 9 for byte in head) > len(head) / 100:
        raise InputError(
            f"{path.name!r} is binary, not text; give CSV, TSV, Parquet (.parquet) or .npz"
        )
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
        return "utf-8-sig", ""
    except UnicodeDecodeError as error:
        return "latin-1", (
            f"{path.name!r} is not UTF-8 (byte {error.start + 1}); it was read as Latin-1, "
            "so check the names"
        )


def guess_layout(lines: Sequence[str], label: str) -> Layout:
    """Guess how a table is written from its first lines.

    >>> guess_layout(["time;x", "0,5;1", "1,5;2"], "a.csv")
    Layout(delimiter=';', decimal=',', names=('time', 'x'), skip=1, width=2)
    """
    numbered = [
        (number, line)
        for number, line in enumerate(lines)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not numbered:
        raise InputError(f"{label!r} holds no rows; it needs rows of times and states")
    delimiter = _guess_delimiter([line for _, line in numbered[:200]])
    rows = [split_cells(line, delimiter) for _, line in numbered[:200]]
    decimal = _guess_decimal(rows, delimiter)
    names: list[str] | None = None
    skip = 0
    if _is_header(rows[0], decimal):
        names, skip = rows[0], numbered[0][0] + 1
    else:
        names = _comment_header(lines[: numbered[0][0]], delimiter, len(rows[0]))
    data = rows[1:] if skip else rows
    if not data:
        raise InputError(f"{label!r} has a header but no rows; it needs rows of times and states")
    _check_width(names, data[0], label, numbered[0][1])
    return Layout(delimiter, decimal, tuple(names) if names else None, skip, len(data[0]))


def _guess_delimiter(lines: Sequence[str]) -> str:
    for delimiter in _DELIMITERS:
        count, share = Counter(line.count(delimiter) for line in lines).most_common(1)[0]
        if count and share >= 0.7 * len(lines):
            return delimiter
    for delimiter in _DELIMITERS:  # ragged rows: any delimiter that nearly every row has
        if sum(delimiter in line for line in lines) >= 0.7 * len(lines):
            return delimiter
    return r"\s+"


def split_cells(line: str, delimiter: str) -> list[str]:
    """Split one line, honouring quotes."""
    if delimiter == r"\s+":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(",", ".") if decimal == "," else cell)
        return True
    except ValueError:
        return False


def _guess_decimal(rows: Sequence[Sequence[str]], delimiter: str) -> str:
    cells = [cell for row in rows[1:] for cell in row if "," in cell or "." in cell]
    commas = sum(not _is_number(cell, ".") and _is_number(cell, ",") for cell in cells)
    return "," if delimiter != "," and commas > len(cells) / 2 else "."


def _is_header(row: Sequence[str], decimal: str) -> bool:
    cells = [cell for cell in row if cell]
    text = sum(not _is_number(cell, decimal) for cell in cells)
    return bool(text) and 2 * text >= len(cells)


def _comment_header(lines: Sequence[str], delimiter: str, width: int) -> list[str] | None:
    """Take the last comment above the data as the header when it has as many cells."""
    for line in reversed([line for line in lines if line.strip()]):
        cells = split_cells(line.lstrip("# "), delimiter)
        return cells if len(cells) == width and _is_header(cells, ".") else None
    return None


def _check_width(names: Sequence[str] | None, row: Sequence[str], label: str, first: str) -> None:
    if names and len(names) != len(row):
        raise InputError(
            f"the header of {label!r} names {len(names)} columns but row 1 has {len(row)} cells; "
            "use one delimiter throughout and one name a column"
        )
    if len(row) == 1 and not _is_number(row[0], "."):
        raise InputError(
            f"cannot tell the columns of {label!r} apart (first line {first[:40]!r}); "
            "separate cells by comma, tab, semicolon, | or spaces"
        )


def _read_values(path: Path, layout: Layout, encoding: str) -> list[np.ndarray]:
    parts: list[list[np.ndarray]] = [[] for _ in range(layout.width)]
    for chunk in _chunks(path, layout, encoding):
        if len(chunk.columns) != layout.width:
            raise InputError(
                f"the rows of {path.name!r} have {len(chunk.columns)} cells where "
                f"{layout.width} are expected; give every row one cell a column"
            )
        for part, name in zip(parts, chunk.columns, strict=True):
            values = chunk[name].to_numpy()
            number = values.dtype.kind in "fiub"
            part.append(values.astype(float) if number else values.astype(object))
    return [np.concatenate(part) for part in parts]


def _exact_floats(version: str) -> dict[str, str]:
    """Ask for correctly rounded numbers; from pandas 3.1 on they are, and asking is deprecated."""
    major, minor = map(int, version.split(".")[:2])
    return {} if (major, minor) >= (3, 1) else {"float_precision": "round_trip"}


def _chunks(path: Path, layout: Layout, encoding: str) -> Iterator[Any]:
    import pandas

    try:
        with pandas.read_csv(
            path,
            sep=layout.delimiter,
            decimal=layout.decimal,
            header=None,
            skiprows=layout.skip,
            comment="#",
            encoding=encoding,
            skipinitialspace=layout.delimiter != r"\s+",
            low_memory=False,
            chunksize=_CHUNK_ROWS,
            **_exact_floats(pandas.__version__),
        ) as chunks:
            yield from chunks
    except pandas.errors.EmptyDataError:
        raise InputError(
            f"{path.name!r} holds no rows; it needs rows of times and states"
        ) from None
    except pandas.errors.ParserError as error:
        reason = str(error).strip().splitlines()[-1].removeprefix("Error tokenizing data. ")
        raise InputError(
            f"cannot read the rows of {path.name!r}: {reason.removeprefix('C error: ')}; "
            "give every row one cell a column"
        ) from None


def _drop_empty(
    names: Sequence[str], values: list[np.ndarray]
) -> tuple[list[str], list[np.ndarray]]:
    """Drop nameless columns without a value, which a delimiter at the end of each row makes."""
    kept = [
        j
        for j, name in enumerate(names)
        if name or not (values[j].dtype.kind == "f" and np.isnan(values[j]).all())
    ]
    return [names[j] for j in kept], [values[j] for j in kept]


def _check_duplicates(names: Sequence[str], label: str) -> None:
    duplicates = sorted({name for name in names if name and names.count(name) > 1})
    if duplicates:
        raise InputError(f"column name {duplicates[0]!r} is used twice in {label!r}; rename one")
