"""Units at the edge: about forty symbols, their SI factors and dimensions, and nothing guessed.

Inside the packages everything is SI. A file or a user states the unit of each channel once, here it becomes a factor.
Products, quotients and powers of the table's symbols are read too: ``mm/s^2``, ``kN/m``, ``N*m``, ``um/m``.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._advice import Advice, either
from .errors import InputError, plain

__all__ = ["from_si", "parse", "to_si"]

STANDARD_GRAVITY = 9.80665
ARBITRARY = "arbitrary"

# Exponents of (metre, kilogram, second, ampere, kelvin, radian, own). "own" is the dimension of arbitrary numbers.
Dimension = tuple[int, int, int, int, int, int, int]


def _dimension(m: int = 0, kg: int = 0, s: int = 0, A: int = 0, K: int = 0, rad: int = 0, own: int = 0) -> Dimension:
    return (m, kg, s, A, K, rad, own)


# quantity -> (SI symbol, dimension). Where two quantities share a dimension the first one is what a unit alone means.
_QUANTITIES: dict[str, tuple[str, Dimension]] = {
    "displacement": ("m", _dimension(m=1)),
    "velocity": ("m/s", _dimension(m=1, s=-1)),
    "acceleration": ("m/s^2", _dimension(m=1, s=-2)),
    "strain": ("m/m", _dimension()),
    "force": ("N", _dimension(m=1, kg=1, s=-2)),
    "moment": ("N*m", _dimension(m=2, kg=1, s=-2)),
    "pressure": ("Pa", _dimension(m=-1, kg=1, s=-2)),
    "line_load": ("N/m", _dimension(kg=1, s=-2)),
    "time": ("s", _dimension(s=1)),
    "frequency": ("Hz", _dimension(s=-1)),
    "mass": ("kg", _dimension(kg=1)),
    "angle": ("rad", _dimension(rad=1)),
    "angular_velocity": ("rad/s", _dimension(s=-1, rad=1)),
    "angular_acceleration": ("rad/s^2", _dimension(s=-2, rad=1)),
    "area": ("m^2", _dimension(m=2)),
    "voltage": ("V", _dimension(m=2, kg=1, s=-3, A=-1)),
    "current": ("A", _dimension(A=1)),
    ARBITRARY: (ARBITRARY, _dimension(own=1)),
}
QUANTITIES = tuple(_QUANTITIES)
_BY_DIMENSION = {dimension: quantity for quantity, (_, dimension) in reversed(_QUANTITIES.items())}

_POUND = 0.45359237
_INCH = 0.0254

# symbol -> (factor to SI, quantity)
_TABLE: dict[str, tuple[float, str]] = {
    "m": (1.0, "displacement"), "cm": (1e-2, "displacement"), "mm": (1e-3, "displacement"),
    "um": (1e-6, "displacement"), "nm": (1e-9, "displacement"), "in": (_INCH, "displacement"),
    "ft": (12 * _INCH, "displacement"), "mil": (1e-3 * _INCH, "displacement"),
    "s": (1.0, "time"), "ms": (1e-3, "time"), "us": (1e-6, "time"), "ns": (1e-9, "time"), "min": (60.0, "time"),
    "g": (STANDARD_GRAVITY, "acceleration"), "mg": (1e-3 * STANDARD_GRAVITY, "acceleration"),
    "Gal": (1e-2, "acceleration"),
    "N": (1.0, "force"), "mN": (1e-3, "force"), "kN": (1e3, "force"), "MN": (1e6, "force"),
    "lbf": (_POUND * STANDARD_GRAVITY, "force"), "kip": (1e3 * _POUND * STANDARD_GRAVITY, "force"),
    "kgf": (STANDARD_GRAVITY, "force"), "dyn": (1e-5, "force"),
    "Pa": (1.0, "pressure"), "hPa": (1e2, "pressure"), "kPa": (1e3, "pressure"), "MPa": (1e6, "pressure"),
    "GPa": (1e9, "pressure"), "bar": (1e5, "pressure"), "mbar": (1e2, "pressure"),
    "psi": (_POUND * STANDARD_GRAVITY / _INCH**2, "pressure"),
    "Hz": (1.0, "frequency"), "kHz": (1e3, "frequency"), "MHz": (1e6, "frequency"),
    "V": (1.0, "voltage"), "mV": (1e-3, "voltage"), "A": (1.0, "current"), "mA": (1e-3, "current"),
    "kg": (1.0, "mass"),
    "rad": (1.0, "angle"), "mrad": (1e-3, "angle"), "deg": (math.pi / 180, "angle"),
    "strain": (1.0, "strain"), "microstrain": (1e-6, "strain"),
    ARBITRARY: (1.0, ARBITRARY),
}  # fmt: skip

# Spellings that instruments write. Nothing here is a guess: each has one meaning in this field.
_ALIASES = {
    "gn": "g", "g0": "g", "g_n": "g", "µm": "um", "μm": "um", "micron": "um", "µs": "us", "μs": "us", "sec": "s",
    "inch": "in", "ue": "microstrain", "µe": "microstrain", "με": "microstrain", "µε": "microstrain",
    "uε": "microstrain", "ustrain": "microstrain", "µstrain": "microstrain", "ustr": "microstrain",
    "newton": "N", "Newton": "N", "lb_f": "lbf", "Volt": "V", "volt": "V", "volts": "V", "hz": "Hz", "HZ": "Hz",
    "°": "deg", "degree": "deg", "degrees": "deg", "Nm": "N*m", "kNm": "kN*m", "Nmm": "N*mm", "arb": ARBITRARY,
    "a.u.": ARBITRARY, "arb.": ARBITRARY, "mps2": "m/s^2", "ips": "in/s",
}  # fmt: skip

_POWERS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_NUMBER = r"(?:\d{1,20}\.?\d{0,20}|\.\d{1,20})(?:[eE][+-]?\d{1,3})?"
_SCALED = re.compile(rf"(?P<times>{_NUMBER})\s*\*?\s*(?P<unit>[^\d\s*/].*)", re.DOTALL)
_FACTOR = re.compile(r"([A-Za-zµμε°_][A-Za-zµμε°_.]*)(?:\^?\(?([+-]?\d{1,2})\)?)?")


@dataclass(frozen=True)
class Unit:
    """One unit.

    Parameters
    ----------
    symbol : str
        As it was written.
    factor : float
        Number in this unit times `factor` = number in SI.
    dimension : tuple of int
        Exponents of metre, kilogram, second, ampere, kelvin, radian, and of the own dimension of arbitrary numbers.
    quantity : str
        ``"acceleration"``, ``"force"``, ...; ``"other"`` for a dimension that the table does not name.
    """

    symbol: str
    factor: float
    dimension: Dimension
    quantity: str

    @property
    def si(self) -> str:
        """Symbol of the SI unit of this quantity."""
        return si_symbol(self.quantity) if self.quantity != "other" else _spell(self.dimension)


def parse(text: str | Unit | None, *, channel: str = "", where: str = "") -> Unit:
    """Unit of a text such as ``m/s^2``, ``m/s2``, ``g``, ``um/m``, ``kN*m``, ``arbitrary``.

    Parameters
    ----------
    text : str, Unit or None
        Symbols are case-sensitive (mPa is not MPa); None and "" are a missing unit. A ``Unit`` passes through.
    channel : str, optional
        Channel the unit belongs to, for the message.
    where : str, optional
        File it stands in, for the message.

    Raises
    ------
    InputError
        Missing or unknown unit; it says how to state one.
    """
    if isinstance(text, Unit):
        return text
    if text is None or not isinstance(text, str) or not text.strip():
        _refuse("the unit is missing", text if text is None else repr(text), channel, where)
    if len(text) > 60:
        _refuse("the unit is too long to be one", f"{text[:40]!r}...", channel, where)
    unit = _read(text.strip())
    if unit is None:
        near = _nearest(text.strip())
        _refuse("unknown unit", repr(text) + (f" (did you mean {near}?)" if near else ""), channel, where)
    return unit


def stated(text: str | Unit | None, *, channel: str = "", where: str = "") -> Unit:
    """Unit as a user states it: as `parse`, or a number in front of it, ``100 g``, for numbers that are parts of it.

    What is 1 in a file is then 100 g: a full scale, or what one count of a converter stands for. Texts of files are
    not read so, as "acc (5 g)" there may name a range.

    Raises
    ------
    InputError
        As `parse`; a number that is not positive.
    """
    match = _SCALED.fullmatch(text.strip()) if isinstance(text, str) else None
    if match is None:
        return parse(text, channel=channel, where=where)
    unit, times = parse(match["unit"], channel=channel, where=where), float(match["times"])
    if not (math.isfinite(times * unit.factor) and times * unit.factor > 0):
        _refuse("the number in front of the unit is not positive", repr(text), channel, where)
    return Unit(f"{match['times']} {unit.symbol}", times * unit.factor, unit.dimension, unit.quantity)


def known(text: str) -> bool:
    """Whether a text is a unit that `parse` takes."""
    return isinstance(text, str) and 0 < len(text.strip()) <= 60 and _read(text.strip()) is not None


def si_symbol(quantity: str) -> str:
    """SI symbol of a quantity: ``si_symbol("acceleration") == "m/s^2"``.

    Raises
    ------
    InputError
        If the table does not have the quantity.
    """
    if quantity not in _QUANTITIES:
        raise InputError(
            "unknown quantity",
            where="units",
            found=repr(quantity),
            expected=", ".join(_QUANTITIES),
            hint="arbitrary where none fits",
        )
    return _QUANTITIES[quantity][0]


def to_si(
    values: ArrayLike, unit: str | Unit, *, quantity: str | None = None, channel: str = ""
) -> NDArray[np.float64]:
    """Numbers in SI (a new array, the same shape).

    Parameters
    ----------
    values : array
        Numbers in `unit`.
    unit : str or Unit
        Unit of `values`.
    quantity : str, optional
        What the numbers must be; a unit of another dimension raises.

    Raises
    ------
    InputError
        Unknown unit, or a unit that cannot be one of `quantity`.
    """
    unit = parse(unit, channel=channel)
    if quantity is not None:
        check(unit, quantity, channel=channel)
    return np.asarray(plain(values), dtype=float) * unit.factor


def from_si(values: ArrayLike, unit: str | Unit) -> NDArray[np.float64]:
    """Inverse of `to_si`."""
    return np.asarray(plain(values), dtype=float) / parse(unit).factor


def check(unit: str | Unit, quantity: str, *, channel: str = "") -> Unit:
    """The unit, if it can be one of `quantity`.

    Raises
    ------
    InputError
        If the dimensions differ.
    """
    unit = parse(unit, channel=channel)
    symbol, dimension = si_symbol(quantity), _QUANTITIES[quantity][1]
    if unit.dimension != dimension:
        raise InputError(
            f"{unit.symbol} is no unit of {quantity}",
            where=f"channel {channel}" if channel else "units",
            found=f"{unit.symbol} ({unit.quantity})",
            expected=f"a unit of {quantity}, such as {symbol}",
            hint=_how_to_state(channel),
        )
    return unit


def assignments(texts: Iterable[str]) -> dict[str, str]:
    """``["F=N", "acc=m/s^2"]`` as a dictionary, for ``--unit CH=UNIT``.

    Raises
    ------
    InputError
        If a text has no ``=``, a channel is named twice, or the unit is unknown.
    """
    found: dict[str, str] = {}
    for text in texts:
        channel, equals, unit = text.rpartition("=")
        channel = channel.strip()
        if not equals or not channel:
            raise InputError(
                "no assignment of a unit",
                where="--unit",
                found=repr(text),
                expected="CH=UNIT, such as F=N",
                hint="one text per channel",
            )
        if channel in found:
            raise InputError(
                "two units for one channel",
                where="--unit",
                found=repr(text),
                expected=f"one for {channel}",
                hint="name each channel once",
            )
        stated(unit, channel=channel)
        found[channel] = unit.strip()
    return found


def as_mapping(units: Mapping[str | int, str | Unit] | None) -> dict[str | int, str | Unit]:
    """The argument ``units=`` as a dictionary.

    Raises
    ------
    InputError
        If it is no mapping.
    """
    if units is None:
        return {}
    if not isinstance(units, Mapping):
        raise InputError(
            "units is no dictionary",
            where="units",
            found=repr(units),
            expected='{channel: unit}, such as {"F": "N"}',
            hint="on the command line: --unit F=N",
        )
    return dict(units)


def _read(text: str) -> Unit | None:
    base = _TABLE.get(_ALIASES.get(text, text))
    if base is not None:
        return Unit(text, base[0], _QUANTITIES[base[1]][1], base[1])
    body = _ALIASES.get(text, text).translate(_POWERS).replace("**", "^").replace("·", "*").replace("⋅", "*")
    if "-" in body:  # "N-m" is a product, "s^-2" is a power
        body = re.sub(r"(?<=[A-Za-z])-(?=[A-Za-z])", "*", body)
    numerator, *denominators = body.split("/")
    if len(denominators) > 1:
        return None
    factor, dimension = 1.0, _dimension()
    for part, sign in [(numerator, 1), *((d, -1) for d in denominators)]:
        if part.strip() == "1" and sign == 1 and denominators:
            continue
        if part.startswith("(") and part.endswith(")"):
            part = part[1:-1]
        for token in re.split(r"[*\s]+", part.strip()):
            match = _FACTOR.fullmatch(token)
            entry = _TABLE.get(_ALIASES.get(match[1], match[1])) if match else None
            if match is None or entry is None or entry[1] == ARBITRARY:
                return None
            power = sign * int(match[2] or 1)
            factor *= entry[0] ** power
            dimension = _plus(dimension, _QUANTITIES[entry[1]][1], power)
    if not math.isfinite(factor) or factor <= 0:
        return None
    return Unit(text, factor, dimension, _BY_DIMENSION.get(dimension, "other"))


def _plus(a: Dimension, b: Dimension, times: int) -> Dimension:
    m, kg, s, ampere, kelvin, rad, own = (x + times * y for x, y in zip(a, b, strict=True))
    return (m, kg, s, ampere, kelvin, rad, own)


def _spell(dimension: Dimension) -> str:
    names = ("m", "kg", "s", "A", "K", "rad", ARBITRARY)
    return "*".join(n if e == 1 else f"{n}^{e}" for n, e in zip(names, dimension, strict=True) if e)


def _nearest(text: str) -> str:
    names = [*_TABLE, *(s for s, _ in _QUANTITIES.values())]
    same = [n for n in names if n.lower() == text.lower()]
    near = same or difflib.get_close_matches(text, names, n=1, cutoff=0.6)
    return " or ".join(near)


def _how_to_state(channel: str) -> Advice:
    name = channel or "CH"
    stated = either(f'units={{"{name}": "UNIT"}}', f"--unit {name}=UNIT")
    return Advice("state it: ", stated, '; "arbitrary" is a unit')


def _refuse(what: str, found: object, channel: str, where: str) -> NoReturn:
    raise InputError(
        what,
        where=", ".join(filter(None, (where, f"channel {channel}" if channel else ""))) or "units",
        found="nothing" if found is None else found,
        expected="a unit such as m/s^2, g, N, kN, mm, um/m, Pa, V",
        hint=_how_to_state(channel),
    )
