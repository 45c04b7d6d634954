"""A model under combinations of its loads or sensors: other unknowns, and virtual points of rigid parts.

M. V. van der Seijs, D. D. van den Bosch, D. J. Rixen, D. de Klerk, "An improved methodology for the virtual point
transformation of measured frequency response functions in dynamic substructuring", COMPDYN 2013.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._channels import Channel, named
from .._model import Model
from ..errors import InputError, NotIdentifiable, digest, plain, reals
from .statespace import StateSpace


class StandingOn(Model):
    """A model that stands on another one, `model`: with other sensors or loads, and else what that one is."""

    model: Model

    def has_lines(self, frequencies: ArrayLike) -> NDArray[np.bool_]:
        """As the model."""
        return self.model.has_lines(frequencies)

    def gives(self, method: str) -> bool:
        """As the model, where this kind has the method too."""
        return super().gives(method) and self.model.gives(method)

    def refuse(self, method: str, family: str | None = None) -> NoReturn:
        """Refuse a method in the name of the model, where it is the model that has none."""
        if not self.model.gives(method):
            self.model.refuse(method, family)
        super().refuse(method, family)

    @property
    def moving(self) -> bool:
        """As the model."""
        return self.model.moving

    @property
    def radius(self) -> float:
        """That of the model."""
        return self.model.radius

    @property
    def training(self) -> frozenset[str]:
        """As the model."""
        return self.model.training

    @property
    def default_hold(self) -> str:
        """That of the model."""
        return self.model.default_hold

    @property
    def natural_frequencies(self) -> NDArray[np.float64] | None:
        """Those of the model."""
        return self.model.natural_frequencies

    @property
    def decay_rate(self) -> float | None:
        """That of the model."""
        return self.model.decay_rate


class MappedModel(StandingOn):
    """A model whose loads are ``g = T u``: its unknowns u are combinations of the loads.

    Fewer columns than loads make a low-order basis of them (mode shapes, say); a square T changes the variables, as a
    spatial prior does.

    Parameters
    ----------
    model : Model
        What it gives, this one gives too.
    T : array (loads, unknowns)
    labels : sequence of str or Channel, optional
        Names of the unknowns; those of the loads where T is square, else ``u0, u1, ...``.

    Raises
    ------
    InputError
        If T does not fit, or holds NaN.
    """

    def __init__(self, model: Model, T: ArrayLike, labels: Sequence[str | Channel] | None = None) -> None:
        self.model, self.T = model, reals(T, where="MappedModel", what="the combinations are no matrix of real numbers")
        loads = len(model.loads)
        if self.T.ndim != 2 or self.T.shape[0] != loads or 0 in self.T.shape or not np.all(np.isfinite(self.T)):
            raise InputError("the combinations do not fit the loads", where="MappedModel",
                             found=f"shape {self.T.shape}", expected=f"finite, ({loads}, unknowns)",
                             hint="one row per load")  # fmt: skip
        self.T.flags.writeable = False
        self.gain_covariance = model.gain_covariance
        self.sensors, self.certificate, self.flags = model.sensors, model.certificate, model.flags
        self.dt, self.frequencies = model.dt, model.frequencies
        square = self.T.shape[1] == loads and labels is None
        self.loads = model.loads if square else named(labels, self.T.shape[1], "u", "unknowns")

    def __repr__(self) -> str:
        return f"MappedModel({self.T.shape[1]} unknowns of {self.model!r})"

    def static(self) -> NDArray[np.float64]:
        """As that of the model, (sensors, unknowns)."""
        return self.model.static() @ self.T

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """As that of the model, (lines, sensors, unknowns)."""
        return self.model.frf(frequencies) @ self.T

    def frf_variance(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """As that of the model, errors of its FRFs taken as independent; None where it states none."""
        found = self.model.frf_variance(frequencies)
        return None if found is None else found @ self.T**2

    def noise_spectrum(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """That of the model."""
        return self.model.noise_spectrum(frequencies)

    def impulse_response(self, dt: float, samples: int, hold: str | None = None) -> NDArray[np.float64]:
        """As that of the model, (samples, sensors, unknowns)."""
        return self.model.impulse_response(dt, samples, hold or self.default_hold) @ self.T

    def state_space(self, dt: float, hold: str | None = None) -> StateSpace:
        """As that of the model, driven by the unknowns."""
        s: Any = self.model.state_space(dt, hold or self.default_hold)
        return StateSpace(s.A, s.B @ self.T, s.C, s.D @ self.T, dt, s.hold, sensors=self.sensors, loads=self.loads)

    @cached_property
    def reduced(self) -> Any:
        """As that of the model, driven by the unknowns."""
        own = self.model.reduced
        if own is None:
            return None
        return replace(own, B=own.B @ self.T, residual=None if own.residual is None else own.residual @ self.T)

    @property
    def noise(self) -> NDArray[np.float64] | None:
        """That of the model."""
        return self.model.noise

    @property
    def fingerprint(self) -> str:
        """Sha256 of the model and the combinations."""
        return digest("MappedModel", self.model.fingerprint, self.T, self.loads)


def mapped(model: Model, T: ArrayLike, labels: Sequence[str | Channel] | None = None) -> MappedModel:
    """A model under the combinations T of its loads.

    Raises
    ------
    InputError
        As `MappedModel`.
    """
    return MappedModel(model, T, labels)


MOTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
RANK = 1e-9  # of the largest singular value, lengths measured by the distance of the channels


def rigid(positions: ArrayLike, directions: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """Motion of channels by the six motions of a rigid body, shape (channels, 6): ``e (u + theta x r)``.

    Parameters
    ----------
    positions : array (channels, 3)
        m.
    directions : array (channels, 3)
        Measured or pushed direction of each; its length does not matter.
    centre : array (3,)
        The virtual point, m.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, a direction of length 0.
    """
    r, e = (_vectors(x, name) for x, name in ((positions, "positions"), (directions, "directions")))
    point = reals(centre, what="the centre is no point", where="centre")
    if len(r) != len(e) or point.shape != (3,) or not np.all(np.isfinite(point)):
        raise InputError("positions, directions and centre do not fit", where="rigid",
                         found=f"{len(r)} positions, {len(e)} directions, centre {point.shape}",
                         expected="(channels, 3), (channels, 3), (3,)")  # fmt: skip
    length = np.linalg.norm(e, axis=1, keepdims=True)
    if np.any(length == 0):
        raise InputError("a direction has no length", where="directions", found=f"row {int(np.argmin(length))}",
                         expected="a direction, such as (0, 0, 1)")  # fmt: skip
    e = e / length
    return np.concatenate([e, np.cross(r - point, e)], axis=1)


def motions_of(
    positions: ArrayLike,
    directions: ArrayLike,
    centre: ArrayLike = (0.0, 0.0, 0.0),
    motions: Sequence[str] = MOTIONS,
) -> NDArray[np.float64]:
    """Matrix (motions, channels) that takes measured motions to those of the virtual point, by least squares.

    Raises
    ------
    InputError
        Motions that are none.
    NotIdentifiable
        Channels that leave a motion unseen; it is named.
    """
    R = _full(positions, directions, centre, "sensors", motions)
    return np.asarray(np.linalg.lstsq(R, np.eye(len(R)), rcond=RANK)[0], float)


def loads_of(
    positions: ArrayLike,
    directions: ArrayLike,
    centre: ArrayLike = (0.0, 0.0, 0.0),
    motions: Sequence[str] = MOTIONS,
) -> NDArray[np.float64]:
    """Matrix (loads, motions) of the smallest forces at the channels that make up unit forces and moments at the point.

    Raises
    ------
    InputError
        Motions that are none.
    NotIdentifiable
        Forces that cannot make up one of them; it is named.
    """
    R = _full(positions, directions, centre, "forces", motions)
    return np.asarray(np.linalg.lstsq(R.T, np.eye(R.shape[1]), rcond=RANK)[0], float)


def rigid_share(
    values: ArrayLike,
    positions: ArrayLike,
    directions: ArrayLike,
    centre: ArrayLike = (0.0, 0.0, 0.0),
    motions: Sequence[str] = MOTIONS,
) -> NDArray[np.float64]:
    """Share of the power of sensors around a point that the motions of a rigid part explain, shape (lines,).

    Parameters
    ----------
    values : array, shape (lines, channels, ...), complex
        Their FRFs or spectra.
    motions : sequence of str
        Those that the part is taken to have.

    Raises
    ------
    InputError
        No more channels than motions, which explain anything; arrays that do not fit.
    NotIdentifiable
        As `motions_of`.

    Notes
    -----
    The overall sensor consistency, squared, of van der Seijs et al. (head of this module).
    """
    R = _full(positions, directions, centre, "sensors", motions)
    x = np.asarray(plain(values), complex)
    x = x.reshape(*x.shape[:2], -1) if x.ndim > 1 else x[None, :, None]
    if x.shape[1] != len(R) or len(R) <= R.shape[1] or not np.all(np.isfinite(x)):
        raise InputError("these sensors cannot show whether the part is rigid", where="rigid_share",
                         found=f"{x.shape[1]} channels of values, {len(R)} positions",
                         expected=f"more than {R.shape[1]}, one position each",
                         hint="a sensor more than there are motions")  # fmt: skip
    Q = np.linalg.qr(R / np.maximum(np.linalg.norm(R, axis=0), 1e-300))[0]
    inside = np.sum(np.abs(np.einsum("sr,ksn->krn", Q, x)) ** 2, axis=(1, 2))
    whole = np.sum(np.abs(x) ** 2, axis=(1, 2))
    return np.asarray(np.divide(inside, whole, out=np.ones(len(x)), where=whole > 0), float)


def at_point(
    model: Model,
    positions: ArrayLike,
    directions: ArrayLike,
    centre: ArrayLike = (0.0, 0.0, 0.0),
    label: str = "point",
    motions: Sequence[str] = MOTIONS,
) -> MappedModel:
    """The model under forces and moments at a virtual point, in place of the forces around it.

    Parameters
    ----------
    model : Model
        Its loads are the forces at `positions` along `directions`.
    label : str
        The loads are called ``label+X ... label+RZ``.
    motions : sequence of str
        Of `MOTIONS`, in their order: of hits along Z alone Z, RX and RY.

    Raises
    ------
    InputError
        Other than one position and direction for each load of the model.
    NotIdentifiable
        As `loads_of`.
    """
    T = loads_of(positions, directions, centre, motions)
    if len(T) != len(model.loads):
        raise InputError("positions and loads do not fit", where="at_point", found=f"{len(T)} positions",
                         expected=f"one for each of {len(model.loads)} loads")  # fmt: skip
    return mapped(model, T, point_loads(label, motions))


def point_loads(label: str, motions: Sequence[str] = MOTIONS) -> list[Channel]:
    """Forces and moments at a virtual point, ``label+X ... label+RZ``."""
    return [
        Channel(label=f"{label}+{m}", quantity="moment" if "R" in m else "force", unit="N*m" if "R" in m else "N")
        for m in motions
    ]


def _full(
    positions: ArrayLike, directions: ArrayLike, centre: ArrayLike, what: str, motions: Sequence[str]
) -> NDArray[np.float64]:
    chosen = [m for m in MOTIONS if m in motions]
    if not chosen or list(motions) != chosen:
        raise InputError("no motions of a rigid part", where="motions", found=list(motions),
                         expected=f"some of {list(MOTIONS)}, in this order")  # fmt: skip
    R = rigid(positions, directions, centre)[:, [MOTIONS.index(m) for m in chosen]]
    arms = R.copy()
    turning = [k for k, m in enumerate(chosen) if "R" in m]
    arms[:, turning] /= float(np.max(np.abs(arms[:, turning]), initial=0.0)) or 1.0
    _, s, Vh = np.linalg.svd(arms)
    count = len(chosen)
    rank = int(np.sum(s > RANK * s[0]))
    if rank < count:
        lost = np.max(np.abs(Vh[rank:]), axis=0) > 0.5
        left = ", ".join(m for m, gone in zip(chosen, lost, strict=True) if gone) or "a combination of motions"
        raise NotIdentifiable(
            f"these {what} leave a motion of the virtual point open: {left} (rank {rank} of {count})",
            advice="add channels off the others' axes, leave these motions out (motions=), or give the combinations "
            "that exist as a matrix (structures.virtual.mapped)",
            code="LID-W201",
        )
    return R


def _vectors(given: ArrayLike, name: str) -> NDArray[np.float64]:
    x = reals(given, what=f"the {name} are no real numbers", where=name)
    if x.ndim != 2 or x.shape[1] != 3 or not len(x) or not np.all(np.isfinite(x)):
        raise InputError(f"the {name} are no vectors", where=name, found=f"shape {x.shape}",
                         expected="finite, (channels, 3)")  # fmt: skip
    return x
