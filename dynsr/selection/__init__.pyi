from .pick import (
    SELECTION,
    Pick,
    SelectionSettings,
    explains_all,
    forecast_miss,
    pick_equation,
    trivial_candidates,
)
from .systems import compare_systems

__all__ = [
    "SELECTION",
    "Pick",
    "SelectionSettings",
    "compare_systems",
    "explains_all",
    "forecast_miss",
    "pick_equation",
    "trivial_candidates",
]
