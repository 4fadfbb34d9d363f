import numpy as np
import pytest

from dynsr.data import Trajectory, weak_form
from dynsr.errors import InputError


def circle(t):
    """Give the trajectory of a circle."""
    return Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), ("x", "y"))


@pytest.mark.parametrize("even", [True, False])
def test_the_true_law_holds_over_every_window(even):
    """On 200 rows the means of y are those of the slope of x within 2e-4, on uneven times too."""
    t = np.linspace(0, 12, 200)
    if not even:
        t = np.sort(np.random.default_rng(0).choice(np.linspace(0, 12, 400), 200, replace=False))
    run = circle(t)
    weak = weak_form(run, "x")
    assert len({tuple(np.diff(w)) for w in weak.windows}) == 3
    assert np.max(np.abs(weak.matrix @ run.x[:, 1] - weak.y)) < 2e-4
    assert np.allclose(weak.matrix.sum(axis=1), 1)


@pytest.mark.parametrize("rows", range(6, 15))
def test_few_rows_have_windows(rows):
    """From six rows on there is a window, and the law of a line holds in it exactly."""
    t = np.cumsum(np.random.default_rng(rows).uniform(0.5, 1, rows))
    weak = weak_form(Trajectory(t, 3 * t[:, None], ("x",)), "x")
    assert len(weak.y) > 0 and np.allclose(weak.y, 3, rtol=1e-2)


def test_windows_that_do_not_fit_are_refused():
    """One line says how many rows there are and what would do."""
    with pytest.raises(InputError, match="10 rows hold no window of 12 steps"):
        weak_form(circle(np.arange(10.0)), "x", [12])
