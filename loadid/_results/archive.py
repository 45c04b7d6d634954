"""A load estimate as a tree for files and for JSON, and back."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from structures._certificate import Certificate
from structures._flags import Flag
from structures.errors import InputError
from structures.files import _storage as storage

from .._inverse.choice import Choice, PathCurve
from .._inverse.diagnosis.diagnose import Diagnosis
from .._inverse.posterior import from_arrays
from .._inverse.problem import NOT_KNOWN, NoiseSource
from .._inverse.sweep import RuleResult
from ..validate._checks import Validation
from .faults import SensorFault
from .functionals import LoadSpectrum

if TYPE_CHECKING:
    from .estimate import LoadEstimate

T = TypeVar("T")
KIND = "load estimate"
# first words of the constraints in files of release 0.1, and their kinds
_WRITTEN = {
    "non-negative": "NonNegative", "bounds": "Bounds", "support": "Support", "resultant": "Resultant",
    "friction": "FrictionCone",
}  # fmt: skip


def read(path: str | os.PathLike[str], of_tree: Callable[[dict[str, Any]], T], kind: str = KIND) -> T:
    """Read a result file, whose tree `of_tree` makes a result of.

    Raises
    ------
    InputError
        If the file is missing, of another kind, or damaged.
    """
    tree = storage.read(path, kind)
    try:
        return of_tree(tree)
    except InputError:
        raise
    except Exception as error:  # a whole file that another release wrote
        raise InputError(
            "its content is not what this release expects", where=str(path), found=f"{type(error).__name__}: {error}",
            hint="read it with the release that wrote it",
        ) from error  # fmt: skip


def plain(value: Any) -> Any:
    """Nested lists, text, finite numbers and None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":  # entry by entry takes seconds of a long record
        if (known := np.isfinite(value)).all():
            return value.tolist()
        value = value.astype(object)
        value[~known] = None
        return value.tolist()
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple) and set(map(type, value)) == {float}:
        return [v if isfinite(v) else None for v in value]
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def without_arrays(tree: dict[str, Any]) -> dict[str, Any]:
    """A plain tree of an estimate without what is as long as the record: shapes and ends stand in for it."""
    short = {k: v for k, v in tree.items() if k not in ("load", "std", "bias", "response", "residual")}
    if tree.get("diagnosis") is not None:
        lists = {k for k, v in tree["diagnosis"].items() if isinstance(v, list)}
        short["diagnosis"] = {k: v for k, v in tree["diagnosis"].items() if k not in lists}
    short.pop("geometry", None)
    short.pop("spectrum", None)
    load = tree["load"]
    short["shape"] = [len(load), len(load[0])] if isinstance(load[0], list) else [len(load)]
    if (axis := tree["axis"]) is not None:
        x = axis["values"]
        short["axis"] = {"name": axis["name"], "unit": axis["unit"], "first": x[0], "last": x[-1], "samples": len(x)}
    if tree["choice"] is not None:
        short["choice"] = {k: v for k, v in tree["choice"].items() if k != "sweep"}
    return short


def to_tree(e: LoadEstimate) -> dict[str, Any]:
    """Nested dictionary of everything, as `structures.files._storage` takes it."""
    tree: dict[str, Any] = {f.name: getattr(e, f.name) for f in fields(e) if f.name != "again"}
    tree["axis"] = e.axis and asdict(e.axis)
    tree["choice"] = e.choice and {**asdict(e.choice), "sigma_source": e.choice.sigma_source}
    tree["certificate"] = e.certificate and asdict(e.certificate)
    tree["flags"] = [f.to_dict() for f in e.flags]
    tree["posterior"] = None if e.posterior is None else e.posterior.to_arrays()
    tree["geometry"] = None if e.geometry is None else dict(e.geometry)
    tree["facts"] = dict(e.facts)
    tree["diagnosis"] = None if e.diagnosis is None else e.diagnosis.to_dict()
    tree["validation"] = None if e.validation is None else e.validation.to_dict()
    tree["faults"] = [f.to_dict() for f in e.faults]
    tree["spectrum"] = None if e.spectrum is None else e.spectrum.to_dict()
    return tree


def arguments(tree: dict[str, Any]) -> dict[str, Any]:
    """Inverse of `to_tree`: what an estimate is made of, but for its axis, which stays a dictionary."""
    settings = (tree.get("provenance") or {}).get("settings") or {}
    if settings.get("constraints") and "constraint_kinds" not in settings:  # a file of release 0.1
        settings["constraint_kinds"] = [_WRITTEN.get(str(c).split(" ")[0], "") for c in settings["constraints"]]
    if (choice := tree["choice"]) is not None:
        choice["rules"] = tuple(RuleResult(**r) for r in choice["rules"])
        said, source = choice.pop("sigma_source", None), choice.pop("source", None)
        origin = NoiseSource(**source) if source else NoiseSource.of(said)  # files of release 0.1 have the text only
        choice["source"] = origin or NOT_KNOWN
        choice["sweep"] = choice["sweep"] and PathCurve(**choice["sweep"])
        tree["choice"] = Choice(**choice)
    if (certificate := tree["certificate"]) is not None:
        known: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in certificate.items()}
        tree["certificate"] = Certificate(**known)
    tree["flags"] = [Flag.from_dict(f) for f in tree["flags"]]
    if tree["posterior"] is not None:
        tree["posterior"] = from_arrays(tree["posterior"])
    if tree.get("diagnosis") is not None:
        tree["diagnosis"] = Diagnosis.from_dict(tree["diagnosis"])
    if tree.get("validation") is not None:
        tree["validation"] = Validation.from_dict(tree["validation"])
    tree["faults"] = [SensorFault.from_dict(f) for f in tree.get("faults") or ()]
    if tree.get("spectrum") is not None:
        tree["spectrum"] = LoadSpectrum.from_dict(tree["spectrum"])
    return tree
