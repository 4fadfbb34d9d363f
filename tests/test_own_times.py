"""Columns of times, each for the quantities that follow it."""

import numpy as np
import pytest

from dynsr.data import read_trajectories


@pytest.mark.filterwarnings("ignore::dynsr.errors.DynsrWarning")
@pytest.mark.parametrize(
    "names", ["t1,x,t2,y", "time_x,x,time_y,y", "x t,x,y t,y", "t_1 [s],x,t_2 [s],y", "t,x,t,y"]
)
def test_each_quantity_has_the_times_before_it(tmp_path, names):
    """Times that are called by a number, or by what follows, are no states and no second times."""
    t = np.linspace(0.0, 3.0, 16)
    rows = np.column_stack([t, np.exp(-t), t + 0.1, np.cos(t + 0.1)])
    path = tmp_path / "own.csv"
    np.savetxt(path, rows, delimiter=",", header=names, comments="")
    (run,) = read_trajectories(path).trajectories
    assert run.states == ("x", "y") and len(run) == 32
    assert run.measured.sum(axis=0).tolist() == [16, 16]
    np.testing.assert_allclose(run.x[run.measured[:, 1], 1], np.cos(run.t[run.measured[:, 1]]))


def test_a_clock_and_the_time_since_the_start_are_times_of_all_columns(tmp_path):
    """Two columns of other names that both say the time belong to every quantity."""
    t = np.linspace(0.0, 3.0, 16)
    rows = np.column_stack([t, np.exp(-t), 1.7e9 + t, np.cos(t)])
    path = tmp_path / "both.csv"
    np.savetxt(path, rows, delimiter=",", header="time,x,timestamp,y", comments="")
    (run,) = read_trajectories(path).trajectories
    assert run.states == ("x", "y") and len(run) == 16
