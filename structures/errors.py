"""The two errors of the three packages, and numbers as users give them: settled, or refused in words."""

from __future__ import annotations

import hashlib
import math
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._advice import on_command_line

__all__ = ["InputError", "NotIdentifiable"]


class InputError(ValueError):
    """Wrong input: what is wrong, where, what was found, what was expected, and what to do.

    Parameters
    ----------
    what : str
        One sentence that names the fault.
    where : str, optional
        File, argument, channel or line in which it was found.
    found, expected : object, optional
        What was there, and what should have been there.
    hint : str, optional
        What the user does next.
    code : str, optional
        Guard code (``"LID-E104"``) when a guard refused.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str = "",
        found: object = None,
        expected: object = None,
        hint: str = "",
        code: str = "",
    ) -> None:
        self.what, self.where, self.hint, self.code = what, where, hint, code
        self.found, self.expected = found, expected
        super().__init__(self._told(str))

    @property
    def command(self) -> str:
        """The text in the words of the command line."""
        return self._told(on_command_line)

    def _told(self, said: Callable[[object], str]) -> str:
        what = said(self.what)
        parts = [f"{self.where}: {what}" if self.where else what]
        if self.found is not None:
            parts.append(f"found: {said(self.found)}")
        if self.expected is not None:
            parts.append(f"expected: {said(self.expected)}")
        if self.hint:
            parts.append(f"what to do: {said(self.hint)}")
        return (f"[{self.code}] " if self.code else "") + "; ".join(parts)


class NotIdentifiable(Exception):
    """The data or the layout cannot determine the load.

    Parameters
    ----------
    what : str
        What cannot be determined, with the number that shows it.
    advice : str
        What to add or to change.
    code : str
        Guard code, for example ``"LID-E306"``; naming it in ``allow=`` overrides the refusal where that makes sense.
    """

    def __init__(self, what: str, *, advice: str, code: str) -> None:
        self.what, self.advice, self.code = what, advice, code
        super().__init__(f"[{code}] {what}; what to do: {advice}")

    @property
    def command(self) -> str:
        """The text in the words of the command line."""
        return f"[{self.code}] {on_command_line(self.what)}; what to do: {on_command_line(self.advice)}"


def real(value: Any) -> float | None:
    """The finite number that `value` is, or None: texts, booleans, arrays, NaN and infinity are none."""
    if value is None or isinstance(value, bool | str | bytes | list | tuple):
        return None
    try:
        if np.ndim(value) != 0:
            return None
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def plain(value: Any) -> Any:
    """`value` without a mask: NaN where a masked array, or one within a list, hides an entry; anything else as it is.

    Every door that takes an array looks at it through this, as numpy's own conversions uncover what is hidden, and
    strip units.

    Raises
    ------
    InputError
        A quantity of pint: a door that takes numbers takes them in SI.
    """
    if type(value).__module__.partition(".")[0] == "pint":
        raise InputError("a quantity of pint where numbers are expected", where="array", found=shown(value),
                         expected="numbers in SI", hint="pass q.to_base_units().magnitude")  # fmt: skip
    if isinstance(value, list | tuple) and any(np.ma.isMaskedArray(one) for one in value):
        try:
            value = np.ma.array([np.ma.getdata(v) for v in value], mask=[np.ma.getmaskarray(v) for v in value])
        except ValueError:  # rows of different lengths, which the door refuses
            return value
    if not np.ma.isMaskedArray(value):
        return value
    if not np.ma.getmaskarray(value).any() or value.dtype.kind not in "fiubc":
        return value.data
    return np.ma.filled(value.astype(complex if value.dtype.kind == "c" else float), np.nan)


def as_array(value: Any, *, where: str, dtype: type | None = None) -> NDArray[Any]:
    """An array of anything, or of `dtype`; masked entries become NaN.

    Raises
    ------
    InputError
        Rows of different lengths, or what is no number.
    """
    try:
        return np.asarray(plain(value), dtype)
    except (TypeError, ValueError) as error:
        raise InputError(
            "no array of numbers",
            where=where,
            found=str(error)[:200],
            expected="numbers, in rows of one length",
            hint="pass an array",
        ) from None


def reals(value: Any, *, where: str, what: str = "no real numbers", hint: str = "") -> NDArray[np.float64]:
    """Real numbers of any shape, as a new array; infinity and NaN may be among them, masked entries become NaN.

    Raises
    ------
    InputError
        Texts that are none, objects, truth values, complex numbers, or rows of different lengths.
    """
    value = value.toarray() if hasattr(value, "toarray") else value
    try:
        array = np.asarray(plain(value))
        if array.dtype.kind in "bc":
            raise TypeError("truth values" if array.dtype.kind == "b" else "complex numbers")
        return np.array(array, float)
    except (TypeError, ValueError) as error:
        raise InputError(what, where=where, found=str(error)[:200], expected="real numbers", hint=hint) from None


def numbers(value: Any) -> NDArray[np.float64]:
    """Real numbers as an array, masked ones NaN; an empty array where they are none: for a check of the shape."""
    try:
        return np.asarray(plain(value), float)
    except (TypeError, ValueError):
        return np.empty(0)


def one_of(what: str, value: Any, names: Iterable[str], *, where: str, hint: str = "", expected: str = "") -> str:
    """One of some names.

    Raises
    ------
    InputError
        `what`, if it is none of them.
    """
    if not isinstance(value, str) or value not in names:
        raise InputError(what, where=where, found=shown(value), expected=expected or ", ".join(names), hint=hint)
    return value


def span(value: Any, *, where: str, hint: str) -> tuple[float, float]:
    """Start and stop in m, the start below the stop.

    Raises
    ------
    InputError
        If it is none.
    """
    ends = [real(v) for v in value] if np.ndim(value) == 1 else []
    if len(ends) != 2 or ends[0] is None or ends[1] is None or ends[0] >= ends[1]:
        expected = "(start, stop) in m, start < stop"
        raise InputError("no span", where=where, found=shown(value), expected=expected, hint=hint)
    return ends[0], ends[1]


def own_step(own: Any, given: Any, where: str) -> float:
    """Step (s) of a record that may have its own, which a given one must not contradict.

    Raises
    ------
    InputError
        If none is known, one is not positive, or the two differ.
    """
    what, found, expected = "", f"dt = {given!r}", "dt= in s, > 0"
    step = given if own is None else own
    if own is not None and given is not None and abs(given / own - 1) > 1e-9:
        what, expected = "the record has its own step", f"dt = {own}"
    elif step is None:
        what, found = "the step of a bare array is not known", "no dt"
    elif real(step) is None or step <= 0:
        what, found = "the step is not positive", f"dt = {step!r}"
    if what:
        raise InputError(what, where=where, found=found, expected=expected, hint="state dt= of bare arrays only")
    return float(step)


def shown(value: Any) -> str:
    """A value in an error message: numbers bare, the rest quoted and cut."""
    text = repr(value.item() if isinstance(value, np.generic) else value)
    return "nothing" if value is None else text if len(text) <= 60 else text[:57] + "..."


def finite(values: NDArray[Any], what: str = "NaN or infinity", *, where: str, expected: str = "finite numbers",
           hint: str = "") -> None:  # fmt: skip
    """Refuse an array with entries that are not finite.

    Raises
    ------
    InputError
        `what`, with the number of such entries.
    """
    good = np.isfinite(values)
    if not np.all(good):
        found = f"{np.sum(~good)} of {good.size} entries"
        raise InputError(what, where=where, found=found, expected=expected, hint=hint)


def whole(value: Any) -> int | None:
    """The integer that `value` is (Python or NumPy), or None; a truth value is none."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None


def number(name: str, value: Any, *, where: str, unit: str = "", hint: str = "") -> float:
    """One finite number.

    Raises
    ------
    InputError
        If it is none.
    """
    found = real(value)
    if found is None:
        raise InputError(
            f"{name} must be one finite number",
            where=where,
            found=shown(value),
            expected=f"a number{f' in {unit}' if unit else ''}",
            hint=hint or f"pass {name} as a number, without a unit and without quotes",
        )
    return found


def positive(name: str, value: Any, *, where: str, unit: str = "", hint: str = "") -> float:
    """One finite number above zero.

    Raises
    ------
    InputError
        If it is none.
    """
    found = real(value)
    if found is None or found <= 0:
        raise InputError(
            f"{name} must be positive",
            where=where,
            found=shown(value),
            expected=f"one number > 0{f', in {unit}' if unit else ''}",
            hint=hint or f"pass {name} as a positive number in SI units",
        )
    return found


def pair(name: str, value: Any, *, where: str, unit: str = "") -> tuple[float, float]:
    """Two finite numbers.

    Raises
    ------
    InputError
        If they are none, or not two.
    """
    row = value.ndim == 1 if isinstance(value, np.ndarray) else not isinstance(value, str | bytes)
    items = list(value) if row and isinstance(value, Sequence | np.ndarray) else []
    found = [x for x in map(real, items) if x is not None]
    if len(items) != 2 or len(found) != 2:
        raise InputError(
            f"{name} must be two finite numbers",
            where=where,
            found=shown(value),
            expected=f"two numbers{f' in {unit}' if unit else ''}: one along X, one along Y",
            hint=f"pass {name}=(1.0, 0.5), for example",
        )
    return found[0], found[1]


def integer(name: str, value: Any, *, where: str, limit: int) -> int:
    """An integer from 1 to `limit`.

    Raises
    ------
    InputError
        If it is none.
    """
    found = whole(value) or 0
    if not 1 <= found <= limit:
        raise InputError(
            f"no number of {name}",
            where=where,
            found=shown(value),
            expected=f"an integer from 1 to {limit}",
            hint=f"six {name} per shortest wavelength are enough" if found > limit else f"pass {name} as an integer",
        )
    return found


def frozen(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Read-only float copy; refuses NaN, infinity, complex numbers and text."""
    try:
        raw = np.asarray(plain(values))
        if np.iscomplexobj(raw):
            raise TypeError("complex")
        array = np.array(raw, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(
            "not a real array", where=name, found=str(error), expected="numbers", hint="pass an array of numbers"
        ) from None
    finite(array, where=name, expected="finite", hint="repair or leave out what is missing")
    array.flags.writeable = False
    return array


def lines(frequencies: ArrayLike, nyquist: float = np.inf) -> NDArray[np.float64]:
    """Frequencies in Hz as a checked array (lines,)."""
    f = np.atleast_1d(frozen(frequencies, "frequencies"))
    if f.ndim != 1 or np.any(f < 0) or np.any(f > nyquist * (1 + 1e-9)):
        raise InputError(
            "no list of frequencies",
            where="frequencies",
            found=f"shape {f.shape}, {f.min(initial=0):g} to {f.max(initial=0):g} Hz",
            expected=f"one axis, 0 to {nyquist:g} Hz",
            hint="frequencies are in Hz, not rad/s",
        )
    return f


def count(samples: int) -> int:
    """A number of samples, checked."""
    found = whole(samples) or 0
    if found < 1:
        raise InputError(
            "no number of samples",
            where="samples",
            found=repr(samples),
            expected="an integer >= 1",
            hint="samples = duration / dt",
        )
    return found


def digest(*parts: Any) -> str:
    """Sha256 (hex) of arrays, numbers and channels, each with its shape."""
    h = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            part = np.ascontiguousarray(part)
            h.update(f"{part.dtype.str}{part.shape}".encode())
            h.update(part.tobytes())
        elif isinstance(part, tuple):
            for c in part:
                h.update(repr((c.label, c.quantity, c.unit, c.noise, c.highpass, c.measure)).encode())
        else:
            h.update(repr(part).encode())
        h.update(b"\0")
    return h.hexdigest()


def digests(columns: ArrayLike) -> tuple[str, ...]:
    """sha256 of the samples of each column of an array (samples, columns)."""
    return tuple(hashlib.sha256(np.ascontiguousarray(c, float).tobytes()).hexdigest() for c in np.asarray(columns).T)
