"""Correlation of shapes, frequency responses and histories: numbers from 0 (nothing in common) to 1 (the same)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, as_array

Array = NDArray[np.float64]


def mac(shapes: ArrayLike, others: ArrayLike | None = None, *, weights: ArrayLike | None = None) -> Array:
    """Modal assurance criterion of mode shapes or operating shapes, real or complex; blind to scale and phase.

    Parameters
    ----------
    shapes, others : array, shape (places, shapes) or (places,)
        Columns that are compared pairwise; `others` default to `shapes`.
    weights : array, shape (places,), optional
        Positive weights, masses for example.

    Returns
    -------
    array, shape (shapes, others)
        ``|a^H W b|^2 / (a^H W a)(b^H W b)``.

    Raises
    ------
    InputError
        Places that do not fit, NaN, a shape of zeros.

    Notes
    -----
    R. J. Allemang, D. L. Brown, "A correlation coefficient for modal vector analysis", Proc. 1st Int. Modal Analysis
    Conf., 1982, 110-116.
    """
    a = _columns(shapes, "mac, shapes")
    b = a if others is None else _columns(others, "mac, others")
    if len(a) != len(b):
        raise _misfit("mac", a.shape, b.shape, "shapes over the same places")
    if weights is not None:
        root = np.sqrt(_weights(weights, len(a)))[:, None]
        a, b = a * root, b * root
    return np.asarray(np.minimum(np.abs(_unit(a, "mac").conj().T @ _unit(b, "mac")) ** 2, 1.0))


def frac(responses: ArrayLike, others: ArrayLike) -> Array:
    """Frequency response assurance criterion of each pair over all lines; blind to one complex factor per pair.

    Parameters
    ----------
    responses, others : array, shape (lines, ...)
        FRFs (lines, sensors, loads), or spectra of the same record (lines, sensors).

    Returns
    -------
    array, the shape without lines
        ``|sum a conj(b)|^2 / (sum |a|^2)(sum |b|^2)``.

    Raises
    ------
    InputError
        Shapes that differ, NaN, a response that is zero on every line.

    Notes
    -----
    W. Heylen, S. Lammens, "FRAC: a consistent way of comparing frequency response functions", Proc. Int. Conf.
    Identification in Engineering Systems, Swansea, 1996, 48-57.
    """
    a, b = _pair(responses, others, "frac")
    return _cosine2(a, b, "frac")


def faac(responses: ArrayLike, others: ArrayLike) -> Array:
    """Frequency amplitude assurance criterion of each pair over all lines: 1 only where the amplitudes agree as well.

    ``2 |sum a conj(b)| / (sum |a|^2 + sum |b|^2)``; arguments, shapes and errors as `frac`.

    Notes
    -----
    The scale factor of `csf` taken over the lines of one pair, as `frac` is the criterion of `csac` taken so.
    """
    a, b = _pair(responses, others, "faac")
    return _amplitude(a, b, "faac")


def csac(responses: ArrayLike, others: ArrayLike) -> Array:
    """Cross signature assurance criterion: shape over all pairs, line by line; blind to one complex factor per line.

    Parameters
    ----------
    responses, others : array, shape (lines, ...)

    Returns
    -------
    array, shape (lines,)
        The MAC of the two operating shapes at each line.

    Raises
    ------
    InputError
        Shapes that differ, NaN, a line on which a response is zero everywhere.

    Notes
    -----
    C. Zang, H. Grafe, M. Imregun, "Frequency-domain criteria for correlating and updating dynamic finite element
    models", Mechanical Systems and Signal Processing 15 (2001) 139-155. Sums over one shape at a time, as here, are
    known as global shape correlation, too.
    """
    a, b = _pair(responses, others, "csac")
    return _cosine2(a.reshape(len(a), -1).T, b.reshape(len(b), -1).T, "csac")


def csf(responses: ArrayLike, others: ArrayLike) -> Array:
    """Cross signature scale factor: amplitude and shape over all pairs, line by line, shape (lines,).

    ``2 |a^H b| / (a^H a + b^H b)``; arguments, source and errors as `csac`.
    """
    a, b = _pair(responses, others, "csf")
    return _amplitude(a.reshape(len(a), -1).T, b.reshape(len(b), -1).T, "csf")


def trac(histories: ArrayLike, others: ArrayLike) -> Array:
    """Time response assurance criterion of each channel; blind to a factor.

    Parameters
    ----------
    histories, others : array, shape (samples, ...)
        Real.

    Returns
    -------
    array, the shape without samples
        ``(x . y)^2 / (x . x)(y . y)``.

    Raises
    ------
    InputError
        Shapes that differ, complex numbers, NaN, a history that is zero throughout.

    Notes
    -----
    P. Avitabile, P. Pingle, "Prediction of full field dynamic strain from limited sets of measured data", Shock and
    Vibration 19 (2012) 765-785.
    """
    x, y = _pair(histories, others, "trac")
    if x.dtype.kind == "c" or y.dtype.kind == "c":
        raise InputError(
            "histories are real", where="trac", found="complex numbers", expected="samples over time",
            hint="frac compares spectra",
        )  # fmt: skip
    return _cosine2(x, y, "trac")


def lac(responses: ArrayLike, others: ArrayLike) -> Array:
    """Local amplitude criterion: how far two amplitudes agree, entry by entry, whatever their phase.

    ``2 |a| |b| / (|a|^2 + |b|^2)``, the shape of the arguments; 1 where both are zero.

    Raises
    ------
    InputError
        Shapes that differ, NaN.

    Notes
    -----
    The scale factor of `csf` for one entry.
    """
    a, b = _pair(responses, others, "lac")
    small, large = np.minimum(np.abs(a), np.abs(b)), np.maximum(np.abs(a), np.abs(b))
    ratio = np.divide(small, large, out=np.ones_like(large), where=large > 0)
    return np.asarray(2 * ratio / (1 + ratio**2))


# -- helpers -----------------------------------------------------------------------------------------------------------
def _numbers(values: ArrayLike, where: str) -> NDArray[Any]:
    array = as_array(values, where=where)
    if array.dtype.kind not in "biufc" or not array.size or not np.all(np.isfinite(array)):
        raise InputError(
            "no finite numbers", where=where, found=f"{array.dtype} of shape {array.shape}",
            expected="real or complex numbers", hint="leave out what was not measured",
        )  # fmt: skip
    return array.astype(complex if array.dtype.kind == "c" else float)


def _columns(values: ArrayLike, where: str) -> NDArray[Any]:
    array = _numbers(values, where)
    if array.ndim not in (1, 2):
        raise _misfit(where, array.shape, "", "(places, shapes)")
    return array.reshape(len(array), -1)


def _pair(one: ArrayLike, other: ArrayLike, where: str) -> tuple[NDArray[Any], NDArray[Any]]:
    a, b = _numbers(one, where), _numbers(other, where)
    if a.shape != b.shape or a.ndim == 0:
        raise _misfit(where, a.shape, b.shape, "two arrays of one shape, lines or samples first")
    return a, b


def _weights(weights: ArrayLike, places: int) -> Array:
    w = as_array(weights, where="mac, weights", dtype=float)
    if w.shape != (places,) or not np.all(np.isfinite(w)) or not np.all(w > 0):
        raise _misfit("mac, weights", w.shape, "", f"({places},) positive numbers")
    return w


def _scaled(a: NDArray[Any], where: str) -> NDArray[Any]:
    """Columns over the first axis with a largest modulus of 1: squares neither overflow nor vanish."""
    top = np.abs(a).max(axis=0)
    if np.any(top == 0):
        raise InputError(
            "zero throughout: nothing can be correlated", where=where, found=f"{int(np.sum(top == 0))} of {top.size}",
            expected="responses that are not zero", hint="leave these channels or lines out",
        )  # fmt: skip
    return np.asarray(a / top)


def _unit(a: NDArray[Any], where: str) -> NDArray[Any]:
    scaled = _scaled(a, where)
    return np.asarray(scaled / np.linalg.norm(scaled, axis=0))


def _cosine2(a: NDArray[Any], b: NDArray[Any], where: str) -> Array:
    return np.asarray(np.minimum(np.abs(np.sum(_unit(a, where) * _unit(b, where).conj(), axis=0)) ** 2, 1.0))


def _amplitude(a: NDArray[Any], b: NDArray[Any], where: str) -> Array:
    top = np.maximum(np.abs(a).max(axis=0), np.abs(b).max(axis=0))
    if np.any(top == 0):
        _scaled(np.where(top > 0, a, 0), where)
    a, b = a / top, b / top
    return np.asarray(2 * np.abs(np.sum(a * b.conj(), axis=0)) / np.sum(np.abs(a) ** 2 + np.abs(b) ** 2, axis=0))


def _misfit(where: str, found: object, other: object, expected: str) -> InputError:
    return InputError(
        "arrays do not fit", where=where, found=f"{found} {other}".strip(), expected=expected,
        hint="the first axis is places, lines or samples",
    )  # fmt: skip
