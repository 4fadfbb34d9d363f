"""Tables of names and numbers between commas, which NumPy reads before pandas is imported."""

import subprocess
import sys
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynsr.data import text
from dynsr.data.columns import load_columns
from dynsr.errors import InputError

NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers(-(10**15), 10**15).map(str),
    st.sampled_from(["1.", ".5", "+3", "1E5", "2e-308", "1e400", "0.1", "-0"]),
)
CELLS = st.one_of(NUMBERS, st.sampled_from(["", "nan", "x", "1-2", " 3", "#4", '"5"', "--1", "e"]))
NAMES = st.sampled_from(["t", "x", "x_1", "NaN", "inf", "true", "na", "v [m]", "2", "", "nap", "µ"])


def read(path):
    """Give what a file holds, or what is said of it."""
    try:
        found = load_columns(path)
    except InputError as error:
        return str(error)
    return found.names, found.named, found.notes, [value.tolist() for value in found.values]


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_numpy_reads_what_pandas_reads(tmp_path_factory, data) -> None:
    """Names, numbers to the last bit, and refusals are those of the reader of all other tables."""
    width = data.draw(st.integers(1, 4))
    head = data.draw(st.lists(NAMES, min_size=width, max_size=width, unique=True))
    cells = data.draw(st.sampled_from([NUMBERS, CELLS]))
    rows = st.lists(cells, min_size=width, max_size=width + data.draw(st.integers(0, 1)))
    end = data.draw(st.sampled_from(["\n", "\r\n", "\n\n"]))
    lines = [",".join(row) for row in [head, *data.draw(st.lists(rows, max_size=5))]]
    path = tmp_path_factory.mktemp("plain") / "x.csv"
    path.write_text(end.join(lines) + data.draw(st.sampled_from(["", end])), newline="")
    with patch.object(text, "_load_plain", return_value=None):
        expected = read(path)
    np.testing.assert_equal(read(path), expected)


def test_a_whole_number_has_no_sign_where_it_is_0(tmp_path) -> None:
    """-0 is 0, as pandas reads it, and -0.0 keeps its sign."""
    path = tmp_path / "x.csv"
    path.write_text("t,x,y\n0,-0,-0.0\n")
    assert np.signbit([own[0] for own in load_columns(path).values]).tolist() == [
        False,
        False,
        True,
    ]


@pytest.mark.slow
def test_a_plain_table_needs_no_pandas(tmp_path) -> None:
    """Half a second of every start goes to importing it, which a plain table is spared; one with
    units in its names is not.
    """
    for name, head in (("plain", "t,x"), ("units", "t,x [m]")):
        (tmp_path / f"{name}.csv").write_text(f"{head}\n0,1.5\n1,2.5\n")
    code = (
        "import sys; from dynsr.data.columns import load_columns\n"
        "for name in ('plain', 'units'):\n"
        "    load_columns(f'{sys.argv[1]}/{name}.csv'); print('pandas' in sys.modules)"
    )
    said = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True)
    assert said.stdout.split() == ["False", "True"], said.stderr
