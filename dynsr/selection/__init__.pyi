from .comparison import ComparisonSettings
from .first_look import Look, LookSettings, look
from .pick import (
    Pick,
    SelectionSettings,
    explains_all,
    forecast_miss,
    lead_with,
    pick_equation,
    rank_by_length,
    trivial_candidates,
)
from .systems import SystemChoice, compare_systems, explore, other_in_halves

__all__ = [
    "ComparisonSettings",
    "Look",
    "LookSettings",
    "Pick",
    "SelectionSettings",
    "SystemChoice",
    "compare_systems",
    "explains_all",
    "explore",
    "forecast_miss",
    "lead_with",
    "look",
    "other_in_halves",
    "pick_equation",
    "rank_by_length",
    "trivial_candidates",
]
