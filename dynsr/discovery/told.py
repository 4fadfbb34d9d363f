"""Told: what the data said of themselves stands with what was found in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynsr.data import Trajectory
from dynsr.discovery.result import Discovery


def with_told(found: Discovery, runs: Sequence[Trajectory]) -> Discovery:
    """Give a discovery that knows how its columns were read, the unit of its time, and misfits.

    Parameters
    ----------
    found : the discovery.
    runs : the data; what was read from them stands in their origin.
    """
    told = {
        name: runs[0].origin.get(name)
        for name in ("columns", "table", "time_unit", "doses", "said_noise")
    }
    known = {name: words for name, words in told.items() if words}
    found = replace(found, settings={**found.settings, **known})
    if "column_units" not in found.settings:
        return found
    misfits = {
        state: f" In the units given it is no equation: {fault}."
        for state, fault in found.unit_faults().items()
    }
    words = {s: why + misfits.get(s, "") for s, why in found.explanation.items()}
    return replace(found, explanation=words)
