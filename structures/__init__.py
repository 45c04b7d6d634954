"""Everything that maps a load to a response: structures, sensors, loads, forward models, measured models."""

from __future__ import annotations

import importlib
from typing import Any

_PUBLIC = {
    "Certificate": "certificate",
    "Channel": "channels",
    "CrossSpectra": "testing.welch",
    "Dof": "channels",
    "Flag": "flags",
    "ForwardModel": "models.forward",
    "FrfModel": "models.tabulated",
    "ImpulseModel": "models.arrays",
    "InputError": "errors",
    "MatrixModel": "models.arrays",
    "MeasuredModel": "models.measured",
    "Model": "model",
    "NotIdentifiable": "errors",
    "StateSpace": "models.statespace",
    "Structure": "system.structure",
    "Surface": "elements.surfaces",
    "TrainingRecords": "testing.impact",
    "cross_spectra": "testing.welch",
}
_MODULES = {
    "bases": "bases",
    "beams": "elements.beams",
    "chains": "elements.chains",
    "circular": "elements.circular",
    "damping": "system.damping",
    "dofs": "channels",
    "factor": "system.factor",
    "files": "files",
    "flags": "flags",
    "frames": "elements.frames",
    "loads": "system.loads",
    "modelfile": "files.modelfile",
    "motion": "models.motion",
    "plates": "elements.plates",
    "reduction": "models.reduction",
    "risers": "elements.beams",
    "sensors": "system.sensors",
    "solids": "elements.solids",
    "storage": "files.storage",
    "surfaces": "elements.surfaces",
    "units": "units",
    "virtual": "models.mapped",
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
