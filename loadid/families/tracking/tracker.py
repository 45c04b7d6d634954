"""A fitted tracker: one answer a sample, blocks, smoothing, its certificate, its file."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.flags import Flag
from structures.values import reals

from ...estimate import LoadEstimate
from ...inverse.kalman.lag import fixed_lag
from . import blocks, recipe
from .certificate import Certificate
from .engine import Engine
from .fitted import Fitted
from .late import Late
from .limits import inside
from .peer import Peer
from .replay import Replay

__all__ = ["Fitted", "Tracker"]

STATES = 4 * 2**30  # bytes of states that a smoother without a settled gain may keep
PATH = "square-root filter, settled gain"
ENGINES = {"own": Engine, "filterpy": Peer}


class Tracker:
    """Loads of a running structure, sample by sample.

    Parameters
    ----------
    fitted : Fitted
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

    def __init__(
        self, fitted: Fitted, gate: float | None = None, lag: int = 0, *, replay: int | None = None,
        engine: str = "own",
    ) -> None:  # fmt: skip
        self.fitted, self.gate, self.lag = fitted, gate, lag
        self.replay, self.engine = lag if replay is None else replay, engine
        self._p = fitted.model.p
        self._origin: Any = None  # the model of the structure, where it is at hand
        self.reset()

    def made_of(self, model: Any) -> None:
        """The model of the structure behind the filter, for `update_model`: a file does not hold it."""
        self._origin = model

    def __repr__(self) -> str:
        f = self.fitted
        return (
            f"Tracker({len(f.sensors)} sensors, {self._p} loads, {f.model.n} states, dt {f.dt:g} s, {f.words}, "
            f"{self.phase})"
        )

    @property
    def certificate(self) -> Certificate | None:
        """Tests of the record that it was fitted to."""
        return self.fitted.certificate

    @property
    def flags(self) -> tuple[Flag, ...]:
        """What the guards found at the fit."""
        return self.fitted.flags

    @property
    def phase(self) -> str:
        """``"warm-up"``, ``"steady"``, ``"periodic"`` (channels of several rates) or ``"transient"``."""
        return self._engine.phase

    @property
    def counts(self) -> dict[str, int]:
        """What has come, since the start.

        ``samples``; channel samples ``missing``, at the end of a range among them (``saturated``), or ``gated``;
        events of the load taken up (``steps``); times that the state was ``lost`` and found; late samples put in their
        place (``replayed``), or come too late (``expired``).
        """
        found = {name: self._engine.counts[name] for name in ("samples", "missing", "gated", "steps", "lost")}
        return found | {name: self._tally[name] for name in ("saturated", "replayed", "expired")}

    def reset(self) -> None:
        """Back before the first sample."""
        self._tally: Counter[str] = Counter()
        self._ring = Replay(self.replay) if self.replay else None
        self._made()

    def _made(self) -> None:
        """Engines of the fit, before their first sample."""
        f = self.fitted
        self._engine: Any = Peer(f.model)
        if self.engine == "own":
            self._engine = Engine(f.model, f.settled, self.gate, self._width())
        prior = f.model.Cp @ f.model.x0, np.linalg.norm(f.model.Cp @ f.model.L0, axis=1)
        fixed = None if not self.lag or f.settled is None else fixed_lag(f.settled, self.lag)
        self._late = Late(self.lag, fixed, *prior) if self.lag else None
        self._bank = [(weight, Engine(model, settled, None)) for weight, model, settled in f.bank]

    # -- samples ----------------------------------------------------------------------------------------------------
    def step(self, sample: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Loads and their std (loads,) after one sample (sensors,); NaN marks a channel that is missing.

        With a lag they are those of so many samples ago: before the first one, what the prior says.

        Raises
        ------
        InputError
            A sample of another width, or infinite.
        """
        if self.fitted.limits is not None:
            sample = self._believable(sample)
        if self._ring is None:
            return self._one(sample)
        if self._ring.count % self.replay == 0 or not self._ring.anchors:
            self._ring.anchor(self._changing())
        answer = self._one(sample)
        self._ring.push(np.asarray(sample, float)[None])
        return answer

    def _one(self, sample: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        if self._late is not None:
            given = self._engine.core.sample(
                reals(sample, where="sample", what="a sample that is no row of real numbers")
            )
            load, std = np.empty((1, self._p)), np.empty((1, self._p))
            self._engine.block(given[None], load, std, late=self._late)
            return load[0], std[0]
        steady = self._engine.phase == "steady"
        load, std = self._engine.step(sample)
        if not self._bank:
            return load, std
        quick = steady and self._engine.phase == "steady"
        taken = sample if quick else self._engine.taken  # what was kept out is kept out of all models
        between = np.zeros(self._p)
        for weight, engine in self._bank:
            between += weight * (engine.step(taken)[0] - load) ** 2
        return load, np.sqrt(std**2 + between)

    def track(
        self, block: Any, dt: float | None = None, *, progress: Callable[[float, str], None] | None = None
    ) -> LoadEstimate:
        """Loads of a block, going on from the last sample; with a lag those of so many samples ago.

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
        if self.lag:
            return blocks.estimate(self.fitted, self.counts, load[skip:], std[skip:], None, None, inputs,
                                   first - self.lag + skip, f"{PATH}, {self.lag} samples late")  # fmt: skip
        Y, path = inside(Y, self.fitted.limits), PATH if self.engine == "own" else "filterpy, full covariance"
        return blocks.estimate(self.fitted, self.counts, load, std, Y, e * self._spread(), inputs, first, path)

    def run(self, Y: NDArray, progress: Callable[[float, str], None] | None = None) -> tuple[NDArray, NDArray, NDArray]:
        """Loads and std (samples, loads), normalised innovations (samples, sensors) of bare numbers."""
        load, std, e = np.empty((len(Y), self._p)), np.empty((len(Y), self._p)), np.full(Y.shape, np.nan)
        if self.fitted.limits is not None:
            Y = self._believable(Y)
        if self._ring is None:
            self._run(Y, load, std, e, progress)
            return load, std, e
        cuts = self._ring.cuts(len(Y))
        for start, stop in zip([0, *cuts], cuts, strict=False):
            part = slice(start, stop)
            if start in cuts:
                self._ring.anchor(self._changing())
            self._run(Y[part], load[part], std[part], e[part], progress)
            self._ring.push(Y[part])
        return load, std, e

    def _run(
        self, Y: NDArray, load: NDArray, std: NDArray, e: NDArray, progress: Callable[[float, str], None] | None
    ) -> None:
        """Fill loads, std and innovations of a block."""
        told = progress or (lambda share, text: None)
        size = 65_536
        for k in range(0, len(Y), size):
            part = slice(k, k + size)
            taken = Y[part].copy() if self._bank else None
            late = {} if self._late is None else {"late": self._late}
            self._engine.block(Y[part], load[part], std[part], e[part], taken, **late)
            if taken is not None:
                between = np.zeros(load[part].shape)
                other, unused = np.empty(load[part].shape), np.empty(load[part].shape)
                for weight, engine in self._bank:
                    engine.block(taken, other, unused)
                    between += weight * (other - load[part]) ** 2
                std[part] = np.sqrt(std[part] ** 2 + between)
            told(min((k + size) / len(Y), 1.0), "tracking")

    def insert(self, sample: ArrayLike, ago: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Put a sample that comes late in its place, and run the filter again from there.

        What has already come of that time stays; the channels that were missing then are filled in.

        Parameters
        ----------
        sample : array (sensors,)
            NaN marks a channel that is still missing.
        ago : int
            Samples taken after it.

        Returns
        -------
        load, std : array, shape (ago + 1, loads), or None
            The answers from its time on, as if it had come in order (with a lag, of so many samples before); None
            where it comes too late (`replay`), which is counted.

        Raises
        ------
        InputError
            A sample of another width, or infinite; `ago` is no count.
        """
        if isinstance(ago, bool) or not isinstance(ago, int | np.integer) or ago < 0:
            raise InputError("no count of samples", where="ago", found=repr(ago), expected="0, 1, 2, ...")
        row = self._engine.core.sample(sample)
        place = None if self._ring is None else self._ring.place(int(ago))
        if self._ring is None or place is None:
            self._tally["expired"] += 1
            return None
        row = self._believable(row)
        rows = self._ring.samples
        rows[place] = np.where(np.isfinite(rows[place]), rows[place], row)
        load, std = self._again(np.array(rows))
        self._tally["replayed"] += 1
        return load[place:], std[place:]

    def _again(self, Y: NDArray) -> tuple[NDArray, NDArray]:
        """The kept samples once more, from the older anchor on."""
        assert self._ring is not None
        load, std, e = np.empty((len(Y), self._p)), np.empty((len(Y), self._p)), np.full(Y.shape, np.nan)
        marks = [k for k, _ in self._ring.anchors]
        self._restored(self._ring.anchors[0][1])
        anchors, ends = [], [*(k - marks[0] for k in marks), len(Y)]
        for k, start, stop in zip(marks, ends, ends[1:], strict=False):
            anchors.append((k, self._changing()))
            part = slice(start, stop)
            self._run(Y[part], load[part], std[part], e[part], None)
        self._ring.anchors = anchors
        return load, std

    def _believable(self, Y: Any) -> Any:
        """Samples without those at the end of the range of their sensor, which are counted."""
        try:
            given = np.asarray(Y, float)
            found = inside(given, self.fitted.limits)
        except (TypeError, ValueError):
            return Y  # the engine says what is wrong with it
        self._tally["saturated"] += int(np.sum(np.isnan(found)) - np.sum(np.isnan(given)))
        return found

    def smooth(
        self, record: Any, dt: float | None = None, *, progress: Callable[[float, str], None] | None = None
    ) -> LoadEstimate:
        """Loads of a whole record with all its data, from rest; the state of the tracker stays as it is.

        Raises
        ------
        InputError
            As `track`; a record too long to keep its states.
        """
        from ...inverse.kalman.records import filter_settling, smooth_settling

        Y, inputs = blocks.values(self.fitted, record, dt)
        Y = inside(Y, self.fitted.limits)
        told = progress or (lambda share, text: None)
        settled, path = self.fitted.settled, "square-root filter and smoother"
        if settled is None:
            load, std, rest = self._kept(Y, told)
        else:  # no states are kept where the gain is settled
            found = smooth_settling(filter_settling(settled, Y, progress=lambda f, t: told(0.5 * f, t)),
                                    progress=lambda f, t: told(0.5 + 0.5 * f, t))  # fmt: skip
            load, std, rest = found.load, found.std, found.residual
        return blocks.estimate(self.fitted, self.counts, load, std, Y, rest, inputs, 0, path)

    def _kept(self, Y: NDArray, told: Callable[[float, str], None]) -> tuple[NDArray, NDArray, NDArray]:
        """Smoothed loads, std and residual by a filter that keeps the states of all samples."""
        from ...inverse.kalman.smoothing import smooth
        from ...inverse.kalman.squareroot import filter as filtered

        model = self.fitted.model
        if (size := 8 * len(Y) * model.n**2) > STATES:
            raise InputError("the record is too long to keep its states", where="smooth",
                             found=f"{size / 2**30:.1f} GiB", expected=f"at most {STATES / 2**30:.0f} GiB",
                             hint="smooth it in parts")  # fmt: skip
        kept = filtered(model, Y, keep=True, progress=lambda f, t: told(0.5 * f, t))
        found = smooth(kept, progress=lambda f, t: told(0.5 + 0.5 * f, t))
        return found.load, found.std, Y - found.x @ model.H.T

    # -- another model ----------------------------------------------------------------------------------------------
    def update_model(self, model: Any) -> None:
        """Go on with another model of the same sensors and loads: a stiffness that has changed, say.

        Gains are solved anew under the priors and noises of the fit. Where both models have modes of the same degrees
        of freedom the state is carried over through these, with its covariance; else it may be anywhere in reach, and
        the next samples find it. Late samples from before cannot be put in their place any more. The certificate stays
        as the one of the model before (`Fitted.stale`, flag W522).

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
        self._made()
        self._engine.succeed(old, T)
        if self._late is not None and late is not None:
            self._late.succeed(late)
        for _, engine in self._bank:
            engine.succeed(old, T)
        self._ring, self._origin = Replay(self.replay) if self.replay else None, model

    # -- others -----------------------------------------------------------------------------------------------------
    def to_filterpy(self) -> Any:
        """The configured filter as ``filterpy.kalman.KalmanFilter``, before its first update.

        See `loadid.inverse.kalman.filterpy.to_filterpy` for missing channels and correlated noises.
        """
        from ...inverse.kalman.filterpy import to_filterpy

        return to_filterpy(self.fitted.model)

    def to_c(self, path: str | os.PathLike, name: str = "tracker") -> Path:
        """Write the settled filter as one C99 file without dependencies, for a microcontroller.

        Parameters
        ----------
        path : path
        name : str
            Prefix of its functions: ``NAME_reset``, ``NAME_step``, ``NAME_std``.

        Raises
        ------
        InputError
            A tracker without a settled gain, no C identifier, a folder that is not there.
        """
        from ...inverse.kalman.ccode import write_c

        f = self.fitted
        if f.settled is None:
            raise InputError("a filter that never settles has no constant gain", where="to_c", found="allow_drift",
                             expected="a settled gain", hint="add a sensor that sees a constant load")  # fmt: skip
        labels = {"sensors": [c.label for c in f.sensors], "loads": [c.label for c in f.loads]}
        return write_c(Path(path), f.settled, name=name, dt=f.dt, **labels)

    def on_filterpy(
        self, record: Any, dt: float | None = None, *, progress: Callable[[float, str], None] | None = None
    ) -> LoadEstimate:
        """The same filter run by filterpy over a whole record, from rest: slower, and written by others.

        Raises
        ------
        InputError
            As `track`.
        """
        from ...inverse.kalman.filterpy import FilterpyEngine

        Y, inputs = blocks.values(self.fitted, record, dt)
        Y = inside(Y, self.fitted.limits)
        found = FilterpyEngine(self.fitted.model).track(Y, progress)
        return blocks.estimate(self.fitted, self.counts, found.load, found.std, Y, None, inputs, 0,
                               "filterpy, full covariance")  # fmt: skip

    # -- files ------------------------------------------------------------------------------------------------------
    def save(self, path: str | os.PathLike) -> None:
        """Write fit and state to a file, whole or not at all.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        from .checkpoint import save

        save(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike, model: Any = None) -> Tracker:
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
        from .checkpoint import load

        return load(path, model)

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes from sample to sample, as plain arrays and numbers."""
        ring = None if self._ring is None else self._ring.to_tree()
        return self._changing() | {"ring": ring, "tally": dict(self._tally)}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self._restored(tree)
        self._tally = Counter({str(k): int(v) for k, v in tree["tally"].items()})
        if self._ring is not None:
            self._ring.restore(tree["ring"])

    # -- inside -----------------------------------------------------------------------------------------------------
    def _changing(self) -> dict[str, Any]:
        """What a sample changes in the filters."""
        return {
            "engine": self._engine.to_tree(),
            "bank": [engine.to_tree() for _, engine in self._bank],
            "late": None if self._late is None else self._late.to_tree(),
        }

    def _restored(self, tree: dict[str, Any]) -> None:
        self._engine.restore(tree["engine"])
        for (_, engine), own in zip(self._bank, tree["bank"], strict=True):
            engine.restore(own)
        if self._late is not None:
            self._late.restore(tree["late"])

    def _width(self) -> NDArray[np.float64] | None:
        """Of the gate: a model that is not exact is no reason to throw its sensors away."""
        spread = () if self.fitted.certificate is None else self.fitted.certificate.spread
        return np.maximum(1.0, spread) if spread else None

    def _spread(self) -> NDArray[np.float64]:
        settled = self.fitted.settled
        if settled is not None:
            return settled.innovation_std
        return np.linalg.norm(self.fitted.model.LR, axis=1)
