"""How a record and a model become a problem with a path: dense, over states, by convolution, or by measured lines."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice
from structures._model import Model, impulse_of
from structures._models.statespace import StateSpace
from structures.errors import InputError

from ..._inverse import penalties
from ..._inverse.constrained.nonnegative import NonNegativeRecord
from ..._inverse.diagnosis import identifiability
from ..._inverse.problem import LinearProblem, toeplitz, whiten
from ..._inverse.support import SupportedPath
from ..._inverse.svd import SVDPath
from .. import noise as noises
from ..data import Data
from . import support
from .model_errors import gains
from .paths import MOST, TAPS, at_rest_in_place, coloured, convolved, convolved_measured, state_space_of, states
from .posed import (
    AUTO,
    UNUSABLE,
    Posed,
    PosingSettings,
    by_prediction,
    diagonal,
    lines,
    measured_lines,
    shift,
)

Array = NDArray[Any]

__all__ = ["UNUSABLE", "Posed", "PosingSettings", "diagonal", "on_states", "pose"]

DENSE = 2000  # unknowns of a matrix that fits a desk
SMALL = 1000  # unknowns up to which a factorisation, which tells more, is about as quick


def pose(model: Model, data: Data, settings: PosingSettings) -> Posed:
    """Problem of a record, on the path that was asked for or that fits.

    ``auto``: dense up to some thousand unknowns, where penalties are matrices, and without regularisation; beyond, and
    for missing samples, offsets of channels or an initial state, the state-space path of a model with a few dozen
    states, else convolution, of a long record in windows.
    Measured models go by lines, which carry the errors of their FRFs, and by convolution for long gaps and signs;
    the truncated SVD by dense matrix or by lines.

    Raises
    ------
    InputError
        No usable diagonal (LID-E506), different steps, or what the path does not take.
    """
    if model.sampled and settings.support is not None:
        return _measured_window(model, data, settings)
    if model.sampled:
        if settings.lam.path in ("dense", "statespace"):
            raise InputError("a measured model has no such path", where="path", found=repr(settings.lam.path),
                             expected="'auto', 'fft', 'toeplitz' or 'windows'")  # fmt: skip
        beyond_lines = settings.signed is not False or (data.missing.any() and not settings.truncated)
        if settings.lam.path in ("toeplitz", "windows") or (settings.lam.path == "auto" and beyond_lines):
            return convolved_measured(model, data, settings)
        settings.refuse_special("line by line", local=settings.penalty.variance == "smooth")
        return measured_lines(model, data, settings)
    hold, samples = settings.hold or model.default_hold, len(data.values)
    kind, system = _kind(model, data, settings)
    taps = min(samples, TAPS) if kind == "statespace" else samples
    still = system is not None and system.moving
    h = impulse_of(at_rest_in_place(system) if still and system else model, data.dt, taps, hold)
    late = 0 if still else shift(h[:, data.rows], model, settings.allow)
    noise = noises.resolve(settings.noise, model, data)
    if kind == "statespace":
        assert system is not None
        return states(model, system, h[late:], late, noise, data, settings)
    h, values = h[late:], data.values[late:]
    if kind == "dense":
        return dense(h, values, noise, data, settings)
    if kind in ("toeplitz", "windows"):
        return convolved(h, values, data.missing[late:], noise, data, settings)
    return lines(h, values, noise, data, settings)


def on_states(model: Model, data: Data, settings: PosingSettings) -> Posed | None:
    """The problem over the states of the model; None where it has none, or too many, or a matrix is the penalty."""
    named = isinstance(settings.penalty.L, str)
    if model.sampled or settings.lam.path != "auto" or not named or not model.gives("state_space"):
        return None
    system = state_space_of(model, data.dt, settings.hold)
    if system is None or len(system.A) > MOST:
        return None
    return pose(model, data, replace(settings, lam=replace(settings.lam, path="statespace")))


def _columns(h: Array, mask: NDArray[np.bool_] | None) -> Array:
    """Operator (samples, sensors, unknowns) of impulse responses, of the samples at which the loads act."""
    return toeplitz(h) if mask is None else support.columns(h, mask)


def _penalty(settings: PosingSettings, samples: int, loads: int, mask: NDArray[np.bool_] | None) -> Array | None:
    """Matrix of the penalty on the unknowns; None for the identity."""
    given = settings.penalty.L
    if mask is not None:
        L, count = support.penalty(given, mask, loads), int(mask.sum())
    else:
        L, count = None if given is None else penalties.matrix(given, samples, loads), samples
    if (sizes := settings.sizes(loads)) is not None:
        return np.vstack([np.eye(count * loads) if L is None else L, np.kron(np.eye(count), np.diag(sizes))])
    return L


def _path(problem: LinearProblem, mask: NDArray[np.bool_] | None, loads: int, settings: PosingSettings) -> SVDPath:
    if mask is None:
        return SVDPath(problem, truncated=settings.truncated)
    return SupportedPath(problem, np.repeat(mask[:, None], loads, axis=1), truncated=settings.truncated)


def _measured_window(model: Model, data: Data, settings: PosingSettings) -> Posed:
    """A load in a window behind measured FRFs: the columns that are left, noise and errors made white in time.

    Raises
    ------
    InputError
        Another path than ``auto``, missing samples, signs, a window too long for a matrix.
    """
    if settings.lam.path != "auto":
        support.refuse(f"path={settings.lam.path!r}", "path='auto' with measured FRFs")
    settings.refuse_special("dense")
    if data.missing.any():
        support.refuse(f"missing samples ({data.gaps})", "complete channels with measured FRFs")
    count = int(support.acting(settings.support, len(data.values), data.dt).sum()) * len(model.loads)
    if not (count <= DENSE and support.fits(count, *data.values.shape)):
        support.refuse(f"{count} unknowns in it", f"at most {DENSE} with measured FRFs", "a shorter window")
    white = coloured(model, data, settings)
    samples, loads = len(data.values), len(model.loads)
    mask = support.acting(settings.support, samples, data.dt)
    used = white.raw[:, data.rows]
    T = support.columns(used, mask).reshape(-1, count)
    L = _penalty(settings, samples, loads, mask)
    problem = LinearProblem.whitened(support.columns(white.h, mask), white.y, None, L, (count // loads, loads))
    path = _path(problem, mask, loads, settings)
    kappa, _, _ = identifiability.layout(path.singular_values, count)

    def predict(load: Array) -> Array:
        return (T @ load[mask].reshape(-1)).reshape(data.values.shape)

    layout = kappa, path.rank, max(count - path.rank, 0)
    compare = by_prediction(data.values, predict)
    errors = gains(model, np.asarray(data.rows), settings.noise.errors or {}, np.sum(white.y**2, axis=0))
    return Posed(path, white.noise, compare, data.values, "dense SVD", used, layout, None, count, path, gains=errors)


def _windowed(model: Model, data: Data, settings: PosingSettings) -> tuple[str, StateSpace | None]:
    """Path of loads in windows: the matrix of the columns that are left, or states that hear them there alone."""
    path, loads = settings.lam.path, len(model.loads)
    if path not in ("auto", "dense", "statespace"):
        support.refuse(f"path={path!r}", "path='auto', 'dense' or 'statespace'")
    count = int(support.acting(settings.support, len(data.values), data.dt).sum()) * loads
    small = count <= DENSE and support.fits(count, *data.values.shape)
    over_states = data.missing.any() or settings.special or settings.signed is not False
    if path == "dense" or (path == "auto" and small and not over_states and not model.moving):
        if not small:
            support.refuse(f"{count} unknowns in it", f"at most {DENSE} for a matrix", "path='auto', or a shorter one")
        return "dense", None
    system = state_space_of(model, data.dt, settings.hold)
    if system is None or not settings.single or settings.truncated:
        why = "a model without state_space()" if system is None else repr(settings.penalty)
        if path == "auto" and small and not model.moving:  # the matrix says what it does not take
            return "dense", None
        support.refuse(f"{count} unknowns in it, and {why}"[:80], f"at most {DENSE}, or penalty='identity' alone and a "
                       "model with state_space()", "a shorter window")  # fmt: skip
    return "statespace", system


def _kind(model: Model, data: Data, settings: PosingSettings) -> tuple[str, StateSpace | None]:
    """Name of the path, and the state space if it is that one."""
    if settings.support is not None:
        return _windowed(model, data, settings)
    if model.moving and settings.lam.path in ("auto", "statespace"):
        if settings.truncated:
            raise InputError("loads that move have no singular values to truncate", where="method", found="'tsvd'",
                             expected="method='tikhonov'")  # fmt: skip
        return "statespace", state_space_of(model, data.dt, settings.hold)
    unknowns = len(data.values) * len(model.loads)
    gaps, floating = bool(data.missing.any()), any(data.offsets)
    if settings.lam.path != "auto":
        system = state_space_of(model, data.dt, settings.hold) if settings.lam.path == "statespace" else None
        if settings.lam.path == "statespace" and system is None:
            raise InputError("the model has no state space", where="path", found="'statespace'",
                             expected="'dense' or 'toeplitz', or another model")  # fmt: skip
        return settings.lam.path, system
    if settings.truncated:
        return ("dense" if unknowns <= DENSE else "fft"), None
    if not settings.named or settings.free or (unknowns <= SMALL and not (gaps or floating or settings.special)):
        return "dense", None
    system = state_space_of(model, data.dt, settings.hold)
    if system is not None and (len(system.A) <= MOST or settings.special or settings.penalty.size is not None):
        return "statespace", system
    if settings.special or (settings.penalty.size is not None and (gaps or unknowns > DENSE)):
        settings.refuse_special("convolution")
    return ("dense" if unknowns <= DENSE and not gaps else "toeplitz"), None


def dense(h: Array, values: Array, noise: noises.NoiseLevel, data: Data, settings: PosingSettings) -> Posed:
    """Problem of impulse responses (samples, sensors, loads) of all sensors of the model.

    Raises
    ------
    InputError
        A record too long for a matrix, or with missing samples.
    """
    settings.refuse_special("dense")
    samples, loads = len(values), h.shape[2]
    mask = settings.acting(samples, data.dt)
    n = (samples if mask is None else int(mask.sum())) * loads
    if n > 2 * DENSE:
        raise InputError(
            "the record is too long for the dense path", where="penalty" if not settings.named else "path",
            found=f"{n} unknowns", expected=f"at most {2 * DENSE}",
            hint=Advice("use a named penalty with lambda > 0 and ", AUTO, ", or a window"),
        )  # fmt: skip
    if data.missing.any():
        raise InputError(
            "the dense path takes no missing samples", where="record", found=data.gaps, expected="complete channels",
            hint=Advice("use a named penalty, Tikhonov, lambda > 0 and ", AUTO),
        )  # fmt: skip
    used = h[:, data.rows]
    T, L = _columns(used, mask), _penalty(settings, samples, loads, mask)
    problem, constant = LinearProblem.whitened(T, values, noise.level, L, (n // loads, loads)), None
    if len(floating := data.floating) and settings.signed is False and not settings.free:
        constant = whiten(np.eye(values.shape[1])[:, floating], noise.level, 0)  # (kept, offsets) at every sample
        problem = problem.without(np.tile(constant, (samples, 1)))
    path = _path(problem, mask, loads, settings)
    full = None
    if len(data.rows) < h.shape[1]:
        scale = np.sqrt(np.mean(h**2, axis=(0, 2)))
        full = identifiability.layout(
            np.linalg.svd(_columns(h / scale[:, None], mask).reshape(-1, n), compute_uv=False), n
        )

    def predict(g: Array) -> Array:
        return (T.reshape(-1, n) @ (g if mask is None else g[mask]).reshape(-1)).reshape(values.shape)

    kappa, _, _ = identifiability.layout(path.singular_values, n)
    layout = kappa, path.rank, max(n - path.rank, 0)
    penalty = settings.penalty.L

    def pushing(signed: ArrayLike | None) -> NonNegativeRecord:
        if mask is not None:
            support.refuse("signs", "penalty='identity' alone and a model with state_space()")
        if not isinstance(penalty, str):
            raise InputError("signs take a named penalty", where="penalty", found="a matrix or None",
                             expected=f"one of {penalties.names()}")  # fmt: skip
        return NonNegativeRecord.convolved(
            whiten(used, noise.level, 1), whiten(values, noise.level, 1), penalty, signed=signed
        )

    def compare(load: Array, lam: float, start: Array | None) -> tuple[Array, Array]:
        rest = values - predict(load)
        if constant is not None:
            mean = whiten(rest.mean(axis=0), noise.level, 0)
            rest[:, floating] -= np.linalg.lstsq(constant, mean, rcond=None)[0]
        return values, rest

    def white(raw: Array) -> Array:
        return whiten(raw, noise.level, 1)

    return Posed(path, noise, compare, values, "dense SVD", used, layout, full, n, path, pushing, white=white,
                 floats=constant is not None)  # fmt: skip
