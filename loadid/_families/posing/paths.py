"""The exact paths of long records: over states in O(N), and Toeplitz behind the impulse responses of any model.

The noise of a measured model differs from line to line, and its FRFs err by a share of the load's own spectrum. Both
are put into one spectrum per sensor, and record and impulse responses pass the causal filter that makes it flat: what
was causal stays so, and what lies beyond the end of the record does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice
from structures._model import Model
from structures._models.statespace import StateSpace
from structures._testing.spectra import minimum_phase, smooth_lines
from structures.errors import InputError, plain

from ..._inverse.constrained.nonnegative import NonNegativeRecord
from ..._inverse.convolution import Convolution, heard
from ..._inverse.convolved.path import ConvolvedPath
from ..._inverse.convolved.windows import WindowedPath, beginning_of
from ..._inverse.gaussian.coarse import windows_of
from ..._inverse.gaussian.gains import feedback
from ..._inverse.gaussian.passes import forward
from ..._inverse.gaussian.path import StateSpacePath, layout
from ..._inverse.gaussian.record import Augmented, WhitenedRecord, augment, measured, moving, observed_first, whitened
from ..._inverse.gaussian.sized import SizedPath
from ..._inverse.penalties import names
from ..._inverse.problem import whiten
from ..data import Data
from ..noise import NoiseLevel
from .model_errors import nuisances
from .posed import BY_MATRIX, WHOLE, Posed, PosingSettings, measured_response
from .support import gated

Array = NDArray[Any]

MOST = 64  # states up to which small matrices are quick
LONGEST = 8192  # samples over states whose variances are learned
WHOLE_STATES = 4096  # samples beyond which lambda is sought on windows of the record first
TAPS = 4096  # samples of the impulse response that guards look at


def state_space_of(model: Model, dt: float, hold: str | None) -> StateSpace | None:
    """Discrete state space of a model; None where it has none."""
    if not model.gives("state_space"):
        return None
    system: StateSpace = model.state_space(dt, hold or model.default_hold)
    return system


def at_rest_in_place(system: StateSpace) -> StateSpace:
    """The system with its loads held where they are in the middle of the record: what guards look at."""
    B, D = (M if M.ndim == 2 else M[len(M) // 2] for M in (system.B, system.D))
    return StateSpace(system.A, B, system.C, D, system.dt, system.hold, sensors=system.sensors, loads=system.loads)


def states(
    model: Model, system: StateSpace, h: Array, late: int, noise: NoiseLevel, data: Data, settings: PosingSettings
) -> Posed:  # fmt: skip
    """Problem of a state space whose first `late` Markov parameters are zero.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Beginning of the impulse responses of all sensors, advanced.

    Raises
    ------
    InputError
        An initial state that does not fit, loads that move over another number of samples, or a penalty without a name.
    """
    if not isinstance(settings.penalty.L, str):
        raise InputError("the state-space path takes a named penalty", where="penalty", found="a matrix or None",
                         expected=Advice(f"one of {names()}; a matrix goes by ", BY_MATRIX))  # fmt: skip
    C, D = _advanced(system, late)
    rows, values, missing = data.rows, data.values[late:], data.missing[late:]
    start = _start(system, settings)
    unknown = isinstance(start, str) and start == "unknown"
    A, B, seen = system.A, system.B, 0
    if unknown:
        level = noise.level if np.ndim(noise.level) == 1 else np.sqrt(np.diag(noise.level))
        A, B, back, seen = observed_first(A, B, C[rows] / level[:, None], len(values))
        C = C @ back
    sizes = settings.sizes(D.shape[-1])
    constants = _constants(data, len(C)) if sizes is None else np.zeros((len(C), 0))
    if count := constants.shape[1]:
        # what is left of an offset, however small, is a load that drifts: it is an unknown of the problem
        A, B, C = _with_constants(A, B, C, constants)
        start = np.r_[np.zeros(count), start] if isinstance(start, np.ndarray) else start
        unknown, seen = True, seen + count

    def respond(load: Array, first: Array) -> Array:
        """Response (samples, sensors) of the used sensors to a load, from a state at the first sample."""
        plain = measured(_systems(A, B, C[rows], D[..., rows, :], len(values), "identity"), np.zeros_like(values))
        return forward(plain, feedback(plain), np.ascontiguousarray(load, float), first)[2]

    known = respond(np.zeros((len(values), D.shape[-1])), start) if isinstance(start, np.ndarray) else 0.0
    extra = {"leak": settings.penalty.leak, "from_zero": settings.penalty.from_zero, "unknown_start": seen}
    systems = _systems(A, B, C[rows], D[..., rows, :], len(values), settings.penalty.L, **extra)
    mask = settings.acting(len(values), data.dt)

    def heard_in_window(found: WhitenedRecord) -> WhitenedRecord:
        return found if mask is None else gated(found, mask)

    own = heard_in_window(measured(systems, np.where(missing, np.nan, values - known), noise.level))
    long = len(values) > WHOLE_STATES
    if sizes is not None and unknown:
        raise InputError("with a weight of the size the start of the structure is known", where="initial",
                         found="'unknown'", expected="'rest' or a state",
                         hint="leave out the size of the penalty")  # fmt: skip
    path = StateSpacePath(own, quick=long) if sizes is None else SizedPath(own, sizes, quick=long)
    judged = (windows_of(path) or path) if long and sizes is None and mask is None else path

    def compare(load: Array, lam: float, first: Array | None) -> tuple[Array, Array]:
        begin = np.zeros(len(A))
        if unknown:  # the free states come first, in what a path and what a solver of signs calls its start
            begin[:seen] = (path.start(lam) if first is None else first)[:seen]
        predicted = known + respond(load, begin)
        shown = np.where(missing, predicted, values)
        return shown, shown - predicted

    full = None
    if len(rows) < len(C):
        size = np.sqrt(np.mean(h**2, axis=(0, 2)))
        everything = _systems(A, B, C, D, len(values), settings.penalty.L, **extra)
        full = layout(measured(everything, np.zeros((len(values), len(C))), np.where(size > 0, size, 1.0)))

    def pushing(signed: ArrayLike | None) -> NonNegativeRecord:
        return NonNegativeRecord(own, signed)

    def altered(other: StateSpace, factors: Array) -> WhitenedRecord:
        if other is system:
            Ao, Bo, Co, Do = A, B, C, D
        else:
            Co, Do = _advanced(other, late)
            Ao, Bo, Co = _with_constants(other.A, other.B, Co, constants)
        scale = factors[:, None]
        again = _systems(Ao, Bo, Co[rows] * scale, Do[..., rows, :] * scale, len(values), settings.penalty.L, **extra)
        return heard_in_window(measured(again, np.where(missing, np.nan, values - known), noise.level))

    wrong = None
    if settings.penalty.variance != "constant":
        modal = not seen or seen == constants.shape[1]
        wrong = nuisances(model, system, rows, settings.noise.errors or {}, modal, altered)
    name, visible = "state space, O(N)", layout(own)
    unknowns = path.unknowns if mask is None else int(mask.sum()) * D.shape[-1]
    if mask is not None:
        rank = min(round(visible[1] * unknowns / path.unknowns), unknowns)
        visible = visible[0], rank, unknowns - rank

    def white(raw: Array) -> Array:
        return whitened(np.where(missing, np.nan, raw), noise.level)[0]

    return Posed(path, noise, compare, values, name, h[:, rows], visible, full, unknowns, judged, pushing, own,
                 wrong, white=white, floats=bool(count))  # fmt: skip


def _constants(data: Data, sensors: int) -> NDArray[np.float64]:
    """Columns (sensors, offsets), a constant in one channel each: those whose offset was subtracted."""
    floating = data.floating
    columns = np.zeros((sensors, len(floating)))
    columns[data.rows[floating], np.arange(len(floating))] = data.rms[floating]
    return columns


def _with_constants(A: Array, B: Array, C: Array, constants: Array) -> tuple[Array, Array, Array]:
    """The system with states in front that never change and that the sensors see as `constants` (sensors, states)."""
    count, n = constants.shape[1], len(A)
    A = np.block([[np.eye(count), np.zeros((count, n))], [np.zeros((n, count)), A]])
    B = np.concatenate([np.zeros((*B.shape[:-2], count, B.shape[-1])), B], axis=-2)
    return A, B, np.hstack([constants, C])


def _systems(
    A: Array, B: Array, C: Array, D: Array, samples: int, penalty: str, **extra: Any
) -> Augmented | list[Augmented]:
    """One augmented system, or one for each sample where loads move."""
    if B.ndim == 3 or D.ndim == 3:
        return moving(A, B, C, D, samples, penalty, **extra)
    return augment(A, B, C, D, penalty, **extra)


def _advanced(system: StateSpace, late: int) -> tuple[Array, Array]:
    """Output matrices that pair a load with the response `late` samples later."""
    if late == 0 or system.moving:
        return system.C, system.D
    before = system.C @ np.linalg.matrix_power(system.A, late - 1)
    return before @ system.A, before @ system.B


def _start(system: StateSpace, settings: PosingSettings) -> str | NDArray[np.float64]:
    if isinstance(settings.initial, str):
        return settings.initial
    x0 = np.asarray(plain(settings.initial), float)
    if x0.shape != (len(system.A),) or not np.all(np.isfinite(x0)):
        raise InputError("the initial state does not fit the model", where="initial", found=f"shape {x0.shape}, or NaN",
                         expected=f"({len(system.A)},), 'rest' or 'unknown'")  # fmt: skip
    return x0


PILOT = 1e-2  # relative lambda of the first estimate
NEIGHBOURS = 20  # lines to either side over which the power of the load is averaged
RANGE = 1e-12  # of the largest noise power: weaker lines are not believed


@dataclass(frozen=True)
class Coloured:
    """Impulse responses of all sensors (taps, sensors, loads), whitened ones of the used sensors, whitened data.

    The level of `noise` is that of the mean over all lines.
    """

    raw: NDArray[np.float64]
    h: NDArray[np.float64]
    y: NDArray[np.float64]
    noise: NoiseLevel


def coloured(model: Model, data: Data, settings: PosingSettings) -> Coloured:
    """Whiten a record and its measured model in time.

    Raises
    ------
    InputError
        A record of another step, or an FRF that is not causal.
    """
    raw, noise = measured_response(model, data, settings)
    power = noise.power / len(data.values)
    h, y = _whitened(raw[:, data.rows], data.values, power)
    variance = model.frf_variance(np.linspace(0, 0.5 / float(model.dt or data.dt), len(power)))
    if variance is not None:
        # the errors of the FRFs are in proportion to the load, of which a first estimate knows the power
        load = (WindowedPath if len(y) > WHOLE else ConvolvedPath)(heard(h), y).solution(PILOT, None).load
        size = smooth_lines(np.abs(np.fft.rfft(load, 2 * (len(power) - 1), axis=0)) ** 2, NEIGHBOURS)
        power = power + np.einsum("ksl,kl->ks", variance[:, data.rows], size) / len(data.values)
        h, y = _whitened(raw[:, data.rows], data.values, power)
    level = np.sqrt(np.mean(power, axis=0))
    source = replace(noise.source, text=f"{noise.source}, with the errors of the FRFs, white in time", white=True)
    return Coloured(raw, h, y, NoiseLevel(level, noise.known, source))


def _whitened(h: Array, y: Array, power: Array) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Impulse responses (taps, sensors, loads) and data (samples, sensors) after the filter of each sensor."""
    from scipy import fft

    samples, padded = len(y), 2 * (len(power) - 1)
    W = minimum_phase(1 / np.sqrt(np.maximum(power, RANGE * power.max(axis=0))))
    white = fft.irfft(fft.rfft(h, padded, axis=0) * W[..., None], padded, axis=0)[:samples]
    return white, fft.irfft(fft.rfft(y, padded, axis=0) * W, padded, axis=0)[:samples]


FEW = 4096  # samples of a record whose lines tell as much as those of a longer one, once the response has ended
LAYOUT = 1e-12  # share of the largest line below which a line says nothing


def convolved(
    h: Array, values: Array, missing: Array, noise: NoiseLevel, data: Data, settings: PosingSettings
) -> Posed:
    """Problem of impulse responses (taps, sensors, loads) of all sensors of the model.

    Raises
    ------
    InputError
        A penalty without a name, a start that is not at rest, or a covariance beside missing samples.
    """
    if not isinstance(settings.penalty.L, str):
        raise InputError("the Toeplitz path takes a named penalty", where="penalty", found="a matrix or None",
                         expected=Advice(f"one of {names()}; a matrix goes by ", BY_MATRIX))  # fmt: skip
    if missing.any() and noise.level.ndim == 2:
        raise InputError("missing samples take a noise std per sensor, not a covariance", where="noise",
                         found=f"covariance {noise.level.shape}", expected=f"({len(data.rows)},)")  # fmt: skip
    white = whiten(h[:, data.rows], noise.level, 1), whiten(values, noise.level, 1)
    posed = _posed(h, *white, values, missing, noise, data, settings)
    return replace(posed, white=lambda raw: whiten(np.where(missing, 0.0, raw), noise.level, 1))


def _posed(
    h: Array, h_white: Array, y_white: Array, values: Array, missing: Array, noise: NoiseLevel, data: Data,
    settings: PosingSettings,
) -> Posed:  # fmt: skip
    """Problem of whitened impulse responses of the used sensors and whitened data."""
    settings.refuse_special("Toeplitz")
    used, samples, penalty = h[:, data.rows], len(values), settings.penalty.L
    assert isinstance(penalty, str)
    weight = (~missing).astype(float) if missing.any() else None
    pieces = settings.lam.path == "windows" or (settings.lam.path == "auto" and samples > WHOLE and weight is None)
    h_white = heard(h_white)
    path = (WindowedPath if pieces else ConvolvedPath)(h_white, y_white, penalty, weight)
    judged = (beginning_of(path) or path) if pieces else path
    forward = Convolution(heard(used), samples)

    def compare(load: Array, lam: float, start: Array | None) -> tuple[Array, Array]:
        predicted = forward.apply(load)
        shown = np.where(missing, predicted, values)
        return shown, shown - predicted

    full = None
    if len(data.rows) < h.shape[1]:
        size = np.sqrt(np.mean(h**2, axis=(0, 2)))
        full = _layout(h / np.where(size > 0, size, 1.0)[:, None], samples)

    def pushing(signed: ArrayLike | None) -> NonNegativeRecord:
        return NonNegativeRecord.convolved(h_white, y_white, penalty, weight=weight, signed=signed)

    n = path.unknowns
    name = "Toeplitz, in windows" if pieces else "Toeplitz, preconditioned CG"
    visible = _layout(h_white, samples)
    return Posed(path, noise, compare, values, name, used, visible, full, n, judged, pushing)


def convolved_measured(model: Model, data: Data, settings: PosingSettings) -> Posed:
    """The same for a measured model, its noise made white in time; with gaps, at its mean level.

    Raises
    ------
    InputError
        As `convolved`, and a record of another step.
    """
    if not isinstance(settings.penalty.L, str):
        raise InputError("the Toeplitz path takes a named penalty", where="penalty", found="a matrix or None",
                         expected=Advice(f"one of {names()}; a matrix goes by ", BY_MATRIX))  # fmt: skip
    if data.missing.any():
        h, line_noise = measured_response(model, data, settings)
        level = np.sqrt(np.mean(line_noise.power, axis=0) / len(data.values))
        noise = NoiseLevel(level, line_noise.known, line_noise.source)
        return convolved(h, data.values, data.missing, noise, data, settings)
    white = coloured(model, data, settings)
    return _posed(white.raw, white.h, white.y, data.values, data.missing, white.noise, data, settings)


def _layout(h: Array, samples: int) -> tuple[float, int, int]:
    """Condition number, rank and nullity by the lines of a padded transform of impulse responses."""
    h = heard(h)
    values = np.linalg.svd(
        np.moveaxis(Convolution(h, min(samples, max(len(h), FEW))).spectrum, -1, 0), compute_uv=False
    )
    seen = values > LAYOUT * values.max()
    unknowns = samples * h.shape[2]
    rank = round(unknowns * float(np.sum(seen)) / values.size)
    return float(values.max() / values[seen].min()), rank, max(unknowns - rank, 0)
