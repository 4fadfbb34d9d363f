"""Confirmation: the engine that was asked for integrates what was found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynsr.discovery.result import Discovery
from dynsr.engines import AbstractEngine, EmbeddedEngine, find_engine
from dynsr.errors import EngineError
from dynsr.fit import rmse
from dynsr.verdict import MEASURED, predict


def confirm(found: Discovery) -> Discovery:
    """Have the engine that was asked for integrate the equations over every run of the data.

    ``settings["confirmed"]`` of the result names the engine and its versions, and gives for each
    state the root mean square of its distance from the data, None where a solution ends early or
    the engine fails. Ctrl-C leaves the equations unconfirmed. The embedded engine, in whose terms
    constants are fitted, has nothing to add; a map is iterated, and an engine that takes no
    measured inputs gives way to the embedded one, which ``settings["engines"]`` says.

    Parameters
    ----------
    found : a discovery with its data.
    """
    engine = find_engine(found.engine)
    idle = found.is_map or found.settings["engines"]["simulate"] == MEASURED
    if isinstance(engine, EmbeddedEngine) or idle or not found.complete:
        return found
    versions: dict[str, str] = {}
    distances: dict[str, float | None] = dict.fromkeys(found.equations)
    try:
        versions = engine.versions()
        distances = _distances(found, engine)
    except EngineError:
        pass
    except KeyboardInterrupt:
        # The search is over, and what it found is not lost.
        return found
    confirmed = {"engine": engine.name, "versions": versions, "trajectory_rmse": distances}
    return replace(found, settings={**found.settings, "confirmed": confirmed})


def _distances(found: Discovery, engine: AbstractEngine) -> dict[str, float | None]:
    states = list(found.equations)
    truths, curves = [], []
    for run in found.carried:
        places = [run.index(state) for state in states]
        inputs = found.inputs_of(run)
        truths.append(run.observed[:, places])
        curves.append(predict(found.equations, run.x[0, places], run.t, inputs, engine).x)
    x, y = np.concatenate(curves), np.concatenate(truths)
    return {state: rmse(x[:, i], y[:, i]) for i, state in enumerate(states)}
