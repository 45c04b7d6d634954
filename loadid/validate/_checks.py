"""Numbers of one comparison, of sensors, resultants or distributions, and what they come to together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from structures._flags import Flag

from .._guards.measurement import NECESSARY

Array = NDArray[np.float64]

SHAPE = 0.98  # cosine of two maps from which on their shape is the same
GAIN = (0.9, 1.1)
SDS = 3.0  # of the difference, up to which two numbers agree
EARLIER = {"found": "estimated"}  # names of 0.1 in result files
CLOSE = 0.05  # relative difference up to which two numbers of unknown std agree


@dataclass(frozen=True)
class SensorCheck:
    """Sensors that were kept out of the inversion.

    Parameters
    ----------
    labels : tuple of str
    error : tuple of float
        As in `HeldOut`.
    noise_ratio : tuple of float, optional
        Rms of the difference over the noise std, per channel.
    source : str
    """

    kind: ClassVar[str] = "held-out sensors"
    labels: tuple[str, ...]
    error: tuple[float, ...]
    noise_ratio: tuple[float, ...] | None = None
    source: str = ""

    @property
    def agrees(self) -> bool:
        """Within three times the noise, or within 5 % where the noise is not known."""
        return max(self.error) <= CLOSE if self.noise_ratio is None else max(self.noise_ratio) <= SDS

    def __str__(self) -> str:
        worst = int(np.argmax(self.error if self.noise_ratio is None else self.noise_ratio))
        text = f"{_count(len(self.labels), 'held-out sensor')}: error at most {max(self.error):.2%}"
        if self.noise_ratio is not None:
            text += f", {self.noise_ratio[worst]:.3g} times the noise"
        return f"{text} ({self.labels[worst]})"


@dataclass(frozen=True)
class ResultantCheck:
    """Resultant forces and moments.

    Parameters
    ----------
    labels, units : tuple of str
    estimated, reference : tuple of float
        Of a sequence, at the frame or sample in which the reference is largest.
    error : tuple of float or None
        Norm over the frames of the difference, over the norm of the reference of all resultants of that unit; None
        where those are all zero.
    sd : tuple of float, optional
        Rms over the frames of the difference over its std (estimate and reference); None where neither has one.
    at : float, optional
        Value of the axis at which `estimated` and `reference` are taken.
    source : str
    """

    kind: ClassVar[str] = "resultant"
    labels: tuple[str, ...]
    units: tuple[str, ...]
    estimated: tuple[float, ...]
    reference: tuple[float, ...]
    error: tuple[float | None, ...]
    sd: tuple[float, ...] | None = None
    at: float | None = None
    source: str = ""

    @property
    def agrees(self) -> bool:
        """Within three sd, or within 5 % where no std is known."""
        if self.sd is not None:
            return max(self.sd) <= SDS
        return all((np.inf if e is None else e) <= CLOSE for e in self.error)

    def __str__(self) -> str:
        parts = []
        for i, label in enumerate(self.labels):
            text = f"{label} {self.estimated[i]:.4g} against {self.reference[i]:.4g} {self.units[i]}".rstrip()
            error = self.error[i]
            notes = [] if error is None else [f"{error:.2%}"]
            notes += [] if self.sd is None else [f"{self.sd[i]:.2g} sd"]
            parts.append(f"{text} ({', '.join(notes)})" if notes else text)
        return "; ".join(parts)


@dataclass(frozen=True)
class DistributionCheck:
    """The load, place by place and sample by sample.

    Parameters
    ----------
    unit : str
    what : str
        What was compared: ``"48 loads"``, ``"16 averages"``.
    error : float
        Norm of estimate minus reference over norm of the reference; integrals over the surface where areas are known.
    shape : float
        Cosine of the angle between the two maps: 1 is the same shape, whatever the gain.
    gain : float
        Factor that scales the reference onto the estimate, by least squares; 1 is right.
    peak, reference_peak : float
        Entry of largest modulus, with its sign.
    peak_at, reference_peak_at : str
        Where they are.
    peak_distance : float, optional
        Distance of the two places in `distance_unit` (m; s of a history); None where no places are known.
    band : float, optional
        Share of the reference values inside the stated band; None without a std.
    level : float
        Probability of that band.
    source : str
    """

    kind: ClassVar[str] = "distribution"
    unit: str
    what: str
    error: float
    shape: float
    gain: float
    peak: float
    reference_peak: float
    peak_at: str
    reference_peak_at: str
    peak_distance: float | None = None
    distance_unit: str = "m"
    band: float | None = None
    level: float = 0.95
    source: str = ""

    @property
    def peak_error(self) -> float:
        """Relative error of the peak, signed."""
        return self.peak / self.reference_peak - 1

    @property
    def agrees(self) -> bool:
        """Shape and gain right."""
        return self.shape >= SHAPE and GAIN[0] <= self.gain <= GAIN[1]

    @property
    def verdict(self) -> str:
        """Shape and gain judged apart: a modulus changes the gain alone, most other faults the shape."""
        if self.shape < SHAPE:
            return f"shape wrong: correlation {self.shape:.3f} (Poisson's ratio, geometry, supports, resolution first)"
        if not GAIN[0] <= self.gain <= GAIN[1]:
            return f"shape right, gain {self.gain:.3g}: recheck E (regularisation also lowers the gain)"
        return f"shape right (correlation {self.shape:.3f}), gain {self.gain:.3g}"

    def __str__(self) -> str:
        where = f"at {self.peak_at}" + (
            "" if self.peak_at == self.reference_peak_at else f" instead of {self.reference_peak_at}"
        )
        if self.peak_distance:
            where += f", {self.peak_distance:.3g} {self.distance_unit} away".rstrip()
        ratio = self.peak / self.reference_peak
        peak = f"{abs(ratio) - 1:+.1%}" + ("" if ratio > 0 else ", with the other sign,")
        text = f"{self.what}: error {self.error:.1%}, peak {peak} {where}; {self.verdict}"
        return text if self.band is None else f"{text}; the {self.level:.0%} band holds {self.band:.1%}"


Check = SensorCheck | ResultantCheck | DistributionCheck
_KINDS: dict[str, type[SensorCheck] | type[ResultantCheck] | type[DistributionCheck]] = {
    c.kind: c for c in (SensorCheck, ResultantCheck, DistributionCheck)
}


def to_dict(check: Check) -> dict[str, Any]:
    """Plain texts, numbers and lists."""
    tree = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(check).items()}
    return {"kind": check.kind, **tree}


def from_dict(tree: Mapping[str, Any]) -> Check:
    """Inverse of `to_dict`; what a later release added is left out."""
    kind = _KINDS[str(tree["kind"])]
    names = {f.name for f in fields(kind)}
    own = {EARLIER.get(k, k): v for k, v in tree.items()}
    settled: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in own.items() if k in names}
    return kind(**settled)


LEVELS = ("none", "held-out sensors", "resultant", "distribution")


@dataclass(frozen=True)
class Validation:
    """What an estimate was compared with, and how far that reaches.

    Parameters
    ----------
    checks : tuple of SensorCheck, ResultantCheck or DistributionCheck
    flags : tuple of Flag
        N701 where resultants alone were compared, W704 where a reference was used in the inversion.
    date : str
        ISO date and time, UTC.

    Attributes
    ----------
    level : str
        ``"none"`` < ``"held-out sensors"`` < ``"resultant"`` < ``"distribution"``: the highest with a check.
    agrees : bool
        Every check agrees within its limits, which the classes of the checks name.
    """

    checks: tuple[Check, ...] = ()
    flags: tuple[Flag, ...] = ()
    date: str = ""

    @property
    def level(self) -> str:
        """Highest level at which there is a check."""
        return LEVELS[max((LEVELS.index(c.kind) for c in self.checks), default=0)]

    @property
    def agrees(self) -> bool:
        """Every check agrees; false where there is none."""
        return bool(self.checks) and all(c.agrees for c in self.checks)

    @property
    def partial(self) -> bool:
        """The checks leave the distribution open."""
        return any(f.code == "LID-N701" for f in self.flags) or self.level in LEVELS[:2]

    @property
    def resultants(self) -> tuple[ResultantCheck, ...]:
        """Checks of resultants."""
        return tuple(c for c in self.checks if isinstance(c, ResultantCheck))

    @property
    def distributions(self) -> tuple[DistributionCheck, ...]:
        """Checks of distributions."""
        return tuple(c for c in self.checks if isinstance(c, DistributionCheck))

    @property
    def sensors(self) -> tuple[SensorCheck, ...]:
        """Checks on held-out sensors."""
        return tuple(c for c in self.checks if isinstance(c, SensorCheck))

    def __str__(self) -> str:
        if not self.checks:
            return "level: none"
        text = f"level: {self.level}" + (", partial" if self.partial else "") + ("" if self.agrees else ", disagrees")
        parts = [f"{_source(c)}{c}" for c in self.checks]
        parts += [NECESSARY for f in self.flags if f.code == "LID-N701"]
        return f"{text}. " + ". ".join(parts)

    def table(self) -> str:
        """One line for each check, as text."""
        rows = [(c.kind, c.source, "agrees" if c.agrees else "disagrees", str(c)) for c in self.checks]
        wide = [max((len(r[i]) for r in rows), default=0) for i in range(3)]
        lines = ["  ".join([*(x.ljust(w) for x, w in zip(r, wide, strict=False)), r[3]]) for r in rows]
        return "\n".join([f"level reached: {self.level}{' (partial)' if self.partial else ''}", *lines])

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists, for files."""
        return {
            "level": self.level,
            "checks": [to_dict(c) for c in self.checks],
            "flags": [f.to_dict() for f in self.flags],
            "date": self.date,
        }

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any]) -> Validation:
        """Inverse of `to_dict`."""
        checks = tuple(from_dict(c) for c in tree["checks"])
        return cls(checks, tuple(Flag.from_dict(f) for f in tree["flags"]), str(tree["date"]))


def _source(check: Check) -> str:
    return f"{check.source}: " if check.source and check.source != check.kind else ""


def compare(found: Array, known: Array, weights: Array) -> tuple[float, float, float, tuple[int, ...], tuple[int, ...]]:
    """Relative error, cosine, gain, and places of the two peaks; `weights` (places,) are those of the inner product."""
    root = np.sqrt(weights)
    a, b = found * root, known * root
    size, own = float(np.linalg.norm(b)), float(np.linalg.norm(a))
    product = float(np.sum((a / size) * (b / size)))
    shape = product * size / own if own else 0.0
    peaks = [tuple(int(i) for i in np.unravel_index(np.argmax(np.abs(x)), x.shape)) for x in (found, known)]
    return float(np.linalg.norm((a - b) / size)), shape, product, peaks[0], peaks[1]


def resultant_check(
    labels: Sequence[str],
    units: Sequence[str],
    found: Array,
    known: Array,
    std: Array | None,
    at: Array | None,
    source: str,
) -> ResultantCheck:
    """Compare resultants (frames, R); `std` is that of their difference."""
    group = np.array(units)
    size = np.array([np.linalg.norm(known[:, group == u]) for u in units])
    frame = int(np.argmax(np.linalg.norm(known / np.where(size > 0, size, 1.0), axis=1)))
    difference = found - known
    off = np.linalg.norm(difference, axis=0)
    sd = None if std is None else np.sqrt(np.mean((difference / std) ** 2, axis=0))
    return ResultantCheck(
        tuple(labels),
        tuple(units),
        tuple(found[frame].tolist()),
        tuple(known[frame].tolist()),
        tuple(float(o / s) if s > 0 else None for o, s in zip(off, size, strict=True)),
        None if sd is None else tuple(sd.tolist()),
        None if at is None else float(at[frame]),
        source,
    )


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' * (number != 1)}"
