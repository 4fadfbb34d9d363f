"""Properties: what the data said of themselves is kept with what was found in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dynsr.data import Trajectory
from dynsr.discovery.result import Discovery, with_words


def with_provenance(
    found: Discovery, runs: Sequence[Trajectory], observed: Mapping[str, Any] | None = None
) -> Discovery:
    """Give a discovery that knows how its columns were read, the unit of its time, and misfits.

    Parameters
    ----------
    found : the discovery.
    runs : the data; what was read from them is in their origin.
    observed : column -> the sum of states that it is.
    """
    told = {
        name: runs[0].origin.get(name)
        for name in ("columns", "table", "time_unit", "doses", "said_noise", "said_limits")
    }
    known = {name: words for name, words in told.items() if words}
    known |= {"observed": {n: str(e) for n, e in observed.items()}} if observed else {}
    if "column_units" not in found.settings:
        return with_words(found, "", **known)
    misfits = {
        state: f" In the units given it is no equation: {fault}."
        for state, fault in found.unit_faults().items()
    }
    return with_words(found, misfits, **known)
