from .crosschecks import crosscheck
from .doctor import examine, install, is_healthy

__all__ = [
    "crosscheck",
    "examine",
    "install",
    "is_healthy",
]
