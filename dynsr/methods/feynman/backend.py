"""Where the arrays of the brute-force search live: numpy, or torch where a GPU is asked for.

The enumeration forms and projects its value rows through one of these two classes and nothing
else, so the same code runs on both. torch is imported only when a torch device is asked for, or
by ``device="auto"`` when it is imported already and sees a GPU.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from dynsr.errors import InputError
from dynsr.expression import OPERATORS

DEVICES = ("auto", "cpu", "cuda", "torch-cpu")


class NumpyBackend:
    """Arrays of float64 in main memory."""

    name = "numpy"

    def put(self, array: np.ndarray) -> Any:
        """Bring a numpy array to where the work is done."""
        return np.ascontiguousarray(array, dtype=float)

    def get(self, array: Any) -> np.ndarray:
        """Bring an array back to numpy."""
        return np.asarray(array)

    def apply(self, token: str, *arrays: Any) -> Any:
        """Apply an operator of OPERATORS; values outside its domain become NaN or inf."""
        return OPERATORS[token].numpy(*arrays)

    def concatenate(self, arrays: list[Any]) -> Any:
        """Put arrays below each other."""
        return np.concatenate(arrays)

    def square_sums(self, rows: Any) -> np.ndarray:
        """Give the sum of squares of each row."""
        return np.einsum("ij,ij->i", rows, rows)

    def pick(self, rows: Any, index: np.ndarray) -> Any:
        """Give some rows by number."""
        return rows[index]

    def above(self, values: Any, bound: float) -> np.ndarray:
        """Give the flat positions of the values above a bound (never those of NaN)."""
        return np.flatnonzero(values.ravel() > bound)


class TorchBackend:
    """Arrays of float64 on a torch device."""

    def __init__(self, device: str) -> None:
        """Check that the device is there."""
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

    def concatenate(self, arrays: list[Any]) -> Any:
        """Put arrays below each other."""
        return self.torch.cat(arrays)

    def square_sums(self, rows: Any) -> np.ndarray:
        """Give the sum of squares of each row."""
        return self.get((rows * rows).sum(1))

    def pick(self, rows: Any, index: np.ndarray) -> Any:
        """Give some rows by number."""
        return rows[self.torch.as_tensor(index, device=self.device)]

    def above(self, values: Any, bound: float) -> np.ndarray:
        """Give the flat positions of the values above a bound (never those of NaN)."""
        return self.get(self.torch.nonzero(values.reshape(-1) > bound).reshape(-1))


Backend = NumpyBackend | TorchBackend


def choose_backend(device: str = "auto") -> Backend:
    """Give the backend of a device: "cpu" (numpy), "cuda", "torch-cpu", or "auto".

    "auto" takes CUDA when torch is already imported and sees a GPU, numpy otherwise. Raises
    InputError for an unknown or absent device.

    >>> choose_backend("cpu").name
    'numpy'
    """
    if device not in DEVICES:
        raise InputError(f"unknown device {device!r}; the devices are: {', '.join(DEVICES)}")
    if device == "auto":
        torch = sys.modules.get("torch")
        return TorchBackend("cuda") if torch and torch.cuda.is_available() else NumpyBackend()
    return NumpyBackend() if device == "cpu" else TorchBackend(device.removeprefix("torch-"))
