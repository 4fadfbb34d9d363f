"""Where the arrays of the brute-force search live: numpy, or torch where a GPU is asked for.

The enumeration forms and projects its value rows through one of these two classes and nothing
else, so the same code runs on both. torch is imported only when a torch device is asked for, or
by ``device="auto"`` on a machine with the driver of a GPU.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np

from dynsr.errors import InputError, need
from dynsr.expression import OPERATORS

DEVICES = ("auto", "cpu", "cuda", "torch-cpu")
_DRIVER = "/dev/nvidiactl"
# Share of a GPU's free memory that one batch may take, arrays that are held of it at a time, and
# batches that are measured at once at most: beyond these the host is what takes the time.
_SHARE, _ARRAYS, _MOST = 0.25, 4, 64


class Store(Protocol):
    """Value rows that are put below each other."""

    def add(self, rows: Any, index: np.ndarray) -> None:
        """Take in some of the rows by number."""

    def finish(self) -> Any:
        """Give all of them as one array."""


class _Reserved:
    """One array from the start; untouched pages of it cost nothing."""

    def __init__(self, count: int, rows: int) -> None:
        self.held, self.filled = np.empty((count, rows)), 0

    def add(self, rows: np.ndarray, index: np.ndarray) -> None:
        end = self.filled + len(index)
        np.take(rows, index, axis=0, out=self.held[self.filled : end], mode="clip")
        self.filled = end

    def finish(self) -> np.ndarray:
        return self.held[: self.filled]


class _Joined:
    """Pieces that are joined at the end."""

    def __init__(self, backend: TorchBackend, rows: int) -> None:
        self.backend, self.pieces = backend, [backend.put(np.empty((0, rows)))]

    def add(self, rows: Any, index: np.ndarray) -> None:
        self.pieces.append(self.backend.pick(rows, index))

    def finish(self) -> Any:
        return self.backend.torch.cat(self.pieces)


class NumpyBackend:
    """Arrays of float64 in main memory."""

    name = "numpy"

    def __init__(self) -> None:
        """Start without memory of its own."""
        self._scratch = np.empty(0)

    def put(self, array: np.ndarray) -> Any:
        """Bring a numpy array to where the work is done."""
        return np.ascontiguousarray(array, dtype=float)

    def get(self, array: Any) -> np.ndarray:
        """Bring an array back to numpy."""
        return np.asarray(array)

    def apply(self, token: str, *arrays: Any) -> Any:
        """Apply an operator of OPERATORS; values outside its domain become NaN or inf."""
        return OPERATORS[token].numpy(*arrays)

    def form(self, token: str, *arrays: Any) -> Any:
        """Do the same into memory that the next call uses again: fresh memory is slow."""
        shape = np.broadcast_shapes(*(array.shape for array in arrays))
        size = int(np.prod(shape))
        if len(self._scratch) < size:
            self._scratch = np.empty(size)
        out = self._scratch[:size].reshape(shape)
        return OPERATORS[token].numpy(*arrays, out=out)

    def reserve(self, count: int, rows: int) -> Store:
        """Give room for at most ``count`` value rows; memory is taken as it is filled."""
        return _Reserved(count, rows)

    def together(self, count: int, rows: int) -> int:
        """Give the batches of ``count`` value rows that are measured at once: they share memory."""
        del count, rows
        return 1

    def measure(
        self, batches: Sequence[Any], directions: Any
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Give products with directions, and sums of squares, of the value rows of each batch."""
        return [(self.get(directions @ own.T), self.square_sums(own)) for own in batches]

    def square_sums(self, rows: Any) -> np.ndarray:
        """Give the sum of squares of each row."""
        return np.einsum("ij,ij->i", rows, rows)

    def pick(self, rows: Any, index: np.ndarray) -> Any:
        """Give some rows by number."""
        return rows[index]

    def signs(self, rows: Any) -> np.ndarray:
        """Give 1 for rows without a negative value, -1 without a positive one, 0 for others."""
        return (rows.min(1, initial=0.0) >= 0).astype(int) - (rows.max(1, initial=0.0) <= 0)


class TorchBackend:
    """Arrays of float64 on a torch device."""

    def __init__(self, device: str) -> None:
        """Check that torch and the device are there."""
        need("torch", "torch", f"device {device!r}")
        import torch

        if device.startswith("cuda") and not torch.cuda.is_available():
            raise InputError(f"device {device!r} was asked for, but torch sees no GPU; use 'cpu'")
        self.torch, self.device, self.name = torch, device, f"torch:{device}"

    def put(self, array: np.ndarray) -> Any:
        """Bring a numpy array to the device."""
        source = np.ascontiguousarray(array, dtype=float)
        return self.torch.as_tensor(source, dtype=self.torch.float64, device=self.device)

    def get(self, array: Any) -> np.ndarray:
        """Bring an array back to numpy."""
        return array.cpu().numpy()

    def apply(self, token: str, *arrays: Any) -> Any:
        """Apply an operator of OPERATORS; values outside its domain become NaN or inf."""
        return getattr(self.torch, OPERATORS[token].torch)(*arrays)

    form = apply

    def reserve(self, count: int, rows: int) -> Store:
        """Give room for value rows; nothing is taken ahead, since devices do it at once."""
        return _Joined(self, rows)

    def together(self, count: int, rows: int) -> int:
        """Give the batches of ``count`` value rows that are measured at once, by free memory."""
        if not self.device.startswith("cuda"):
            return 1
        free, _ = self.torch.cuda.mem_get_info(self.device)
        each = _ARRAYS * count * rows * np.dtype(float).itemsize
        return max(1, min(_MOST, int(_SHARE * free / each)))

    def measure(
        self, batches: Sequence[Any], directions: Any
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Give products with directions, and sums of squares, of the value rows of each batch."""
        # What a device has computed is fetched once for all: each fetch waits for it.
        values = self.torch.cat(list(batches))
        ends = np.cumsum([len(own) for own in batches])[:-1]
        projected, squares = self.get(directions @ values.T), self.square_sums(values)
        return list(zip(np.split(projected, ends, axis=1), np.split(squares, ends), strict=True))

    def square_sums(self, rows: Any) -> np.ndarray:
        """Give the sum of squares of each row."""
        return self.get((rows * rows).sum(1))

    def pick(self, rows: Any, index: np.ndarray) -> Any:
        """Give some rows by number."""
        return rows[self.torch.as_tensor(index, device=self.device)]

    def signs(self, rows: Any) -> np.ndarray:
        """Give 1 for rows without a negative value, -1 without a positive one, 0 for others."""
        return self.get((rows >= 0).all(1)).astype(int) - self.get((rows <= 0).all(1))


Backend = NumpyBackend | TorchBackend


@cache
def _sees_gpu() -> bool:
    """Whether torch is installed and sees a GPU; it is imported only where there is a driver."""
    if not (find_spec("torch") and (os.path.exists(_DRIVER) or shutil.which("nvidia-smi"))):
        return False
    import torch

    return bool(torch.cuda.is_available())


def choose_backend(device: str = "auto") -> Backend:
    """Give the backend of a device: "cpu" (numpy), "cuda", "torch-cpu", or "auto".

    "auto" takes CUDA where torch is installed and sees a GPU, numpy otherwise. Raises InputError
    for an unknown or absent device, MissingExtra for one that needs torch where there is none.

    >>> choose_backend("cpu").name
    'numpy'
    """
    if device not in DEVICES:
        raise InputError(f"unknown device {device!r}; the devices are: {', '.join(DEVICES)}")
    if device == "auto":
        return TorchBackend("cuda") if _sees_gpu() else NumpyBackend()
    return NumpyBackend() if device == "cpu" else TorchBackend(device.removeprefix("torch-"))
