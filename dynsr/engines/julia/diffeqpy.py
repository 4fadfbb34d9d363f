"""Integration through diffeqpy, the Python face of DifferentialEquations.jl: a peer.

The paper's own data generation. It brings the whole of DifferentialEquations.jl along and is
therefore no engine for daily use.
"""

from __future__ import annotations

import importlib.util

from dynsr.engines.base import SparseProblem, SparseSolution
from dynsr.engines.julia.engine import START_SECONDS, JuliaEngine, announce_on_stderr
from dynsr.engines.julia.process import Announce
from dynsr.errors import EngineError, EngineUnavailable, say_install


class DiffeqpyEngine(JuliaEngine):
    """Integrates by ``de.solve(..., de.Tsit5())`` in a process of its own; does not regress.

    Raises EngineUnavailable, with the remedy, where diffeqpy or Julia is not set up.
    """

    name = "diffeqpy"
    integration = "diffeqpy"
    takes_drives = False

    def __init__(
        self, start_seconds: float = START_SECONDS, announce: Announce = announce_on_stderr
    ) -> None:
        """Check that diffeqpy and Julia are there; they start on the first use."""
        if importlib.util.find_spec("diffeqpy") is None:
            raise EngineUnavailable(
                f"diffeqpy is not installed; run {say_install('diffeqpy')}, "
                "then dynsr doctor --install"
            )
        super().__init__(start_seconds=start_seconds, announce=announce)

    def __reduce__(self) -> tuple[type[DiffeqpyEngine], tuple[float, Announce]]:
        """Travel to another process as settings."""
        return (DiffeqpyEngine, (self.start_seconds, self.announce))

    def regress(self, problem: SparseProblem) -> SparseSolution:
        """Raise EngineError: diffeqpy only integrates."""
        raise EngineError("diffeqpy only integrates; regress by the engine embedded or julia")
