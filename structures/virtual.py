"""Virtual points: the six motions and loads of a part that moves as a rigid body, in place of single channels.

M. V. van der Seijs, D. D. van den Bosch, D. J. Rixen, D. de Klerk, "An improved methodology for the virtual point
transformation of measured frequency response functions in dynamic substructuring", COMPDYN 2013.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .channels import Channel
from .errors import InputError, NotIdentifiable
from .mapped import MappedModel, mapped
from .values import reals

if TYPE_CHECKING:
    from .model import Model

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


def motions_of(positions: ArrayLike, directions: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """Matrix (6, channels) that takes measured motions to those of the virtual point, by least squares.

    Raises
    ------
    NotIdentifiable
        Channels that leave a motion unseen; it is named.
    """
    R = _full(positions, directions, centre, "sensors")
    return np.asarray(np.linalg.lstsq(R, np.eye(len(R)), rcond=RANK)[0], float)


def loads_of(positions: ArrayLike, directions: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """Matrix (loads, 6) of the smallest forces at the channels that make up unit forces and moments at the point.

    Raises
    ------
    NotIdentifiable
        Forces that cannot make up one of them; it is named.
    """
    R = _full(positions, directions, centre, "forces")
    return np.asarray(np.linalg.lstsq(R.T, np.eye(6), rcond=RANK)[0], float)


def at_point(
    model: Model,
    positions: ArrayLike,
    directions: ArrayLike,
    centre: ArrayLike = (0.0, 0.0, 0.0),
    label: str = "point",
) -> MappedModel:
    """The model under three forces and three moments at a virtual point, in place of the forces around it.

    Parameters
    ----------
    model : Model
        Its loads are the forces at `positions` along `directions`.
    label : str
        The loads are called ``label+X ... label+RZ``.

    Raises
    ------
    InputError
        Other than one position and direction for each load of the model.
    NotIdentifiable
        As `loads_of`.
    """
    T = loads_of(positions, directions, centre)
    if len(T) != len(model.loads):
        raise InputError("positions and loads do not fit", where="at_point", found=f"{len(T)} positions",
                         expected=f"one for each of {len(model.loads)} loads")  # fmt: skip
    names = [
        Channel(label=f"{label}+{m}", quantity="moment" if "R" in m else "force", unit="N*m" if "R" in m else "N")
        for m in MOTIONS
    ]
    return mapped(model, T, names)


def _full(positions: ArrayLike, directions: ArrayLike, centre: ArrayLike, what: str) -> NDArray[np.float64]:
    R = rigid(positions, directions, centre)
    arms = R.copy()
    size = float(np.max(np.abs(arms[:, 3:]), initial=0.0)) or 1.0
    arms[:, 3:] /= size
    _, s, Vh = np.linalg.svd(arms)
    rank = int(np.sum(s > RANK * s[0]))
    if rank < 6:
        lost = np.max(np.abs(Vh[rank:]), axis=0) > 0.5
        named = ", ".join(m for m, gone in zip(MOTIONS, lost, strict=True) if gone) or "a combination of motions"
        raise NotIdentifiable(
            f"these {what} leave a motion of the virtual point open: {named} (rank {rank} of 6)",
            advice="add channels off the others' axes, or give the combinations that exist as a matrix "
            "(structures.mapped.mapped)",
            code="LID-W201",
        )
    return R


def _vectors(given: ArrayLike, name: str) -> NDArray[np.float64]:
    x = reals(given, what=f"the {name} are no real numbers", where=name)
    if x.ndim != 2 or x.shape[1] != 3 or not len(x) or not np.all(np.isfinite(x)):
        raise InputError(f"the {name} are no vectors", where=name, found=f"shape {x.shape}",
                         expected="finite, (channels, 3)")  # fmt: skip
    return x
