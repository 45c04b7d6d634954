"""Argument values that can be checked while the command line is parsed: what is wrong here is usage (exit 2)."""

from __future__ import annotations

import math
from argparse import ArgumentTypeError

METHODS = ("tikhonov", "tsvd")
PATHS = ("auto", "dense", "statespace", "toeplitz", "windows", "fft")
SPARSE_RULES = ("ebic",)
DICTIONARIES = ("dirac", "bspline", "wavelet")
SIGNALS = ("stationary", "transient")
OVER = ("neighbours", "line", "band")
STARTS = ("rest", "unknown")
NONE = "none"


class UsageError(Exception):
    """Wrong words on the command line."""


def frequency(text: str) -> float:
    """Sampling frequency in Hz, positive and finite."""
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not (math.isfinite(rate) and rate > 0 and math.isfinite(1 / rate)):
        raise ArgumentTypeError(f"{text!r} is no sampling frequency in Hz, > 0")
    return rate


def unit(text: str) -> str:
    """A text of the form CH=UNIT."""
    channel, sign, symbol = text.rpartition("=")
    if not (sign and channel.strip() and symbol.strip()):
        raise ArgumentTypeError(f"{text!r} is not CH=UNIT, for example force=N")
    return text


def channels(text: str) -> list[str]:
    """``"a,b"`` as a list of channels, at least one."""
    from . import names

    found = names(text)
    if not found:
        raise ArgumentTypeError("no channel is named")
    return found


def choice(text: str) -> str | float:
    """A rule, or a relative lambda >= 0."""
    from loadid.inverse.rules import RULES

    known = (*RULES, *SPARSE_RULES)
    if text in known:
        return text
    try:
        lam = float(text)
    except ValueError:
        lam = math.nan
    if not (math.isfinite(lam) and lam >= 0):
        raise ArgumentTypeError(f"{text!r} is no rule ({', '.join(known)}) and no relative lambda >= 0")
    return lam


def penalty(text: str) -> str:
    """Name of a penalty, or ``none`` for plain least squares."""
    from loadid.inverse.penalties import ORDER, names

    if text not in (*ORDER, NONE):
        raise ArgumentTypeError(f"{text!r} is no penalty ({names()}, {NONE})")
    return text


def leak(text: str) -> float:
    """A leak of a difference, between 0 and 1."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1:
        raise ArgumentTypeError(f"{text!r} is no leak: a number between 0 and 1")
    return value


def positive(text: str) -> float:
    """A finite number > 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise ArgumentTypeError(f"{text!r} is no number > 0")
    return value


def band(text: str) -> tuple[float, float]:
    """``"20:1000"`` as a band in Hz."""
    low, _, high = text.partition(":")
    try:
        ends = float(low), float(high)
    except ValueError:
        ends = math.nan, math.nan
    if not (math.isfinite(ends[0]) and math.isfinite(ends[1]) and 0 <= ends[0] < ends[1]):
        raise ArgumentTypeError(f"{text!r} is no band LOW:HIGH in Hz")
    return ends


def count(text: str) -> int:
    """A whole number > 0."""
    if not (text.strip().isascii() and text.strip().isdecimal() and int(text) > 0):
        raise ArgumentTypeError(f"{text!r} is no whole number > 0")
    return int(text)


def seed(text: str) -> int:
    """A whole number, not negative."""
    if not (text.strip().isascii() and text.strip().isdecimal()):
        raise ArgumentTypeError(f"{text!r} is no seed: a whole number >= 0")
    return int(text)
