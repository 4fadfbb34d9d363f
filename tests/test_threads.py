"""Claims about the threads that a discovery takes."""

import numpy as np
from threadpoolctl import threadpool_info

from dynsr import discover


def blas_threads():
    """Threads that each linear algebra library takes."""
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_a_discovery_takes_one_thread_and_gives_the_others_back():
    """While it runs linear algebra has one thread, in this process too; afterwards as before."""
    before, seen = blas_threads(), []
    t = np.linspace(0, 3, 151)
    found = discover(
        (t, np.exp(-0.5 * t)[:, None]),
        preset="quick",
        jobs=1,
        progress=lambda step: seen.append(blas_threads()),
    )
    assert found.equations
    assert before
    assert seen
    assert all(count == 1 for counts in seen for count in counts)
    assert blas_threads() == before
