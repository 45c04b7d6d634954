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
    "MeasuredModes": "_testing.modes",
    "ModalModel": "_models.modal",
    "Model": "_model",
    "NotIdentifiable": "errors",
    "StateSpace": "_models.statespace",
    "Structure": "_system.structure",
    "Surface": "_elements.surfaces",
    "TrainingRecords": "_testing.impact",
    "cross_spectra": "_testing.welch",
    "identify_modes": "_testing.modes",
}
_MODULES = {
    "bases": "bases",
    "beams": "_elements.beams",
    "chains": "_elements.chains",
    "damping": "_system.damping",
    "files": "files",
    "frames": "_elements.frames",
    "loads": "_system.loads",
    "motion": "_models.motion",
    "plates": "_elements.plates",
    "sensors": "_system.sensors",
    "shape_sensing": "shape_sensing",
    "solids": "_elements.solids",
    "units": "units",
}
_UNLISTED = {  # parts that release 0.1 names here too
    "circular": "_elements.circular",
    "dofs": "_channels",
    "factor": "_system.factor",
    "flags": "_flags",
    "modelfile": "files._modelfile",
    "reduction": "_models.reduction",
    "risers": "_elements.beams",
    "storage": "files._storage",
    "surfaces": "_elements.surfaces",
    "virtual": "_models.mapped",
}

__all__ = sorted([*_PUBLIC, *_MODULES])


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f".{_PUBLIC[name]}", __name__), name)
    if (place := _MODULES.get(name) or _UNLISTED.get(name)) is not None:
        return importlib.import_module(f".{place}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
