"""The linear inverse problem in arrays: operator and data whitened by the noise covariance, the penalty, the noise.

A covariance may be singular, as that of readings interpolated from fewer raw ones, C = W S W^T: the noise then lives in
its range, and whitening keeps that range only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, plain, shown

from . import Array, Numbers

LEAVES = 1e-6  # share of the data outside the range of a singular covariance that is more than rounding


@dataclass(frozen=True)
class Cholesky:
    """Noise covariance given by its lower Cholesky factor, R = factor @ factor.T.

    Parameters
    ----------
    factor : array, shape (sensors, sensors)
        Lower triangular, positive diagonal, in the units of the readings.
    """

    factor: ArrayLike


Noise = ArrayLike | Cholesky


@dataclass(frozen=True)
class Whitener:
    """One way to whiten `sensors` readings.

    Parameters
    ----------
    scale : array, shape (sensors,)
        Std of each sensor.
    lower : array, shape (sensors, sensors), optional
        Cholesky factor of the covariance of the scaled readings.
    across : array, shape (kept, sensors), optional
        Rows that whiten a singular covariance of the scaled readings, on its range.
    basis : array, shape (sensors, kept), optional
        Orthonormal basis of that range.
    """

    scale: Array
    lower: Array | None = None
    across: Array | None = None
    basis: Array | None = None

    def apply(self, values: Numbers, axis: int) -> Numbers:
        """``R^(-1/2) values`` along the sensor axis, which shrinks to the rank of a singular covariance."""
        scaled = np.moveaxis(values, axis, -1) / self.scale
        if self.lower is not None:
            from scipy.linalg import solve_triangular

            flat = scaled.reshape(-1, len(self.scale)).T
            scaled = solve_triangular(self.lower, flat, lower=True).T.reshape(scaled.shape)
        elif self.across is not None:
            scaled = scaled @ self.across.T
        return np.moveaxis(scaled, -1, axis)

    def outside(self, values: Numbers, axis: int) -> float:
        """Share of the scaled values, by their norm, that lies outside the range of the covariance."""
        if self.basis is None:
            return 0.0
        scaled = np.moveaxis(values, axis, -1) / self.scale
        size = float(np.linalg.norm(scaled))
        return float(np.linalg.norm(scaled - (scaled @ self.basis) @ self.basis.T)) / size if size > 0 else 0.0


def whitener(noise: Noise, sensors: int) -> Whitener:
    """Whitener of a noise that is given by its std, its covariance or a Cholesky factor of it.

    Parameters
    ----------
    noise : array or Cholesky
        Std (sensors,), covariance (sensors, sensors), which may be singular, or `Cholesky`.
    sensors : int

    Raises
    ------
    InputError
        If the noise does not fit the sensors, is not positive, or is no covariance.
    """
    if isinstance(noise, Cholesky):
        return _from_factor(_checked(noise.factor, sensors, matrices_only=True), sensors)
    values = _checked(noise, sensors)
    if values.ndim == 1:
        if np.any(values <= 0):
            raise InputError("a noise std must be positive", where="noise", found=values.tolist(), expected="> 0")
        return Whitener(values)
    return _from_covariance(values)


def whiten(values: Numbers, noise: Noise | None, axis: int) -> Numbers:
    """``R^(-1/2) values`` along the sensor axis; on the range of R, where R is singular.

    ``whiten(np.eye(sensors), noise, 0)`` is the whitening matrix, (kept, sensors).

    Raises
    ------
    InputError
        If the noise does not fit the sensors or is no covariance.
    """
    return values if noise is None else whitener(noise, values.shape[axis]).apply(values, axis)


def _checked(noise: ArrayLike, sensors: int, matrices_only: bool = False) -> Array:
    values = np.asarray(plain(noise), float)
    shapes = {(sensors, sensors)} if matrices_only else {(sensors,), (sensors, sensors)}
    if values.shape not in shapes or not np.all(np.isfinite(values)):
        raise InputError("the noise does not fit the sensors", where="noise",
                         found=f"shape {values.shape}" + ("" if np.all(np.isfinite(values)) else " with NaN or inf"),
                         expected="finite, shape " + " or ".join(str(s) for s in sorted(shapes, key=len)))  # fmt: skip
    return values


def _from_factor(factor: Array, sensors: int) -> Whitener:
    if np.any(np.triu(factor, 1)) or np.any(np.diag(factor) <= 0):
        raise InputError(
            "this is no Cholesky factor of a noise covariance", where="noise",
            found="entries above the diagonal" if np.any(np.triu(factor, 1)) else "a diagonal that is not positive",
            expected="lower triangular with a positive diagonal", hint="numpy.linalg.cholesky gives one",
        )  # fmt: skip
    scale = np.linalg.norm(factor, axis=1)
    return Whitener(scale, lower=factor / scale[:, None])


def _from_covariance(noise: Array) -> Whitener:
    """From a full covariance; every check is made on correlations, so that units play no part."""
    if np.any(np.diag(noise) <= 0):
        raise InputError(
            "a noise variance must be positive", where="noise", found=np.diag(noise).tolist(), expected="> 0"
        )
    scale = np.sqrt(np.diag(noise))
    correlation = noise / scale / scale[:, None]
    if not np.allclose(correlation, correlation.T, rtol=0, atol=1e-8):
        raise InputError("the noise covariance is not symmetric", where="noise", expected="R = R^T")
    values, vectors = np.linalg.eigh((correlation + correlation.T) / 2)
    rounding = 10 * len(values) * np.finfo(float).eps * values[-1]
    if values[0] < -rounding:
        raise InputError("the noise covariance is not positive definite", where="noise",
                         found=f"smallest eigenvalue {values[0]:.3g} of its correlation matrix",
                         expected="no negative one", hint="a covariance is W S W^T of independent noise")  # fmt: skip
    if values[0] > rounding:
        return Whitener(scale, lower=np.asarray(np.linalg.cholesky(correlation), float))
    keep = values > rounding
    basis = vectors[:, keep]
    return Whitener(scale, across=(basis / np.sqrt(values[keep])).T, basis=basis)


@dataclass(frozen=True)
class LinearProblem:
    """Whitened problem ``min |H g - y|^2 + lambda^2 |L g|^2``, for one vector of data or for frames with one lambda.

    Parameters
    ----------
    H : array, shape (m, n)
        Operator.
    y : array, shape (m,) or (m, frames)
        Data.
    L : array, shape (rows, n), optional
        Penalty matrix; None is the identity.
    layout : tuple of int
        Shape of the data, (samples, sensors) or (frames, sensors), for residuals.
    shape : tuple of int
        Shape of the load of one frame.
    dropped : float
        Share of the operator, by its norm, outside the range of a singular noise covariance; whitening dropped it.
    apart : array, shape (m, k), optional
        Orthonormal data that further unknowns make: see `without`.
    """

    H: Numbers
    y: Numbers
    L: Numbers | None
    layout: tuple[int, ...]
    shape: tuple[int, ...]
    dropped: float = 0.0
    apart: Array | None = None

    @property
    def spent(self) -> int:
        """Data of a frame that other unknowns take up."""
        return 0 if self.apart is None else int(self.apart.shape[1])

    def without(self, columns: Array) -> LinearProblem:
        """The problem with further unknowns that have no prior: responses (m, k), whitened; independent.

        What is at right angles to them decides the load, exactly.
        """
        basis = np.linalg.qr(columns)[0]
        return replace(self, H=_off(basis, self.H), y=_off(basis, self.y), apart=basis)

    def projected(self, data: Array) -> Array:
        """What further unknowns leave of whitened data (m,)."""
        return data if self.apart is None else _off(self.apart, data)

    @property
    def frames(self) -> int | None:
        """Number of frames; None for a single vector of data."""
        return self.y.shape[1] if self.y.ndim == 2 else None

    @property
    def load_shape(self) -> tuple[int, ...]:
        """Shape of the load: `shape`, with the frames in front where there are any."""
        return self.shape if self.frames is None else (self.frames, *self.shape)

    @classmethod
    def whitened(
        cls, H: ArrayLike, y: ArrayLike, noise: Noise | None = None, L: Any = None, shape: tuple[int, ...] | None = None
    ) -> LinearProblem:
        """Whiten an operator and its data by the noise of the sensors.

        Parameters
        ----------
        H : array, shape (..., sensors, unknowns)
            Leading axes (samples) share the same sensor noise.
        y : array, shape (..., sensors) or (frames, ..., sensors)
            Data, or frames of data.
        noise : array or Cholesky, optional
            Std per sensor (sensors,), covariance (sensors, sensors), or a Cholesky factor of it. A singular covariance
            (of interpolated readings) is whitened on its range.
        L : array or sparse matrix, shape (rows, unknowns), optional
            Penalty.
        shape : tuple, optional
            Shape of the load of one frame.

        Raises
        ------
        InputError
            Shapes that do not fit, NaN, noise that is no covariance, or data outside the range of a singular one.
        """
        H, y = np.asarray(plain(H)), np.asarray(plain(y))
        framed = H.ndim >= 2 and y.ndim == H.ndim and y.shape[1:] == H.shape[:-1]
        if not framed and (H.ndim < 2 or H.shape[:-1] != y.shape):
            raise InputError("operator and data do not fit", where="inverse problem", found=f"H {H.shape}, y {y.shape}",
                             expected="H (..., sensors, unknowns) with y (..., sensors), or y (frames, ..., sensors)",
                             hint="frames come first, then sensors")  # fmt: skip
        if 0 in H.shape or 0 in y.shape:
            raise InputError("nothing to invert", where="inverse problem", found=f"H {H.shape}, y {y.shape}",
                             expected="at least one sensor, one unknown and one frame")  # fmt: skip
        if not (np.all(np.isfinite(H)) and np.all(np.isfinite(y))):
            raise InputError("NaN or inf in the operator or the data", where="inverse problem",
                             expected="finite numbers", hint="leave out or repair the samples")  # fmt: skip
        n = H.shape[-1]
        L, dropped = _penalty(L, n), 0.0
        if noise is not None:
            white = whitener(noise, H.shape[-2])
            _refuse_outside(white, y)
            dropped = white.outside(H, axis=-2)
            H, y = white.apply(H, axis=-2), white.apply(y, axis=-1)
        data = y.reshape(len(y), -1).T if framed else y.reshape(-1)
        return cls(H.reshape(-1, n), data, L, y.shape, shape or (n,), dropped)


def _off(basis: Array, columns: Numbers) -> Numbers:
    return columns - basis @ (basis.T @ columns)


def _penalty(L: Any, n: int) -> Array | None:
    """Penalty as a dense matrix that fits."""
    if L is None:
        return None
    L = np.asarray(plain(L.toarray() if hasattr(L, "toarray") else L), float)
    if not (L.ndim == 2 and L.shape[1] == n and np.all(np.isfinite(L))):
        raise InputError("the penalty matrix does not fit the unknowns", where="penalty",
                         found=f"shape {L.shape}, or NaN", expected=f"finite, shape (rows, {n})")  # fmt: skip
    return np.asarray(L)


def _refuse_outside(white: Whitener, y: Numbers) -> None:
    """Data with a part that the noise cannot reach are not what the covariance says that they are."""
    share = white.outside(y, axis=-1)
    if share > LEAVES:
        raise InputError(
            "the data leave the range of the singular noise covariance",
            where="noise",
            found=f"a share of {share:.3g} of their norm outside it",
            expected=f"at most {LEAVES:g}: interpolated readings lie in the range of the interpolation",
            hint="give the covariance of the data as they are, or invert the readings before interpolation",
        )


# kind: what is printed where nothing else is said
KINDS = {
    "datasheet": "data sheet",  # of the sensors, or declared with them
    "repeatability": "repeatability",  # scatter of repeated measurements, or a covariance of them
    "pre_trigger": "quiet segment",  # the part of the record before its response
    "quiet": "unloaded record",  # another record, or other frames, without a load
    "residual": "residual",  # what a model leaves of data that it was fitted to
    "stated": "a guess of the user",  # a number, and nothing known on how it was found
    "unknown": "not known",  # no level: the data tell it, or nobody does
}
MEASURED = ("datasheet", "repeatability", "pre_trigger", "quiet", "residual")  # the level was found by somebody


@dataclass(frozen=True)
class NoiseSource:
    """Where a noise level comes from.

    Parameters
    ----------
    kind : {"datasheet", "repeatability", "pre_trigger", "quiet", "residual", "stated", "unknown"}
        Data sheet; scatter of repeated measurements; the record before its response; an unloaded record; what a model
        leaves of its data; a number without an origin; no level.
    text : str, optional
        For people; default a word for the kind. Nothing is decided by it.
    white : bool
        The noise is known to be white.

    Raises
    ------
    InputError
        Another kind, or a text that is none.
    """

    kind: str
    text: str = ""
    white: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in KINDS or not isinstance(self.text, str):
            raise InputError("no source of a noise level", where="noise_source",
                             found=shown(self.kind if isinstance(self.text, str) else self.text),
                             expected=f"a kind ({', '.join(KINDS)}) and a text")  # fmt: skip
        object.__setattr__(self, "white", bool(self.white))
        if not self.text:
            object.__setattr__(self, "text", KINDS[self.kind] + (", white" if self.white else ""))

    def __str__(self) -> str:
        return self.text

    @property
    def measured(self) -> bool:
        """Whether somebody has found the level, rather than stated a number."""
        return self.kind in MEASURED

    @property
    def facts(self) -> dict[str, Any]:
        """Text and kind, as they stand among the facts of a result."""
        return {"noise_source": self.text, "noise_kind": self.kind}

    @classmethod
    def of(cls, given: NoiseSourceLike) -> NoiseSource | None:
        """What a caller gave as the source: a kind, a kind and a text, or a text of its own, which is ``stated``.

        Parameters
        ----------
        given : NoiseSource, str, (str, str) or None
            Texts that release 0.1 documented or printed have the kind that they had there (`WRITTEN`).

        Raises
        ------
        InputError
            Something else.
        """
        if given is None or isinstance(given, cls):
            return given
        if isinstance(given, str):
            if not given:
                return None
            return cls(given) if given in KINDS else WRITTEN.get(given) or cls("stated", given)
        if isinstance(given, tuple | list) and len(given) == 2:
            return cls(*given)
        raise InputError("no source of a noise level", where="noise_source", found=shown(given),
                         expected=f"a kind ({', '.join(KINDS)}), (kind, text), or a text")  # fmt: skip


NoiseSourceLike: TypeAlias = NoiseSource | str | tuple[str, str] | None
NOT_KNOWN = NoiseSource("unknown")
STATED = NoiseSource("stated")
# texts by which release 0.1 told sources apart: those of its documentation, of its results and of its advice
WRITTEN = {
    text: NoiseSource(kind, text, white=white)
    for text, kind, white in (
        ("data sheet", "datasheet", False),
        ("data sheet (declared with the sensors)", "datasheet", False),
        ("data sheet (stated with the channels)", "datasheet", False),
        ("repeatability", "repeatability", False),
        ("covariance", "repeatability", False),
        ("covariance of the interpolated markers", "repeatability", False),
        ("quiet segment", "pre_trigger", False),
        ("unloaded record", "quiet", False),
        ("unloaded frames", "quiet", False),
        ("residual", "residual", False),
        ("residual power", "residual", False),
        ("roughness", "residual", False),
        ("roughness of the load spectrum that each sensor gives alone", "residual", False),
        ("likelihood of the innovations", "residual", False),
        ("what the fit of the best criterion leaves", "residual", False),
        ("a guess of the user", "stated", False),
        ("white", "stated", True),
        ("not known", "unknown", False),
    )
}


def toeplitz(h: Array) -> Array:
    """Lower block triangular Toeplitz operator of impulse responses (samples, sensors, loads).

    Returns
    -------
    array, shape (samples, sensors, samples * loads)
    """
    N, m, p = h.shape
    padded = np.concatenate([np.zeros((N - 1, m, p)), h])
    # row t holds h[t], h[t-1], ... h[t-N+1]: windows of the padded history, read backwards
    windows = np.lib.stride_tricks.sliding_window_view(padded, N, axis=0)[..., ::-1]  # (N, m, p, N)
    return np.ascontiguousarray(windows.transpose(0, 1, 3, 2)).reshape(N, m, N * p)
