"""A tracker as a file: what the fit settled and where the filter stands, so that it goes on bit for bit.

The gains are stored, not solved for again; the file is written whole or not at all (`structures.storage`).
"""

from __future__ import annotations

import hashlib
import os
from typing import Any
from weakref import WeakKeyDictionary

from structures import storage
from structures.errors import InputError

from .fitted import Fitted
from .packing import pack, unpack
from .tracker import Tracker

KIND = "tracker"
FORMAT = 2
_PACKED: WeakKeyDictionary[Fitted, tuple[dict[str, Any], str]] = WeakKeyDictionary()


def save(tracker: Tracker, path: str | os.PathLike, stream: dict[str, Any] | None = None) -> None:
    """Write a tracker with its present state.

    Parameters
    ----------
    tracker : Tracker
    path : path
        Replaced as a whole; on any error the old file stays.
    stream : dict, optional
        Where its stream stands; `read` gives it back.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    fitted, digest = _packed(tracker.fitted)
    tree = {
        "format": FORMAT,
        "model": tracker.fitted.fingerprint,
        "fit": digest,
        "fitted": fitted,
        "gate": tracker.gate,
        "lag": tracker.lag,
        "replay": tracker.replay,
        "kind of engine": tracker.engine,
        "running": pack(tracker.to_tree()),
        "stream": pack(stream),
    }
    storage.write(path, tree, KIND)


def load(path: str | os.PathLike, model: Any = None) -> Tracker:
    """Tracker of a file, at the sample at which it was saved, and ready: its first sample waits for no compiler.

    Parameters
    ----------
    path : path
    model : Model or str, optional
        The model of the structure, or its fingerprint: a tracker of another one is refused.

    Raises
    ------
    InputError
        A file that is missing, damaged, cut short, of another kind, format or model.
    """
    tracker = read(path, model)[0]
    tracker.compile()
    return tracker


def read(path: str | os.PathLike, model: Any = None) -> tuple[Tracker, dict[str, Any] | None]:
    """Tracker of a file, and where its stream stood; None where it was saved without one. No compiler is loaded.

    Raises
    ------
    InputError
        As `load`.
    """
    tree = storage.read(path, KIND)
    if tree.get("format") != FORMAT:
        raise InputError("a tracker of another format", where=str(path), found=f"format {tree.get('format')!r}",
                         expected=f"format {FORMAT}", hint="fit again, or use the release that wrote it")  # fmt: skip
    wanted = model if isinstance(model, str | None) else model.fingerprint
    if wanted is not None and wanted != tree["model"]:
        raise InputError("a tracker of another model", where=str(path), found=f"model {tree['model'][:12]}",
                         expected=f"model {wanted[:12]}", hint="fit a tracker to this model")  # fmt: skip
    try:
        tracker = Tracker(
            unpack(tree["fitted"]), tree["gate"], int(tree["lag"]), replay=int(tree["replay"]),
            engine=str(tree["kind of engine"]),
        )  # fmt: skip
        tracker.restore(unpack(tree["running"]))
        _PACKED[tracker.fitted] = tree["fitted"], tree["fit"]  # to be written again as it was
        return tracker, unpack(tree["stream"])
    except InputError:
        raise
    except (KeyError, IndexError, TypeError, ValueError) as error:  # of another release
        raise InputError("its content is not what this release expects", where=str(path),
                         found=f"{type(error).__name__}: {error}",
                         hint="read it with the release that wrote it") from error  # fmt: skip


def fit_of(path: str | os.PathLike) -> str:
    """Digest of what the fit settled: two files with the same one go on alike from the same state.

    Raises
    ------
    InputError
        As `storage.read`.
    """
    return str(storage.read(path, KIND)["fit"])


def running(tracker: Tracker) -> dict[str, Any]:
    """What changes from sample to sample, as plain arrays and numbers."""
    return tracker.to_tree()


def _packed(fitted: Fitted) -> tuple[dict[str, Any], str]:
    """A fit, which never changes, as it is written again and again, and its digest."""
    if fitted not in _PACKED:
        tree = pack(fitted)
        digest = hashlib.sha256(tree["text"].encode())
        digest.update(tree["numbers"].tobytes())
        _PACKED[fitted] = tree, digest.hexdigest()
    return _PACKED[fitted]
