"""A fitted tracker: one answer a sample, blocks, smoothing, its certificate, its file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from structures.errors import InputError
from structures.flags import Flag

from ...estimate import LoadEstimate
from . import blocks, recipe
from .certificate import Certificate
from .fitted import Fitted
from .limits import inside
from .replay import Replay
from .running import ENGINES, Running

__all__ = ["ENGINES", "Fitted", "Tracker"]

STATES = 4 * 2**30  # bytes of states that a smoother without a settled gain may keep
PATH = "square-root filter, settled gain"


class Tracker(Running):
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
        """What the guards found at the fit, and since the first sample (`alarms`)."""
        return (*self.fitted.flags, *self.alarms)

    # -- samples ----------------------------------------------------------------------------------------------------

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
                                   first - self.lag + skip, f"{PATH}, {self.lag} samples late", self.flags)  # fmt: skip
        Y, path = inside(Y, self.fitted.limits), PATH if self.engine == "own" else "filterpy, full covariance"
        return blocks.estimate(self.fitted, self.counts, load, std, Y, e * self._spread(), inputs, first, path,
                               self.flags)  # fmt: skip

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
        return blocks.estimate(self.fitted, self.counts, load, std, Y, rest, inputs, 0, path, self.flags)

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
                               "filterpy, full covariance", self.flags)  # fmt: skip

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
