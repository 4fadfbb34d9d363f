"""What other libraries give and take is read: tensors, solutions, steps, and times of each run."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch

import dynsr
from dynsr.data import read_trajectories, take_trajectories
from dynsr.errors import InputError
from tests.command_line import run

T = np.arange(20) * 0.25
X = np.column_stack([np.exp(-T), np.cos(T)])
FRAME = pd.DataFrame({"t": T, "a": X[:, 0], "b": X[:, 1]})


def check(runs, count=1):
    """See that each run has these times and states."""
    assert len(runs) == count
    for k, own in enumerate(runs):
        np.testing.assert_allclose(own.t, T, rtol=1e-15)
        np.testing.assert_allclose(own.x, X + k, rtol=1e-15)


@pytest.mark.parametrize("read", [lambda *a: read_trajectories(*a).trajectories, None])
@pytest.mark.parametrize(
    ("source", "time", "count"),
    [
        (X, 0.25, 1),
        (X.tolist(), 0.25, 1),
        (torch.tensor(X, requires_grad=True), T, 1),
        ((torch.tensor(T), torch.tensor(X)), None, 1),
        (SimpleNamespace(t=T.tolist(), u=X.tolist()), None, 1),
        ([X, X + 1], 0.25, 2),
        ([torch.tensor(X), torch.tensor(X + 1)], 0.25, 2),
        ([SimpleNamespace(t=T, u=X), SimpleNamespace(t=T, u=X + 1)], None, 2),
        ([X, X + 1], [T, T], 2),
        (np.stack([X, X + 1]), T, 2),
        (np.stack([X, X + 1]), 0.25, 2),
        (np.stack([np.column_stack([T, X + k]) for k in (0, 1)]), None, 2),
        (FRAME.drop(columns="t"), 0.25, 1),
        ({"a": X[:, 0], "b": X[:, 1]}, 0.25, 1),
    ],
    ids=lambda own: type(own).__name__,
)
def test_sources_of_other_libraries_are_read(read, source, time, count):
    """Also by discover, which takes what describe takes."""
    if read is None:
        check(take_trajectories(source, time=time)[0], count)
    else:
        check(read(source, time), count)


def test_a_step_is_the_time_of_a_file_without_one(tmp_path):
    """In the shell too; a column of that name comes first."""
    path = tmp_path / "runs.csv"
    FRAME.drop(columns="t").to_csv(path, index=False)
    for step in (0.25, "0.25"):
        check(read_trajectories(path, step).trajectories)
    assert "20 rows from 0 to 4.75 every 0.25" in run("describe", path, "--time", "0.25").stdout
    with pytest.raises(InputError, match=r"or give the step between rows, e\.g\. --time 0\.1"):
        read_trajectories(path)
    named = FRAME.rename(columns={"t": "1"})
    named.to_csv(path, index=False)
    check(read_trajectories(path, "1").trajectories)


@pytest.mark.parametrize("step", [0, -0.5, np.nan, np.inf])
def test_a_step_is_above_0(step):
    """One line says so."""
    with pytest.raises(InputError, match=r"must be the step from row to row, above 0"):
        dynsr.describe(X, time=step)


def test_frames_that_were_joined_by_name_are_runs():
    """pandas.concat keeps the names in an index, next to the rows' numbers or their times."""
    frames = {"mutant": FRAME, "wild": FRAME.assign(a=FRAME.a + 1, b=FRAME.b + 1)}
    timed = {name: own.set_index("t").rename_axis(None) for name, own in frames.items()}
    for joined in (pd.concat(frames), pd.concat(timed)):
        table = read_trajectories(joined)
        check(table.trajectories, 2)
        assert table.description.named_by == ("run",)


def test_columns_called_t_and_u_are_those_of_a_table():
    """A frame has them as attributes, as a solution has; so have records and datasets."""
    frame = pd.DataFrame({"t": T, "u": X[:, 0], "x": X[:, 1]})
    for source in (frame, frame.to_records(index=False), frame.set_index("t").to_xarray()):
        assert {*read_trajectories(source).trajectories[0].names} == {"u", "x"}
