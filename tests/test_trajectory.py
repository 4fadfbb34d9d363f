import numpy as np
import pytest

from dynsr.data.samples import Samples
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError


@pytest.mark.parametrize(
    ("t", "x", "states", "said"),
    [
        ([0, 1, 1], [[1], [2], [3]], ("x",), "repeats at row 3"),
        ([0, 2, 1], [[1], [2], [3]], ("x",), "backwards at row 3"),
        ([0, np.nan], [[1], [2]], ("x",), "time in row 2"),
        ([0, 1], [[1], [np.inf]], ("x",), "'x' holds inf in row 2"),
        ([0, 1], [[1, 2], [2, 3]], ("x",), "do not fit"),
        ([0, 1], [[1, 2], [2, 3]], ("x", "x"), "'x' is used twice"),
        ([0, 1], [[1], [2]], ("t",), "used twice"),
        ([0, 1], [[1], [2]], ("sin",), "function"),
    ],
)
def test_bad_data_is_refused_with_its_place(t: list, x: list, states: tuple, said: str):
    """The message names the column and the row, in one line."""
    with pytest.raises(InputError, match=said):
        Trajectory(t, x, states)


def test_rows_are_selected_with_their_inputs():
    """A selection keeps times, states and inputs together."""
    whole = Trajectory(
        np.arange(5.0), np.arange(5.0)[:, None], ("x",), np.arange(5.0)[:, None] * 2, ("u",)
    )
    part = whole.select(slice(1, 3))
    assert part.t.tolist() == [1, 2]
    assert part.columns.tolist() == [[1, 2], [2, 4]]
    assert part.names == ("x", "u")


@pytest.mark.parametrize(
    "rows",
    [
        np.array([0.0, 1.0]),
        np.array([0.5]),
        np.array([7]),
        np.array([[0, 1]]),
        np.array([True, False]),
        np.array(["a"]),
        slice(0.0, 2.0),
        None,
        3,
        object(),
    ],
)
@pytest.mark.parametrize("kind", [Trajectory, Samples])
def test_rows_that_are_none_are_refused_in_one_line(kind, rows):
    """Fractions, rows that are not there, tables of them: one line with the remedy, for both."""
    t = np.arange(5.0)
    whole = (
        Trajectory(t, t[:, None], ("x",))
        if kind is Trajectory
        else Samples(t[:, None], -2 * t, ("x",), "x", "given", t)
    )
    with pytest.raises(InputError, match="of 5 rows; give a slice or whole numbers") as said:
        whole.select(rows)
    assert "\n" not in str(said.value)


@pytest.mark.parametrize(
    "rows", [[0, 2], np.array([-2, -1]), np.arange(5) > 2, slice(None, None, 2)]
)
def test_rows_are_taken_as_numpy_takes_them(rows):
    """Lists, rows from the end, booleans and slices."""
    t = np.arange(5.0)
    assert Trajectory(t, t[:, None], ("x",)).select(rows).t.tolist() == t[rows].tolist()
