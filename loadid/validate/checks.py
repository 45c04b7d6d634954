"""Numbers of one comparison (sensors, resultants, distributions), and the coverage of the stated bands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from statistics import NormalDist
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, plain
from structures.flags import Flag
from structures.model import Model

from ..guards.measurement import NECESSARY
from .references import numbers

SHAPE = 0.98  # cosine of two maps from which on their shape is the same
GAIN = (0.9, 1.1)
SDS = 3.0  # of the difference, up to which two numbers agree
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
    found, reference : tuple of float
        Of a sequence, at the frame or sample in which the reference is largest.
    error : tuple of float or None
        Norm over the frames of found minus reference, over the norm of the reference of all resultants of that unit;
        None where those are all zero.
    sd : tuple of float, optional
        Rms over the frames of the difference over its std (estimate and reference); None where neither has one.
    at : float, optional
        Value of the axis at which `found` and `reference` are taken.
    source : str
    """

    kind: ClassVar[str] = "resultant"
    labels: tuple[str, ...]
    units: tuple[str, ...]
    found: tuple[float, ...]
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
            text = f"{label} {self.found[i]:.4g} against {self.reference[i]:.4g} {self.units[i]}".rstrip()
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
        text = f"{self.what}: error {self.error:.1%}, peak {self.peak_error:+.1%} {where}; {self.verdict}"
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
    settled: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in tree.items() if k in names}
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


def compare(
    found: NDArray, known: NDArray, weights: NDArray
) -> tuple[float, float, float, tuple[int, ...], tuple[int, ...]]:
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
    found: NDArray,
    known: NDArray,
    std: NDArray | None,
    at: NDArray | None,
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


HISTORIES, READINGS = 50, 2000  # draws where none are asked for: records in time, static readings
Draw = Callable[[np.random.Generator], ArrayLike]


@dataclass(frozen=True)
class Coverage:
    """Share of the true load values inside the stated band.

    Parameters
    ----------
    share : float
        Over all draws, samples and loads.
    level : float
        Stated level of the band.
    draws : int
    date : str
    """

    share: float
    level: float
    draws: int
    date: str

    def __str__(self) -> str:
        return f"the {self.level:.0%} band held {self.share:.1%} of the true values in {self.draws} simulated records"


def coverage(
    family: Any,
    loads: ArrayLike | Sequence[ArrayLike] | Draw,
    dt: float | None = None,
    *,
    noise: ArrayLike,
    truth: Model | None = None,
    draws: int | None = None,
    level: float = 0.95,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Coverage:
    """Simulate readings of known loads with fresh noise, rebuild them, and count the values inside the band.

    Parameters
    ----------
    family : Deconvolution, StaticInversion or another family
        Set up as it will be used.
    loads : array, sequence of arrays, or callable
        Loads like the ones to be expected; draws go through them in turn. In time, ``(samples, loads)`` or a sequence
        of such histories; static, ``(loads,)`` or ``(draws, loads)``. A callable takes a random generator and returns
        one of them: a prior to draw from.
    dt : float, optional
        Step in s; None is static.
    noise : float, array (sensors,) or array (sensors, sensors)
        Noise std to add, or its covariance.
    truth : Model, optional
        Model that makes the data; default the family's own, which is optimistic (an inverse crime).
    draws : int, optional
        Number of records; default 50 histories or 2000 static readings.
    level, seed
        Level of the band, seed of the noise.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    Coverage
        Pass it as ``coverage=`` to the family.

    Raises
    ------
    InputError
        No draw, no load or a level outside (0, 1); loads or noise that do not fit the model.
    """
    if not (hasattr(family, "estimate") and hasattr(family, "model")):
        raise InputError(
            "no family", where="coverage", found=type(family).__name__, expected="StaticInversion, Deconvolution, ...",
            hint="coverage(StaticInversion(model), loads, noise=...)",
        )  # fmt: skip
    draws = (READINGS if dt is None else HISTORIES) if draws is None else draws
    shapes = _static(loads) if dt is None else _histories(loads)
    if draws < 1 or not 0 < level < 1 or not (callable(shapes) or shapes):
        raise InputError(
            "nothing to draw",
            where="coverage",
            found=f"{draws} draws, {'a' if callable(shapes) else len(shapes)} loads, level {level}",
            expected="at least one draw of one load, and a level in (0, 1)",
            hint="give loads like the ones to be expected",
        )
    rng, z = np.random.default_rng(seed), NormalDist().inv_cdf(0.5 + level / 2)
    model = truth or family.model
    add = _noise(noise, rng)
    static = None if dt is not None else _transfer(model)
    inside = total = 0
    for i, g in enumerate(_draws(shapes, draws, rng, dt)):
        if static is not None:
            _fits(g, static)
            estimate = family.estimate(add(static @ g))
        else:
            assert dt is not None
            estimate = family.estimate(add(model.predict(g, dt)), dt)
        hit = np.abs(estimate.load - g[: len(estimate.load)]) <= z * estimate.std
        inside, total = inside + int(hit.sum()), total + hit.size
        if progress is not None:
            progress((i + 1) / draws, "coverage")
    return Coverage(inside / total, level, draws, datetime.now(UTC).isoformat(timespec="seconds"))


Shapes = Draw | list[NDArray[np.float64]]


def _draws(shapes: Shapes, draws: int, rng: np.random.Generator, dt: float | None) -> Iterator[NDArray[np.float64]]:
    for i in range(draws):
        if callable(shapes):
            (g,) = _static([shapes(rng)]) if dt is None else _histories([shapes(rng)])  # type: ignore[misc]
            yield g
        else:
            yield shapes[i % len(shapes)]


def _histories(loads: ArrayLike | Sequence[ArrayLike] | Draw) -> Shapes:
    if callable(loads):
        return loads
    several = isinstance(loads, list | tuple) and any(np.ndim(g) > 0 for g in loads)
    arrays = [np.asarray(plain(g), float) for g in loads] if several else [np.asarray(plain(loads), float)]  # type: ignore[union-attr]
    for g in arrays:
        if g.ndim not in (1, 2) or not g.size:
            raise InputError(
                "no load history",
                where="coverage",
                found=f"shape {g.shape}",
                expected="(samples,) or (samples, loads)",
                hint="leave dt out where the loads are static",
            )
    return [g.reshape(len(g), -1) for g in arrays]


def _static(loads: ArrayLike | Sequence[ArrayLike] | Draw) -> Shapes:
    if callable(loads):
        return loads
    table = numbers(loads, "static loads", "give dt= where the loads are histories", where="coverage")
    if table.ndim not in (1, 2):
        raise InputError(
            "no static loads",
            where="coverage",
            found=f"shape {table.shape}",
            expected="(loads,) or (draws, loads)",
            hint="give dt= where the loads are histories",
        )
    return list(np.atleast_2d(table))


def _transfer(model: Model) -> NDArray[np.float64]:
    return np.asarray(model.static(), float)


def _fits(g: NDArray, H: NDArray) -> None:
    if g.shape != H.shape[1:]:
        raise InputError(
            "the loads do not fit the model",
            where="coverage",
            found=f"{g.size} loads",
            expected=f"{H.shape[1]} loads",
            hint="one number per load, in the order of model.loads",
        )


def _noise(noise: ArrayLike, rng: np.random.Generator) -> Callable[[NDArray], NDArray]:
    """What adds noise to clean readings, sensors last."""
    level = numbers(noise, "noise", where="coverage")
    if level.ndim > 2 or (level.ndim < 2 and np.any(level < 0)):
        raise InputError(
            "no noise level",
            where="coverage",
            found=f"shape {level.shape}",
            expected="std >= 0, a number or (sensors,), or a covariance (sensors, sensors)",
            hint="give the std of each sensor",
        )
    if level.ndim < 2:
        return lambda y: y + level * rng.standard_normal(y.shape)
    try:
        root = np.linalg.cholesky(level)
    except np.linalg.LinAlgError:
        raise InputError(
            "the noise covariance is not positive definite",
            where="coverage",
            found=f"shape {level.shape}",
            expected="a symmetric positive definite matrix",
            hint="give the std of each sensor where the covariance is singular",
        ) from None
    return lambda y: y + rng.standard_normal(y.shape) @ root.T
