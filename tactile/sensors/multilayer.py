"""iFEM2.0-style force maps: several layers of elements, interior free of load, ridge or smoothness on the tractions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from loadid.inverse.noise_source import NoiseSource
from structures import bases
from structures.errors import InputError, as_array
from structures.flags import Flag

from .linear import LinearSensor, Settings
from .observation import DepthMap, Depths, Markers
from .posing import StrainWatch, of_pad

if TYPE_CHECKING:
    from ..pad.pad import Pad
    from ..vision.eye import Eye


Array = NDArray[np.float64]


class MultilayerPad(LinearSensor):
    """Force maps from the motion of markers on a pad of several layers of finite elements.

    The interior carries no load and is condensed; unknowns are the tractions at the nodes of the surface (bilinear
    between them), with a ridge or smoothness on them: ``min |R^(-1/2) (H t - y)|^2 + lambda^2 |L t|^2``. In the style
    of Zhao, Liu & Ma, IEEE Trans. Robotics (2025), whose formulas are not reproduced here.

    Parameters
    ----------
    pad : Pad
    markers : array (N, 2) or (N, 3), optional
        Places of the markers at rest (m); those of the `eye` where not given.
    noise : float or array
        Std of their motion (m): of the unloaded sensor. That of the `eye` where not given.
    axes : {"XY", "XYZ"}
        In-plane motion, or all three components.
    depth : DepthMap, optional
        A map of the kind that will be measured: its pixel and noise count, its values do not.
    depth_width : float, optional
        Side of the windows about the surface nodes over which depth is averaged (m); the pitch of the mesh.
    slope : array (N, 2), optional
        Apparent in-plane motion per unit of normal motion, where the readings are apparent; of the `eye` otherwise.
    eye : Eye, optional
        Turns images into motion.
    penalty, choice, noise_source, no_pull, friction, support, allow
        See `tactile.sensors.linear.Settings`.

    Raises
    ------
    InputError
        Fewer than three markers, markers outside the pad, settings that do not fit.
    """

    name = "multilayer pad"

    def __init__(
        self,
        pad: Pad,
        markers: ArrayLike | None = None,
        *,
        noise: Any = None,
        axes: str = "XY",
        depth: DepthMap | None = None,
        depth_width: float | None = None,
        slope: ArrayLike | None = None,
        eye: Eye | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        self.pad, self._strain = pad, StrainWatch(pad)
        if eye is not None:
            settings.setdefault("noise_source", NoiseSource("quiet", "unloaded frames"))
        seen = observed(markers, noise, axes, slope, eye)
        mass = sparse.kron(pad.surface.mass, sparse.eye_array(3)).tocsr()

        def transfer(points: Array, pick: Callable[[Any], Any]) -> Array:
            per_force = pick(pad.from_surface(points)) @ pad.compliance
            return np.asarray((mass.T @ per_force.T).T)

        super().__init__(
            seen,
            transfer,
            of_pad(pad),
            basis=bases.hats(pad.structure, region=pad.surface, components=("+X", "+Y", "+Z")),
            depth=None if depth is None else windows(pad, depth, depth_width),
            flags=pad.flags,
            eye=eye,
            body=pad,
            about={"pad": repr(pad), "markers": len(seen)},
            **settings,
        )

    def _checked(self, load: Array) -> list[Flag | None]:
        return [self._strain.check(self.pad.surface.mass @ load.reshape(-1, 3))]


def observed(markers: ArrayLike | None, noise: Any, axes: str, slope: ArrayLike | None, eye: Eye | None) -> Markers:
    """Markers as a user gave them, or as an eye sees them.

    Raises
    ------
    InputError
        If neither gives them, or their noise.
    """
    if eye is not None:
        markers = eye.markers if markers is None else markers
        noise = eye.noise if noise is None else noise
        slope = eye.slope if slope is None else slope
    if markers is None or noise is None:
        raise InputError(
            "it is not known where the markers are, or how noisy their motion is", where="sensor",
            found=f"markers {'given' if markers is not None else 'missing'}, noise {noise!r}",
            expected="markers=(N, 2) in m and noise= their std in m, or an eye that knows both",
            hint="the std of the motion of markers of the unloaded sensor",
        )  # fmt: skip
    return Markers(
        as_array(markers, where="markers"),
        noise,
        axes,
        None if slope is None else as_array(slope, where="markers, slope"),
    )


def windows(pad: Pad, depth: DepthMap, width: float | None) -> Depths:
    """Windows of a depth map about the nodes of the surface, off its rim."""
    inner = pad.nodes2d[~pad.edge]
    pitch = float(np.sqrt(np.median(pad.surface.areas[~pad.edge])))
    return Depths(depth, inner, pitch if width is None else float(width))
