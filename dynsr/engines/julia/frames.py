"""Frames: how an engine and its worker process talk, a header of JSON and arrays of float64.

A frame is the length of the header (4 bytes, big-endian), the header as UTF-8 JSON, and the bytes
of the arrays one after the other; the header's ``arrays`` lists their names and shapes. Nothing
in a frame can run code in who reads it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import IO, Any

import numpy as np

from dynsr.errors import EngineError

_LENGTH = struct.Struct(">I")
_LONGEST_HEADER = 1 << 26
Frame = tuple[dict[str, Any], dict[str, np.ndarray]]


def write_frame(
    stream: IO[bytes], header: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None
) -> None:
    """Write one frame and flush.

    >>> import io
    >>> stream = io.BytesIO()
    >>> write_frame(stream, {"call": "add"}, {"x": np.array([1.0, np.nan])})
    >>> _ = stream.seek(0)
    >>> read_frame(stream)
    ({'call': 'add'}, {'x': array([ 1., nan])})
    """
    values = {k: np.ascontiguousarray(v, dtype="<f8") for k, v in (arrays or {}).items()}
    shapes = [[name, list(value.shape)] for name, value in values.items()]
    text = json.dumps({**header, "arrays": shapes}, allow_nan=False).encode()
    stream.write(_LENGTH.pack(len(text)))
    stream.write(text)
    for value in values.values():
        stream.write(value.tobytes())
    stream.flush()


def read_frame(stream: IO[bytes]) -> Frame | None:
    """Read one frame; None at the end of the stream.

    Raises EngineError when the stream breaks off inside a frame or holds something else.
    """
    start = stream.read(_LENGTH.size)
    if not start:
        return None
    if len(start) < _LENGTH.size:
        raise EngineError("the worker's stream broke off inside a frame")
    (length,) = _LENGTH.unpack(start)
    if length > _LONGEST_HEADER:
        raise EngineError(f"a frame's header of {length} bytes is no header of ours")
    try:
        header = json.loads(_read_exactly(stream, length))
        shapes = [(str(name), tuple(map(int, shape))) for name, shape in header.pop("arrays")]
    except (ValueError, KeyError, TypeError, AttributeError):
        raise EngineError("a frame's header cannot be read") from None
    arrays = {}
    for name, shape in shapes:
        count = int(np.prod(shape, dtype=np.int64))
        values = np.frombuffer(_read_exactly(stream, 8 * count), dtype="<f8")
        # A copy, because what lies over bytes cannot be written to.
        arrays[name] = values.reshape(shape).astype(float)
    return header, arrays


def _read_exactly(stream: IO[bytes], count: int) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise EngineError("the worker's stream broke off inside a frame")
    return data
