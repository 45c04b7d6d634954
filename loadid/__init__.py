"""Reconstruct applied loads, with their uncertainty, from measured responses and a forward model."""

from __future__ import annotations

import importlib
import logging
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "Absolute": "loadid.settings",
    "Ambient": "loadid._inverse.gaussian.augment",
    "AutomaticInversion": "loadid._families.automatic",
    "Deconvolution": "loadid._families.deconvolution",
    "FieldDeconvolution": "loadid._families.field",
    "FrequencyInversion": "loadid._families.frequency",
    "Guards": "loadid.settings",
    "HarmonicInversion": "loadid._families.harmonic",
    "InputError": "structures.errors",
    "Lambda": "loadid.settings",
    "LearnedMap": "loadid._families.learned",
    "LoadEstimate": "loadid._results.estimate",
    "LoadTracker": "loadid._families.kalman",
    "LocationSearch": "loadid._families.location",
    "ModelErrors": "loadid.settings",
    "Noise": "loadid.settings",
    "NoiseSource": "loadid._inverse.problem",
    "NotIdentifiable": "structures.errors",
    "Online": "loadid.settings",
    "Penalty": "loadid.settings",
    "Priors": "loadid.settings",
    "Record": "loadid._record",
    "Search": "loadid.settings",
    "ShapeSensing": "loadid._families.shape",
    "Signal": "loadid.settings",
    "Sparsity": "loadid.settings",
    "Spectra": "loadid._record",
    "SparseDeconvolution": "loadid._families.sparse",
    "StaticInversion": "loadid._families.static",
    "align": "loadid._align",
    "calibrate": "loadid._commands.calibrate",
    "compare": "loadid._commands.compare",
    "compare_domains": "loadid._families.domains",
    "identify": "loadid._commands.identify",
    "load": "loadid._results.estimate",
    "load_map": "loadid._families.learned",
    "q_sweep": "loadid._families.tracking.sweep",
    "read": "loadid._readers",
    "read_all": "loadid._readers",
    "read_folder": "loadid._readers",
    "recommend": "loadid._families.recommend",
    "register_penalty": "loadid._inverse.penalties",
    "register_rule": "loadid._inverse.rules",
}
_ALSO = {
    "Alignment": "loadid._align",
    "FittedMap": "loadid._families.learned",
    "Folder": "loadid._folders",
    "LocationResult": "loadid._results.location",
}  # to import for a type; nobody makes one by hand

__all__ = sorted([*_PUBLIC, "__version__"])

logging.getLogger("loadid").addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    home = _PUBLIC.get(name) or _ALSO.get(name)
    if home is not None:
        return getattr(importlib.import_module(home), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
