"""Discovery on a real cluster: two workers of dask.distributed, one of which is killed."""

import os
import signal

import numpy as np
import pytest

from dynsr.discovery.search import discover
from dynsr.methods.rational import RationalSearch


def problem():
    """Give three states in closed form, searched by a quick method."""
    t = np.linspace(0, 4, 101)
    decays = np.exp(-np.outer(t, [0.5, 1.0]))
    x = np.column_stack([decays, np.sin(2 * t)])
    return (t, x), RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1)


@pytest.mark.slow
# Dask warns of its own connections while a worker dies, and joblib of large tasks.
@pytest.mark.filterwarnings("ignore")
def test_a_killed_worker_does_not_change_the_result(tmp_path):
    """With one of two workers killed mid-run the discovery ends as on one machine."""
    import joblib

    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")

    data, method = problem()
    alone = discover(data, method=method, jobs=1)
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    )
    client = distributed.Client(cluster)
    try:
        pids = list(client.run(os.getpid).values())
        killed = []

        def kill(step):
            """Kill a worker when the first task has ended."""
            if step.what and not killed:
                os.kill(pids[0], signal.SIGKILL)
                killed.append(step.what)

        with joblib.parallel_config("dask", wait_for_workers_timeout=30):
            spread = discover(data, method=method, jobs=-1, progress=kill, out=tmp_path)
    finally:
        client.close()
        cluster.close()
    assert killed
    assert {**spread.as_record(), "seconds": 0} == {**alone.as_record(), "seconds": 0}
