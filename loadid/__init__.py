"""Reconstruct applied loads, with their uncertainty, from measured responses and a forward model."""

from __future__ import annotations

import importlib
import logging
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "Absolute": "loadid.settings",
    "Deconvolution": "loadid.families.deconvolution",
    "FieldDeconvolution": "loadid.families.field",
    "FrequencyInversion": "loadid.families.frequency",
    "Guards": "loadid.settings",
    "HarmonicInversion": "loadid.families.harmonic",
    "InputError": "structures.errors",
    "Lambda": "loadid.settings",
    "LoadEstimate": "loadid.results.estimate",
    "LoadTracker": "loadid.families.kalman",
    "LocationResult": "loadid.results.location",
    "LocationSearch": "loadid.families.location",
    "ModelErrors": "loadid.settings",
    "Noise": "loadid.settings",
    "NoiseSource": "loadid.inverse.noise_source",
    "NotIdentifiable": "structures.errors",
    "Online": "loadid.settings",
    "Penalty": "loadid.settings",
    "Priors": "loadid.settings",
    "Record": "loadid.record",
    "Search": "loadid.settings",
    "Signal": "loadid.settings",
    "Sparsity": "loadid.settings",
    "Spectra": "loadid.record",
    "SparseDeconvolution": "loadid.families.sparse",
    "StaticInversion": "loadid.families.static",
    "compare_domains": "loadid.families.domains",
    "load": "loadid.results.estimate",
    "q_sweep": "loadid.families.tracking.sweep",
    "read": "loadid.readers",
    "read_all": "loadid.readers",
    "recommend": "loadid.families.recommend",
    "register_penalty": "loadid.inverse.penalties",
    "register_rule": "loadid.inverse.rules",
}

__all__ = sorted([*_PUBLIC, "__version__"])

logging.getLogger("loadid").addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
