"""Cluster: tasks spread over the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from joblib import parallel_config

from dynsr.errors import InputError, need, one_line

# Seconds until a scheduler has answered, or a worker has come.
_SECONDS = 10.0


@contextmanager
def on_cluster(address: str | None) -> Iterator[None]:
    """Spread what is run in parallel within over the workers of a scheduler.

    Workers need the same versions of dynsr and Python, and the same folders.

    Parameters
    ----------
    address : of the scheduler, such as "tcp://node1:8786"; None for this machine alone.

    Raises MissingExtra without dask.distributed, and InputError where no scheduler answers or it
    has no workers.

    >>> with on_cluster(None):
    ...     pass
    """
    if address is None:
        yield
        return
    need("distributed", "cluster", "--cluster")
    from distributed import Client

    try:
        client = Client(address, timeout=_SECONDS)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {address!r} ({one_line(error)[:80]}); start one with "
            "dask scheduler, and give the address that it prints"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_SECONDS)
        except TimeoutError:
            raise InputError(
                f"the Dask scheduler at {address!r} has no workers; start some with "
                f"dask worker {address}"
            ) from None
        with parallel_config("dask", wait_for_workers_timeout=_SECONDS):
            yield
