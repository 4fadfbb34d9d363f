"""Which device the enumeration takes."""

import sys

import pytest

from dynsr.methods.feynman.enumeration import backend

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
