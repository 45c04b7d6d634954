"""Everything that maps a load to a response: structures, sensors, loads, forward models, measured models."""

from __future__ import annotations

import importlib
from typing import Any

_PUBLIC = {
    "Certificate": "_certificate",
    "Channel": "_channels",
    "CrossSpectra": "_testing.welch",
    "Dof": "_channels",
    "Flag": "_flags",
    "ForwardModel": "_models.forward",
    "FrfModel": "_models.tabulated",
    "ImpulseModel": "_models.arrays",
    "InputError": "errors",
    "MatrixModel": "_models.arrays",
    "MeasuredModel": "_models.measured",
    "Model": "_model",
    "NotIdentifiable": "errors",
    "StateSpace": "_models.statespace",
    "Structure": "_system.structure",
    "Surface": "_elements.surfaces",
    "TrainingRecords": "_testing.impact",
    "cross_spectra": "_testing.welch",
}
_MODULES = {
    "bases": "bases",
    "beams": "_elements.beams",
    "chains": "_elements.chains",
    "circular": "_elements.circular",
    "damping": "_system.damping",
    "dofs": "_channels",
    "factor": "_system.factor",
    "files": "files",
    "flags": "_flags",
    "frames": "_elements.frames",
    "loads": "_system.loads",
    "modelfile": "files._modelfile",
    "motion": "_models.motion",
    "plates": "_elements.plates",
    "reduction": "_models.reduction",
    "risers": "_elements.beams",
    "sensors": "_system.sensors",
    "solids": "_elements.solids",
    "storage": "files._storage",
    "surfaces": "_elements.surfaces",
    "units": "units",
    "virtual": "_models.mapped",
}

__all__ = sorted([*_PUBLIC, *_MODULES])


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f".{_PUBLIC[name]}", __name__), name)
    if name in _MODULES:
        return importlib.import_module(f".{_MODULES[name]}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
