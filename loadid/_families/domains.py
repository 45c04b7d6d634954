"""One transient, both domains: what frequency lines and the exact time-domain solution say, and which to take."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures._model import Model, as_model
from structures.errors import InputError, as_array

from .._results.estimate import LoadEstimate
from .._spellings import takes
from ..settings import Lambda, Noise
from .deconvolution import Deconvolution
from .frequency import FrequencyInversion
from .posing.posed import PADDED

APART = 3.0  # standard deviations of a difference beyond which the two contradict each other
LONG = 20_000  # unknowns
BETTER = 1.1  # how much smaller the stated error must be to decide
CUT = ("LID-W505", "LID-W508", "LID-W518")  # what lines cannot represent


@dataclass(frozen=True)
class Domains:
    """Two answers to one record.

    Parameters
    ----------
    frequency, time : LoadEstimate
    difference : tuple of float
        Of each load: norm of the difference over the norm of the answer that is recommended.
    stated : tuple of float
        Stated error of the two (root mean square std over root mean square load, all loads).
    apart : float
        Share of the samples at which the two differ by more than three standard deviations.
    take : {"frequency", "time"}
    reason : str
    """

    frequency: LoadEstimate
    time: LoadEstimate
    difference: tuple[float, ...]
    stated: tuple[float, float]
    apart: float
    take: str
    reason: str

    @property
    def estimate(self) -> LoadEstimate:
        """The answer that is recommended."""
        return self.frequency if self.take == "frequency" else self.time

    def __str__(self) -> str:
        family = "FrequencyInversion" if self.take == "frequency" else "Deconvolution"
        differ = ", ".join(
            f"{label} {d:.1%}" for label, d in zip(self.frequency.labels[:8], self.difference, strict=False)
        )
        return (
            f"take {family}: {self.reason}\n"
            f"stated error: frequency {self.stated[0]:.1%}, time {self.stated[1]:.1%}; the two differ by {differ}; "
            f"beyond three standard deviations at {self.apart:.1%} of the samples"
        )


@takes(noise=(Noise, "source"))
def compare_domains(
    model: Model,
    record: Any,
    dt: float | None = None,
    *,
    noise: ArrayLike | Noise | None = None,
    frequency: Mapping[str, Any] | None = None,
    time: Mapping[str, Any] | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Domains:
    """Invert a transient by frequency lines and in time, and say which answer to take.

    Lines are taken where the response fits into the record and they state the smaller error: their prior follows the
    spectrum of each load. The time domain is taken where the record is cut, begins in motion or has gaps, which lines
    cannot represent, and where it states the smaller error.

    Parameters
    ----------
    model : Model
        With ``impulse_response`` or a full grid of FRFs.
    record, dt
        As for `Deconvolution.estimate`.
    noise
        For both families.
    frequency, time : mapping, optional
        Further settings of `FrequencyInversion` and `Deconvolution`. Beyond `LONG` unknowns the latter goes line by
        line over the padded spectrum (``choice=Lambda(path="fft")``) where nothing else is said and the model has no
        state space: the exact convolution takes minutes there.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Raises
    ------
    InputError
        A record that does not fit the model.
    """
    told = progress or (lambda fraction, text: None)
    known = Noise.of(noise)
    told(0.0, "in time")
    values = as_array(getattr(record, "values", record), where="compare_domains")
    if values.dtype.kind == "f" and np.isnan(values).any():
        raise InputError("a record with gaps has no spectrum to compare with", where="compare_domains",
                         found=f"{int(np.isnan(values).sum())} missing samples", expected="complete channels",
                         hint="take Deconvolution")  # fmt: skip
    unknowns = (len(values) if values.ndim else 0) * len(as_model(model, "compare_domains", "impulse_response").loads)
    long = unknowns > LONG and not model.gives("state_space")
    in_time = {"choice": Lambda(path="fft")} if long and time is None else dict(time or {})
    timed = Deconvolution(model, noise=known, **in_time, progress=lambda f, t: told(0.7 * f, t)).estimate(record, dt)
    told(0.7, "by frequency lines")
    lines = FrequencyInversion(
        model, signal="transient", noise=known, **(frequency or {}), progress=lambda f, t: told(0.7 + 0.3 * f, t)
    ).estimate(record, dt)
    stated = (_stated(lines), _stated(timed))
    take, reason = _judge(lines, timed, stated)
    chosen = lines if take == "frequency" else timed
    gap = lines.load - timed.load
    spread = np.sqrt(lines.std**2 + timed.std**2)
    apart = float(np.mean(np.abs(gap) > APART * np.where(spread > 0, spread, np.inf)))
    difference = np.linalg.norm(gap, axis=0) / np.maximum(np.linalg.norm(chosen.load, axis=0), 1e-300)
    return Domains(lines, timed, tuple(difference.tolist()), stated, apart, take, reason)


def _stated(e: LoadEstimate) -> float:
    size = float(np.sqrt(np.mean(np.abs(e.load) ** 2)))
    return float(np.sqrt(np.mean(e.std**2))) / size if size > 0 else float("inf")


def _judge(lines: LoadEstimate, timed: LoadEstimate, stated: tuple[float, float]) -> tuple[str, str]:
    cut = [f for f in (*lines.flags, *timed.flags) if f.code in CUT]
    if cut:
        return "time", f"lines cannot represent this record ({cut[0].code}: {cut[0].message})"
    if stated[1] * BETTER < stated[0]:
        return "time", f"it states an error of {stated[1]:.1%} against {stated[0]:.1%}"
    if stated[0] * BETTER < stated[1]:
        return "frequency", (
            f"the record is complete, and its prior, which follows the spectrum of each load, leaves an error of "
            f"{stated[0]:.1%} against {stated[1]:.1%}"
        )
    if timed.facts.path == PADDED:
        return "frequency", "both go line by line here and state the same error; the prior of each load decides"
    return "time", "both state the same error, and the solution in time is exact at the ends of the record"
