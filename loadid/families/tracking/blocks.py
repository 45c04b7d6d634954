"""Blocks of samples in, estimates out: what `Tracker.track` takes and gives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.flags import Flag
from structures.values import number

from ... import flags as guards
from ...estimate import Axis, LoadEstimate
from ...provenance import provenance
from ...record import Record
from ..data import numbers
from .fitted import Fitted


def values(f: Fitted, block: Any, dt: float | None) -> tuple[NDArray[np.float64], dict[str, str]]:
    """Samples (samples, sensors) of a block in the order of the sensors, and the digest of its record.

    Raises
    ------
    InputError
        Channels, units or a step that are not those of the fit; infinite numbers.
    """
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


def estimate(
    f: Fitted, counts: Mapping[str, int], load: NDArray, std: NDArray, Y: NDArray | None, rest: NDArray | None,
    inputs: dict[str, str], first: int, path: str, flags: Iterable[Flag],
) -> LoadEstimate:  # fmt: skip
    """Estimate of a block from sample `first` on; Y, rest (samples, sensors): data and what is left of them."""
    there = np.ones((len(load), len(f.sensors)), bool) if Y is None else np.isfinite(Y)
    facts: dict[str, Any] = {
        "path": path, "m": int(there.sum()), "n": int(load.size), **f.noise_source.facts,
        "time_constant": None if f.settled is None else f.settled.time_constant,
        **{f"tuned_{name}": value for name, value in f.numbers.items()},
        **{f"count_{name}": value for name, value in counts.items()},
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
        flags=guards.collect(flags),
        facts=facts,
        provenance=provenance(
            "load tracking", settings=dict(f.settings), inputs={**f.inputs, **inputs}, model=f.fingerprint,
            prior=f.words,
        ),
    )  # fmt: skip
