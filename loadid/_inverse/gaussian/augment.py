"""A structure and the priors of its loads as one filter model, sample by sample or in continuous time.

    [x]      [A  B H 0] [x]         y = [C  D H  U] [x z c]^T + v
    [z]    = [0  F   0] [z] + w     p = [0  H    0] [x z c]^T
    [c] k+1  [0  0   1] [c] k

x the states of the structure, z those of the priors, c drifting offsets of sensors. With the first-order hold, A, B, C
and D are those of the causal form (the state less ``B1 p``): the step to the next sample then asks for the load at this
one alone, and the noise of the structure and of the loads stays apart. Under the joint hold, structure and priors are
one system in continuous time, and one quadrature gives the noise of both.

Sources: E. Lourens et al., Mech. Syst. Signal Process. 27 (2012) 446-460 (augmented filter); R. Nayek et al., Mech.
Syst. Signal Process. 128 (2019) 497-530 (Gaussian processes as loads).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures._model import Model, as_model
from structures._models.discretise import continuous
from structures.errors import InputError, NotIdentifiable, positive, reals, shown

from ...priors import Companion, Prior, White, diagonal
from .model import FilterModel, near_rest
from .roots import Array, lower, step

OPEN = 1e3  # noise stds of a sensor's offset before the first sample, where none is stated
SAME = 1e-9  # asymmetry of a matrix, against its size, that is rounding


def noise_root(noise: ArrayLike, m: int) -> Array:
    """Lower triangular root of the noise of the sensors."""
    LR = covariance_root(noise, m, "noise")
    if np.any(np.diag(LR) <= 0):
        raise InputError("a sensor without noise", where="noise", found="a std of zero", expected="above zero",
                         hint="the std of its quantisation, step / sqrt(12), if nothing else is known")  # fmt: skip
    return LR


def covariance_root(given: ArrayLike, count: int, name: str) -> Array:
    """Lower triangular root of a covariance given as stds or as a matrix."""
    array = reals(given, where=name)
    if array.ndim < 2:
        return np.diag(levels(array, count, name))
    scale = np.sqrt(np.abs(np.diag(array))) if array.shape == (count, count) else np.zeros(0)
    unit = np.where(scale > 0, scale, 1.0)
    if (
        array.shape != (count, count)
        or not np.all(np.isfinite(array))
        or (np.abs(array - array.T).max() > SAME * np.abs(array).max())
    ):
        raise InputError("no covariance", where=name, found=f"shape {array.shape}",
                         expected=f"({count},) stds, or ({count}, {count}), symmetric and finite")  # fmt: skip
    try:  # in units of the stds: channels differ by many decades
        return np.asarray(unit[:, None] * np.linalg.cholesky(array / unit[:, None] / unit))
    except np.linalg.LinAlgError:
        raise InputError("a covariance that is not positive definite", where=name, found=shown(given),
                         expected="positive definite", hint="is one a copy of another?") from None  # fmt: skip


def spread_root(given: ArrayLike, count: int, name: str) -> Array:
    """Root (count, any) from a std, stds, or a root; columns of zeros are left out."""
    array = reals(given, where=name)
    if array.ndim == 2 and len(array) == count and np.all(np.isfinite(array)):
        return array
    stds = levels(array, count, name)
    return np.diag(stds)[:, stds > 0]


def levels(given: ArrayLike, count: int, name: str) -> Array:
    """Stds (count,), none negative."""
    array = reals(given, where=name)
    if array.shape not in ((), (count,)) or not np.all(np.isfinite(array)) or np.any(array < 0):
        raise InputError("the stds do not fit", where=name, found=shown(given),
                         expected=f"{count} finite numbers, none negative")  # fmt: skip
    return np.array(np.broadcast_to(array, (count,)))


@dataclass(frozen=True, eq=False)
class Offsets:
    """Offsets of sensors in multiples of their noise: noise of a step, start, rows."""

    LQ: Array
    L0: Array
    rows: Array


def offsets(bias: ArrayLike, start: ArrayLike | None, noise: Array, dt: float) -> Offsets:
    """Of the sensors that drift (std that a second adds, `bias`) or start anywhere (std, `start`), all (sensors,)."""
    m = len(noise)
    rate = levels(bias, m, "bias")
    first = np.where(rate > 0, OPEN * noise, 0.0) if start is None else levels(start, m, "bias_start")
    some = np.flatnonzero((rate > 0) | (first > 0))
    rows = np.zeros((m, len(some)))
    rows[some, np.arange(len(some))] = noise[some]
    return Offsets(np.diag(rate[some] / noise[some] * math.sqrt(dt)), np.diag(first[some] / noise[some]), rows)


HOLDS = ("foh", "zoh", "joint")
SINGULAR = 1e13  # condition above which a structure has no static state

Parts = tuple[Array, Array, Array, Array]


@dataclass(frozen=True, eq=False)
class Matrices:
    """Matrices of a structure at a step: discrete, or under the joint hold continuous.

    Under the first-order hold of a model with modes those in continuous time (A, B) stand in `rates` beside.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float
    hold: str
    rates: tuple[Array, Array] | None = None

    @classmethod
    def of(cls, model: Any, dt: float, hold: str | None) -> Matrices:
        """Those of a model; refused by name where it has none that stay."""
        model = as_model(model, "augment", "state_space")
        hold = model.default_hold if hold is None else hold
        if hold not in HOLDS:
            raise InputError("no such hold", where="hold", found=shown(hold), expected=", ".join(map(repr, HOLDS)),
                             hint="'foh' fits a sampled smooth load, 'joint' one with a Matern prior")  # fmt: skip
        if hold == "joint":
            return cls(*_continuous(model), positive("the step", dt, where="dt", unit="s"), hold)
        known = model.state_space(dt, hold)
        if known.moving:
            raise InputError("a load that moves has no filter of constant matrices", where="augment", found="B(t)",
                             expected="loads that stay in place",
                             hint="put a basis of fixed loads along its way")  # fmt: skip
        return cls(known.A, known.B, known.C, known.D, known.dt, hold, _rates(model) if hold == "foh" else None)

    def static(self) -> Array:
        """States in equilibrium with constant loads of one (nx, loads)."""
        rest = -self.A if self.hold == "joint" else np.eye(len(self.A)) - self.A
        if len(rest) and np.linalg.cond(rest) > SINGULAR:
            raise InputError("the structure never settles under a constant load", where="start='static'",
                             found=f"a motion that nothing resists (condition {np.linalg.cond(rest):.1g})",
                             expected="a supported structure", hint="start it with stds of its states")  # fmt: skip
        return np.asarray(np.linalg.solve(rest, self.B), float)

    def held(self, priors: Sequence[Prior]) -> Parts:
        """F and LQ (of x and z), reading of the loads and their start.

        A prior with a length says how its load runs between the samples; the first-order hold takes it for straight.
        What the load does beside disturbs the structure, where it is known in continuous time.
        """
        known = [prior.discrete(self.dt) for prior in priors]
        Fz, LQz, H, L0 = (diagonal([getattr(k, name) for k in known]) for name in ("F", "LQ", "H", "L0"))
        F = np.block([[self.A, self.B @ H], [np.zeros((len(Fz), len(self.A))), Fz]])
        rest = np.hstack([self._beside(prior, load) for load, prior in enumerate(priors)])
        LQ = diagonal([rest, LQz])
        return F, LQ, H, L0

    def displaced(self, model: Model) -> tuple[Array, Array]:
        """Displacements where and as the loads act, of the states (loads, nx) and of the loads (loads, loads).

        Those of the modes: what the modes left out add under a static load is not among them.
        """
        rates = _rates(model)
        if rates is None:
            raise InputError(f"{type(model).__name__} knows no displacement at its loads", where="dummy",
                             found="no modes", expected="a model with modes, as ForwardModel has them",
                             hint="a displacement sensor of the model that is zero does the same")  # fmt: skip
        omega = np.sqrt(model.reduced.lam)
        C = np.zeros((rates[1].shape[1], len(self.A)))
        C[:, 2 * np.arange(len(omega))] = rates[1][1 : 2 * len(omega) : 2].T / np.where(omega > 0, omega, 1.0)
        if self.hold != "foh":
            return C, np.zeros((len(C), len(C)))
        return C, C @ np.hstack([self._pushed(rates[0], b[:, None])[1] for b in rates[1].T])

    def _pushed(self, A: Array, b: Array) -> tuple[Array, Array]:
        """What a load does to the states at the end of a step (nx, 1): with its value before it, and after it."""
        n, line = len(A), np.diag([1.0], 1)  # of the load: a value and a slope
        held, ramp = _exponential(self.dt * np.block([[A, b, 0 * b], [np.zeros((2, n)), line]]))[:n, n:].T[:, :, None]
        return held - ramp / self.dt, ramp / self.dt

    def _beside(self, prior: Prior, load: int) -> Array:
        """Root of what a load does to the states within a step beside its straight line (nx, any), in the long run.

        From one step to the next it is correlated a little, and with the noise of the load: taken as white it makes
        the band cautious, not its mean better (the joint hold does both).
        """
        n = len(self.A)
        if self.rates is None or not isinstance(prior, Companion):
            return np.zeros((n, 0))
        A, b, known = self.rates[0], self.rates[1][:, [load]], prior.continuous()
        size, (early, late) = len(known.F), self._pushed(A, b)
        rates = np.block([[A, b @ known.H], [np.zeros((size, n)), known.F]])
        E, L = step(rates, np.vstack([np.zeros((n, known.b.shape[1])), known.b]), self.dt)
        straight = early @ known.H + late @ known.H @ E[n:, n:]
        return lower(L[:n] - late @ known.H @ L[n:], (E[:n, n:] - straight) @ known.L0)

    def jointly(self, priors: Sequence[Prior]) -> Parts:
        """The same from one system in continuous time."""
        known = [prior.continuous() for prior in priors]
        for prior in priors:
            prior.discrete(self.dt)  # what the step cannot carry is refused by the prior
        Fz, b, H, L0 = (diagonal([getattr(k, name) for k in known]) for name in ("F", "b", "H", "L0"))
        rates = np.block([[self.A, self.B @ H], [np.zeros((len(Fz), len(self.A))), Fz]])
        pushes = np.vstack([np.zeros((len(self.A), b.shape[1])), b])
        return *step(rates, pushes, self.dt), H, L0


def _continuous(model: Model) -> Parts:
    """Matrices in continuous time of a model that has modes."""
    if model.reduced is None:
        raise InputError(f"{type(model).__name__} exists from sample to sample only: it has no joint hold",
                         where="hold", found="'joint'", expected=f"hold={model.default_hold!r}",
                         hint="'joint' needs a model with modes, as ForwardModel has them")  # fmt: skip
    return continuous(model.reduced)


def _rates(model: Model) -> tuple[Array, Array] | None:
    """A and B in continuous time of a model that has modes and constant matrices; None of any other."""
    if model.reduced is None or model.reduced.moving or model.reduced.loss != 0:
        return None
    return continuous(model.reduced)[:2]


def _exponential(A: Array) -> Array:
    from scipy.linalg import expm

    return np.asarray(expm(A))


def held_over(A: Array, B: Array, dt: float) -> Array:
    """State that a load of one, held over a step, leaves behind."""
    n, p = B.shape
    return _exponential(dt * np.block([[A, B], [np.zeros((p, n + p))]]))[:n, n:]


FREE = 1e6  # times what a sample resolves: a white load so wide that its prior says nothing, 1e-12 of its variance
BLIND = 1e-12  # share of the largest whitened feedthrough below which a load is not seen at once


@dataclass(frozen=True, eq=False)
class Ambient:
    """Unknown loads that are white from sample to sample: they disturb the structure and what its sensors read alike.

    Parameters
    ----------
    model : Model
        The same structure and sensors under the ambient loads (``model.with_loads(...)``); a `StateSpace` with the same
        A and C.
    sd : float, array (loads,) or (loads, loads)
        Std of each, of all, or their covariance.
    """

    model: Any
    sd: ArrayLike


def augment(
    model: Model,
    dt: float,
    priors: Prior | Sequence[Prior],
    *,
    noise: ArrayLike,
    hold: str | None = None,
    state_noise: ArrayLike = 0.0,
    start: ArrayLike | str = 0.0,
    ambient: Ambient | None = None,
    bias: ArrayLike = 0.0,
    bias_start: ArrayLike | None = None,
    dummy: float | None = None,
) -> FilterModel:
    """Filter model of a structure under loads with priors.

    Parameters
    ----------
    model : Model
        With a state space.
    dt : float
        Step in s.
    priors : Prior or sequence
        One per load, or one for all.
    noise : array (sensors,) or (sensors, sensors)
        Std of each sensor, or their covariance.
    hold : ``"foh"``, ``"zoh"`` or ``"joint"``, optional
        How the load runs between its samples: linear, constant, or as its prior says (needs a model with modes). That
        of the model by default. Under ``"foh"`` a model with modes takes what an OU or Matern load does beside its
        straight line as noise of the states: the band holds, though ``"joint"`` has the smaller error.
    state_noise : float or array (nx,)
        Std that a sample adds to every state of the structure, in the units of the states.
    start : float, array (nx,), root (nx, any) or "static"
        Std of the states before the first sample; at rest by default. Static: the structure carries its first load
        in equilibrium, as one that has been loaded for long.
    ambient : Ambient, optional
        Other loads, unknown and white. Under the joint hold each is held over its sample.
    bias : float or array (sensors,)
        Std that a second adds to the offset of a sensor, in its units per root second; 0: the offset does not drift.
    bias_start : float or array (sensors,), optional
        Std of the offset before the first sample. A sensor with neither has no offset; one that drifts starts a
        thousand noise stds wide where nothing is said.
    dummy : float, optional
        Std in m within which every load is believed to leave the structure near its rest, at each sample and where it
        acts: a prior, not data (see `model.near_rest`). It needs a model with modes.

    Returns
    -------
    FilterModel
        States: structure (nx), priors load by load, offsets.

    Raises
    ------
    InputError
        If the model has no state space, a load moves, or a setting does not fit.
    NotIdentifiable
        If a load with ``White(inf)`` is not seen by the sensors within its own sample.
    """
    structure = Matrices.of(model, dt, hold)
    m, p, nx = len(structure.C), structure.B.shape[1], len(structure.A)
    LR, S = noise_root(noise, m), None
    LQx = spread_root(state_noise, nx, "state_noise")
    if ambient is not None:
        pushes, heard = _disturbances(structure, ambient)
        LQx, LR, S = np.hstack([LQx, pushes]), lower(LR, heard), pushes @ heard.T
    kinds = _finite(_priors(priors, p), np.asarray(np.linalg.solve(LR, structure.D)))
    F, LQ, Hz, Lz = (structure.jointly if structure.hold == "joint" else structure.held)(kinds)
    drift = offsets(bias, bias_start, np.linalg.norm(LR, axis=1), dt)
    states, carried = _start(start, structure, Hz @ Lz)
    c, n = drift.rows.shape[1], len(F) + drift.rows.shape[1]
    made = FilterModel(
        F=diagonal([F, np.eye(c)]),
        LQ=diagonal([np.hstack([np.vstack([LQx, np.zeros((len(F) - nx, LQx.shape[1]))]), LQ]), drift.LQ]),
        H=np.hstack([structure.C, structure.D @ Hz, drift.rows]),
        LR=LR,
        Cp=np.hstack([np.zeros((p, nx)), Hz, np.zeros((p, c))]),
        x0=np.zeros(n),
        L0=diagonal([np.block([[states, carried], [np.zeros((len(Lz), states.shape[1])), Lz]]), drift.L0]),
        nx=nx,
        S=None if S is None else np.vstack([S, np.zeros((n - nx, m))]),
        held=structure.hold == "zoh",
    )
    if dummy is None:
        return made
    own, direct = structure.displaced(model)
    return near_rest(made, np.hstack([own, direct @ Hz, np.zeros((p, c))]), dummy)


def _start(start: Any, structure: Matrices, loads: Array) -> tuple[Array, Array]:
    """Roots of the first states: their own (nx, any), and what a root of the first loads (loads, any) makes of them."""
    nx = len(structure.A)
    if not isinstance(start, str):
        return spread_root(start, nx, "start"), np.zeros((nx, loads.shape[1]))
    if start != "static":
        raise InputError("no such start", where="start", found=shown(start), expected="stds, a root, or 'static'")
    return np.zeros((nx, 0)), structure.static() @ loads


def _disturbances(own: Matrices, ambient: Ambient) -> tuple[Array, Array]:
    """What ambient loads of one do to the states (nx, loads), and to the sensors (sensors, loads)."""
    if not isinstance(ambient, Ambient):
        raise InputError("no ambient loads", where="ambient", found=shown(ambient), expected="Ambient(model, sd)")
    other = Matrices.of(ambient.model, own.dt, own.hold)
    for name in ("A", "C"):
        mine, its = getattr(own, name), getattr(other, name)
        if mine.shape != its.shape or np.abs(mine - its).max(initial=0) > SAME * np.abs(mine).max(initial=0):
            raise InputError("the ambient loads act on another structure, or its sensors are others",
                             where="ambient", found=f"another {name} of shape {its.shape}",
                             expected=f"that of the model, {mine.shape}",
                             hint="Ambient(model.with_loads(...), sd)")  # fmt: skip
    spread = covariance_root(ambient.sd, other.B.shape[1], "ambient.sd")
    pushes = held_over(other.A, other.B, own.dt) if own.hold == "joint" else other.B
    return pushes @ spread, other.D @ spread


def _priors(priors: Any, loads: int) -> list[Prior]:
    """One prior per load."""
    kinds = [priors] * loads if isinstance(priors, Prior) else list(priors) if isinstance(priors, Sequence) else []
    if len(kinds) != loads or not all(isinstance(prior, Prior) for prior in kinds):
        raise InputError("the priors do not fit the loads", where="priors", found=shown(priors),
                         expected=f"one prior, or {loads} of them",
                         hint="Matern32(sd, length), RandomWalk(rate)")  # fmt: skip
    return kinds


def _finite(priors: Sequence[Prior], heard: Array) -> list[Prior]:
    """White loads of infinite std as ones far beyond what a sample resolves; `heard` is the whitened feedthrough."""
    free = [i for i, prior in enumerate(priors) if isinstance(prior, White) and prior.sd == math.inf]
    if not free:
        return list(priors)
    # loads differ in units and sensors in number: each column counts against its own size
    size = np.linalg.norm(heard[:, free], axis=0)
    seen = np.linalg.svd(heard[:, free] / np.where(size > 0, size, 1.0), compute_uv=False)
    if len(seen) < len(free) or seen[-1] <= BLIND or np.any(size == 0):
        raise NotIdentifiable(
            f"{len(free)} loads without a prior, of which the sensors tell {int(np.sum(seen > BLIND))} within a sample",
            advice="add accelerometers at the loads, or give these loads a prior with a length (Matern32)",
            code="LID-E306",
        )
    wide = dict(zip(free, FREE / (seen[-1] * size), strict=True))
    return [White(float(wide[i])) if i in wide else prior for i, prior in enumerate(priors)]
