"""Ranges that are drawn from: one number, or two between which all values are equally likely."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, fields
from typing import Any

import numpy as np

from structures.errors import InputError, number, real, shown

Range = tuple[float, float]
INF = float("inf")


def within(unit: str, low: float, high: float = INF) -> dict[str, Any]:
    """What a field says that is a range: the unit that files state, and the bounds of its values."""
    return {"unit": unit, "low": low, "high": high}


class Ranges:
    """A table of ranges, checked when it is made."""

    def __post_init__(self) -> None:
        for one in _of_ranges(self):
            value = getattr(self, one.name)
            if value is not None:
                object.__setattr__(self, one.name, _range(value, one, type(self).__name__))

    @property
    def plain(self) -> dict[str, Any]:
        """Names and values, without those that are not stated."""
        stated = {one.name: getattr(self, one.name) for one in fields(self)}  # type: ignore[arg-type]
        return {k: list(v) if isinstance(v, tuple) else v for k, v in stated.items() if v is not None}

    def draw(self, rng: np.random.Generator, name: str) -> float:
        """A value of a range."""
        low, high = getattr(self, name)
        return float(rng.uniform(low, high))


def _of_ranges(table: Any) -> Iterator[Field[Any]]:
    return (one for one in fields(table) if "unit" in one.metadata)


def _range(value: Any, one: Field[Any], where: str) -> Range:
    """Lowest and highest value of a range."""
    one_value = real(value) is not None
    ends = [value, value] if one_value else list(value) if isinstance(value, list | tuple | np.ndarray) else []
    if len(ends) != 2:
        raise InputError("no range", where=f"{where}, {one.name}", found=shown(value),
                         expected="a number, or the lowest and the highest")  # fmt: skip
    low, high = (float(f"{number(one.name, v, where=where):.12g}") for v in ends)  # as units of a file round them
    if low > high or low < one.metadata["low"] or high > one.metadata["high"]:
        least, most = one.metadata["low"], one.metadata["high"]
        raise InputError(
            "a range that is not possible", where=f"{where}, {one.name}", found=f"{low:g} to {high:g}",
            expected=f"lowest <= highest, within {least:g} and {most:g}", hint="SI units in Python, units in TOML",
        )  # fmt: skip
    return low, high


def halton(number: int, base: int) -> float:
    """Member of the van der Corput sequence of a base, between 0 and 1."""
    found, share = 0.0, 1.0
    while number:
        share /= base
        number, digit = divmod(number, base)
        found += share * digit
    return found
