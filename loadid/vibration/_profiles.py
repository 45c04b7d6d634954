"""Specifications of a vibration test: breakpoint tables, slopes in dB per octave, targets of sensors, limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures import units as _units
from structures._channels import Channel
from structures._model import Model
from structures._models.lines import ascending
from structures._readonly import ReadOnly
from structures.errors import InputError, positive, reals

from ..sources._synthesis import DENSITIES, unit_of

Real = NDArray[np.float64]
OCTAVE = float(np.log10(2.0))
TOLERANCE = 3.0  # dB to either side: MIL-STD-810H, method 514.8, for random vibration up to 1 kHz
HALF = "/Hz"


@dataclass(frozen=True, eq=False)
class Profile(ReadOnly):
    """A level over frequency by breakpoints, straight between them on log-log paper.

    Parameters
    ----------
    frequencies : array, shape (points,)
        Hz, ascending, above 0.
    levels : array, shape (points,)
        Densities (``"g^2/Hz"``) of a random specification or limit, amplitudes (``"g"``) of a sine.
    unit : str
        Of the levels: a unit such as ``"g"``, or the density of one, ``"g^2/Hz"``. Kept in SI.

    Raises
    ------
    InputError
        No breakpoints, levels that are not positive, an unknown unit.
    """

    frequencies: Real
    levels: Real
    unit: str

    def __init__(self, frequencies: ArrayLike, levels: ArrayLike, unit: str) -> None:
        f = reals(frequencies, where="Profile, frequencies", what="these are no frequencies")
        x = reals(levels, where="Profile, levels", what="these are no levels")
        if f.ndim != 1 or len(f) < 2 or x.shape != f.shape or not np.all(np.isfinite([*f, *x])):
            raise InputError("no breakpoints", where="Profile", found=f"{f.shape} frequencies, {x.shape} levels",
                             expected="a level for each of two or more frequencies")  # fmt: skip
        if np.any(np.diff(f) <= 0):
            k = int(np.argmax(np.diff(f) <= 0))
            raise InputError("breakpoints are not ascending", where="Profile, frequencies",
                             found=f"{f[k + 1]:g} Hz after {f[k]:g} Hz", expected="Hz, ascending",
                             hint="a step is two breakpoints, a hair apart")  # fmt: skip
        factor, channel = scale(unit)
        if f[0] <= 0 or np.any(x <= 0):
            k = int(np.argmax((f <= 0) | (x <= 0)))
            raise InputError("breakpoints have no logarithm", where="Profile", found=f"{x[k]:g} at {f[k]:g} Hz",
                             expected=f"Hz and levels above 0, in {unit}",
                             hint="of a level in dB take 10^(dB/10), of an amplitude 10^(dB/20)")  # fmt: skip
        object.__setattr__(self, "frequencies", f)
        object.__setattr__(self, "levels", x * factor)
        object.__setattr__(self, "unit", channel)
        for one in (self.frequencies, self.levels):
            one.flags.writeable = False

    @classmethod
    def from_slopes(
        cls, frequencies: ArrayLike, slopes: ArrayLike, *, level: float, at: float, unit: str
    ) -> Profile:  # fmt: skip
        """Profile from the slopes between its breakpoints and the level at one frequency.

        Parameters
        ----------
        frequencies : array, shape (points,)
            Hz.
        slopes : array, shape (points - 1,)
            dB per octave from each breakpoint to the next: of densities 10 log10, of amplitudes 20 log10.
        level : float
        at : float
            Hz, within the breakpoints.
        unit : str

        Raises
        ------
        InputError
            Slopes that do not fit, or a frequency outside.
        """
        f = reals(frequencies, where="Profile, frequencies", what="these are no frequencies")
        s = reals(slopes, where="Profile, slopes", what="these are no slopes in dB per octave")
        level, at = positive("the level", level, where="Profile"), positive("at", at, where="Profile", unit="Hz")
        if f.ndim != 1 or len(f) < 2 or s.shape != (len(f) - 1,) or not np.all(np.isfinite(s)) or np.any(f <= 0):
            raise InputError("slopes and breakpoints do not fit", where="Profile", found=f"{s.shape} slopes, {f.shape}",
                             expected="one slope between every two frequencies, above 0 Hz")  # fmt: skip
        if not f[0] <= at <= f[-1]:
            raise InputError("the level stands outside the breakpoints", where="Profile", found=f"{at:g} Hz",
                             expected=f"{f[0]:g} to {f[-1]:g} Hz")  # fmt: skip
        decibels = np.concatenate([[0.0], np.cumsum(s * np.diff(np.log10(f)) / OCTAVE)])
        decibels -= np.interp(np.log10(at), np.log10(f), decibels)
        return cls(f, level * 10 ** (decibels / (10 if is_density(unit) else 20)), unit)

    def at(self, frequencies: ArrayLike, *, outside: float | None = None) -> Real:
        """Levels at some lines (Hz), SI.

        Parameters
        ----------
        outside : float, optional
            What holds below the first and above the last breakpoint.

        Raises
        ------
        InputError
            A line outside the breakpoints, where nothing holds there.
        """
        f = np.atleast_1d(reals(frequencies, where="Profile.at", what="these are no lines"))
        ends = self.frequencies[[0, -1]]
        out = (f < ends[0] * (1 - 1e-9)) | (f > ends[1] * (1 + 1e-9))
        if out.any() and outside is None:
            raise InputError("a line outside the breakpoints", where="Profile", found=f"{f[out][0]:g} Hz",
                             expected=f"{ends[0]:g} to {ends[1]:g} Hz",
                             hint="take the lines of the specification, or end the profile later")  # fmt: skip
        inside = np.log(np.clip(f, *ends))
        found = np.exp(np.interp(inside, np.log(self.frequencies), np.log(self.levels)))
        return np.asarray(np.where(out, outside if outside is not None else 0.0, found))

    def __str__(self) -> str:
        f, x = self.frequencies, self.levels
        return f"profile, {f[0]:g} to {f[-1]:g} Hz, {x.min():.4g} to {x.max():.4g} {self.unit}"

    @property
    def density(self) -> bool:
        """Whether the levels are densities."""
        return self.unit.endswith(HALF)

    @property
    def rms(self) -> float:
        """Root of the area below a density, SI; each strip in closed form.

        Raises
        ------
        InputError
            Amplitudes, which have no density.
        """
        if not self.density:
            raise InputError("amplitudes have no rms over a band", where="Profile.rms", found=self.unit,
                             expected="a density such as g^2/Hz")  # fmt: skip
        f, x = self.frequencies, self.levels
        n = np.diff(np.log(x)) / np.diff(np.log(f))
        flat = np.abs(n + 1) < 1e-9
        power = np.where(flat, 0.0, n + 1)
        strips = np.where(flat, x[:-1] * f[:-1] * np.log(f[1:] / f[:-1]),
                          (x[1:] * f[1:] - x[:-1] * f[:-1]) / np.where(flat, 1.0, power))  # fmt: skip
        return float(np.sqrt(strips.sum()))

    def raised(self, decibels: float) -> Profile:
        """The same profile some dB higher: a limit above a target, or a test at a lower level."""
        factor = 10 ** (float(decibels) / (10 if self.density else 20))
        made = Profile.__new__(Profile)
        for name, value in {"frequencies": self.frequencies, "levels": self.levels * factor, "unit": self.unit}.items():
            object.__setattr__(made, name, value)
        made.levels.flags.writeable = False
        return made


def _base(unit: str) -> str | None:
    """``g`` of ``"g^2/Hz"``, however that is spelled; None of what is no density."""
    text = str(unit).replace(" ", "").replace("²", "^2").replace("**", "^")
    if not text.lower().endswith("2/hz"):
        return None
    base = text[: -len("2/Hz")].removesuffix("^")
    return base[1:-1] if base.startswith("(") and base.endswith(")") else base


def is_density(unit: str) -> bool:
    """Whether a unit is a density: ``g^2/Hz``."""
    return _base(unit) is not None


def scale(unit: str) -> tuple[float, str]:
    """Factor to SI, and the unit of the channel (``"m/s^2"``) or of its density (``"(m/s^2)^2/Hz"``).

    Raises
    ------
    InputError
        An unknown unit.
    """
    base = _base(unit)
    if (base is None and "hz" in str(unit).lower()) or not _units.known(str(unit) if base is None else base):
        raise InputError("unknown unit", where="Profile, unit", found=repr(unit),
                         expected="a density such as g^2/Hz, (m/s^2)^2/Hz or V^2/Hz; of a sine an amplitude such as g",
                         hint="square levels per root of Hz, turn levels in dB into numbers; an rms over a band is a "
                         "limit, not a profile")  # fmt: skip
    known = _units.parse(str(unit) if base is None else base)
    return (known.factor, known.si) if base is None else (known.factor**2, unit_of(known.si, DENSITIES))


def checked_unit(profile: Profile, channel: Channel, density: bool, where: str) -> None:
    """Refuse a profile that is none of this channel.

    Raises
    ------
    InputError
        Another unit, or an amplitude for a density.
    """
    wanted = unit_of(channel.unit, DENSITIES) if density else channel.unit
    if profile.unit != wanted and "arbitrary" not in (channel.unit, profile.unit.removesuffix("^2/Hz")):
        raise InputError("the unit of the profile is not that of the channel", where=f"{where}, {channel.label}",
                         found=profile.unit, expected=wanted,
                         hint="g^2/Hz for random accelerations, g for a sine; V for drives, N for forces")  # fmt: skip


# -- targets -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Target(ReadOnly):
    """What sensors are to do on frequency lines, each by itself: autospectra, or amplitudes of a sine.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, ascending.
    levels : array, shape (lines, sensors)
        One-sided densities (unit^2/Hz) of a random target, amplitudes (unit) of a sine, both SI. 0: no motion.
    channels : sequence of Channel or str
        Sensors, by their labels in the model.
    kind : ``"random"`` or ``"sine"``
    phases : array, shape (lines, sensors), optional
        rad, of a sine; default free.
    tolerance : float
        dB to either side.

    Raises
    ------
    InputError
        Shapes that do not fit, negative or infinite levels, phases of a random target.
    """

    frequencies: Real
    levels: Real
    channels: tuple[Channel, ...]
    kind: str
    phases: Real | None
    tolerance: float

    def __init__(
        self,
        frequencies: ArrayLike,
        levels: ArrayLike,
        channels: Sequence[Channel | str],
        *,
        kind: str = "random",
        phases: ArrayLike | None = None,
        tolerance: float = TOLERANCE,
    ) -> None:
        if kind not in ("random", "sine"):
            raise InputError("unknown kind of target", where="Target", found=repr(kind), expected="'random' or 'sine'")
        f = ascending(frequencies)
        named = tuple(c if isinstance(c, Channel) else Channel(label=str(c)) for c in channels)
        x = reals(levels, where="Target, levels", what="these are no levels")
        shape = (len(f), len(named))
        if x.shape != shape or not np.all(np.isfinite(x)) or np.any(x < 0) or not np.any(x):
            raise InputError("levels and lines do not fit", where="Target", found=f"shape {x.shape}",
                             expected=f"finite, none below 0, some above, {shape}: (lines, sensors)")  # fmt: skip
        if len({c.label for c in named}) < len(named):
            raise InputError("labels are doubled", where="Target", found=[c.label for c in named], expected="one each")
        given = None if phases is None else reals(phases, where="Target, phases", what="these are no phases in rad")
        if given is not None and (kind != "sine" or given.shape != shape or not np.all(np.isfinite(given))):
            raise InputError("phases belong to the amplitudes of a sine", where="Target",
                             found=f"{given.shape}, {kind}", expected=f"rad, {shape}, kind='sine'",
                             hint="phases between random channels: loadid.vibration.by_coherence")  # fmt: skip
        within = positive("the tolerance", tolerance, where="Target", unit="dB")
        settled: dict[str, Any] = {"frequencies": f, "levels": x, "channels": named, "kind": kind, "phases": given,
                                   "tolerance": within}  # fmt: skip
        for name, value in settled.items():
            object.__setattr__(self, name, value)
        x.flags.writeable = False

    @classmethod
    def of(
        cls, model: Model, profiles: Profile | Mapping[str, Profile], frequencies: ArrayLike | None = None,
        *, tolerance: float = TOLERANCE,
    ) -> Target:  # fmt: skip
        """Target from profiles, one for all sensors of a model or one for each that is named.

        Parameters
        ----------
        model : Model
        profiles : Profile, or dict of label -> Profile
            Densities make a random target, amplitudes a sine.
        frequencies : array, optional
            Hz; default the lines of the model that lie inside all profiles.
        tolerance : float
            dB.

        Raises
        ------
        InputError
            A sensor that is not there, units that do not fit, densities beside amplitudes, no lines.
        """
        from .._record import find

        labels = [s.label for s in model.sensors]
        named = dict.fromkeys(labels, profiles) if isinstance(profiles, Profile) else dict(profiles)
        rows = [find(label, labels, what="sensor", where="Target") for label in named]
        chosen, given = [model.sensors[i] for i in rows], list(named.values())
        if not given or len({p.density for p in given}) > 1:
            raise InputError("densities and amplitudes in one target", where="Target",
                             found=[p.unit for p in given], expected="either, and at least one")  # fmt: skip
        for channel, profile in zip(chosen, given, strict=True):
            checked_unit(profile, channel, profile.density, "Target")
        f = frequencies if frequencies is not None else _lines(model, given)
        kind = "random" if given[0].density else "sine"
        return cls(f, np.stack([p.at(f) for p in given], axis=1), chosen, kind=kind, tolerance=tolerance)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(c.label for c in self.channels)


def _lines(model: Model, profiles: Sequence[Profile]) -> Real:
    own = model.frequencies
    if own is None:
        raise InputError("the model has an FRF at any frequency", where="Target", found="no lines",
                         expected="frequencies=: lines in Hz",
                         hint="one line every quarter of the narrowest resonance, say")  # fmt: skip
    low = max(p.frequencies[0] for p in profiles)
    high = min(p.frequencies[-1] for p in profiles)
    inside = np.asarray(own)[(own >= low) & (own <= high)]
    if not len(inside):
        raise InputError("no line of the model lies inside the profiles", where="Target",
                         found=f"{low:g} to {high:g} Hz", expected=f"some of {own[0]:g} to {own[-1]:g} Hz")  # fmt: skip
    return inside


# -- limits ------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Limit(ReadOnly):
    """The most that a drive or a response may be; exactly one of the three is given.

    Parameters
    ----------
    channel : str
        A load of the model (a drive), or a sensor of it, which need not be one of the target.
    rms : float, optional
        Over all lines together, of random drives.
    density : float or Profile, optional
        On each line, of random drives; where a Profile has no breakpoints, nothing is limited.
    amplitude : float or Profile, optional
        On each line, of a sine.
    unit : str, optional
        Unit of the numbers: ``"V"``, ``"g"``, of a density ``"g^2/Hz"``; default SI, as the channel.

    Raises
    ------
    InputError
        None or several of them, a number that is not positive, a Profile of the other kind.
    """

    channel: str
    rms: float | None = None
    density: float | Profile | None = None
    amplitude: float | Profile | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        given = {n: x for n, x in (("rms", self.rms), ("density", self.density), ("amplitude", self.amplitude))
                 if x is not None}  # fmt: skip
        if len(given) != 1:
            raise InputError("a limit is one number or profile", where=f"Limit, {self.channel}", found=list(given),
                             expected="rms=, density= or amplitude=")  # fmt: skip
        ((name, value),) = given.items()
        if not isinstance(value, Profile):
            positive(name, value, where=f"Limit, {self.channel}")
        elif name == "rms":
            raise InputError("an rms over all lines is one number", where=f"Limit, {self.channel}", found="a Profile",
                             expected="a number, or density= for a limit on each line")  # fmt: skip
        elif value.density != (name == "density"):
            raise InputError("the profile is of the other kind", where=f"Limit, {self.channel}", found=value.unit,
                             expected="g^2/Hz for density=, g for amplitude=")  # fmt: skip
        if self.unit is not None and is_density(self.unit) != (name == "density"):
            raise InputError("the unit of the limit is of the other kind", where=f"Limit, {self.channel}",
                             found=self.unit,
                             expected="such as g^2/Hz" if name == "density" else "such as g or V")  # fmt: skip

    @property
    def kind(self) -> str:
        """``"rms"``, ``"density"`` or ``"amplitude"``."""
        return "rms" if self.rms is not None else "density" if self.density is not None else "amplitude"

    def on(self, frequencies: Real, channel: Channel) -> Real:
        """Its value on some lines, SI, inf where there is none; of an rms the same number on all.

        Raises
        ------
        InputError
            A unit that is not that of the channel.
        """
        value = next(x for x in (self.rms, self.density, self.amplitude) if x is not None)
        if isinstance(value, Profile):
            checked_unit(value, channel, self.kind == "density", "Limit")
            return value.at(frequencies, outside=np.inf)
        factor = 1.0
        if self.unit is not None:
            factor, own = scale(self.unit)
            wanted = unit_of(channel.unit, DENSITIES) if self.kind == "density" else channel.unit
            if own != wanted and "arbitrary" not in (channel.unit, own.removesuffix("^2/Hz")):
                raise InputError("the unit of the limit is not that of the channel", where=f"Limit, {self.channel}",
                                 found=self.unit, expected=wanted)  # fmt: skip
        return np.full(len(frequencies), factor * float(value))

    def __str__(self) -> str:
        return self.told("SI")

    def told(self, unit: str) -> str:
        """The limit in words; `unit` is that of the channel, in which a number without a unit of its own is."""
        value = next(x for x in (self.rms, self.density, self.amplitude) if x is not None)
        own = self.unit or (unit_of(unit, DENSITIES) if self.kind == "density" and unit != "SI" else unit)
        most = str(value) if isinstance(value, Profile) else f"{value:g} {own}"
        return f"{self.channel}: {self.kind} <= {most}"
