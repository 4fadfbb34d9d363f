import numpy as np

from dynsr.methods.feynman.enumeration.bank import Seen


def test_the_table_agrees_with_a_set():
    """Over many batches with repeats, and growth between, new is what a Python set says is new."""
    rng = np.random.default_rng(0)
    pool = rng.integers(1, 2**63, 4000).astype(np.uint64)
    seen, known = Seen(bits=4), set()
    for _ in range(30):
        hashes = rng.choice(pool, 500)
        assert seen.has(hashes).tolist() == [int(h) in known for h in hashes]
        expected = []
        for value in hashes.tolist():
            expected.append(value not in known)
            known.add(value)
        assert seen.add(hashes).tolist() == expected
        assert len(seen) == len(known)
