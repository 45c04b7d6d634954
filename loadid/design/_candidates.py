"""Candidate sensors as whitened rows, where they are, and the loads that a layout is judged for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Spelling
from structures._model import Model
from structures.errors import InputError, plain, reals

Places = NDArray[np.float64] | None
DYNAMIC = Advice(
    "sensors are placed for hits by ",
    Spelling("loadid.design.place_for_hits", "loadid design MODEL.h5 -n N --pulse 0.001:100"),
)


def of_model(model: Model) -> tuple[Places, Places, Places]:
    """Places of the sensors (sensors, dim), of the loads (loads, dim), and of the nodes of the structure."""
    structure = model.structure
    if structure is None:
        return None, None, None
    outline = structure.coordinates
    nodes = {}
    if outline is not None:
        numbers = sorted({dof.node for dof in structure.dofs})
        nodes = dict(zip(numbers, np.asarray(outline, float), strict=True))
    sensors = _stack([_place(s, nodes) for s in model.sensors])
    return sensors, _of_loads(model, nodes), outline


def _of_loads(model: Model, nodes: dict[int, NDArray[Any]]) -> Places:
    basis = model.basis
    if basis is not None and getattr(basis, "kind", "") != "polynomials":
        x = np.asarray(basis.coordinates, float)
        x = x[:, None] if x.ndim == 1 else x
        return (
            np.repeat(x, len(basis.components), axis=0) if len(x) * len(basis.components) == len(model.loads) else None
        )
    return _stack([_place(c, nodes) for c in model.loads])


def _place(channel: Any, nodes: dict[int, NDArray[Any]]) -> NDArray[np.float64] | None:
    """Its own place, the middle of its patch, or its node."""
    at, dof = getattr(channel, "at", None), getattr(channel, "dof", None)
    if at is not None:
        return np.atleast_1d(np.asarray(at, float))
    if dof is not None:
        return nodes.get(dof.node)
    spans = [getattr(channel, name, None) for name in "xy"]
    middle = [float(np.mean(s)) for s in spans if s is not None and np.shape(s) == (2,)]
    return np.array(middle) if middle else None


def _stack(found: list[NDArray[Any] | None]) -> Places:
    """One table, dimensions that only some have filled with zeros; None where a place is not known."""
    if not found or any(x is None for x in found):
        return None
    dim = max(len(x) for x in found if x is not None)
    return np.array([np.r_[x, np.zeros(dim - len(x))] for x in found if x is not None])


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CandidateSensors:
    """Sensors that could be used, and the loads they shall tell apart.

    Parameters
    ----------
    H : array, shape (sensors, loads)
    noise : array, shape (sensors,) or (sensors, sensors), or None
        Std or covariance; None where it is not known, and then the same for all.
    labels, load_labels : tuple of str
    units, load_units : tuple of str
    at, loads_at : array, shape (sensors, dim) and (loads, dim), or None
        Places in m.
    outline : array, shape (nodes, dim), or None
        Nodes of the structure.
    """

    H: Array
    noise: Array | None
    labels: tuple[str, ...]
    load_labels: tuple[str, ...]
    units: tuple[str, ...]
    load_units: tuple[str, ...]
    at: Array | None = None
    loads_at: Array | None = None
    outline: Array | None = None

    @property
    def std(self) -> Array:
        """Noise std per sensor; ones where it is not known."""
        if self.noise is None:
            return np.ones(len(self.H))
        return self.noise if self.noise.ndim == 1 else np.sqrt(np.diagonal(self.noise))

    def whitened(self, rows: NDArray[np.intp] | None = None) -> Array:
        """Rows in units of the noise, of all sensors or of some."""
        rows = np.arange(len(self.H)) if rows is None else rows
        if self.noise is None or self.noise.ndim == 1:
            return self.H[rows] / self.std[rows, None]
        from scipy.linalg import solve_triangular

        root = np.linalg.cholesky(self.noise[np.ix_(rows, rows)])
        return np.asarray(solve_triangular(root, self.H[rows], lower=True))

    def index(self, chosen: Any, where: str) -> NDArray[np.intp]:
        """Rows of sensors named by label or index, each once.

        Raises
        ------
        InputError
            If one is unknown or named twice.
        """
        items = [chosen] if isinstance(chosen, str | int | np.integer) else list(chosen)
        place = {label: i for i, label in enumerate(self.labels)}
        rows = []
        for item in items:
            if isinstance(item, str) and item in place:
                rows.append(place[item])
            elif (
                isinstance(item, int | np.integer) and not isinstance(item, bool) and -len(self.H) <= item < len(self.H)
            ):
                rows.append(int(item) % len(self.H))
            else:
                raise InputError("there is no such candidate", where=where, found=repr(item),
                                 expected=f"a label, or an index below {len(self.H)}: {list(self.labels[:8])} ...",
                                 hint="name sensors as the model does")  # fmt: skip
        if len(set(rows)) != len(rows):
            twice = sorted({self.labels[i] for i in rows if rows.count(i) > 1})
            raise InputError("a sensor is named twice", where=where, found=twice, expected="each sensor once",
                             hint="leave out the repeats")  # fmt: skip
        return np.array(rows, dtype=np.intp)


def settle(
    given: Model | ArrayLike,
    *,
    noise: ArrayLike | None = None,
    loads: Sequence[str | int] | None = None,
    at: ArrayLike | None = None,
    loads_at: ArrayLike | None = None,
    where: str = "design",
) -> CandidateSensors:
    """CandidateSensors from a model or an array (sensors, loads).

    Raises
    ------
    InputError
        No real matrix, NaN, sensors that no load moves, noise or places that do not fit, mixed units without noise.
    """
    if isinstance(given, Model):
        if not given.gives("static"):
            raise InputError("layouts are judged by static loads, and this model knows none: it is of hits or FRFs",
                             where=where, found=type(given).__name__, expected="a model that gives static()",
                             hint=DYNAMIC)  # fmt: skip
        H = np.asarray(given.static(), float)
        labels, units = tuple(s.label for s in given.sensors), tuple(s.unit for s in given.sensors)
        names, load_units = tuple(c.label for c in given.loads), tuple(c.unit for c in given.loads)
        own, sensors_at, columns_at, outline = given.noise, *of_model(given)
    else:
        H = _matrix(given, where)
        labels, units = tuple(f"y{i}" for i in range(len(H))), ("arbitrary",) * len(H)
        names, load_units = tuple(f"u{j}" for j in range(H.shape[1])), ("arbitrary",) * H.shape[1]
        own = sensors_at = columns_at = outline = None
    level = own if noise is None else _noise(noise, len(H), where)
    if level is None and len(set(units)) > 1:
        raise InputError(
            "sensors of different units need their noise",
            where=where,
            found=", ".join(sorted(set(units))),
            expected="a std per sensor",
            hint=Advice("without it a strain and a displacement cannot be weighed against each other: ",
                        Spelling("noise=[...]", "--noise STD,..."), " in SI"),
        )  # fmt: skip
    pick = np.arange(H.shape[1]) if loads is None else _loads(loads, names, where)
    sensors_at = sensors_at if at is None else _places(at, len(H), "at")
    columns_at = columns_at if loads_at is None else _places(loads_at, len(names), "loads_at")
    return CandidateSensors(
        H[:, pick],
        level,
        labels,
        tuple(names[j] for j in pick),
        units,
        tuple(load_units[j] for j in pick),
        sensors_at,
        None if columns_at is None else columns_at[pick],
        outline,
    )


def _matrix(given: Any, where: str) -> Array:
    try:
        array = np.asarray(plain(given))
    except ValueError:  # rows of different lengths
        array = np.empty(0)
    if np.iscomplexobj(array):
        raise InputError(
            "a complex matrix",
            where=where,
            found="complex numbers",
            expected="real numbers (sensors, loads)",
            hint="stack real and imaginary parts as rows, and judge sets of rows with design.compare",
        )
    try:
        H = np.asarray(array, float)
    except (TypeError, ValueError):
        H = np.empty(0)
    if H.ndim != 2 or 0 in H.shape or not np.all(np.isfinite(H)):
        raise InputError("no model and no matrix", where=where,
                         found=f"shape {H.shape}, {int(np.sum(~np.isfinite(H)))} entries that are not finite",
                         expected="a Model with static(), or finite numbers (sensors, loads)",
                         hint="one row per candidate sensor, one column per load")  # fmt: skip
    return H


def _noise(noise: ArrayLike, m: int, where: str) -> Array:
    level = reals(noise, what="the noise is no real number", where=where)
    level = np.full(m, float(level)) if level.ndim == 0 else level
    good = level.shape in ((m,), (m, m)) and bool(np.all(np.isfinite(level)))
    if good and level.ndim == 1:
        good = bool(np.all(level > 0))
    elif good:
        try:
            np.linalg.cholesky(level)
        except np.linalg.LinAlgError:
            good = False
    if not good:
        raise InputError("no noise level", where=where,
                         found=f"shape {level.shape}, smallest {level.min(initial=np.inf):.3g}",
                         expected=f"finite: std > 0, one or ({m},), or a positive definite covariance ({m}, {m})",
                         hint="the std of each sensor in its own unit")  # fmt: skip
    return level


def _loads(loads: Sequence[str | int], names: tuple[str, ...], where: str) -> NDArray[np.intp]:
    found = []
    for item in [loads] if isinstance(loads, str | int) else loads:
        if isinstance(item, str) and item in names:
            found.append(names.index(item))
        elif isinstance(item, int | np.integer) and -len(names) <= item < len(names):
            found.append(int(item) % len(names))
        else:
            raise InputError("there is no such load", where=where, found=repr(item),
                             expected=f"a label or an index below {len(names)}: {list(names[:8])}",
                             hint="loads= picks columns of the model")  # fmt: skip
    return np.array(found, dtype=np.intp)


def _places(at: ArrayLike, count: int, name: str) -> Array:
    x = np.asarray(plain(at), float)
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != count or not 1 <= x.shape[1] <= 3 or not np.all(np.isfinite(x)):
        raise InputError("places do not fit", where=name, found=f"shape {x.shape}",
                         expected=f"({count},) to ({count}, 3), finite, in m", hint="one place for each")  # fmt: skip
    return x


SNR = 100.0


@dataclass(frozen=True)
class Expected:
    """Std of each load before any reading, (loads,), and where it comes from, in words."""

    amplitude: NDArray[np.float64]
    words: str


def expected(sets: Sequence[CandidateSensors], amplitude: ArrayLike | None, snr: float | None, where: str) -> Expected:
    """Amplitude of the loads: as stated, or such that the sensor that sees a load of each unit best reads it at `snr`.

    Raises
    ------
    InputError
        Both given, one that is not positive or does not fit, an amplitude without a noise level, no sensor that moves.
    """
    one = sets[0]
    n = one.H.shape[1]
    rows = np.vstack([np.abs(c.H) / c.std[:, None] for c in sets])
    if not np.any(rows):
        raise InputError(
            "no load moves any sensor", where=where, found="a transfer matrix of zeros", expected="some response",
            hint=Advice("layouts are judged by static loads, which accelerometers and AC-coupled sensors do not see; ",
                        DYNAMIC),
        )  # fmt: skip
    if amplitude is not None:
        if snr is not None or any(c.noise is None for c in sets):
            raise InputError(
                "an amplitude is judged against a noise level" if snr is None else "amplitude and snr say the same",
                where=where, found="no noise" if snr is None else "both", expected="amplitude= with noise=, or snr=",
                hint="give noise= (std per sensor), or state snr= alone",
            )  # fmt: skip
        try:
            level = np.broadcast_to(np.asarray(plain(amplitude), float), (n,))
        except (TypeError, ValueError):
            level = np.zeros(1)
        if not np.all(np.isfinite(level)) or np.any(level <= 0):
            raise InputError(
                "no amplitude", where=where, found=repr(amplitude)[:60], expected=f"positive, one number or ({n},)",
                hint="the std of the load that is expected, SI",
            )  # fmt: skip
        return Expected(np.array(level), "loads of the stated amplitude")
    ratio = SNR if snr is None else snr
    if (
        isinstance(ratio, bool)
        or not isinstance(ratio, int | float | np.number)
        or not np.isfinite(ratio)
        or ratio <= 0
    ):
        raise InputError(
            "no signal-to-noise ratio", where=where, found=repr(snr), expected="a positive number", hint="snr=100"
        )
    level = np.ones(n)
    for unit in set(one.load_units):
        group = np.array([u == unit for u in one.load_units])
        top = rows[:, group].max()
        level[group] = ratio / top if top > 0 else 1.0
    same = "" if all(c.noise is not None for c in sets) else "; noise not stated: equal for all sensors"
    return Expected(level, f"loads that the best-placed sensor reads at {ratio:g} times its noise{same}")
