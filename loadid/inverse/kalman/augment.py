"""A structure and the priors of its loads as one filter model.

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
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable
from structures.model import Model
from structures.values import shown

from .dummy import near_rest
from .levels import covariance_root, noise_root, offsets, spread_root
from .matrices import Matrices, held_over
from .model import FilterModel
from .priors import Prior, White, diagonal
from .roots import lower

FREE = 1e6  # times what a sample resolves: a white load so wide that its prior says nothing, 1e-12 of its variance
BLIND = 1e-12  # share of the largest whitened feedthrough below which a load is not seen at once
SAME = 1e-9  # difference of two state matrices, against their size, that is rounding


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
        acts: a prior, not data (see `dummy.near_rest`). It needs a model with modes.

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
    kinds = _finite(_priors(priors, p), np.linalg.solve(LR, structure.D))
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


def _start(start: Any, structure: Matrices, loads: NDArray) -> tuple[NDArray, NDArray]:
    """Roots of the first states: their own (nx, any), and what a root of the first loads (loads, any) makes of them."""
    nx = len(structure.A)
    if not isinstance(start, str):
        return spread_root(start, nx, "start"), np.zeros((nx, loads.shape[1]))
    if start != "static":
        raise InputError("no such start", where="start", found=shown(start), expected="stds, a root, or 'static'")
    return np.zeros((nx, 0)), structure.static() @ loads


def _disturbances(own: Matrices, ambient: Ambient) -> tuple[NDArray, NDArray]:
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


def _finite(priors: Sequence[Prior], heard: NDArray) -> list[Prior]:
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
