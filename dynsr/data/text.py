"""Text: tables of delimited text, however an instrument, a program or a person writes them."""

from __future__ import annotations

import bz2
import codecs
import csv
import gzip
import io
import lzma
import os
import re
import warnings
import zipfile
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.data.assembling import MAX_BYTES, Columns, assemble, check_size, unreadable
from dynsr.data.blocks import find_blocks
from dynsr.data.brackets import may_be_bracketed, read_brackets
from dynsr.data.layout import (
    NUMBER,
    TEXT,
    Row,
    kind,
    rows_that_are_none,
    search_layout,
    settings_of_wells,
)
from dynsr.data.monitor import read_monitor
from dynsr.data.name_parts import bare_name
from dynsr.data.said_steps import find_said_step
from dynsr.data.times import is_time_name, unit_in_name
from dynsr.data.wrapping import unwrapped, without_colours
from dynsr.errors import InputError, quoted

_HEAD_BYTES = 1 << 16
_HEAD_LINES = 20
_LONGEST_LINE = 1 << 24
_LINE_END = re.compile(r"\r\n|\n|\r")
# A cell of a header has a name, a unit and little more on lines of its own.
_CELL_LINES = 5
# A name of a column that no reader takes for a number, a truth value or a missing one.
_NAME = re.compile(r"(?i)(?!(?:na|nan|null|none|inf|infinity|true|false)$)[A-Za-z_]\w*")
_PLAIN_BYTES = 1 << 22
_SPACE = r"\s+"
_DIGIT = re.compile(r"[0-9]")
# In order of preference where several tell the cells of the sample apart equally well.
_DELIMITERS = ("\t", ";", "|", ",", _SPACE)
# What is packed and damaged.
_BROKEN = (OSError, EOFError, zlib.error, lzma.LZMAError)
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_MAGIC = {
    b"PK\x03\x04": "a zip or Excel file, not text; name it .zip, .xlsx or .npz if it is one",
    b"\x89PNG": "a picture, not a table",
    b"%PDF": "a PDF, not a table",
    b"\x89HDF": "an HDF5 file, not text; name it .h5, .mat or .nc",
    b"\xd0\xcf\x11\xe0": "an old Excel file, not text; name it .xls",
}
_SEP = re.compile(r"\s*\"?sep=(.)\"?\s*", re.IGNORECASE)
# A line of remarks, but not one whose first cell is an error of a spreadsheet or a name "#". Julia
# says the size of an array above it, and GROMACS has lines for a plot.
_COMMENT = re.compile(
    r"\s*(#(?!N/A|NA\b|NV\b|DIV/0|VALUE|REF!|NUM!|NAME\?|NULL!|WERT|ZAHL|BEZUG|\d)|%|//"
    r"|@(?!\d)|\d+\u00d7\d+ .*:\s*$)"
)
_REMARKS = re.compile(r"(comment|remark|note|bemerkung|kommentar|remarque)s?", re.IGNORECASE)
_MARK = re.compile(r"^\s*(#|%|//)+\s*")
# Columns of an oscilloscope that say its times in a row of their own.
_STEPS = ("start", "increment")


def load_delimited(path: Path, decimal: str | None = None) -> Columns:
    """Read a table of delimited text; every cell that says no number stays as text.

    Parameters
    ----------
    path : the file, packed where its name ends in .gz, .bz2 or .xz, alone in an archive where it
        ends in .zip.
    decimal : the decimal mark, "." or ","; found by default.

    Raises InputError when no table can be recognised in it.
    """
    head, cut = _read_head(path)
    plain = _load_plain(path) if decimal in (None, ".") else None
    if plain is not None:
        return plain
    if _first_of_monitor(path, head):
        check_size(path, _unpacked_size(path))
        with _opener(path)(path, "rt", encoding=_encoding(head), errors="replace") as file:
            found = read_monitor(map(without_colours, file), path.name)
        if found is not None:
            return found
    if (array := _load_array(path, head)) is not None:
        return array
    try:
        return _load_text(path, _Head.of(path, head, cut), decimal)
    except UnicodeDecodeError:
        # A few letters of a header are all that tells the encoding of a table of numbers, too few
        # for charset-normalizer: it reads a Latin-1 "é" as Arabic and "µm" as Big5.
        note = f"{path.name!r} is not UTF-8; it was read as Latin-1, so check the names"
        found = _load_text(path, _Head(path.name, head, cut, "latin-1"), decimal)
        return replace(found, notes=(note, *found.notes))


def read_header(path: Path) -> tuple[str, ...]:
    """Give the names of the columns of a text; only its first lines are read."""
    head, cut = _read_head(path)
    if printed := _first_of_monitor(path, head) or _load_array(path, head):
        return printed.names
    return tuple(_Head.of(path, head, cut).layout.names)


def _first_of_monitor(path: Path, head: bytes) -> Columns | None:
    """Read the first lines as those that a program printed."""
    text = without_colours(head.decode(_encoding(head), errors="replace"))
    return read_monitor(_LINE_END.split(text)[:_HEAD_LINES], path.name)


def _load_array(path: Path, head: bytes) -> Columns | None:
    """Read a text that is an array in brackets; None where it is anything else."""
    lines = _LINE_END.split(head.decode(_encoding(head), errors="replace"))
    if not may_be_bracketed("\n".join(lines[:_HEAD_LINES])):
        return None
    check_size(path, _unpacked_size(path))
    with _opener(path)(path, "rt", encoding=_encoding(head), errors="replace") as file:
        found = read_brackets(file.read(), path.name)
    if found is None:
        return None
    return assemble(list(found.names), list(found.values.T), path.name)


def _encoding(head: bytes) -> str:
    return "utf-16" if head.startswith(_UTF16) else "utf-8-sig"


def _load_plain(path: Path) -> Columns | None:
    """Read a small file of names and numbers between commas; None where it may be anything else.

    Most files are of this kind, and NumPy reads them before pandas is imported.
    """
    try:
        if path.stat().st_size > _PLAIN_BYTES:
            return None
        header, _, body = path.read_bytes().partition(b"\n")
        names = header.decode("ascii").rstrip("\r").split(",")
        if len(names) < 2 or body.translate(None, b"0123456789.,eE+-\r\n"):
            return None
        if not body.strip() or not all(map(_NAME.fullmatch, names)):
            return None
        table = np.loadtxt(io.BytesIO(body), delimiter=",", comments=None, ndmin=2)
    except (OSError, ValueError):  # not ASCII, or no table
        return None
    if table.shape[1] != len(names) or len(set(names)) < len(names):
        return None
    # Whole numbers might be rounded, and have no -0.
    if np.any(np.abs(table) > 2**53) or np.any((table == 0) & np.signbit(table)):
        return None
    columns = tuple(table.T.copy())
    return None if find_blocks(names, columns) else Columns(tuple(names), columns, path.name)


def _opener(path: Path) -> Any:
    packed = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open, ".zip": _open_member}
    return packed.get(path.suffix.lower(), open)


@contextmanager
def _open_member(path: Path, mode: str, **options: Any) -> Iterator[Any]:
    """Open the only file in a zip archive; raises InputError where it holds others."""
    try:
        with zipfile.ZipFile(path) as archive:
            # What a Mac adds is no file of the user's.
            members = [
                member
                for member in archive.infolist()
                if not member.is_dir() and not member.filename.startswith("__MACOSX/")
            ]
            if len(members) != 1:
                names = ", ".join(member.filename for member in members[:4])
                raise InputError(
                    f"{path.name!r} holds {len(members)} files ({names}); "
                    "unpack it and give those to read"
                )
            check_size(path, members[0].file_size)
            with archive.open(members[0]) as file:
                yield io.TextIOWrapper(file, **options) if mode == "rt" else file
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise unreadable(path, "zip archive", error) from None


def _read_head(path: Path) -> tuple[bytes, bool]:
    """Read the first lines of a file, and say whether the last of them may be cut."""
    try:
        with _opener(path)(path, "rb") as file:
            head: bytes = file.read(_HEAD_BYTES)
            cut = len(head) == _HEAD_BYTES
            # The lines of a table with thousands of columns are long.
            while cut and max(map(head.count, (b"\n", b"\r"))) < _HEAD_LINES:
                more = file.read(len(head))
                cut = len(more) == len(head)
                head += more
                _check_line(path, len(head) - max(map(head.rfind, (b"\n", b"\r"))))
    except _BROKEN as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot read {str(path)!r}: {reason}") from None
    for magic, what in _MAGIC.items():
        if head.startswith(magic):
            raise InputError(f"{path.name!r} is {what}; or save the data as CSV")
    controls = sum(byte < 9 for byte in head[:_HEAD_BYTES])
    if not head.startswith(_UTF16) and (b"\0" in head or controls > len(head) / 100):
        raise InputError(
            f"{path.name!r} is binary, not text; give CSV, TSV, Excel (.xlsx), Parquet (.parquet), "
            "MATLAB (.mat), HDF5 (.h5), NetCDF (.nc) or .npz"
        )
    return head, cut


class _Head:
    """What the first lines of a text show: the delimiter, and where the table is.

    ``whole`` is the text where it is not as in the file.
    """

    whole: str | None = None

    @classmethod
    def of(cls, path: Path, head: bytes, cut: bool) -> _Head:
        """Look at a file by its head; of a table in a wrapping, at all of it without that."""
        encoding = _encoding(head)
        take = unwrapped(head.decode(encoding, errors="replace"))
        if take is None:
            return cls(path.name, head, cut, encoding)
        check_size(path, _unpacked_size(path))
        with _opener(path)(path, "rt", encoding=encoding, errors="replace") as file:
            whole = take(file.read()) + "\n"
        found = cls(path.name, whole.encode(), False, "utf-8")
        found.whole = whole
        return found

    def __init__(self, label: str, head: bytes, cut: bool, encoding: str) -> None:
        # Not splitlines(), for which a form feed or U+0085 ends a line too.
        self.lines = _LINE_END.split(head.decode(encoding, errors="replace"))
        self.encoding = encoding
        if cut:
            self.lines.pop()
        _join_quoted(self.lines)
        places = [j for j, line in enumerate(self.lines) if line.strip()]
        told = _SEP.fullmatch(self.lines[places[0]].lstrip("\ufeff")) if places else None
        if told:
            places = places[1:]
        places = [j for j in places if self.lines[j].strip(" #")]
        plain = [j for j in places if not is_comment(self.lines[j])]
        if not plain:
            raise InputError(f"{label!r} has no rows; it needs rows of times and states")
        self.delimiter = told[1] if told else _find_delimiter([self.lines[j] for j in plain])
        self.first_line = self.lines[plain[0]]
        found = search_layout(self._row, places)
        if found is None or found.first > plain[-1]:
            raise InputError(f"{label!r} has a header but no rows; it needs times and states")
        self.layout = found
        self.width = len(found.names) or len(_cells(self.lines[found.first], self.delimiter))

    def _row(self, place: int) -> Row:
        line = self.lines[place]
        comment = is_comment(line)
        if comment and line.lstrip()[1:2] == self.delimiter.strip() != "":
            comment = False  # a column that is called "#"
        text = _MARK.sub("", line) if comment else line
        if comment and self.delimiter == _SPACE:  # a unit in brackets goes with its name
            return Row(re.split(r"\s+(?![\[(])", text.strip()), place, comment)
        return Row(_cells(text, self.delimiter), place, comment)


def _join_quoted(lines: list[str]) -> None:
    """Put what is within a pair of quotation marks in its first line; the others are blank."""
    for j, line in enumerate(lines):
        if line.count('"') % 2 == 0 or is_comment(line):
            continue
        for end in range(j + 1, min(j + 1 + _CELL_LINES, len(lines))):
            if lines[end].count('"') % 2:
                lines[j] = " ".join(lines[j : end + 1])
                lines[j + 1 : end + 1] = [""] * (end - j)
                break


def is_comment(line: str) -> bool:
    """Whether a line is marked as a remark.

    >>> is_comment("# rig 3"), is_comment("#N/A,5"), is_comment("5 # well")
    (True, False, False)
    """
    return _COMMENT.match(line) is not None


def _cells(line: str, delimiter: str) -> list[str]:
    """Split a line as pandas does."""
    if delimiter == _SPACE:
        line, sign = line.strip().replace("\t", " "), " "
    else:
        sign = delimiter
    try:
        found = next(csv.reader([line], delimiter=sign, skipinitialspace=True), [])
    except csv.Error:  # a cell beyond the limit of that module, or an odd delimiter
        found = line.split(sign)
    return [cell.strip() for cell in found]


def _find_delimiter(lines: Sequence[str]) -> str:
    """Find the sign that makes most cells of most lines numbers or times.

    csv.Sniffer, pandas' own sniffing and clevercsv count signs and know nothing of numbers: they
    take the decimal comma of "0,5 1,5" for a delimiter.

    >>> _find_delimiter(["0,5;1", "1,5;2"])
    ';'
    """
    # The last lines at hand that hold a number: what stands above a table is at their beginning.
    sample = ([line for line in lines if _DIGIT.search(line)] or lines)[-_HEAD_LINES:]

    def score(delimiter: str) -> tuple[float, int, int]:
        shares: dict[int, list[float]] = defaultdict(list)
        for line in sample:
            cells = _cells(line, delimiter)
            if len(cells) == 1:
                continue
            row = Row(cells, 0)
            told = [k for k in row.kinds if k]
            # A text that holds another delimiter may be several cells.
            torn = sum(
                k == TEXT and any(sign in cell for sign in _DELIMITERS[:4])
                for k, cell in zip(row.kinds, row.cells, strict=True)
            )
            if told:
                shares[len(row.cells)].append((told.count(NUMBER) - torn) / len(told))
        found = [(sum(own), len(own), width) for width, own in shares.items()]
        share, count, width = max(found, default=(-1.0, 0, 1))
        return round(share, 9), count, width

    return max(_DELIMITERS, key=score)


def _load_text(path: Path, head: _Head, decimal: str | None) -> Columns:
    layout = head.layout
    frame, notes = _parse_file(path, head)
    if _shows_commas(frame):
        frame, notes = _parse_file(path, head, dtype=str)
    if frame.shape[1] == 1 and frame[0].dtype.kind not in "fiub":
        raise InputError(
            f"cannot separate the columns of {path.name!r} (first line "
            f"{quoted(head.first_line)}); separate cells by comma, tab, semicolon, | or spaces"
        )
    if tuple(name.lower() for name in layout.names if name)[-2:] == _STEPS:
        # What is said once, in a row of its own below the names, has no cell in the others.
        frame = frame.reindex(columns=range(max(frame.shape[1], len(layout.names))))
    names = _fit_names(path.name, head, frame)
    above, skipped = settings_of_wells(lambda j: _cells(head.lines[j], head.delimiter), layout)
    if skipped:
        first, last = skipped[0] + 1, skipped[-1] + 1
        count = f"line {first}" if first == last else f"lines {first} to {last}"
        have = "has" if first == last else "have"
        notes = (f"{count} of {path.name} above its table {have} no data; skipped", *notes)
    columns = [frame[j].to_numpy(None if frame[j].dtype.kind in "fiub" else object) for j in frame]
    names, columns, said = _with_increment(head, names, columns)
    notes = (*notes, *said)
    names, columns, said = _with_said_step(head, names, columns)
    notes = (*notes, *said)
    none, said = rows_that_are_none(columns, path.name)
    notes = (*notes, *said)
    columns = [column[~none] for column in columns]
    if not names and (lead := _leading(columns)):
        names, columns = [], columns[lead:]
        which = "column 1" if lead == 1 else f"columns 1 to {lead}"
        have = "has" if lead == 1 else "have"
        notes = (*notes, f"{which} of {path.name} {have} cells in few rows; left out")
    table = assemble(
        names,
        columns,
        path.name,
        # Row names have no unit.
        units=[*[""] * (len(names) == len(layout.units) + 1), *layout.units],
        notes=notes,
        decimal=decimal,
        delimiter=head.delimiter,
    )
    return replace(table, above=above)


def _leading(columns: Sequence[np.ndarray]) -> int:
    """Count the columns before the first one that has a cell in most rows.

    There oscilloscopes write their settings, next to the rows.
    """
    import pandas

    counts = [int(np.count_nonzero(~pandas.isna(column))) for column in columns]
    return next((j for j, count in enumerate(counts) if 2 * count > len(columns[j])), 0)


def _with_increment(
    head: _Head, names: list[str], columns: list[np.ndarray]
) -> tuple[list[str], list[np.ndarray], list[str]]:
    """Count the rows of an oscilloscope in seconds, where a row below the names says how.

    The columns Start and Increment are then empty in all other rows, as Rigol writes them.
    """
    lower = [name.lower() for name in names]
    if not {"x", *_STEPS} <= set(lower) or not head.layout.skipped:
        return names, columns, []
    cells = _cells(head.lines[head.layout.skipped[-1]], head.delimiter)
    at = {name: lower.index(name) for name in ("x", *_STEPS)}
    if len(cells) <= max(at.values()) or columns[at["x"]].dtype.kind not in "fiu":
        return names, columns, []
    try:
        start, step = (float(cells[at[name]]) for name in _STEPS)
    except ValueError:
        return names, columns, []
    if not (np.isfinite(start) and 0 < step < np.inf):
        return names, columns, []
    t = start + step * columns[at["x"]]
    own = [j for j, name in enumerate(lower) if name not in _STEPS]
    renamed = ["t [s]" if j == at["x"] else names[j] for j in own]
    said = f"{names[at['x']]!r} counts rows of {step:g} s from {start:g} s on"
    return renamed, [t if j == at["x"] else columns[j] for j in own], [said]


def _with_said_step(
    head: _Head, names: list[str], columns: list[np.ndarray]
) -> tuple[list[str], list[np.ndarray], list[str]]:
    """Count the rows in seconds where no column is called a time and a line says the rate."""
    timed = any(is_time_name(name) or unit_in_name(name) for name in map(bare_name, names) if name)
    said = None if timed or not names else find_said_step(head.lines[: head.layout.first])
    if said is None:
        return names, columns, []
    t = said[0] * np.arange(len(columns[0]))
    return ["t [s]", *names], [t, *columns], [f"rows are {said[0]:g} s apart: {quoted(said[1])}"]


def _fit_names(label: str, head: _Head, frame: Any) -> list[str]:
    """Fit the names to the columns: blanks within a name, delimiters and remarks behind the last.

    Raises InputError where a row has more numbers than there are names, or no row has as many.
    """
    names, width = list(head.layout.names), frame.shape[1]
    if head.layout.above and len(names) != width:
        names = []  # a comment that is no header
    if head.delimiter == _SPACE and names and len(names) != width:
        line = next((line for line in head.lines if _cells(line, _SPACE) == names), "")
        for pattern in (r"\s{2,}|\t", r"\s+(?![\[(])"):
            split = re.split(pattern, line.strip())
            if len(split) == width:
                return split
    if len(names) == width - 1 and _are_row_names(frame[0]):
        return ["", *names]
    # A last column of remarks may have no cell in any row.
    while len(names) > width and (not names[-1] or _REMARKS.fullmatch(names[-1])):
        names.pop()
    first = len(_cells(head.lines[head.layout.first], head.delimiter))
    wanted = len(names) or first
    for j in range(wanted, width):
        filled = frame[j].notna()
        # Remarks may stand behind the last column, numbers may not.
        if frame[j].dtype.kind in "fiub" and filled.any():
            row = int(filled.to_numpy().argmax())
            if row == 0:
                break
            raise InputError(
                f"row {row + 1} of {label!r} has {j + 1} cells or more, where there are {wanted} "
                "columns; give every row one cell a column"
            )
    else:
        if len(names) <= width:
            return [*names, *[""] * (width - len(names))] if names else []
    raise InputError(
        f"the header of {label!r} names {len(names)} columns but row 1 has "
        f"{first} cells; use one delimiter throughout and one name a column"
    )


def _are_row_names(column: Any) -> bool:
    """Whether a first column that has no name counts the rows, or names each, as R does."""
    if column.dtype.kind in "iu":
        return bool(np.all(np.diff(column) == 1))
    return column.dtype.kind not in "fb" and bool(column.notna().all() and column.is_unique)


def _shows_commas(frame: Any) -> bool:
    """Whether a comma is in a cell although other columns were read with a point as the mark."""
    texts = [j for j in frame if frame[j].dtype.kind not in "fiub"]
    points = any(frame[j].dtype.kind == "f" and frame[j].notna().any() for j in frame)
    return points and any(frame[j].str.contains(",", regex=False).any() for j in texts)


def _parse_file(path: Path, head: _Head, **options: Any) -> tuple[Any, tuple[str, ...]]:
    """Parse the rows of a file; raises InputError when one of them is lost."""
    named = len(head.layout.names)
    names = [cell for cell in head.layout.names if cell]

    @contextmanager
    def open_there() -> Iterator[Any]:
        with (
            _opener(path)(path, "rt", encoding=head.encoding)
            if head.whole is None
            else io.StringIO(head.whole)
        ) as file:
            # pandas itself would join lines that it skips where a comment holds a quotation mark.
            for _ in range(head.layout.first):
                file.readline()
            yield file

    def is_row(line: str) -> bool:
        return bool(line.strip())

    def is_remark(line: str) -> bool:
        cells = _cells(line, head.delimiter)
        if is_comment(line):
            return len(cells) != head.width or NUMBER not in map(kind, cells[1:])
        return bool(names) and [" ".join(cell.split()) for cell in cells if cell] == names

    try:
        check_size(path, _unpacked_size(path))
        with open_there() as file:
            count, width, odd = _count(file, head.delimiter, names[0] if names else "#")
        notes: tuple[str, ...] = ()
        with open_there() as file:
            if odd:
                lines = [line for line in file if is_row(line)]
                kept = [line for line in lines if not is_remark(line)]
                if len(kept) < len(lines):
                    few = len(lines) - len(kept)
                    what = "1 remark was" if few == 1 else f"{few} remarks were"
                    notes = (f"{what} skipped between the rows of {path.name}",)
                if not kept:
                    raise InputError(
                        f"{path.name!r} has no rows; it needs rows of times and states"
                    )
                count, file = len(kept), io.StringIO("".join(kept))
            frame = _parse_rows(file, head.delimiter, width, repr(path.name), **options)
        # The longest row may end in delimiters, or have one within quotation marks.
        while frame.shape[1] > max(named, 1) and frame[frame.shape[1] - 1].isna().all():
            frame = frame.drop(columns=frame.shape[1] - 1)
    except _BROKEN as error:
        raise unreadable(path, "table", error) from None
    if len(frame) < count and not _spans_lines(path, head, len(frame)):
        raise InputError(
            f"only {len(frame)} of {count} rows of {path.name!r} could be separated; "
            "remove quotation marks and odd characters from them"
        )
    return frame, notes


def _spans_lines(path: Path, head: _Head, rows: int) -> bool:
    """Whether rows are fewer than lines only since cells have line ends, and none has a row."""
    if head.delimiter == _SPACE:
        return False
    with _opener(path)(path, "rt", encoding=head.encoding, newline="") as file:
        for _ in range(head.layout.first):
            file.readline()
        try:
            found = [row for row in csv.reader(file, delimiter=head.delimiter) if any(row)]
        except csv.Error:
            return False
    within = [line for row in found for cell in row for line in cell.splitlines()[1:]]
    return len(found) >= rows and all(
        line.count(head.delimiter) + 1 < head.width for line in within
    )


def _unpacked_size(path: Path) -> int:
    """Count the bytes of a text, unpacked, and refuse lines without an end."""
    if path.suffix.lower() == ".gz":
        # A gzip file ends with the length of what was packed last.
        with open(path, "rb") as file:
            file.seek(-min(4, path.stat().st_size), os.SEEK_END)
            check_size(path, int.from_bytes(file.read(4), "little"))
    total = line = 0
    with _opener(path)(path, "rb") as file:
        while chunk := file.read(1 << 20):
            total += len(chunk)
            if total > MAX_BYTES:
                break
            end = max(chunk.rfind(b"\n"), chunk.rfind(b"\r"))
            line = line + len(chunk) if end < 0 else len(chunk) - end
            _check_line(path, line)
    return total


def _check_line(path: Path, length: int) -> None:
    if length > _LONGEST_LINE:
        raise InputError(
            f"a line of {path.name!r} is longer than {_LONGEST_LINE >> 20} MB, so that it is no "
            "table; give one row per line"
        )


def _count(file: Any, delimiter: str, name: str) -> tuple[int, int, bool]:
    """Count the rows and the cells of the longest, and say whether some may be remarks."""
    count, width, odd = 0, 0, False
    marks = tuple(f"{quote}{mark}" for mark in ("#", "%", "//", name) for quote in ("", '"'))
    while block := file.readlines(1 << 20):
        # A tab in front is an empty cell, and stays.
        lines = [line for line in block if not line.isspace()]
        count += len(lines)
        cells = (
            map(len, map(str.split, lines)) if delimiter == _SPACE else _counts(lines, delimiter)
        )
        width = max(width, max(cells, default=0))
        odd = odd or any(map(str.startswith, map(str.lstrip, lines), repeat(marks)))
    return count, width, odd


def _counts(lines: Sequence[str], delimiter: str) -> Iterator[int]:
    return (n + 1 for n in map(str.count, lines, repeat(delimiter)))


def _parse_rows(file: Any, delimiter: str, width: int, label: str, **options: Any) -> Any:
    """Parse an open file as a pandas frame whose columns are numbered from 0."""
    import pandas

    if tuple(map(int, pandas.__version__.split(".")[:2])) < (3, 1):
        # From pandas 3.1 on numbers are rounded correctly, and asking for it is deprecated.
        options["float_precision"] = "round_trip"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pandas.errors.DtypeWarning)
            return pandas.read_csv(
                file,
                sep=delimiter,
                header=None,
                names=list(range(max(width, 1))),
                index_col=False,
                keep_default_na=False,
                na_values=[""],
                skipinitialspace=delimiter != _SPACE,
                low_memory=False,
                **options,
            )
    except pandas.errors.EmptyDataError:
        raise InputError(f"{label} has no rows; it needs rows of times and states") from None
    except (pandas.errors.ParserError, ValueError) as error:
        if isinstance(error, UnicodeDecodeError):
            raise
        reason = str(error).strip().splitlines()[-1].removeprefix("Error tokenizing data. ")
        raise InputError(
            f"cannot read the rows of {label}: {reason.removeprefix('C error: ')}; "
            "give every row one cell a column"
        ) from None
