"""What lies before somebody who looks at own data: a model, a log, the estimate, and the same at other lambdas.

Words of the page are read by what reads those of the command line, the estimate comes from `loadid.identify`: the
numbers are those of `loadid identify` on the same files.
"""

from __future__ import annotations

import shlex
from argparse import ArgumentParser, ArgumentTypeError
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np

from structures.errors import InputError

from .shown import Shown, curve, flags_of

if TYPE_CHECKING:
    from structures._model import Model

T = TypeVar("T")


class Desk:
    """A model, a log and an estimate, for one user at a time."""

    def __init__(self) -> None:
        self._lock = RLock()
        self._model: Model | None = None
        self._log: Any = None
        self._name = ""
        self._shown: Shown | None = None
        self._estimates = 0

    # -- files --------------------------------------------------------------------------------------------------------
    def read_model(self, path: str | Path) -> dict[str, Any]:
        """Put a model there, and say what it is; a log that lay there is taken away.

        Raises
        ------
        InputError
            No model.
        """
        from .._commands import load_model

        model = load_model(path)
        with self._lock:
            self._model, self._log = model, None
            self._shown = None
        return self.state()

    def read_words(self, path: Path, *, fs: str, columns: str, record: str, units: str) -> dict[str, Any]:
        """Put a log there, read as words have it that options of these names would be given."""
        return self.read_log(path, record=record, **_reading(fs, columns, units))

    def read_log(self, path: str | Path, *, record: str | Sequence[str] = "", **reading: Any) -> dict[str, Any]:
        """Put a log there, read as `loadid.read` reads it, and say what is in it.

        Raises
        ------
        InputError
            No model yet, and all that the reader refuses; where units or a step must be stated it says so.
        """
        from .._commands._inputs import sensor_table
        from .._readers import read

        if self._model is None:
            raise InputError("a log is read for a model", where="log", found="no model", expected="the model first")
        labels = [s.label for s in self._model.sensors]
        plain = self._model.gives("static") and not (reading or record)
        found: Any = sensor_table(path, labels) if plain else None
        if found is None:
            found = read(path, record=record or None, **reading)
        with self._lock:
            self._log, self._name = found, Path(path).name
            self._shown = None
        return self.state()

    def state(self) -> dict[str, Any]:
        """What is there."""
        with self._lock:
            return {
                "model": _model(self._model),
                "log": _log(self._log, self._name),
                "found": self._shown is not None,
            }

    # -- the estimate -------------------------------------------------------------------------------------------------
    def identify(self, family: str, response: str, noise: str, more: str) -> dict[str, Any]:
        """The estimate of log and model, as `loadid identify` has it with these options.

        Raises
        ------
        InputError, NotIdentifiable
            From the options and from the family.
        """
        from .._commands import channels
        from .._commands.identify import identify

        given = _options(more)
        if noise.strip():
            given |= _options(f"--noise {shlex.quote(noise.strip())}")
        with self._lock:
            model, log = self._model, self._log
        if model is None or log is None:
            lacking = "no model" if model is None else "no log"
            raise InputError("nothing to identify a load from", where="identify", found=lacking,
                             expected="a model, then a log")  # fmt: skip
        chosen = _word(channels, response, "response") if response.strip() else None
        found = identify(log, model, family=family, responses=chosen, **given)
        with self._lock:
            self._estimates += 1
            shown = Shown(found, self._estimates)
            if self._log is log:  # nobody has put another there in the meantime
                self._shown = shown
        return shown.found()

    @property
    def shown(self) -> Shown:
        """The estimate.

        Raises
        ------
        InputError
            There is none.
        """
        with self._lock:
            if self._shown is None:
                raise InputError("there is no estimate yet", where="lab", found="none", expected="a model and a log")
            return self._shown


# -- words of the page ------------------------------------------------------------------------------------------------
def _word(read: Callable[[str], T], text: str, name: str) -> T:
    try:
        return read(text)
    except ArgumentTypeError as error:
        raise InputError("an option is none", where=name, found=str(error)[:200], expected="as on the command line",
                         hint="loadid identify --help says what it may be") from None  # fmt: skip


def _reading(fs: str, columns: str, units: str) -> dict[str, Any]:
    from .._commands import channels, frequency, names
    from .._commands import units as pairs

    given: dict[str, Any] = {}
    if fs.strip():
        given["fs"] = _word(frequency, fs.strip(), "fs")
    if columns.strip():
        given["columns"] = _word(channels, columns, "columns")
    if units.strip():
        given["units"] = pairs(names(units))
    return given


class _Words(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError("an option is none of `loadid identify`", where="options", found=message[:200],
                         expected="settings of a family, as on the command line")  # fmt: skip


def _options(text: str) -> dict[str, Any]:
    """Settings of a family in the words of the command line; nothing that names a file is among them.

    Raises
    ------
    InputError
        Other words.
    """
    from .._commands._settings import add_settings, given

    parser = _Words(prog="options", add_help=False, allow_abbrev=False)
    add_settings(parser)
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise InputError("the options cannot be told apart", where="options", found=str(error),
                         expected="words, each quotation closed") from None  # fmt: skip
    return given(vars(parser.parse_args(words)))


# -- what is said -----------------------------------------------------------------------------------------------------
def _model(model: Model | None) -> dict[str, Any] | None:
    if model is None:
        return None
    return {
        "kind": type(model).__name__, "sensors": [f"{c.label} [{c.unit}]" for c in model.sensors],
        "loads": [f"{c.label} [{c.unit}]" for c in model.loads],
        "verified": "forward model not verified" if model.certificate is None else str(model.certificate),
        "flags": flags_of(model.flags),
    }  # fmt: skip


def _log(log: Any, name: str) -> dict[str, Any] | None:
    if log is None:
        return None
    if isinstance(log, Mapping):
        rows = [{"label": k, "unit": "", "rms": abs(v), "noise": None, "findings": []} for k, v in log.items()]
        return {"name": name, "samples": 1, "dt": None, "channels": rows, "notes": [], "flags": [], "curves": []}
    from .._quality import describe

    told = describe(log)
    t = np.arange(len(log.values)) * log.dt
    curves = [
        {"label": c.label, "unit": c.unit, **curve(t, v)} for c, v in zip(log.channels, log.values.T, strict=True)
    ]
    channels = [
        {key: one[key] for key in ("label", "unit", "recorded_unit", "quantity", "min", "max", "rms", "offset", "noise",
                                   "findings")}
        for one in told["channels"]
    ]  # fmt: skip
    return {
        "name": name, "samples": told["samples"], "dt": told["dt"], "fs": told["fs"], "channels": channels,
        "notes": told["notes"], "flags": told["flags"], "curves": curves,
    }  # fmt: skip
