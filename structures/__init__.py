"""Everything that maps a load to a response: structures, sensors, loads, forward models, measured models."""

from __future__ import annotations

import importlib
from typing import Any

_PUBLIC = {
    "Certificate": "model",
    "Channel": "channels",
    "CrossSpectra": "welch",
    "Dof": "dofs",
    "Flag": "flags",
    "ForwardModel": "forward",
    "FrfModel": "tabulated",
    "ImpulseModel": "arrays",
    "InputError": "errors",
    "MatrixModel": "arrays",
    "MeasuredModel": "measured",
    "Model": "model",
    "NotIdentifiable": "errors",
    "StateSpace": "statespace",
    "Structure": "structure",
    "Surface": "surfaces",
    "cross_spectra": "welch",
}
_MODULES = (
    "bases",
    "beams",
    "chains",
    "circular",
    "damping",
    "dofs",
    "factor",
    "files",
    "flags",
    "frames",
    "loads",
    "modelfile",
    "motion",
    "plates",
    "reduction",
    "risers",
    "sensors",
    "solids",
    "storage",
    "surfaces",
    "units",
    "virtual",
)

__all__ = sorted([*_PUBLIC, *_MODULES])


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f".{_PUBLIC[name]}", __name__), name)
    if name in _MODULES:
        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
