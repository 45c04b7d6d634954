"""A fitted tracker: one answer a sample, blocks, smoothing, its certificate; its file, to go on bit for bit.

The gains are stored, not solved for again; the file is written whole or not at all (`structures.files._storage`).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from structures._flags import Flag
from structures.errors import InputError
from structures.files import _storage as storage

from ..._inverse.gaussian.exports import FilterpyEngine, to_filterpy
from ..._inverse.gaussian.records import filter_record, smooth_record
from ..._results.estimate import LoadEstimate
from . import fit as recipe
from . import samples as blocks
from .beginning import beginning
from .certificate import TrackCertificate
from .controller import write_c
from .fit import TrackerFit, pack, unpack
from .running import Running
from .samples import Replay, inside

__all__ = [
    "Tracker",
    "TrackerFit",
]


STATES = 4 * 2**30  # bytes of states that a smoother without a settled gain may keep
PATH = "square-root filter, settled gain"


class Tracker(Running):
    """Loads of a running structure, sample by sample.

    Parameters
    ----------
    fitted : TrackerFit
    gate : float or None
        Std of an innovation beyond which a single channel is kept out, or a step of the load is taken up.
    lag : int
        Samples by which the answers come late.
    replay : int, optional
        Samples by which a sample may come late and still be put in its place (`insert`); the lag if left out.
    engine : {"own", "filterpy"}
        filterpy believes every number: it has no gate.

    Notes
    -----
    A tracker has a state: `step` and `track` go on from the last sample. `smooth` and `reset` do not.
    """

    def __repr__(self) -> str:
        f = self.fitted
        return (
            f"Tracker({len(f.sensors)} sensors, {self._p} loads, {f.model.n} states, dt {f.dt:g} s, {f.words}, "
            f"{self.phase})"
        )

    @property
    def certificate(self) -> TrackCertificate | None:
        """Tests of the record that it was fitted to."""
        return self.fitted.certificate

    @property
    def flags(self) -> tuple[Flag, ...]:
        """What the guards found at the fit, and since the first sample (`alarms`)."""
        return (*self.fitted.flags, *self.alarms)

    # -- samples ----------------------------------------------------------------------------------------------------

    def track(
        self, block: Any, dt: float | None = None, *, progress: Callable[[float, str], None] | None = None
    ) -> LoadEstimate:
        """Loads of a block, going on from the last sample; with a lag those of so many samples ago.

        It starts at rest, or, where its first five samples do not, in motion that they tell of (flag N532).

        Parameters
        ----------
        block : Record or array (samples, sensors)
            NaN marks what is missing.
        dt : float, optional
            Step in s of a bare array; that of the fit if left out.
        progress : callable, optional

        Raises
        ------
        InputError
            Channels or a step that are not those of the fit, a first block that is shorter than the lag.
        """
        Y, inputs = blocks.values(self.fitted, block, dt)
        first = self._engine.counts["samples"]
        skip = max(self.lag - first, 0)
        if skip >= len(Y):
            raise InputError("the block ends before the first late answer", where="track", found=f"{len(Y)} samples",
                             expected=f"more than the lag of {self.lag}", hint="hand over more at once")  # fmt: skip
        load, std, e = self.run(Y, progress)
        Y, path = inside(Y, self.fitted.limits), PATH if self.engine == "own" else "filterpy, full covariance"
        said = blocks.not_told(self.fitted, Y)
        if self.lag:
            return blocks.estimate(self.fitted, self.counts, load[skip:], std[skip:], None, None, inputs,
                                   first - self.lag + skip, f"{PATH}, {self.lag} samples late", self.flags,
                                   said)  # fmt: skip
        return blocks.estimate(self.fitted, self.counts, load, std, Y, e * self._spread(), inputs, first, path,
                               self.flags, said)  # fmt: skip

    def smooth(
        self, record: Any, dt: float | None = None, *, progress: Callable[[float, str], None] | None = None
    ) -> LoadEstimate:
        """Loads of a whole record with all its data; the state of the tracker stays as it is.

        It starts at rest, or, where its first samples do not, in motion that they tell of (flag N532).

        Raises
        ------
        InputError
            As `track`; a record too long to keep its states.
        """
        Y, inputs = blocks.values(self.fitted, record, dt)
        Y = inside(Y, self.fitted.limits)
        told = progress or (lambda share, text: None)
        model, settled, path = self.fitted.model, self.fitted.settled, "square-root filter and smoother"
        start = beginning(model, settled, Y)
        model = model if start is None else start.of(model)
        if settled is None and (size := 8 * len(Y) * model.n**2) > STATES:
            raise InputError("the record is too long to keep its states", where="smooth",
                             found=f"{size / 2**30:.1f} GiB", expected=f"at most {STATES / 2**30:.0f} GiB",
                             hint="smooth it in parts")  # fmt: skip
        filtered = filter_record(model, Y, settled, progress=lambda f, t: told(0.5 * f, t))
        found = smooth_record(filtered, progress=lambda f, t: told(0.5 + 0.5 * f, t))
        std = found.std if self.fitted.wider is None else found.std * self.fitted.wider
        return blocks.estimate(self.fitted, self.counts, found.load, std, Y, found.residual, inputs, 0, path,
                               self.flags if start is None else (*self.flags, start.flag),
                               blocks.not_told(self.fitted, Y))  # fmt: skip

    # -- another model ----------------------------------------------------------------------------------------------

    def update_model(self, model: Any) -> None:
        """Go on with another model of the same sensors and loads: a stiffness that has changed, say.

        Gains are solved anew under the priors and noises of the fit. Where both models have modes of the same degrees
        of freedom the state is carried over through these, with its covariance; else it may be anywhere in reach, and
        the next samples find it. Late samples from before cannot be put in their place any more. The certificate stays
        as the one of the model before (`TrackerFit.stale`, flag W522).

        Raises
        ------
        InputError
            Other sensors, loads or number of states; a fit whose priors cannot be made again.
        NotIdentifiable
            The new model has no settled gain.
        """
        f, old = self.fitted, self._engine
        if f.recipe is None or self.engine != "own":
            raise InputError("this tracker does not know how its filter was made", where="update_model",
                             found="ambient loads, a prior of one's own, or filterpy", expected="the own engine under "
                             "priors of the library", hint="fit a tracker to the model")  # fmt: skip
        recipe.same_channels(f, model)
        T = recipe.carried(self._origin, model, f.model.nx)
        self.fitted, late = recipe.renewed(f, model), self._late
        self._watch = self._watching()
        self._made()
        self._engine.succeed(old, T)
        if self._late is not None and late is not None:
            self._late.succeed(late)
        for _, engine in self._bank:
            engine.succeed(old, T)
        self._ring, self._origin = Replay(self.replay) if self.replay else None, model
        self._head = None

    # -- others -----------------------------------------------------------------------------------------------------

    def to_filterpy(self) -> Any:
        """The configured filter as ``filterpy.kalman.KalmanFilter``, before its first update.

        See `loadid._inverse.gaussian.exports.to_filterpy` for missing channels and correlated noises.
        """
        return to_filterpy(self.fitted.model)

    def to_c(self, path: str | os.PathLike[str], name: str = "tracker", dtype: str = "double") -> Path:
        """Write the tracker as a C99 file with its header, for a controller: no heap, no files, no static variables.

        The C answers as `step` of a tracker that has just been fitted: missing channels, the gate, ends of range and
        bounds of the loads. It starts as it is told, at rest (`NAME_reset`) or in motion (`NAME_reset_moving`); it has
        no watch over the sensors, answers at once, and its std does not hold declared errors of the model.

        Parameters
        ----------
        path : path
            Of the C file, like ``roof.c``; ``roof.h`` is written beside it.
        name : str
            Prefix of what others see: type ``NAME_tracker``, functions ``NAME_reset``, ``NAME_reset_moving`` and
            ``NAME_step``.
        dtype : {"double", "float"}
            Type of its numbers, where neither ``NAME_DOUBLE`` nor ``NAME_FLOAT`` is defined.

        Returns
        -------
        Path
            Of the C file.

        Raises
        ------
        InputError
            No C identifier, another type, no name of a file, a folder that is not there.
        """
        gate = self.gate if self.engine == "own" else None
        return write_c(Path(path), self.fitted, gate, self._width(), self._bounds(), name=name, dtype=dtype)

    def on_filterpy(
        self, record: Any, dt: float | None = None, *, progress: Callable[[float, str], None] | None = None
    ) -> LoadEstimate:
        """The same filter run by filterpy over a whole record, from rest: slower, and written by others.

        Raises
        ------
        InputError
            As `track`.
        """
        Y, inputs = blocks.values(self.fitted, record, dt)
        Y = inside(Y, self.fitted.limits)
        found = FilterpyEngine(self.fitted.model).track(Y, progress)
        return blocks.estimate(self.fitted, self.counts, found.load, found.std, Y, None, inputs, 0,
                               "filterpy, full covariance", self.flags)  # fmt: skip

    # -- files ------------------------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write fit and state to a file, whole or not at all.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        save(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str], model: Any = None) -> Tracker:
        """Tracker of a file, which goes on from the sample after which it was saved, bit for bit.

        Parameters
        ----------
        path : path
        model : Model or str, optional
            Model of the structure, or its fingerprint: a tracker of another one is refused.

        Raises
        ------
        InputError
            A file that is missing, damaged, cut short, of another kind, format version or model.
        """
        return load(path, model)


KIND = "tracker"
FORMAT = 2
_PACKED: WeakKeyDictionary[TrackerFit, tuple[dict[str, Any], str]] = WeakKeyDictionary()


def save(tracker: Tracker, path: str | os.PathLike[str], stream: dict[str, Any] | None = None) -> None:
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


def load(path: str | os.PathLike[str], model: Any = None) -> Tracker:
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


def read(path: str | os.PathLike[str], model: Any = None) -> tuple[Tracker, dict[str, Any] | None]:
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


def fit_of(path: str | os.PathLike[str]) -> str:
    """Digest of what the fit settled: two files with the same one go on alike from the same state.

    Raises
    ------
    InputError
        As `storage.read`.
    """
    return str(storage.read(path, KIND)["fit"])


def _packed(fitted: TrackerFit) -> tuple[dict[str, Any], str]:
    """A fit, which never changes, as it is written again and again, and its digest."""
    if fitted not in _PACKED:
        tree = pack(fitted)
        digest = hashlib.sha256(tree["text"].encode())
        digest.update(tree["numbers"].tobytes())
        _PACKED[fitted] = tree, digest.hexdigest()
    return _PACKED[fitted]
