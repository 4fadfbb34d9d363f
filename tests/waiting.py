"""Waiting for what another thread or process does."""

import time


def wait_for(condition, seconds=10.0):
    """Wait until a condition holds; give its value."""
    until = time.monotonic() + seconds
    while not (value := condition()) and time.monotonic() < until:
        time.sleep(0.01)
    return value or condition()
