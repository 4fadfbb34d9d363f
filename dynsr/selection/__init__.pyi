from .pick import (
    Pick,
    explains_all,
    forecast_miss,
    pick_equation,
    read_candidates,
    trivial_candidates,
    write_candidates,
)
from .systems import settle

__all__ = [
    "Pick",
    "explains_all",
    "forecast_miss",
    "pick_equation",
    "read_candidates",
    "settle",
    "trivial_candidates",
    "write_candidates",
]
