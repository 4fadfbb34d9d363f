import io
import struct

import numpy as np
import pytest

from dynsr.engines.julia.frames import read_frame, write_frame
from dynsr.errors import EngineError


def test_frames_follow_one_another():
    """Two frames written are the two read, and then the stream is over."""
    stream = io.BytesIO()
    arrays = {
        "a": np.arange(6.0).reshape(2, 3).T,
        "b": np.array([np.nan, -np.inf]),
        "c": np.empty(0),
    }
    write_frame(stream, {"call": "integrate", "text": "θ\n"}, arrays)
    write_frame(stream, {"n": 3})
    stream.seek(0)
    header, found = read_frame(stream)
    assert header == {"call": "integrate", "text": "θ\n"}
    for name, value in arrays.items():
        assert np.array_equal(found[name], value, equal_nan=True) and found[name].flags.writeable
    assert read_frame(stream) == ({"n": 3}, {})
    assert read_frame(stream) is None


def test_a_stream_that_breaks_off_is_an_error():
    """Wherever a frame is cut, reading it is an EngineError and never half an answer."""
    stream = io.BytesIO()
    write_frame(stream, {"call": "x"}, {"a": np.arange(3.0)})
    whole = stream.getvalue()
    for length in range(1, len(whole)):
        with pytest.raises(EngineError):
            read_frame(io.BytesIO(whole[:length]))


@pytest.mark.parametrize(
    "text", ['{"arrays": 3}', "[]", '{"call": "x"}', '{"arrays": [["a", "b"]]}', "print(1)"]
)
def test_a_header_that_is_none_of_ours_is_an_error(text):
    """What another program wrote to the pipe is refused."""
    data = struct.pack(">I", len(text)) + text.encode()
    with pytest.raises(EngineError, match="header"):
        read_frame(io.BytesIO(data))


def test_text_on_the_pipe_is_refused_before_it_is_read():
    """A line of output taken for a length would ask for gigabytes; it is refused."""
    with pytest.raises(EngineError, match="no header of ours"):
        read_frame(io.BytesIO(b"Precompiling packages...\n"))


def test_numbers_of_a_header_must_be_finite():
    """NaN is no JSON; arrays carry it instead."""
    with pytest.raises(ValueError, match="JSON"):
        write_frame(io.BytesIO(), {"x": float("nan")})
