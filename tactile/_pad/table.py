"""One table of a TOML file whose numbers carry units: each value is taken once, and what is left over is refused."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from structures import units
from structures.errors import InputError, real, shown

from .._arrays import Array

NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")
EXAMPLES = {"displacement": "3 mm", "pressure": "0.147 MPa", "angle": "12 deg", "px": "5.6 px", "force": "0.5 N"}
WORDS = {"displacement": "a length", "pressure": "a modulus", "angle": "an angle", "px": "pixels", "force": "a force"}
MISSING: Any = object()


class TomlTable:
    """The values of one table, as TOML gives them; without a name those of the whole file.

    Every method takes the key and a default; without a default the key must be there. `end` refuses what nobody asked
    for.
    """

    def __init__(self, file: Path, name: str, values: Any) -> None:
        self.file, self.name = file, name
        if not isinstance(values, Mapping):
            raise InputError(f"[{name}] is no table", where=str(file), found=shown(values), expected="a table")
        self.values = values
        self._asked: set[str] = set()
        self._bare: dict[str, float] = {}

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def refused(self, key: str, what: str, found: object = None, expected: object = None, hint: str = "") -> InputError:
        """An error at a key of this table."""
        table = f"[{self.name}]" if self.name else ""
        where = ": ".join(x for x in (str(self.file), " ".join(y for y in (table, key) if y)) if x)
        return InputError(what, where=where, found=found, expected=expected, hint=hint)

    @contextmanager
    def named(self) -> Iterator[None]:
        """Errors of what is built from the table name the file and the table too."""
        try:
            yield
        except InputError as error:
            if error.where.startswith(str(self.file)):
                raise
            where = f"{self.file}: [{self.name}]" + (f": {error.where}" if error.where else "")
            parts = {name: getattr(error, name) for name in ("found", "expected", "hint", "code")}
            raise InputError(error.what, where=where, **parts) from None

    def known(self, *keys: str) -> None:
        """Keys that may be there, and need not."""
        self._asked.update(keys)

    def end(self) -> None:
        """Refuse keys that nobody asked for, with the nearest key that is known."""
        unknown = sorted(set(self.values) - self._asked)
        if not unknown:
            return
        near = difflib.get_close_matches(unknown[0], self._asked, n=1, cutoff=0.6)
        raise self.refused(unknown[0], "unknown " + ("key" if self.name else "table"), ", ".join(unknown),
                           "any of " + ", ".join(sorted(self._asked)),
                           f"did you mean {near[0]}?" if near else "leave it out")  # fmt: skip

    # -- plain values -------------------------------------------------------------------------------------------------
    def number(self, key: str, default: Any = MISSING) -> Any:
        """A number without a unit."""
        value = self._take(key, default)
        return default if value is default else self._number(key, value)

    def count(self, key: str, default: Any = MISSING) -> Any:
        """A whole number > 0."""
        return self._checked(key, default, _whole, "no whole number > 0", f"{key} = 4, for example")

    def counts(self, key: str, many: int, default: Any = MISSING) -> Any:
        """Several whole numbers > 0."""
        value = self._checked(
            key, default, lambda v: isinstance(v, list) and len(v) == many and all(map(_whole, v)),
            f"no {many} whole numbers > 0", f"{key} = [24, 24], for example",
        )  # fmt: skip
        return default if value is default else tuple(value)

    def flag(self, key: str, default: Any = MISSING) -> Any:
        """True or false."""
        expected = "true or false, without quotes"
        return self._checked(key, default, lambda v: isinstance(v, bool), "neither true nor false", expected)

    def text(self, key: str, default: Any = MISSING) -> Any:
        """A text that is not empty."""
        return self._checked(
            key, default, lambda v: isinstance(v, str) and bool(v.strip()), "no text", "a text in quotes"
        )

    def word(self, key: str, choices: Sequence[str], default: Any = MISSING) -> Any:
        """One of some words."""
        expected = " or ".join(f'"{c}"' for c in choices)
        return self._checked(key, default, lambda v: v in choices, "unknown word", expected)

    def words(self, key: str, default: Any = MISSING) -> Any:
        """A list of texts."""
        value = self._checked(
            key, default, lambda v: isinstance(v, list) and all(isinstance(one, str) for one in v),
            "no list of texts", f'{key} = ["W115"], for example',
        )  # fmt: skip
        return default if value is default else tuple(value)

    def matrix(self, key: str) -> Array:
        """Three rows of three numbers."""
        value = self._checked(
            key, MISSING, lambda v: isinstance(v, list) and len(v) == 3 and all(_listed(row, 3) for row in v),
            "no 3 x 3 matrix", "three rows of three numbers",
        )  # fmt: skip
        return np.array([[self._number(key, x) for x in row] for row in value])

    def beside(self, name: str) -> Path:
        """A file that is named relative to this one."""
        return self.file.parent / name

    def table(self, key: str) -> TomlTable | None:
        """A table inside; None where there is none."""
        value = self._take(key, None)
        return None if value is None else TomlTable(self.file, f"{self.name}.{key}" if self.name else key, value)

    # -- values with units --------------------------------------------------------------------------------------------
    def bare_numbers(self, length: str | None, modulus: str | None) -> None:
        """Units that the table states once, for numbers without one."""
        for quantity, unit in (("displacement", length), ("pressure", modulus)):
            if unit is not None:
                self._bare[quantity] = units.parse(unit).factor

    def quantity(self, key: str, quantity: str, default: Any = MISSING) -> Any:
        """A number with a unit of some quantity, in SI."""
        value = self._take(key, default)
        return default if value is default else self._si(key, value, quantity)

    def positive(self, key: str, quantity: str, default: Any = MISSING) -> Any:
        """A number > 0 with a unit, in SI."""
        found = self.quantity(key, quantity, default)
        if found is not default and found <= 0:
            raise self.refused(key, f"{key} must be positive", shown(self.values[key]), WORDS[quantity] + " > 0")
        return found

    def quantities(self, key: str, quantity: str, many: int, default: Any = MISSING) -> Any:
        """Several numbers with units, in SI."""
        example = ", ".join([f'"{EXAMPLES[quantity]}"'] * many)
        value = self._checked(
            key, default, lambda v: _listed(v, many), f"no list of {many} values", f"{key} = [{example}], for example"
        )
        return default if value is default else tuple(self._si(key, v, quantity) for v in value)

    def places(self, key: str, quantity: str, default: Any = MISSING) -> Any:
        """Points (n, 2) in SI, or in px."""
        value = self._checked(
            key, default, lambda v: isinstance(v, list) and all(_listed(point, 2) for point in v),
            "no list of points", f"{key} = [[x, y], [x, y], ...]",
        )  # fmt: skip
        if value is default:
            return default
        return np.array([[self._si(key, x, quantity) for x in point] for point in value]).reshape(-1, 2)

    def pixels(self, key: str, default: Any = MISSING) -> Any:
        """A number of pixels; the unit may be left out."""
        return self.quantity(key, "px", default)

    def pixel_pair(self, key: str) -> tuple[float, float]:
        """A place in the image."""
        x, y = self.quantities(key, "px", 2)
        return x, y

    def scale(self, key: str, default: Any = MISSING) -> Any:
        """Metres of a unit of length."""
        value = self._take(key, default)
        if value is default:
            return default
        return self._factor(key, shown(value) if not isinstance(value, str) else value, "displacement")

    def unit(self, key: str, default: Any = MISSING) -> Any:
        """``"px"``, or metres of a unit of length."""
        return "px" if self.values.get(key) == "px" and self._take(key, default) else self.scale(key, default)

    def noise(self, key: str) -> tuple[float, str] | None:
        """A std > 0 in px or in m, with which of them; None where there is none."""
        value = self._take(key, None)
        if value is None:
            return None
        split = NUMBER.fullmatch(value) if isinstance(value, str) else None
        which = "px" if split and split[2] == "px" else "m"
        if split is None or not split[2]:
            raise self.refused(key, "a std needs its unit", shown(value), f'{key} = "0.02 px" or {key} = "5 um"')
        std = self._si(key, value, "px" if which == "px" else "displacement")
        if std <= 0:
            raise self.refused(key, "a std is above zero", shown(value), f'{key} = "0.02 px", for example')
        return std, which

    # -- inside -------------------------------------------------------------------------------------------------------
    def _take(self, key: str, default: Any) -> Any:
        self._asked.add(key)
        if key in self.values:
            return self.values[key]
        if default is MISSING:
            near = difflib.get_close_matches(key, self.values, n=1, cutoff=0.75)
            raise self.refused(key, "a key is missing", ", ".join(self.values) or "an empty table", key,
                               f"is it {near[0]}, misspelt?" if near else "")  # fmt: skip
        return default

    def _checked(self, key: str, default: Any, good: Callable[[Any], bool], what: str, expected: str) -> Any:
        """The value of a key if it is good, or the default."""
        value = self._take(key, default)
        if value is not default and not good(value):
            raise self.refused(key, what, shown(value), expected)
        return value

    def _number(self, key: str, value: Any) -> float:
        found = real(value)
        if found is None:
            raise self.refused(key, "no number", shown(value), "a number, without a unit and without quotes")
        return found

    def _si(self, key: str, value: Any, quantity: str) -> float:
        if not isinstance(value, str):
            number = self._number(key, value)
            bare = 1.0 if quantity == "px" else self._bare.get(quantity)
            if bare is None:
                raise self._bare_refused(key, value, quantity)
            return number * bare
        split = NUMBER.fullmatch(value)
        if split is None:
            raise self.refused(key, "no number with a unit", shown(value), f'"{EXAMPLES[quantity]}", for example')
        if split[2] is None:
            raise self._bare_refused(key, value, quantity)
        return float(split[1]) * self._factor(key, split[2], quantity)

    def _factor(self, key: str, unit: str, quantity: str) -> float:
        if quantity == "px" and unit == "px":
            return 1.0
        if quantity != "px" and unit != "px" and units.known(unit):
            found = units.parse(unit)
            if found.quantity == quantity:
                return found.factor
        raise self.refused(key, f"no unit of {WORDS[quantity].removeprefix('a ').removeprefix('an ')}", shown(unit),
                           f'{WORDS[quantity]} such as "{EXAMPLES[quantity]}"')  # fmt: skip

    def _bare_refused(self, key: str, value: Any, quantity: str) -> InputError:
        expected = f'{WORDS[quantity]} such as {key} = "{EXAMPLES[quantity]}"'
        return self.refused(key, "a number without its unit", shown(value), expected)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


def _listed(value: Any, many: int) -> bool:
    return isinstance(value, list) and len(value) == many
