"""Discovery on a real cluster: two workers of dask.distributed, one of which is killed."""

import json
import os
import signal
import time
from threading import Thread

import numpy as np
import pytest
from command_line import run

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


@pytest.fixture(scope="module")
def cluster():
    """Give a cluster of two workers on this machine."""
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as own:
        yield own


def table_of(*words):
    """Run a batch from the shell; gives its table without the seconds."""
    rows = json.loads(run("discover", *words, "--batch", "--json").stdout)
    return [{**row, "seconds": 0} for row in rows]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_batch_on_a_cluster_ends_with_the_same_table(cluster, tmp_path):
    """Six files by --cluster, with one of two workers killed in between, are as on one machine."""
    import distributed

    t = np.linspace(0, 4, 60)
    for rate in range(1, 7):
        rows = np.column_stack([t, 3 * np.exp(-0.25 * rate * t)])
        np.savetxt(tmp_path / f"rate{rate}.csv", rows, delimiter=",", header="t,x", comments="")
    files = [str(path) for path in sorted(tmp_path.glob("*.csv"))]
    alone = table_of(*files, "--out", str(tmp_path / "alone"), "--jobs", "1")
    assert [row["level"] for row in alone] == ["law"] * 6
    with distributed.Client(cluster) as client:
        pid = next(iter(client.run(os.getpid).values()))
    out = tmp_path / "spread"

    def kill():
        """Kill a worker when the first file has its law."""
        while not list(out.glob("each/*/discovery.json")):
            time.sleep(0.05)
        os.kill(pid, signal.SIGKILL)

    killer = Thread(target=kill, daemon=True)
    killer.start()
    spread = table_of(*files, "--out", str(out), "--cluster", cluster.scheduler_address)
    killer.join(timeout=60)
    assert not killer.is_alive()
    assert spread == alone


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_named_in_one_line(tmp_path, monkeypatch):
    """Where no scheduler answers, one line names the address and what to start."""
    pytest.importorskip("distributed", reason="dask.distributed is not installed")
    monkeypatch.setattr("dynsr.jobs.cluster._SECONDS", 0.3)
    path = tmp_path / "decay.csv"
    path.write_text("t,x\n" + "".join(f"{i},{0.5**i}\n" for i in range(20)))
    for address, said in (
        ("tcp://127.0.0.1:9", "start one with"),
        ("nowhere", "no Dask scheduler"),
    ):
        failed = run("discover", str(path), "--cluster", address, code=2)
        assert said in " ".join(failed.stderr.split())
