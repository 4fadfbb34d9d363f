"""Which device the enumeration takes."""

import sys

import numpy as np
import pytest

from dynsr.methods.feynman.enumeration import backend, formation
from dynsr.methods.feynman.enumeration.brute_force import BruteForce, search_values

torch = pytest.importorskip("torch", reason="the extra torch is not installed")


@pytest.fixture(autouse=True)
def _anew():
    """Look for a GPU in every test."""
    backend._sees_gpu.cache_clear()
    yield
    backend._sees_gpu.cache_clear()


@pytest.mark.parametrize(("seen", "name"), [(True, "torch:cuda"), (False, "numpy")])
def test_a_gpu_is_taken_where_torch_sees_one(monkeypatch, tmp_path, seen, name):
    """Whether torch has been imported before plays no part."""
    driver = tmp_path / "driver"
    driver.touch()
    monkeypatch.setattr(backend, "_DRIVER", str(driver))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: seen)
    assert backend.choose_backend("auto").name == name


def test_torch_is_not_imported_where_there_is_no_driver(monkeypatch):
    """Half a gigabyte of libraries stays where it is."""
    monkeypatch.setattr(backend, "_DRIVER", "/no/such/driver")
    monkeypatch.setattr(backend.shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "torch", None)
    assert backend.choose_backend("auto").name == "numpy"


@pytest.mark.parametrize(("free", "batches"), [(1e6, 1), (160e6, 10), (80e9, 64)])
def test_batches_are_measured_together_as_free_memory_allows(monkeypatch, free, batches):
    """Four arrays of 1000 rows of 1000 numbers take 32 MB; a quarter of what is free is used."""
    gpu = object.__new__(backend.TorchBackend)
    gpu.torch, gpu.device = torch, "cuda"
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (int(8 * free), int(1e11)))
    assert gpu.together(1000, 1000) == batches


def test_the_same_is_found_however_many_batches_are_measured_together(monkeypatch):
    """Free memory decides nothing but the speed: counts and formulas are the same to the last."""
    x = np.random.default_rng(0).uniform(0.5, 2.0, (80, 2))
    settings = BruteForce(max_size=4, sums=(), beam=0, device="torch-cpu", max_candidates=600)
    monkeypatch.setattr(formation, "CHUNK", 32)
    found = []
    for together in (1, 5):
        monkeypatch.setattr(
            backend.TorchBackend, "together", lambda self, count, rows, n=together: n
        )
        y = np.sin(x[:, 0] * x[:, 1]) + 0.3 * x[:, 0]
        found.append(search_values(x, y, ["x", "y"], settings))
    one, many = found
    assert (one.formed, one.distinct, one.stored) == (many.formed, many.distinct, many.stored)
    assert one.formed > 5 * 32
    assert one.stopped == many.stopped == "candidates"
    assert [c.expr for c in one.candidates] == [c.expr for c in many.candidates]
