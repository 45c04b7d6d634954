"""A fitted tracker: one answer a sample, blocks, smoothing, its certificate, its file."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.channels import Channel
from structures.errors import InputError
from structures.flags import Flag
from structures.values import number

from ... import flags as guards
from ...estimate import Axis, LoadEstimate
from ...flags.tracking import kept_out
from ...inverse.kalman.lag import fixed_lag
from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.steady import Steady
from ...provenance import provenance
from ...record import Record
from ..data import numbers
from .certificate import Certificate
from .engine import Engine
from .late import Late

STATES = 4 * 2**30  # bytes of states that a smoother without a settled gain may keep
CALM = 0.01  # of the std of the loads, within which the gain counts as settled
PATH = "square-root filter, settled gain"


@dataclass(frozen=True, eq=False)
class Fitted:
    """What a fit has settled; everything that a tracker needs to run.

    Parameters
    ----------
    model : FilterModel
    settled : Steady or None
    bank : tuple of (weight, FilterModel, Steady or None)
        Models that are wrong by what was declared.
    dt : float
    sensors, loads : tuple of Channel
    words : str
        The priors of the loads.
    numbers : mapping
        What was tuned.
    noise_source : str
    certificate : Certificate or None
    flags : tuple of Flag
    fingerprint : str
        Of the model of the structure.
    settings : mapping
    inputs : mapping
        Digest of the record of the fit.
    """

    model: FilterModel
    settled: Steady | None
    bank: tuple[tuple[float, FilterModel, Steady | None], ...]
    dt: float
    sensors: tuple[Channel, ...]
    loads: tuple[Channel, ...]
    words: str
    numbers: Mapping[str, float]
    noise_source: str
    certificate: Certificate | None
    flags: tuple[Flag, ...]
    fingerprint: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, str]


class Tracker:
    """Loads of a running structure, sample by sample.

    Parameters
    ----------
    fitted : Fitted
    gate : float or None
        Std of an innovation beyond which a single channel is kept out, or a step of the load is taken up.
    lag : int
        Samples by which the answers come late.

    Notes
    -----
    A tracker has a state: `step` and `track` go on from the last sample. `smooth` and `reset` do not.
    """

    def __init__(self, fitted: Fitted, gate: float | None = None, lag: int = 0) -> None:
        self.fitted, self.gate, self.lag = fitted, gate, lag
        self._p = fitted.model.p
        self.reset()

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
        """``"warm-up"``, ``"steady"`` or ``"transient"``."""
        return self._engine.phase

    @property
    def counts(self) -> dict[str, int]:
        """Samples taken; channel samples missing and kept out by the gate; steps of the load taken up."""
        return {name: self._engine.counts[name] for name in ("samples", "missing", "gated", "steps", "lost")}

    def reset(self) -> None:
        """Back before the first sample."""
        f = self.fitted
        self._engine = Engine(f.model, f.settled, self.gate, self._width())
        prior = f.model.Cp @ f.model.x0, np.linalg.norm(f.model.Cp @ f.model.L0, axis=1)
        self._late = None if not self.lag or f.settled is None else Late(fixed_lag(f.settled, self.lag), *prior)
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
        steady = self._engine.phase == "steady"
        load, std = self._engine.step(sample)
        if self._late is not None:
            assert self._engine.loop is not None
            said = self._engine.said
            quick = steady and self._engine.phase == "steady"
            e = self._engine.loop.e if quick or said is None else said.normalised * self._spread()
            late, spread = self._late.block(load[None], std[None], self._news(std[None], e[None]))
            return late[0], spread[0]
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
        Y, inputs = self._values(block, dt)
        first = self._engine.counts["samples"]
        skip = max(self.lag - first, 0)
        if skip >= len(Y):
            raise InputError("the block ends before the first late answer", where="track", found=f"{len(Y)} samples",
                             expected=f"more than the lag of {self.lag}", hint="hand over more at once")  # fmt: skip
        load, std, e = self.run(Y, progress)
        if self.lag:
            return self._estimate(load[skip:], std[skip:], None, None, inputs, first - self.lag + skip,
                                  f"{PATH}, {self.lag} samples late")  # fmt: skip
        return self._estimate(load, std, Y, e * self._spread(), inputs, first)

    def run(self, Y: NDArray, progress: Callable[[float, str], None] | None = None) -> tuple[NDArray, NDArray, NDArray]:
        """Loads and std (samples, loads), normalised innovations (samples, sensors) of bare numbers."""
        load, std, e = np.empty((len(Y), self._p)), np.empty((len(Y), self._p)), np.full(Y.shape, np.nan)
        told = progress or (lambda share, text: None)
        size = 65_536
        for k in range(0, len(Y), size):
            part = slice(k, k + size)
            taken = Y[part].copy() if self._bank else None
            self._engine.block(Y[part], load[part], std[part], e[part], taken)
            if taken is not None:
                between = np.zeros(load[part].shape)
                other, unused = np.empty(load[part].shape), np.empty(load[part].shape)
                for weight, engine in self._bank:
                    engine.block(taken, other, unused)
                    between += weight * (other - load[part]) ** 2
                std[part] = np.sqrt(std[part] ** 2 + between)
            if self._late is not None:
                news = self._news(std[part], e[part] * self._spread())
                load[part], std[part] = self._late.block(load[part], std[part], news)
            told(min((k + size) / len(Y), 1.0), "tracking")
        return load, std, e

    def _news(self, std: NDArray, e: NDArray) -> NDArray[np.float64]:
        """Innovations of the samples at the settled gain, or near it; NaN of the others."""
        assert self.fitted.settled is not None
        settled = self.fitted.settled.std
        calm = np.all(np.abs(std - settled) <= CALM * settled, axis=1)
        return np.where(calm[:, None], e, np.nan)

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

        Y, inputs = self._values(record, dt)
        told = progress or (lambda share, text: None)
        settled, path = self.fitted.settled, "square-root filter and smoother"
        if settled is None:
            load, std, rest = self._kept(Y, told)
        else:  # no states are kept where the gain is settled
            found = smooth_settling(filter_settling(settled, Y, progress=lambda f, t: told(0.5 * f, t)),
                                    progress=lambda f, t: told(0.5 + 0.5 * f, t))  # fmt: skip
            load, std, rest = found.load, found.std, found.residual
        return self._estimate(load, std, Y, rest, inputs, 0, path)

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

        Y, inputs = self._values(record, dt)
        found = FilterpyEngine(self.fitted.model).track(Y, progress)
        return self._estimate(found.load, found.std, Y, None, inputs, 0, "filterpy, full covariance")

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

    # -- inside -----------------------------------------------------------------------------------------------------
    def _width(self) -> NDArray[np.float64] | None:
        """Of the gate: a model that is not exact is no reason to throw its sensors away."""
        spread = () if self.fitted.certificate is None else self.fitted.certificate.spread
        return np.maximum(1.0, spread) if spread else None

    def _spread(self) -> NDArray[np.float64]:
        settled = self.fitted.settled
        if settled is not None:
            return settled.innovation_std
        return np.linalg.norm(self.fitted.model.LR, axis=1)

    def _values(self, block: Any, dt: float | None) -> tuple[NDArray[np.float64], dict[str, str]]:
        f = self.fitted
        labels = [c.label for c in f.sensors]
        if isinstance(block, Record):
            picked = block.select(labels)
            step, values = picked.dt, picked.values
            inputs = {block.source or block.name or "record": block.sha256}
            wrong = [
                f"{c.label} in {c.unit}, not {s.unit}"
                for c, s in zip(picked.channels, f.sensors, strict=True)
                if "arbitrary" not in (c.unit, s.unit) and c.unit != s.unit
            ]
            if wrong:
                raise InputError("a channel is in another unit than its sensor", where="track", found="; ".join(wrong),
                                 expected="the units of the fit", hint="state the units of the record")  # fmt: skip
        else:
            values, inputs = numbers(block, "the block is no table of real numbers"), {}
            step = f.dt if dt is None else number("dt", dt, where="track", unit="s")
        if not abs(step / f.dt - 1) <= 1e-6:
            raise InputError("the samples have another step than those of the fit", where="track",
                             found=f"dt = {step:.9g} s", expected=f"dt = {f.dt:.9g} s",
                             hint="resample, or fit a tracker for this step")  # fmt: skip
        if values.ndim != 2 or values.shape[1] != len(labels) or not len(values):
            raise InputError("the block does not fit the sensors", where="track", found=f"shape {values.shape}",
                             expected=f"(samples, {len(labels)}): {', '.join(labels[:8])}")  # fmt: skip
        if np.isinf(values).any():
            raise InputError("an infinite number in the block", where="track",
                             found=labels[int(np.argmax(np.isinf(values).any(axis=0)))],
                             expected="finite numbers, NaN where a sample is missing")  # fmt: skip
        return np.ascontiguousarray(values, float), inputs

    def _estimate(
        self, load: NDArray, std: NDArray, Y: NDArray | None, rest: NDArray | None, inputs: dict[str, str],
        first: int, path: str = PATH,
    ) -> LoadEstimate:  # fmt: skip
        f, counts, m = self.fitted, self.counts, len(self.fitted.sensors)
        there = np.ones((len(load), len(f.sensors)), bool) if Y is None else np.isfinite(Y)
        facts: dict[str, Any] = {
            "path": path, "m": int(there.sum()), "n": int(load.size), "noise_source": f.noise_source,
            "time_constant": None if f.settled is None else f.settled.time_constant,
            **{f"tuned_{name}": value for name, value in f.numbers.items()},
            **{f"count_{name}": value for name, value in self.counts.items()},
        }  # fmt: skip
        if not there.all():
            facts["missing"] = f"{int((~there).sum())} of {there.size} channel samples"
        return LoadEstimate(
            load=load,
            std=std,
            labels=[c.label for c in f.loads],
            units=[c.unit for c in f.loads],
            axis=Axis("time", "s", np.asarray((first + np.arange(len(load))) * f.dt, float)),
            response=None if Y is None else np.where(there, Y, 0.0),
            residual=None if rest is None else np.where(there & np.isfinite(rest), rest, 0.0),
            sensors=[c.label for c in f.sensors],
            sensor_units=[c.unit for c in f.sensors],
            flags=guards.collect([*f.flags, kept_out(counts["gated"], counts["samples"] * m, counts["steps"])]),
            facts=facts,
            provenance=provenance(
                "load tracking", settings=dict(f.settings), inputs={**f.inputs, **inputs}, model=f.fingerprint,
                prior=f.words,
            ),
        )  # fmt: skip
