"""Columns: what a file, a frame or arrays hold, before anyone decides what a column means."""

from __future__ import annotations

import codecs
import gzip
import io
import os
import re
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.data.trajectory import Trajectory, as_floats, as_times, refuse_mask
from dynsr.errors import InputError, need, printable

_HEAD_BYTES = 1 << 16
_HEAD_LINES = 20
_LONGEST_HEAD = 1 << 24
_LINE_END = re.compile(r"\r\n|\n|\r")
_HEAD_ROWS = 200
# A name of a column that no reader takes for a number, a truth value or a missing one.
_NAME = re.compile(r"(?i)(?!(?:na|nan|null|none|inf|infinity|true|false)$)[A-Za-z_]\w*")
_PLAIN_BYTES = 1 << 22
# In order of preference where several read the sample equally well.
_DELIMITERS = ("\t", ";", "|", ",", r"\s+")
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_MAGIC = {b"PK\x03\x04": "a zip or Excel file", b"\x89PNG": "a picture", b"%PDF": "a PDF"}
# A unit in brackets or after a blank bracket: "x [m/s]", "theta (rad)".
_UNIT = re.compile(r"\s*[\[(][\w\s/^*.°%µμ·²³-]*[\])]\s*$")
# Array of names in an archive -> the matrix whose columns they name.
_LABELS = {"states": "x", "input_names": "inputs", "columns": "data"}


@dataclass(frozen=True, eq=False)
class Columns:
    """Named columns as they stood in the source.

    Parameters
    ----------
    names : the names, in the order of the source.
    values : one array (n,) a column: float64, dates, or objects where a cell is no number.
    label : what a message calls the source.
    notes : what was noticed on reading, a sentence each.
    named : whether the names are the source's own.
    inputs : names of the columns that the source declares to be inputs.
    time_unit : what the first column is counted in where that is known to be the time.
    units : column -> its unit, where a row below the header or the cells themselves name it.
    left_out : column that was left out on reading -> the reason.
    """

    names: tuple[str, ...]
    values: tuple[np.ndarray, ...]
    label: str
    notes: tuple[str, ...] = ()
    named: bool = True
    inputs: tuple[str, ...] = ()
    time_unit: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that there are columns of one length, each with a name of its own."""
        # The name of a file may be any bytes; the label goes into records, pages and tables.
        object.__setattr__(self, "label", printable(self.label))
        if not self.names:
            raise InputError(f"{self.label} holds no columns; it needs times and states")
        if not len(self.values[0]):
            raise InputError(f"{self.label} holds no rows; it needs rows of times and states")
        often = Counter(self.names)
        for name, value in zip(self.names, self.values, strict=True):
            if name and often[name] > 1:
                raise InputError(f"column name {name!r} is used twice in {self.label}; rename one")
            if len(value) != len(self.values[0]):
                raise InputError(
                    f"column {name!r} of {self.label} has {len(value)} rows but "
                    f"{self.names[0]!r} has {len(self.values[0])}; "
                    "give all columns the same length"
                )

    def only(self, names: Sequence[str]) -> Columns:
        """Give some of the columns, in the order of the source.

        Parameters
        ----------
        names : names of the source; others are left out.

        Raises InputError when none is left.
        """
        pairs = [p for p in zip(self.names, self.values, strict=True) if p[0] in names]
        return replace(
            self,
            names=tuple(name for name, _ in pairs),
            values=tuple(values for _, values in pairs),
            inputs=tuple(name for name in self.inputs if name in names),
        )


def load_columns(source: Any) -> Columns:
    """Load the columns of a file, a frame, a mapping of arrays, a Trajectory or a 2-D array.

    Files are told by their suffix: ``.npz``, ``.npy``, ``.parquet`` or ``.pq``; anything else is
    delimited text. Frames are those that narwhals knows, such as pandas, polars and pyarrow. An
    array has the time as its first column; a pair ``(t, x)`` is taken apart. Columns stay as they
    are.

    Raises InputError when the source is none of these or cannot be read.

    >>> load_columns({"t": [0, 1], "x": [2.0, 3.0]}).names
    ('t', 'x')
    """
    if isinstance(source, Columns):
        return source
    if isinstance(source, (str, os.PathLike)):
        return _load_file(Path(source))
    if isinstance(source, Trajectory):
        values = (source.t, *source.columns.T)
        return Columns(
            ("t", *source.names),
            values,
            "the trajectory",
            inputs=tuple(source.input_names),
            time_unit=source.time_unit,
        )
    if isinstance(source, Mapping):
        return _load_mapping(source, "the mapping")
    if _is_frame(source):
        return _load_frame(source, "the data frame")
    if isinstance(source, tuple) and len(source) == 2:
        table, unit = beside(*source)
        return replace(_load_array(table, "the arrays"), time_unit=unit)
    if isinstance(source, np.ndarray):
        return _load_array(source, "the array")
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
    if path.suffix.lower() in (".parquet", ".pq", ".npz", ".npy"):
        return load_columns(path).names
    _check_file(path)
    head, cut = _read_head(path)
    encoding = "utf-16" if head.startswith(_UTF16) else "utf-8-sig"
    return tuple(_find_header(path.name, head, cut, encoding).names)


def _is_frame(source: Any) -> bool:
    import narwhals

    known = narwhals.from_native(source, pass_through=True)
    return isinstance(known, (narwhals.DataFrame, narwhals.LazyFrame))


def _load_file(path: Path) -> Columns:
    _check_file(path)
    suffix = path.suffix.lower()
    if suffix in (".parquet", ".pq"):
        return _load_parquet(path)
    if suffix not in (".npz", ".npy"):
        return _load_delimited(path)
    try:
        if suffix == ".npy":
            return _load_array(np.load(path, allow_pickle=False), path.name)
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # zip, zlib, NumPy and tokenize each have their own
        kind = "array file" if suffix == ".npy" else "npz archive"
        raise _unreadable(path, kind, error) from None
    return _load_mapping(arrays, path.name)


def _check_file(path: Path) -> None:
    """Raise InputError, with the reason, when a path is no file with something in it."""
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
    need("pyarrow", "tables", f"reading {path.name!r}")
    import pandas

    try:
        frame = pandas.read_parquet(path)
    except Exception as error:  # pyarrow raises a family of its own for damaged files
        raise _unreadable(path, "Parquet file", error) from None
    return _load_frame(frame, path.name)


def _load_frame(source: Any, label: str) -> Columns:
    import narwhals

    index = getattr(source, "index", None)
    named = [name for name in getattr(index, "names", ()) if name is not None]
    if clash := [name for name in named if name in source.columns]:
        raise InputError(
            f"{clash[0]!r} is the index and a column of {label}; drop or rename one of the two"
        )
    if not named and _is_time_index(index) and "time" not in source.columns:
        source, named = source.rename_axis(index="time"), ["time"]
    if named:
        source = source.reset_index()  # pandas: a named index is a column too
    try:
        frame = narwhals.from_native(source)
        if isinstance(frame, narwhals.LazyFrame):
            frame = frame.collect()
    except narwhals.exceptions.DuplicateError:
        names = [str(name) for name in source.columns]
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"column name {twice!r} is used twice in {label}; rename one") from None
    values = tuple(_plain(column.to_numpy()) for column in frame.iter_columns())
    return Columns(tuple(map(str, frame.columns)), values, label)


def _is_time_index(index: Any) -> bool:
    """Whether the index of a frame of pandas holds dates, durations or rising fractions."""
    kind = getattr(getattr(index, "dtype", None), "kind", "")
    return kind in ("m", "M") or (kind == "f" and bool(index.is_monotonic_increasing))


def _load_mapping(arrays: Mapping[str, Any], label: str) -> Columns:
    """Spread matrices over columns; an array of strings names the columns of the one before."""
    labels = {k: tuple(map(str, v)) for k, v in arrays.items() if _is_text(v) and k in _LABELS}
    names: list[str] = []
    values: list[np.ndarray] = []
    single = [k for k, v in arrays.items() if isinstance(v, np.ndarray) and v.ndim == 0]
    for key, value in arrays.items():
        if key in labels or key in single:
            continue
        refuse_mask(value)
        try:
            array = np.asarray(value)
        except ValueError:
            raise InputError(f"{key!r} of {label} has rows of different lengths") from None
        if array.ndim == 1:
            names.append(str(key))
            values.append(_plain(array))
        elif array.ndim == 2:
            names += _matrix_names(str(key), array, labels)
            values += [_plain(column) for column in array.T]
        elif array.ndim == 0:
            raise InputError(
                f"{key!r} of {label} is a {type(value).__name__}, not a column; "
                "give one value a row"
            )
        else:
            raise InputError(
                f"array {key!r} of {label} has {array.ndim} dimensions; "
                "give one column (n,) or a table (n, k), one row a time"
            )
    inputs = tuple(name for name in labels.get("input_names", ()) if name)
    # Such as the step or a parameter beside the columns of an archive.
    notes = (f"{', '.join(map(repr, single))} of {label} is no column; left out",) if single else ()
    return Columns(tuple(names), tuple(values), label, notes, inputs=inputs)


def _matrix_names(
    key: str, matrix: np.ndarray, labels: Mapping[str, tuple[str, ...]]
) -> Sequence[str]:
    for label, named in _LABELS.items():
        if key == named and len(labels.get(label, ())) == matrix.shape[1]:
            return labels[label]
    return [f"{key}{j + 1}" for j in range(matrix.shape[1])]


def _is_text(value: Any) -> bool:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    return array.ndim == 1 and array.dtype.kind in "US"


def _plain(array: np.ndarray) -> np.ndarray:
    """Give numbers as float64, dates and durations as they are, and all else as objects."""
    if array.dtype.kind in "mM":
        refuse_mask(array)
        return array
    return as_floats(array, "the data") if array.dtype.kind in "fiubc" else array.astype(object)


def bare_name(name: str) -> str:
    """Give the name of a column without a unit in brackets behind it.

    >>> bare_name("theta (rad)")
    'theta'
    """
    return _UNIT.sub("", name).strip()


def bracketed_unit(name: str) -> str:
    """Give the unit in brackets behind the name of a column; "" where there is none.

    >>> bracketed_unit("v [m/s]")
    'm/s'
    """
    found = _UNIT.search(name)
    return "" if found is None else found[0].strip().strip("[]()").strip()


def beside(t: Any, x: Any) -> tuple[np.ndarray, str]:
    """Put times (n,) and states (n,) or (n, k) beside each other as one array (n, 1 + k).

    Gives it with the unit of the times, "" where they are plain numbers. Raises InputError when
    they are no numbers or their shapes do not fit.

    >>> beside([0.0, 1.0], [2.0, 3.0])[0].tolist()
    [[0.0, 2.0], [1.0, 3.0]]
    """
    t, unit = as_times(t, "t")
    x = as_floats(x, "x")
    if t.ndim != 1 or x.ndim not in (1, 2) or len(x) != len(t):
        raise InputError(f"t {t.shape} and x {x.shape} do not fit; give t (n,) and x (n, k)")
    return np.column_stack([t, x]), unit


def with_times(columns: Columns, t: Any) -> Columns:
    """Give columns with times that stand apart from them as their first one, ``t``.

    Parameters
    ----------
    columns : those of a source without times.
    t : (n,) the times.

    Raises InputError when there is a column ``t`` already or the lengths differ.
    """
    if "t" in columns.names:
        raise InputError(f"{columns.label} has a column 't'; drop it, or leave time= out")
    t, unit = as_times(t, "time")
    names, values = ("t", *columns.names), (t, *columns.values)  # noqa: PD011
    return replace(columns, names=names, values=values, time_unit=unit)


def _load_array(array: np.ndarray, label: str) -> Columns:
    refuse_mask(array)
    if array.dtype.names:
        return _load_mapping({name: array[name] for name in array.dtype.names}, label)
    if array.ndim != 2 or array.shape[1] == 1:
        raise InputError(
            f"{label} has shape {array.shape} and so no times; give them too: (t, x), time=t, or "
            "an array (n, 1 + k) whose first column they are"
        )
    names = generated_names(array.shape[1])
    return Columns(names, tuple(_plain(c) for c in array.T), label, named=False)


def generated_names(count: int) -> tuple[str, ...]:
    """Name the columns of a table without a header: t, then x or x1, x2, ...

    >>> generated_names(3)
    ('t', 'x1', 'x2')
    """
    return ("t", "x") if count == 2 else ("t", *(f"x{j}" for j in range(1, count)))


def _load_delimited(path: Path) -> Columns:
    """Read a table of delimited text; every cell that is no number stays as text."""
    head, cut = _read_head(path)
    plain = _load_plain(path)
    if plain is not None:
        return plain
    try:
        encoding = "utf-16" if head.startswith(_UTF16) else "utf-8-sig"
        return _load_text(path, head, cut, encoding)
    except UnicodeDecodeError:
        # A few letters of a header are all that tells the encoding of a table of numbers, too few
        # for charset-normalizer: it reads a Latin-1 "é" as Arabic and "µm" as Big5.
        note = f"{path.name!r} is not UTF-8; it was read as Latin-1, so check the names"
        return replace(_load_text(path, head, cut, "latin-1"), notes=(note,))


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
    if table.shape[1] != len(names):
        return None
    return Columns(tuple(names), tuple(table.T.copy()), path.name)


def _opener(path: Path) -> Any:
    return gzip.open if path.suffix.lower() == ".gz" else open


def _read_head(path: Path) -> tuple[bytes, bool]:
    """Read the first lines of a file, and say whether the last of them may be cut."""
    try:
        with _opener(path)(path, "rb") as file:
            head: bytes = file.read(_HEAD_BYTES)
            cut = len(head) == _HEAD_BYTES
            # The lines of a table with thousands of columns are long.
            while cut and max(map(head.count, (b"\n", b"\r"))) < _HEAD_LINES:
                more = file.read(_HEAD_BYTES)
                head, cut = head + more, len(more) == _HEAD_BYTES and len(head) < _LONGEST_HEAD
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot read {str(path)!r}: {reason}") from None
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            raise InputError(f"{path.name!r} is {kind}, not a table; save the data as CSV")
    controls = sum(byte < 9 for byte in head)
    if not head.startswith(_UTF16) and (b"\0" in head or controls > len(head) / 100):
        raise InputError(
            f"{path.name!r} is binary, not text; give CSV, TSV, Parquet (.parquet) or .npz"
        )
    return head, cut


@dataclass(frozen=True)
class _Header:
    """What the first lines of a text tell.

    ``names`` are those of the columns, if any; ``above`` says that they stand in a comment.
    ``first`` is the first line that is no comment, ``skip`` the lines above the numbers.
    """

    names: list[str]
    first: str
    skip: int
    delimiter: str
    decimal: str
    above: bool


def _find_header(label: str, head: bytes, cut: bool, encoding: str) -> _Header:
    # Not splitlines(), for which a form feed or U+0085 ends a line too.
    lines = _LINE_END.split(head.decode(encoding, errors="replace"))
    if cut:
        lines.pop()
    rows = [j for j, line in enumerate(lines) if line.strip() and line.lstrip()[0] != "#"]
    if not rows:
        raise InputError(f"{label!r} holds no rows; it needs rows of times and states")
    # A first row may be the header, so that the next ones show how cells are written.
    sample = [lines[j] for j in rows[1 : 1 + _HEAD_ROWS]] or [lines[rows[0]]]
    delimiter, decimal = _guess_dialect(sample)
    names, skip = _find_names(lines[rows[0]], delimiter, decimal), rows[0] + 1
    if names and len(rows) == 1:
        raise InputError(f"{label!r} has a header but no rows; it needs times and states")
    above = not names
    if above:
        skip = rows[0]
        comments = [line.lstrip("# ") for line in lines[:skip] if line.strip(" #")]
        names = _find_names(comments[-1], delimiter, decimal) if comments else []
    return _Header(names, lines[rows[0]], skip, delimiter, decimal, above)


def _load_text(path: Path, head: bytes, cut: bool, encoding: str) -> Columns:
    header = _find_header(path.name, head, cut, encoding)
    names = header.names
    frame = _parse_file(path, header.skip, encoding, header.delimiter, header.decimal)
    if header.above and len(names) != frame.shape[1]:
        names = []  # a comment that is no header
    _check_width(names, frame, path.name, header.first)
    # A delimiter at the end of each row makes a nameless column without a value.
    kept = [
        (name, _plain(frame[j].to_numpy()))
        for j, name in enumerate(names or generated_names(frame.shape[1]))
        if name or frame[j].notna().any()
    ]
    found, values = zip(*kept, strict=True)
    return Columns(found, values, path.name, named=bool(names))


def _parse_file(path: Path, skip: int, encoding: str, delimiter: str, decimal: str) -> Any:
    """Parse a file from a line on; raises InputError when a row of it is lost."""

    @contextmanager
    def open_there() -> Iterator[Any]:
        with _opener(path)(path, "rt", encoding=encoding) as file:
            # pandas itself would join lines that it skips where a comment holds a quotation mark.
            for _ in range(skip):
                file.readline()
            yield file

    try:
        with open_there() as file:
            count = sum(bool(line.strip()) and line.lstrip()[0] != "#" for line in file)
        with open_there() as file:
            frame = _parse_rows(file, delimiter, decimal, label=repr(path.name))
    except (OSError, EOFError, zlib.error) as error:
        raise _unreadable(path, "table", error) from None
    if len(frame) < count:
        raise InputError(
            f"only {len(frame)} of {count} rows of {path.name!r} could be told apart; "
            "remove quotation marks and odd characters from them"
        )
    return frame


def _guess_dialect(sample: Sequence[str]) -> tuple[str, str]:
    """Find the delimiter and the decimal mark by which most columns of a sample are numbers.

    csv.Sniffer, pandas' own sniffing and clevercsv count signs and know nothing of numbers: they
    take the decimal comma of "0,5 1,5" for a delimiter.

    >>> _guess_dialect(["0,5;1", "1,5;2"])
    (';', ',')
    """

    def share_of_numbers(dialect: tuple[str, str]) -> tuple[float, int]:
        frame = _parse_rows(sample, *dialect, on_bad_lines="skip")
        numbers = len(frame.select_dtypes("number").columns)
        return numbers / max(frame.shape[1], 1), frame.shape[1]

    dialects = [pair for pair in product(_DELIMITERS, ".,") if pair[0] != pair[1]]
    return max(dialects, key=share_of_numbers)


def _find_names(line: str, delimiter: str, decimal: str) -> list[str]:
    """Give the cells of a header; nothing where more than half of the cells are numbers."""
    cells = _parse_rows([line], delimiter, decimal)
    texts = sum(dtype.kind not in "fiub" for dtype in cells.dtypes)
    if not texts or 2 * texts < int(cells.notna().sum().sum()):
        return []
    names = _parse_rows([line], delimiter, decimal, dtype=str, keep_default_na=False)
    return [str(name).strip() for name in names.iloc[0]]


def _check_width(names: Sequence[str], frame: Any, label: str, first: str) -> None:
    if names and len(names) != frame.shape[1]:
        raise InputError(
            f"the header of {label!r} names {len(names)} columns but row 1 has "
            f"{frame.shape[1]} cells; use one delimiter throughout and one name a column"
        )
    if frame.shape[1] == 1 and frame[0].dtype.kind not in "fiub":
        raise InputError(
            f"cannot tell the columns of {label!r} apart (first line {first[:40]!r}); "
            "separate cells by comma, tab, semicolon, | or spaces"
        )


def _parse_rows(
    source: Any, delimiter: str, decimal: str, label: str = "the first rows", **options: Any
) -> Any:
    """Parse an open file, or lines, as a pandas frame whose columns are numbered from 0."""
    import pandas

    if tuple(map(int, pandas.__version__.split(".")[:2])) < (3, 1):
        # From pandas 3.1 on numbers are rounded correctly, and asking for it is deprecated.
        options["float_precision"] = "round_trip"
    try:
        with warnings.catch_warnings():
            # A column of numbers and text is refused later, with the cell.
            warnings.simplefilter("ignore", pandas.errors.DtypeWarning)
            return pandas.read_csv(
                io.StringIO("\n".join(source)) if isinstance(source, list) else source,
                sep=delimiter,
                decimal=decimal,
                header=None,
                comment="#",
                skipinitialspace=delimiter != r"\s+",
                **options,
            )
    except pandas.errors.EmptyDataError:
        raise InputError(f"{label} holds no rows; it needs rows of times and states") from None
    except pandas.errors.ParserError as error:
        reason = str(error).strip().splitlines()[-1].removeprefix("Error tokenizing data. ")
        raise InputError(
            f"cannot read the rows of {label}: {reason.removeprefix('C error: ')}; "
            "give every row one cell a column"
        ) from None
