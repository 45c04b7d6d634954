"""The state-space path: exact and O(N), for models that are discrete state spaces of some dozen states."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.model import Model
from structures.statespace import StateSpace
from structures.values import plain

from ...inverse.nonnegative.solver import NonNegativeRecord
from ...inverse.penalties import names
from ...inverse.statespace.augmented import Augmented, augment
from ...inverse.statespace.coarse import windows_of
from ...inverse.statespace.measured import measured, moving
from ...inverse.statespace.observed import observed_first
from ...inverse.statespace.passes import forward
from ...inverse.statespace.path import StateSpacePath
from ...inverse.statespace.riccati import feedback
from ...inverse.statespace.scale import layout
from ...inverse.statespace.sized import SizedPath
from ..data import Data
from ..noise import Noise
from .posed import Posed, Settings

MOST = 64  # states up to which small matrices are quick
WHOLE = 4096  # samples beyond which lambda is sought on windows of the record first
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


def states(system: StateSpace, h: NDArray, late: int, noise: Noise, data: Data, settings: Settings) -> Posed:
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
    if not isinstance(settings.penalty, str):
        raise InputError("the state-space path takes a named penalty", where="penalty", found="a matrix or None",
                         expected=f"one of {names()}; a matrix goes by path='dense'")  # fmt: skip
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
    rest = np.zeros(len(A))

    def respond(load: NDArray, first: NDArray) -> NDArray:
        """Response (samples, sensors) of the used sensors to a load, from a state at the first sample."""
        plain = measured(_systems(A, B, C[rows], D[..., rows, :], len(values), "identity"), np.zeros_like(values))
        return forward(plain, feedback(plain), np.ascontiguousarray(load, float), first)[2]

    known = respond(np.zeros((len(values), D.shape[-1])), start) if isinstance(start, np.ndarray) else 0.0
    extra = {"leak": settings.leak, "from_zero": settings.from_zero, "unknown_start": seen}
    systems = _systems(A, B, C[rows], D[..., rows, :], len(values), settings.penalty, **extra)
    own = measured(systems, np.where(missing, np.nan, values - known), noise.level)
    long = len(values) > WHOLE
    if sizes is not None and unknown:
        raise InputError("with a weight of the size the start of the structure is known", where="initial",
                         found="'unknown'", expected="'rest' or a state", hint="leave out size=")  # fmt: skip
    path = StateSpacePath(own, quick=long) if sizes is None else SizedPath(own, sizes, quick=long)
    judged = (windows_of(path) or path) if long and sizes is None else path

    def compare(load: NDArray, lam: float, first: NDArray | None) -> tuple[NDArray, NDArray]:
        if unknown and first is None:
            first = path.start(lam)
        predicted = known + respond(load, rest if first is None or not unknown else first[: len(rest)])
        shown = np.where(missing, predicted, values)
        return shown, shown - predicted

    full = None
    if len(rows) < len(C):
        size = np.sqrt(np.mean(h**2, axis=(0, 2)))
        everything = _systems(A, B, C, D, len(values), settings.penalty, **extra)
        full = layout(measured(everything, np.zeros((len(values), len(C))), np.where(size > 0, size, 1.0)))

    def pushing(signed: ArrayLike | None) -> NonNegativeRecord:
        return NonNegativeRecord(own, signed)

    name, visible = "state space, O(N)", layout(own)
    return Posed(path, noise, compare, values, name, h[:, rows], visible, full, path.unknowns, judged, pushing)


def _constants(data: Data, sensors: int) -> NDArray[np.float64]:
    """Columns (sensors, offsets), a constant in one channel each: those whose offset was subtracted."""
    floating = np.flatnonzero(data.offsets)
    columns = np.zeros((sensors, len(floating)))
    columns[data.rows[floating], np.arange(len(floating))] = data.rms[floating]
    return columns


def _with_constants(A: NDArray, B: NDArray, C: NDArray, constants: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """The system with states in front that never change and that the sensors see as `constants` (sensors, states)."""
    count, n = constants.shape[1], len(A)
    A = np.block([[np.eye(count), np.zeros((count, n))], [np.zeros((n, count)), A]])
    B = np.concatenate([np.zeros((*B.shape[:-2], count, B.shape[-1])), B], axis=-2)
    return A, B, np.hstack([constants, C])


def _systems(
    A: NDArray, B: NDArray, C: NDArray, D: NDArray, samples: int, penalty: str, **extra: Any
) -> Augmented | list[Augmented]:
    """One augmented system, or one for each sample where loads move."""
    if B.ndim == 3 or D.ndim == 3:
        return moving(A, B, C, D, samples, penalty, **extra)
    return augment(A, B, C, D, penalty, **extra)


def _advanced(system: StateSpace, late: int) -> tuple[NDArray, NDArray]:
    """Output matrices that pair a load with the response `late` samples later."""
    if late == 0 or system.moving:
        return system.C, system.D
    before = system.C @ np.linalg.matrix_power(system.A, late - 1)
    return before @ system.A, before @ system.B


def _start(system: StateSpace, settings: Settings) -> str | NDArray[np.float64]:
    if isinstance(settings.initial, str):
        return settings.initial
    x0 = np.asarray(plain(settings.initial), float)
    if x0.shape != (len(system.A),) or not np.all(np.isfinite(x0)):
        raise InputError("the initial state does not fit the model", where="initial", found=f"shape {x0.shape}, or NaN",
                         expected=f"({len(system.A)},), 'rest' or 'unknown'")  # fmt: skip
    return x0
