from .pick import (
    Pick,
    SelectionSettings,
    explains_all,
    forecast_miss,
    pick_equation,
    trivial_candidates,
)
from .systems import compare_systems

__all__ = [
    "Pick",
    "SelectionSettings",
    "compare_systems",
    "explains_all",
    "forecast_miss",
    "pick_equation",
    "trivial_candidates",
]
