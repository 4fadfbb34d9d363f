from .noise import Recovery, Search, measure_recovery

__all__ = [
    "Recovery",
    "Search",
    "measure_recovery",
]
