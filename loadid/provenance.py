"""Where a result comes from: versions, settings, digests of what went in."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

STATIC = "static inversion"  # name of the family whose loads are of readings, whatever their axis


def provenance(
    family: str, *, settings: Mapping[str, Any], inputs: Mapping[str, str], model: str, prior: str
) -> dict[str, Any]:
    """Record of how an estimate was made.

    Parameters
    ----------
    family : str
    settings : mapping
    inputs : mapping
        Name -> sha256.
    model : str
        Fingerprint of the forward model.
    prior : str
        The prior, in words.
    """
    return {
        "family": family,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version(), **{p: _version(p) for p in ("loadid", "numpy", "scipy")}},
        "settings": dict(settings),
        "inputs": dict(inputs),
        "model": model,
        "prior": prior,
    }


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
