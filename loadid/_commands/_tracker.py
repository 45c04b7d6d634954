"""The tracker of ``loadid track``, loaded when it runs: of a file, of a state to go on from, or fitted to a record."""

from __future__ import annotations

import hashlib
from argparse import ArgumentTypeError, Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

from structures._models.tabulated import FILE
from structures.errors import InputError
from structures.files import _modelfile as modelfile
from structures.files import _storage as storage
from structures.files._uff import SUFFIXES

from .._families import kalman
from .._families.tracking import tracker as checkpoint
from .._families.tracking.tracker import KIND, Tracker
from .._readers import read
from .._spellings import folded
from ..settings import Noise
from . import FIT_OPTIONS, load_model, names, one_record, positive, settings

COMMAND = "command"  # among the settings of a fit: what it was made from here
PIECE = 1 << 20


def started(args: Namespace, progress: Any = None) -> tuple[Tracker, dict[str, Any] | None, bool]:
    """Tracker of the state where there is one, else of the model; where its stream stood; whether it was fitted now.

    Raises
    ------
    InputError
        No file, a damaged one, one of another kind; a state of another tracker, model, record or setting; a model
        without a record to tune it on.
    NotIdentifiable
        From the fit.
    """
    model, state = args.model, args.state
    if state is not None and Path(state).exists():
        tracker, stream = checkpoint.read(_tracker_file(state))
        _require_same(args, tracker)
        return tracker, stream, False
    if model is None:
        raise InputError("there is no state to go on from", where=f"--state {state}", found="no such file",
                         expected="a file of a tracker", hint="name a fitted tracker with --model, or a model with "
                         "--model and --fit")  # fmt: skip
    if _is_tracker(model):
        _refuse_fit(args)
        return checkpoint.read(model)[0], None, False
    if args.fit is None:
        raise InputError("this model is not tuned yet", where=f"--model {model}", found="a model of a structure",
                         expected="a fitted tracker", hint="name a record to tune it on with --fit")  # fmt: skip
    tracker = _fitted(args, progress)
    if state is not None:
        checkpoint.save(tracker, state)  # before the first sample: what took seconds is not lost
    return tracker, None, True


def _fitted(args: Namespace, progress: Any) -> Tracker:
    made = _made(args)
    model = load_model(args.model)
    model.require("state_space")
    given: dict[str, Any] = {name: value for name in FIT_OPTIONS if (value := getattr(args, name)) is not None}
    if "prior" in given and len(given["prior"]) == 1:
        given["prior"] = given["prior"][0]
    if "noise" in given:
        given["noise"] = Noise(_noise(given["noise"], [c.label for c in model.sensors]), source="--noise")
    if "start" in given:
        given["start"] = 0.0 if given["start"] == "rest" else "static"
    if given.get("gate") == 0:
        given["gate"] = None
    family = kalman.LoadTracker(model, **folded(kalman.LoadTracker, given), progress=progress)
    found = family.fit(read(args.fit, record=one_record(args), **settings(args)))
    told = replace(found.fitted, settings={**found.fitted.settings, COMMAND: made})
    tracker = Tracker(told, found.gate, found.lag, replay=found.replay, engine=found.engine)
    tracker.made_of(found.origin)
    return tracker


# -- is it the same fit? ----------------------------------------------------------------------------------------------
def _require_same(args: Namespace, tracker: Tracker) -> None:
    """A state is gone on from only where a new start would have made the same tracker."""
    if args.model is None:
        return
    where = f"--state {args.state}"
    if _is_tracker(args.model):
        _refuse_fit(args)
        if checkpoint.fit_of(args.model) != checkpoint.fit_of(args.state):
            raise InputError("the state belongs to another tracker than the model", where=where,
                             expected=f"a state of {args.model}", hint="name a new file with --state")  # fmt: skip
        return
    made = tracker.fitted.settings.get(COMMAND)
    if made is None:  # fitted in Python
        if load_model(args.model).fingerprint != tracker.fitted.fingerprint:
            raise InputError("the state belongs to another model", where=where, expected=f"a state of {args.model}",
                             hint="name a new file with --state")  # fmt: skip
        return
    now = _made(args, int(made["record"]["bytes"]))
    if args.fit is None:
        now |= {"record": made["record"], "options": made["options"]}
    for name, words in (("model", "another model"), ("options", "a fit with other settings"),
                        ("record", "a fit to another record")):  # fmt: skip
        if made[name] != now[name]:
            raise InputError(f"the state belongs to {words}", where=where, found=_shown(made[name]),
                             expected=_shown(now[name]), hint="name a new file with --state")  # fmt: skip


def _shown(value: Any) -> str:
    if not isinstance(value, dict):
        return f"sha256 {value[:12]}"
    if "sha256" in value:
        return f"{value['bytes']} bytes, sha256 {value['sha256'][:12]}"
    return ", ".join(f"--{k.replace('_', '-')} {v}" for k, v in value.items()) or "no settings"


def _made(args: Namespace, size: int | None = None) -> dict[str, Any]:
    """What a fit is made from: content of the model's file, settings, content of the record, which may have grown."""
    options = {name: str(value) for name in (*FIT_OPTIONS, "fs", "columns", "axis", "record", "unit")
               if (value := getattr(args, name)) not in (None, [])}  # fmt: skip
    record = {} if args.fit is None else _digest(args.fit, size)
    return {"model": _digest(args.model)["sha256"], "options": options, "record": record}


def _digest(path: str, size: int | None = None) -> dict[str, Any]:
    """Of a file, or of as much of it as there was before."""
    hasher, total = hashlib.sha256(), 0
    try:
        left = Path(path).stat().st_size if size is None else size
        with Path(path).open("rb") as file:
            while left > 0 and (data := file.read(min(PIECE, left))):
                hasher.update(data)
                total, left = total + len(data), left - len(data)
    except OSError as error:
        raise InputError("the file cannot be read", where=path, found=error.strerror or str(error),
                         hint="check the path") from None  # fmt: skip
    return {"bytes": total, "sha256": hasher.hexdigest()}


def _is_tracker(path: str) -> bool:
    """Whether the file holds a tracker; other kinds of model may become one."""
    if Path(path).suffix.lower() in SUFFIXES:
        return False
    kind = storage.kind_of(path)
    if kind is not None and kind not in (KIND, *modelfile.KINDS, FILE, "measured model", "modal model"):
        raise InputError("this file holds no tracker, and no model to tune", where=path, found=kind,
                         expected=f"{KIND}, or {', '.join(modelfile.KINDS)}",
                         hint="in Python: LoadTracker(model).fit(record).save(file), or model.save(file)")  # fmt: skip
    if kind is None:
        storage.read(path, KIND)  # refuses what is no file of ours
    return kind == KIND


def _tracker_file(path: str) -> str:
    """The path, where it leads to a tracker."""
    if not _is_tracker(path):
        raise InputError("this file holds no tracker", where=path, found="a model of a structure", expected="a state",
                         hint="name the model with --model, and a new file with --state")  # fmt: skip
    return path


def _refuse_fit(args: Namespace) -> None:
    if args.fit is not None:
        raise InputError("this tracker is tuned already", where=f"--model {args.model}", found=f"--fit {args.fit}",
                         expected="a model of a structure", hint="leave --fit out, or name the model")  # fmt: skip


# -- values -----------------------------------------------------------------------------------------------------------
def _noise(text: str, sensors: list[str]) -> list[float]:
    """Std of every sensor."""
    parts = names(text)
    pairs = [part.rpartition("=") for part in parts]
    named = [label for label, sign, _ in pairs if sign]
    if named and sorted(named) != sorted(sensors):
        raise InputError("one noise std for each sensor", where="--noise", found=", ".join(named),
                         expected=", ".join(sensors))  # fmt: skip
    values = []
    for _, _, value in sorted(pairs, key=lambda p: sensors.index(p[0])) if named else pairs:
        try:
            values.append(positive(value))
        except ArgumentTypeError as error:
            raise InputError("no noise std", where="--noise", found=value, expected="a number > 0") from error
    if not named and len(values) == 1:
        return values * len(sensors)
    if len(values) != len(sensors):
        raise InputError("one noise std for each sensor", where="--noise", found=f"{len(values)} numbers",
                         expected=f"{len(sensors)}, for {', '.join(sensors)}")  # fmt: skip
    return values
