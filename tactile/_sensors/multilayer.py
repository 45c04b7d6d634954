"""A pad of finite elements as a force sensor, the motion of markers on it as its readings."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from loadid._inverse.problem import NoiseSource
from structures import bases
from structures._flags import Flag

from .._arrays import Array
from .._pad.tolerances import Tolerances
from .errors import errors
from .image import ImageMotion
from .linear import LinearSensor, PressedBody, alone
from .marked import InversionSettings, observed, spelled_before
from .observation import DepthMap, Depths, Markers
from .posing import StrainWatch, of_pad
from .prior import ContactPrior

if TYPE_CHECKING:
    from .._pad.pad import Pad
    from ..vision._eye import Eye


class MultilayerPad(LinearSensor):
    """Force maps from the motion of markers on a pad of several layers of finite elements.

    The interior carries no load and is condensed; unknowns are the tractions at the nodes of the surface (bilinear
    between them), with a ridge or smoothness on them: ``min |R^(-1/2) (H t - y)|^2 + lambda^2 |L t|^2``. In the style
    of Zhao, Liu & Ma, IEEE Trans. Robotics (2025), whose formulas are not reproduced here.

    Parameters
    ----------
    pad : Pad
    markers : Markers, optional
        Places at rest (N, 2) or (N, 3), noise and axes of their motion; those of the `eye` where not given.
    depth : DepthMap, optional
        A map of the kind that will be measured: its pixel and noise count, its values do not.
    depth_width : float, optional
        Side of the windows about the surface nodes over which depth is averaged (m); the pitch of the mesh.
    eye : Eye, optional
        Turns images into motion.
    image : ImageMotion or None
        What camera and gel may have moved as a whole, beside the load; None if they are known to be fast. Under a
        contact prior.
    tolerances : Tolerances
        How well modulus, Poisson's ratio and thickness of the pad are known; in the band under a contact prior, as is
        the error of the mesh, and in that of a `LearnedSensor`. One frame does not tell them, and markers in the plane
        flag no wrong thickness.
    penalty, choice, noise_source, contact, allow
        See `tactile._sensors.marked.InversionSettings`; the penalty is a `ContactPrior` where none is given.

    Raises
    ------
    InputError
        Fewer than three markers, markers outside the pad, settings that do not fit.
    """

    name = "multilayer pad"

    @spelled_before("markers", "contact")
    def __init__(
        self,
        pad: Pad,
        markers: Markers | ArrayLike | None = None,
        *,
        depth: DepthMap | None = None,
        depth_width: float | None = None,
        eye: Eye | None = None,
        image: ImageMotion | None = ImageMotion(),  # noqa: B008  (frozen)
        tolerances: Tolerances = Tolerances(),  # noqa: B008
        **settings: Unpack[InversionSettings],
    ) -> None:
        self.pad, self._strain = pad, StrainWatch(pad)
        settings.setdefault("penalty", ContactPrior())
        if eye is not None:
            settings.setdefault("noise_source", NoiseSource("quiet", "unloaded frames"))
        mass = sparse.kron(pad.surface.mass, sparse.eye_array(3)).tocsr()
        basis = bases.hats(pad.structure, region=pad.surface, components=("+X", "+Y", "+Z"))
        given = observed(markers, eye)
        about = {"pad": repr(pad), "markers": len(given)}
        body = PressedBody(pad, pad.thickness, partial(_rows, pad, mass), of_pad(pad), basis, pad.flags, about,
                           partial(errors, pad, tolerances, mass), tolerances)  # fmt: skip
        deep = None if depth is None else windows(pad, depth, depth_width)
        with alone(3 * pad.points):
            super().__init__(body, given, eye=eye, depth=deep, image=image, **settings)

    def _gel(self) -> Pad:
        return self.pad

    def prepare(self) -> None:
        """As every linear sensor; strain is found beside the loop from here on, and W112 comes some frames late.

        Raises
        ------
        InputError
            Where lambda is not fixed yet.
        """
        super().prepare()
        self._strain.beside = True

    def _checked(self, load: Array) -> list[Flag | None]:
        return [self._strain.check(self.pad.surface.mass @ load.reshape(-1, 3))]


def _rows(pad: Pad, mass: Any, points: Array, pick: Callable[[Any], Any]) -> Array:
    """Rows (rows, 3 P) of the motion of points under tractions, whose nodal forces are `mass` times them."""
    per_force = pick(pad.from_surface(points)) @ pad.compliance
    return np.asarray((mass.T @ per_force.T).T)


def windows(pad: Pad, depth: DepthMap, width: float | None) -> Depths:
    """Windows of a depth map about the nodes of the surface, off its rim."""
    inner = pad.nodes2d[~pad.edge]
    pitch = float(np.sqrt(np.median(pad.surface.areas[~pad.edge])))
    return Depths(depth, inner, pitch if width is None else float(width))
