import numpy as np
import pytest

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
