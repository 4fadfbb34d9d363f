"""dynsr: the equations of a dynamical system from its trajectories, as formulas you can read."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

__version__ = "0.1.0"

# Public name -> the module it lives in; loaded on first use so that `import dynsr` is quick.
_PUBLIC = {
    "Candidate": "dynsr.pareto",
    "Discovery": "dynsr.found",
    "DynsrRegressor": "dynsr.estimator",
    "ParetoFront": "dynsr.pareto",
    "Samples": "dynsr.samples",
    "Score": "dynsr.scoring",
    "System": "dynsr.system",
    "Trajectory": "dynsr.trajectory",
    "DynsrError": "dynsr.errors",
    "EngineError": "dynsr.errors",
    "EngineUnavailable": "dynsr.errors",
    "InputError": "dynsr.errors",
    "SYSTEMS": "dynsr.catalogue",
    "add_noise": "dynsr.simulate",
    "audit": "dynsr.audit",
    "bootstrap": "dynsr.ensemble",
    "discover": "dynsr.discovery",
    "equation_rmse": "dynsr.scoring",
    "find_engine": "dynsr.engines.select",
    "find_system": "dynsr.catalogue",
    "make_method": "dynsr.methods.select",
    "make_samples": "dynsr.samples",
    "parse": "dynsr.expression",
    "printed_loss": "dynsr.scoring",
    "replicate": "dynsr.replicate",
    "score_expressions": "dynsr.scoring",
    "simulate": "dynsr.simulate",
    "trajectory_loss": "dynsr.scoring",
}

__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'dynsr' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__


class _Package(ModuleType):
    """The package, in which ``dynsr.simulate`` is the function and not the module of that name."""

    def __setattr__(self, name: str, value: Any) -> None:
        # Python binds every module that it imports to its package; a public function stays.
        if not (name in _PUBLIC and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
