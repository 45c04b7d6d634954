"""Pairs of load and response in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, finite, reals

if TYPE_CHECKING:
    from .._record import Record

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Examples:
    """Some draws of a training set in memory.

    Parameters
    ----------
    draws : array (n,) of int
        Numbers of the draws in their set.
    data : array (n, [samples,] sensors)
        What the sensors read, SI, noise included; 0 where missing.
    loads : array (n, [samples,] loads)
        The truth, SI.
    noise : array (n, sensors) or (sensors,)
        Std of the noise that was added.
    kinds : array (n,) of text
        What was drawn: ``"sphere"``, ``"impact"``.
    missing : array of bool, shape of data, optional
        Readings that are lost; None: all are there.
    parameters : mapping of text to array (n,)
        What else was drawn: depth, modulus, factor of stiffness.

    Raises
    ------
    InputError
        Shapes that do not fit, or numbers that are not finite.
    """

    draws: NDArray[np.int64]
    data: Array
    loads: Array
    noise: Array
    kinds: NDArray[np.str_]
    missing: NDArray[np.bool_] | None = None
    parameters: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        draws = np.array(self.draws, np.int64)
        found: dict[str, Any] = {"draws": draws, "kinds": np.array(self.kinds, np.str_)}
        for name in ("data", "loads", "noise"):
            found[name] = reals(getattr(self, name), where=f"Examples, {name}")
        data, loads = found["data"], found["loads"]
        if data.ndim not in (2, 3) or loads.ndim != data.ndim or loads.shape[1:-1] != data.shape[1:-1]:
            shapes = f"{data.shape} and {loads.shape}"
            raise _unfit("data and loads", shapes, "(n, [samples,] sensors) and (n, [samples,] loads)")
        n, sensors = len(data), data.shape[-1]
        if found["noise"].shape not in ((n, sensors), (sensors,)):
            raise _unfit("noise", found["noise"].shape, f"({n}, {sensors}) or ({sensors},)")
        if self.missing is not None:
            found["missing"] = np.array(self.missing, bool)
            if found["missing"].shape != data.shape:
                raise _unfit("missing", found["missing"].shape, f"{data.shape}")
            data[found["missing"]] = 0.0
        parameters = {str(k): reals(v, where=f"Examples, {k}") for k, v in self.parameters.items()}
        for name, values in {"loads": loads, "kinds": found["kinds"], "draws": draws, **parameters}.items():
            if len(values) != n or (name != "loads" and values.ndim != 1):
                raise _unfit(name, values.shape, f"{n} draws")
        for name in ("data", "loads", "noise"):
            finite(found[name], where=f"Examples, {name}", hint="say by missing= what was not read")
        for values in (*found.values(), *parameters.values()):
            values.flags.writeable = False
        for name, values in found.items():
            object.__setattr__(self, name, values)
        object.__setattr__(self, "parameters", MappingProxyType(parameters))

    def __len__(self) -> int:
        return len(self.draws)

    def __getitem__(self, rows: Any) -> Examples:
        """Some of the draws, by a slice, a mask or their places."""
        if isinstance(rows, int | np.integer):
            rows = [int(rows)]
        per_draw = self.noise.ndim == 2
        return Examples(
            self.draws[rows], self.data[rows], self.loads[rows], self.noise[rows] if per_draw else self.noise,
            self.kinds[rows], None if self.missing is None else self.missing[rows],
            {name: values[rows] for name, values in self.parameters.items()},
        )  # fmt: skip

    def __reduce__(self) -> tuple[Any, ...]:
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        return _made, ({**given, "parameters": dict(self.parameters)},)

    @classmethod
    def measured(
        cls,
        data: Any | Sequence[Record],
        loads: Any | Sequence[Record],
        *,
        noise: Any = 0.0,
        kinds: str | Sequence[str] = "measured",
        parameters: Mapping[str, Any] | None = None,
    ) -> Examples:
        """Pairs that were measured.

        Parameters
        ----------
        data : array_like (n, [samples,] sensors), or sequence of Record
            NaN where a reading is missing.
        loads : array_like (n, [samples,] loads), or sequence of Record
            What acted, as known.
        noise : float, array (sensors,) or (n, sensors)
            Std of the readings, in their units.
        kinds : str or sequence of str
        parameters : mapping, optional
            Of text to (n,): what else is known.

        Raises
        ------
        InputError
            Shapes that do not fit, or loads that are not finite.
        """
        y, g = _stacked(data, "data"), _stacked(loads, "loads")
        missing = np.isnan(y)
        level = reals(noise, where="Examples, noise")
        level = np.broadcast_to(level, y.shape[-1:]) if level.ndim == 0 else level
        names = np.full(len(y), kinds) if isinstance(kinds, str) else np.array(kinds, np.str_)
        return cls(
            np.arange(len(y)), np.where(missing, 0.0, y), g, level, names, missing if missing.any() else None,
            parameters or {},
        )  # fmt: skip


def joined(parts: Sequence[Examples]) -> Examples:
    """Examples one after another.

    Raises
    ------
    InputError
        None at all, or such as have not the same shape or parameters.
    """
    if not parts:
        raise InputError("no examples", where="TrainingSet", found="none", expected="one at least")
    first = parts[0]
    if len(parts) == 1:
        return first
    for part in parts:
        if part.data.shape[1:] != first.data.shape[1:] or part.loads.shape[1:] != first.loads.shape[1:]:
            raise _unfit("examples", f"{part.data.shape[1:]} beside {first.data.shape[1:]}", "examples of one shape")
        if set(part.parameters) != set(first.parameters):
            raise _unfit("parameters", ", ".join(part.parameters), ", ".join(first.parameters))
    missing = None
    if any(part.missing is not None for part in parts):
        missing = np.concatenate([np.zeros(p.data.shape, bool) if p.missing is None else p.missing for p in parts])
    noise = [np.broadcast_to(part.noise, (len(part), part.noise.shape[-1])) for part in parts]
    one = all(part.noise.ndim == 1 and np.array_equal(part.noise, first.noise) for part in parts)
    return Examples(
        np.concatenate([p.draws for p in parts]), np.concatenate([p.data for p in parts]),
        np.concatenate([p.loads for p in parts]), first.noise if one else np.concatenate(noise),
        np.concatenate([p.kinds for p in parts]), missing,
        {name: np.concatenate([p.parameters[name] for p in parts]) for name in first.parameters},
    )  # fmt: skip


def _made(given: dict[str, Any]) -> Examples:
    return Examples(**given)


def _stacked(values: Any, name: str) -> Array:
    from .._record import Record

    if isinstance(values, Sequence) and values and all(isinstance(one, Record) for one in values):
        lengths = {one.values.shape for one in values}
        if len(lengths) > 1:
            raise _unfit(name, f"records of {sorted(lengths)}", "records of one length and number of channels")
        values = [one.values for one in values]
    return reals(values, where=f"Examples, {name}")


def _unfit(what: str, found: Any, expected: str) -> InputError:
    return InputError(f"{what} of examples do not fit", where="Examples", found=str(found), expected=expected)
