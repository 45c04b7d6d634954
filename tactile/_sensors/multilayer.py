"""iFEM2.0-style force maps: several layers of elements, interior free of load, ridge or smoothness on the tractions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from loadid._inverse.problem import NoiseSource
from structures import bases
from structures._flags import Flag

from .._arrays import Array
from .linear import LinearSensor, PressedBody
from .marked import observed
from .observation import DepthMap, Depths, Markers
from .posing import StrainWatch, of_pad
from .settings import InversionSettings, spelled_before

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
    penalty, choice, noise_source, contact, allow
        See `tactile._sensors.settings.InversionSettings`.

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
        **settings: Unpack[InversionSettings],
    ) -> None:
        self.pad, self._strain = pad, StrainWatch(pad)
        if eye is not None:
            settings.setdefault("noise_source", NoiseSource("quiet", "unloaded frames"))
        mass = sparse.kron(pad.surface.mass, sparse.eye_array(3)).tocsr()

        def transfer(points: Array, pick: Callable[[Any], Any]) -> Array:
            per_force = pick(pad.from_surface(points)) @ pad.compliance
            return np.asarray((mass.T @ per_force.T).T)

        basis = bases.hats(pad.structure, region=pad.surface, components=("+X", "+Y", "+Z"))
        given = observed(markers, eye)
        super().__init__(
            PressedBody(pad, pad.thickness, transfer, of_pad(pad), basis, pad.flags,
                        {"pad": repr(pad), "markers": len(given)}),
            given, eye=eye, depth=None if depth is None else windows(pad, depth, depth_width), **settings,
        )  # fmt: skip

    def _checked(self, load: Array) -> list[Flag | None]:
        return [self._strain.check(self.pad.surface.mass @ load.reshape(-1, 3))]


def windows(pad: Pad, depth: DepthMap, width: float | None) -> Depths:
    """Windows of a depth map about the nodes of the surface, off its rim."""
    inner = pad.nodes2d[~pad.edge]
    pitch = float(np.sqrt(np.median(pad.surface.areas[~pad.edge])))
    return Depths(depth, inner, pitch if width is None else float(width))
