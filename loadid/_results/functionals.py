"""Numbers made from a load, each with what is known of it; and what every frequency line of an estimate can tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._readonly import ReadOnly
from structures.errors import InputError, plain, real

from .summary import Z95, plus_minus

if TYPE_CHECKING:
    from .estimate import LoadEstimate

Array = NDArray[Any]


DEEP = 0.5  # of the largest gain around it: a minimum below that counts as a zero


def nearest_zeros(frequencies: Array, gain: Array, half: int = 40) -> NDArray[np.float64]:
    """Frequency (Hz) of the antiresonance nearest to each line, for each load, (lines, loads); inf: there is none.

    An antiresonance is a local minimum of the gain below half of the largest gain within `half` lines.
    """
    from scipy.ndimage import maximum_filter1d

    around = maximum_filter1d(gain, 2 * half + 1, axis=0, mode="nearest")
    walled = np.pad(gain, ((1, 1), (0, 0)), constant_values=np.inf)
    low = (gain < walled[:-2]) & (gain <= walled[2:]) & (gain < DEEP * around)
    found = np.full(gain.shape, np.inf)
    for j in range(gain.shape[1]):
        zeros = frequencies[low[:, j]]
        if len(zeros):
            k = np.clip(np.searchsorted(zeros, frequencies), 1, len(zeros)) - 1
            right = zeros[np.minimum(k + 1, len(zeros) - 1)]
            nearer = np.abs(right - frequencies) < np.abs(zeros[k] - frequencies)
            found[:, j] = np.where(nearer, right, zeros[k])
    return found


LEVEL = 0.10  # predicted relative standard deviation above which a line is not believed


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadSpectrum(ReadOnly):
    """Lines of an estimate. Arrays are (lines, loads) unless said.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz.
    load : array
        Complex amplitudes that were estimated; of cross-spectral data the root of the autospectra.
    std : array
        ``sqrt(E|error|^2)`` of these, prior included.
    covariance : array, shape (lines, loads, loads)
        ``E[e e^H]`` of the errors of a line.
    naive : array
        Least-squares amplitudes, without a prior: what blows up at an antiresonance.
    naive_std : array
        Their standard deviation by noise and FRF errors; infinite where a line does not determine the load.
    expected : array
        Size of the load around each line (root mean square over its neighbours).
    gain : array
        Whitened response to one unit of the load that no other loads can imitate: 1 / `naive_std`.
    condition : array, shape (lines,)
        Largest over smallest singular value over loads of their expected size.
    zeros : array
        Frequency (Hz) of the antiresonance nearest to each line; infinite where there is none.
    lam : array, shape (lines,)
        Noise over expected load, relative to the largest singular value of the line.
    noise : array, shape (lines,)
        Standard deviation of the whitened noise: above 1 the data contradict the stated level.
    level : float
        Predicted relative error that was asked for.
    cross : array, shape (lines, loads, loads), optional
        Cross spectra of the loads, unit^2/Hz.
    """

    frequencies: NDArray[np.float64]
    load: NDArray[np.complex128]
    std: NDArray[np.float64]
    covariance: NDArray[np.complex128]
    naive: NDArray[np.complex128]
    naive_std: NDArray[np.float64]
    expected: NDArray[np.float64]
    gain: NDArray[np.float64]
    condition: NDArray[np.float64]
    zeros: NDArray[np.float64]
    lam: NDArray[np.float64]
    noise: NDArray[np.float64]
    level: float = LEVEL
    cross: NDArray[np.complex128] | None = None

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = np.array(value)
                value.setflags(write=False)
                object.__setattr__(self, f.name, value)

    @property
    def predicted(self) -> NDArray[np.float64]:
        """Predicted relative standard deviation of the least-squares load on each line, (lines, loads)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.expected > 0, self.naive_std / self.expected, np.inf)

    def trust(self, level: float | None = None) -> NDArray[np.bool_]:
        """Lines whose predicted relative error is at most `level`, (lines, loads); default the level of the estimate.

        Raises
        ------
        InputError
            A level that is not positive.
        """
        level = self.level if level is None else level
        if not isinstance(level, int | float) or isinstance(level, bool) or not level > 0:
            raise InputError(
                "no level of trust", where="trust", found=repr(level), expected="a number > 0, such as 0.1"
            )
        return self.predicted <= level

    @property
    def untold_power(self) -> float:
        """Largest share of the expected power of a load that stands on lines which are not trusted."""
        power = self.expected**2
        share = np.sum(power * ~self.trust(), axis=0) / np.maximum(np.sum(power, axis=0), 1e-300)
        return float(np.max(share))

    def bands(self, load: int = 0, level: float | None = None) -> tuple[tuple[float, float], ...]:
        """First and last line (Hz) of every stretch that is not trusted, for one load."""
        flagged = np.concatenate([[False], ~self.trust(level)[:, load], [False]])
        edges = np.flatnonzero(np.diff(flagged)).reshape(-1, 2)
        return tuple((float(self.frequencies[a]), float(self.frequencies[b - 1])) for a, b in edges)

    def to_dict(self) -> dict[str, Any]:
        """Plain tree for files."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any]) -> LoadSpectrum:
        """Inverse of `to_dict`."""
        return cls(**{f.name: tree[f.name] for f in fields(cls)})


def in_words(bands: tuple[tuple[float, float], ...], most: int = 4) -> str:
    """Bands as text, the widest first: ``"1 to 4.25 Hz, 16.5 Hz and 3 more"``."""
    order = sorted(bands, key=lambda b: b[0] - b[1])[:most]
    said = [f"{a:.5g} Hz" if a == b else f"{a:.5g} to {b:.5g} Hz" for a, b in sorted(order)]
    more = len(bands) - len(order)
    return ", ".join(said) + (f" and {more} more" if more > 0 else "")


Window = tuple[float, float]


@dataclass(frozen=True)
class Functional:
    """A number made from a load.

    Parameters
    ----------
    name : str
    value : float
    std : float or None
        Standard deviation, of noise and prior; None where the estimate has no posterior.
    unit : str
    noise_std : float or None
        Of the noise alone; None where the estimate does not know it.
    bias_limit : float or None
        Largest error that regularisation can have made, if no load exceeds the limit that was stated.
    """

    name: str
    value: float
    std: float | None
    unit: str
    noise_std: float | None = None
    bias_limit: float | None = None

    def __str__(self) -> str:
        half = None if self.std is None else Z95 * self.std
        text = f"{self.name} {plus_minus(self.value, half)} {self.unit}".rstrip() + (" (95 % band)" if half else "")
        if self.bias_limit is not None:
            text += f", bias at most {self.bias_limit:.3g} {self.unit}".rstrip()
        return text


def functional(
    estimate: LoadEstimate,
    w: str | ArrayLike,
    *,
    load: int | str | None,
    loads: Sequence[int | str] | None,
    window: Window | None,
    limit: float | None,
) -> Functional:
    """See `LoadEstimate.functional`."""
    if estimate.load.dtype.kind == "c":
        raise InputError("complex amplitudes have no weighted sum with a std", where="functional",
                         found="a load over frequency", expected="a load over time",
                         hint="signal='transient' gives the history of a record")  # fmt: skip
    if isinstance(w, str):
        weights, name, unit = _named(estimate, w, load, loads, window)
    else:
        weights, name, unit = _own(estimate, w, load, window), "functional", estimate.units[estimate.index(load)]
    posterior = estimate.posterior
    variance = None if posterior is None else np.asarray(posterior.variance(weights)).item()
    hidden = 0.0 if estimate.bias is None else float(np.sum(weights * estimate.bias))
    std = None if variance is None else max(float(np.sqrt(max(variance, 0.0))), abs(hidden))
    noise = getattr(posterior, "noise_variance", lambda _: None)(weights)
    return Functional(
        name,
        float(np.sum(weights * estimate.load)),
        std,
        unit,
        None if noise is None else float(np.sqrt(max(np.asarray(noise).item(), 0.0))),
        None if limit is None else _bias_limit(posterior, weights, limit),
    )


def resultants(estimate: LoadEstimate) -> tuple[Functional, ...]:
    """Resultant forces and moments of a static load on a basis that knows its geometry; of the last frame."""
    labels = [] if estimate.geometry is None else list(estimate.geometry.get("resultant_labels", ()))
    return tuple(functional(estimate, "resultant", load=x, loads=None, window=None, limit=None) for x in labels)


def _named(
    e: LoadEstimate, w: str, load: int | str | None, loads: Sequence[int | str] | None, window: Window | None
) -> tuple[NDArray[np.float64], str, str]:
    """Weights, name and unit of a functional that has a name."""
    weights = np.zeros(e.load.shape)
    if w == "resultant":
        _refuse_window(w, window)
        weights[_frame(e)], label, unit = _resultant(e, load)
        return weights, label, unit
    if w == "impulse":
        j = e.index(load)
        weights[e.inside(window), j] = e.over("time").step
        return weights, "impulse", f"{e.units[j]} s"
    columns = [e.index(x) for x in loads] if loads is not None else None
    if w == "sum" or (w == "mean" and (columns is not None or (e.load.ndim == 1 and load is None))):
        _refuse_window(w, window)
        columns = (list(range(len(e.labels))) if load is None else [e.index(load)]) if columns is None else columns
        units = {e.units[j] for j in columns}
        if len(units) != 1:
            raise InputError(
                "loads of different units have no common sum", where="functional", found=sorted(units),
                expected="one unit", hint="pick the loads with loads=[...]",
            )  # fmt: skip
        weights[_frame(e)][columns] = 1.0 if w == "sum" else _shares(e, columns)
        return weights, w, units.pop()
    j = e.index(load)
    if w == "mean":
        inside = e.inside(window)
        weights[inside, j] = 1 / np.count_nonzero(inside)
        return weights, "mean", e.units[j]
    if w == "peak":
        column = np.abs(e.load if e.load.ndim == 1 else e.load[:, j])
        if window is not None:
            column = np.where(e.inside(window), column, -1.0)
        at = int(np.argmax(column))
        weights[(at,) if e.load.ndim == 1 else (at, j)] = 1.0
        return weights, "peak", e.units[at if e.load.ndim == 1 else j]
    raise InputError(
        "no such functional", where="w", found=w, expected="'impulse', 'mean', 'sum', 'peak', 'resultant' or an array"
    )


def _refuse_window(w: str, window: Window | None) -> None:
    """Sums over loads are those of one frame: a window in time would be ignored."""
    if window is not None:
        raise InputError(
            f"the {w} over loads is taken of the last frame: it has no window", where="window", found=window,
            expected="None", hint="'impulse', 'mean' and 'peak' of one load take a window; else give the weights",
        )  # fmt: skip


def _shares(e: LoadEstimate, columns: list[int]) -> NDArray[np.float64]:
    """Weights of a mean over loads: by their areas where these are pressures of a basis that knows them.

    Raises
    ------
    InputError
        Polynomials: their coefficients have no mean that would be one of the load.
    """
    measures = None if e.geometry is None else e.geometry.get("measures")
    kind = None if e.geometry is None else e.geometry.get("kind")
    if kind == "polynomials":
        raise InputError(
            "the coefficients of polynomials have no mean", where="functional", found="a basis of polynomials",
            expected="nodal, patches or hats", hint="the first coefficient is the mean load over the region",
        )  # fmt: skip
    if measures is None or e.geometry is None or kind == "nodal":  # forces hold their areas already
        return np.full(len(columns), 1 / len(columns))
    count = len(e.geometry["components"])
    area = np.asarray(measures, float)[np.array(columns) // count]
    return np.asarray(area / area.sum())


def _resultant(e: LoadEstimate, component: int | str | None) -> tuple[NDArray[np.float64], str, str]:
    if e.geometry is None or e.geometry.get("resultant") is None:
        raise InputError(
            "these loads have no geometry to take a resultant over", where="functional",
            found="loads without a basis", expected="a model whose loads are a Basis",
            hint="give the weights as an array",
        )  # fmt: skip
    labels = list(e.geometry["resultant_labels"])
    if component is None and len(labels) == 1:
        component = labels[0]
    if component not in labels:
        raise InputError("no such resultant", where="load", found=repr(component), expected=f"one of {labels}")
    row = np.asarray(e.geometry["resultant"], float)[labels.index(str(component))]
    return row, str(component), "N m" if str(component).startswith("M") else "N"


def _frame(e: LoadEstimate) -> tuple[int, ...] | slice:
    """Index of the static load, or of its last frame."""
    return slice(None) if e.load.ndim == 1 else (len(e.load) - 1,)


def _own(e: LoadEstimate, w: ArrayLike, load: int | str | None, window: Window | None) -> NDArray[np.float64]:
    """Weights of a user in the shape of the load."""
    own = _weights(w)
    if own.shape == e.load.shape:
        weights = own.copy()
    elif own.ndim == 1 and e.load.ndim == 2 and len(own) == len(e.load):
        if e.axis is not None and e.axis.name == "frame" and e.load.shape[0] == e.load.shape[1]:
            raise InputError(
                "weights over frames and over loads have the same length here", where="w", found=own.shape,
                expected=f"{e.load.shape}", hint="give the weights of every frame and load",
            )  # fmt: skip
        weights = np.zeros(e.load.shape)
        weights[:, e.index(load)] = own
    else:
        raise InputError("the weights do not fit", where="w", found=own.shape, expected=e.load.shape)
    if window is not None:
        weights[~e.inside(window)] = 0
    return weights


def _weights(w: ArrayLike) -> NDArray[np.float64]:
    try:
        own = np.asarray(plain(w), float)
    except (TypeError, ValueError) as error:
        raise InputError("the weights are no numbers", where="w", found=str(error), expected="real numbers") from None
    if not np.all(np.isfinite(own)):
        raise InputError(
            "the weights are not finite", where="w", found="NaN or infinity", expected="finite numbers",
            hint="weigh what does not count with 0",
        )  # fmt: skip
    return own


def _bias_limit(posterior: object, weights: Array, limit: float) -> float | None:
    """Worst error of regularisation for loads of at most `limit`: limit times the sum of |(R - I)^T w|."""
    if (real(limit) or 0.0) <= 0:
        raise InputError(
            "no amplitude limit", where="limit", found=repr(limit), expected="a positive number in the unit of the load"
        )
    found = getattr(posterior, "bias_weights", lambda _: None)(weights)
    if found is None:
        raise InputError(
            "this estimate does not know its resolution", where="functional", found=type(posterior).__name__,
            expected="an estimate of a dense path", hint="leave limit out",
        )  # fmt: skip
    return float(limit * np.sum(np.abs(found)))
