"""What every sensor with markers shares: its settings, frames to readings, zero, streams.

Release 0.1 gave the settings that belong together one by one; `spelled_before` takes these spellings.
"""

from __future__ import annotations

import functools
import inspect
import logging
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Self, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loadid._inverse.problem import NoiseSourceLike
from loadid.codes import collect
from structures._flags import Flag
from structures.errors import InputError, as_array, pair, positive

from .. import _guards as guards
from .._arrays import CONTACT, SIDE, THICKNESS, Array, Index, UnusableFrame, settled_depth, shaped
from .._results.forcemap import ForceMap
from ..vision._frames import Frames, each
from .observation import DepthMap, Depths, Markers, Wrench

if TYPE_CHECKING:
    from .._pad.pad import Pad
    from ..vision._eye import Eye

FEWEST = 3  # markers of a frame
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class ContactLaw:
    """What is known of the contact before any reading.

    Parameters
    ----------
    no_pull : bool
        Pressures are not negative.
    friction : float, optional
        Coefficient of friction: tractions stay in their cone.
    support : array, optional
        Nodes of the surface that may be loaded: a mask (P,) or their numbers. The others carry nothing.

    Raises
    ------
    InputError
        A coefficient that is not positive.
    """

    no_pull: bool = False
    friction: float | None = None
    support: ArrayLike | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "no_pull", bool(self.no_pull))
        if self.friction is not None:
            value = positive("the friction coefficient", self.friction, where="friction")
            object.__setattr__(self, "friction", value)

    @property
    def constrains(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.no_pull or self.friction is not None

    def loads(self, points: int) -> Index | None:
        """Loads (3 k,) at the nodes that may be loaded, of a surface of `points` nodes; None is all.

        Raises
        ------
        InputError
            A support that does not fit, or is empty.
        """
        if self.support is None:
            return None
        given = as_array(self.support, where="support")
        mask = given.dtype == bool
        nodes = np.flatnonzero(given) if mask else np.unique(given)
        known = given.dtype.kind in "iu" and np.all((nodes >= 0) & (nodes < points))
        if not (given.shape == (points,) if mask else known) or nodes.size == 0:
            raise InputError(
                "the support does not fit the surface", where="support", found=f"{given.dtype} {given.shape}",
                expected=f"a mask ({points},) or numbers of nodes, not empty",
            )  # fmt: skip
        return (3 * nodes[:, None] + np.arange(3)).ravel()


@dataclass(frozen=True)
class Extent:
    """How large the pad under a closed form is, which knows neither base nor edge.

    Parameters
    ----------
    thickness, contact_radius : float, optional
        Of the pad and of the contacts expected (m): a half-space is flagged above a/t = 0.1 (W601) and refused above
        0.3 (E602).
    size : (a, b), optional
        Sides of the pad (m): contacts nearer to its edge than four thicknesses are flagged (W601).
    """

    thickness: float | None = None
    contact_radius: float | None = None
    size: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.thickness is not None:
            THICKNESS.positive("the thickness", self.thickness, where="Extent")
        if self.contact_radius is not None:
            CONTACT.positive("the contact radius", self.contact_radius, where="Extent")
        for side in () if self.size is None else pair("size", self.size, where="Extent", unit="m"):
            SIDE.positive("a side", side, where="Extent, size")


class InversionSettings(TypedDict, total=False):
    """Settings of every linear sensor.

    Attributes
    ----------
    penalty : ContactPrior, str or matrix
        `tactile.ContactPrior` (presses anywhere, of any radius between two); ``identity`` (ridge; loads that are
        points), ``gradient`` or ``laplacian`` (smooth ones), as `StaticInversion`; None for plain least squares.
    choice : str, float or None
        Rule for lambda, or a relative lambda; `calibrate` freezes it. None takes under a contact prior the middle one
        of UPRE, GCV and the evidence; else UPRE at the noise of the markers, or GCV where the data show that this is
        not all there is (errors of the mesh, a level that is too low).
    noise_source : NoiseSource, str or (str, str)
        Where the noise level comes from, as in `loadid.StaticInversion`.
    contact : ContactLaw
    allow : sequence of str
        Guard codes whose refusal is overridden.
    """

    penalty: Any
    choice: Any
    noise_source: NoiseSourceLike
    contact: ContactLaw
    allow: Sequence[str]


def _markers(points: Any, eye: Any, **given: Any) -> Markers:
    """Markers of 0.1: what was not given of them is that of the eye, where there is one."""
    given = {key: value for key, value in given.items() if value is not None}
    if eye is not None:
        points = eye.markers if points is None else points
        given = {"noise": eye.noise, "slope": eye.slope, **given}
    if points is None or "noise" not in given:
        raise unknown_markers(points is not None)
    return Markers(points, **given)


def unknown_markers(placed: bool) -> InputError:
    """Neither markers nor an eye say where the markers are, or how noisy their motion is."""
    return InputError(
        "it is not known where the markers are, or how noisy their motion is", where="sensor",
        found="places without a noise" if placed else "neither markers nor an eye",
        expected="Markers(points (N, 2) in m, noise= their std in m), or an eye that knows both",
        hint="the std of the motion of markers of the unloaded sensor",
    )  # fmt: skip


GROUPS: dict[str, tuple[type, tuple[str, ...]]] = {
    "markers": (Markers, ("noise", "axes", "slope")),
    "contact": (ContactLaw, tuple(f.name for f in fields(ContactLaw))),
    "extent": (Extent, tuple(f.name for f in fields(Extent))),
}


def spelled_before(*groups: str, **defaults: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Constructors that take as one setting what 0.1 took one by one: the old keywords go on working, with a word.

    `defaults` are those that 0.1 had of them, where they differ now.
    """

    def wrap(init: Callable[..., None]) -> Callable[..., None]:
        names = list(inspect.signature(init).parameters)

        @functools.wraps(init)
        def settled(owner: Any, *args: Any, **given: Any) -> None:
            for group in groups:
                kind, keys = GROUPS[group]
                old = {key: given.pop(key) for key in keys if key in given}
                if not old:
                    continue
                inside = ", ".join(["points"] * (kind is Markers) + [f"{key}=..." for key in old])
                before = f"{type(owner).__name__}, {' and '.join(f'{key}=' for key in old)}"
                now = f"spelled {group}={kind.__name__}({inside}) from version 0.2 on"
                warnings.warn(f"{before}: {now}", DeprecationWarning, stacklevel=2)
                given |= dict(zip(names[1:], args, strict=False))
                args = ()
                if kind is Markers:
                    given[group] = _markers(given.get(group), given.get("eye"), **{**defaults, **old})
                else:
                    given[group] = kind(**old)
            init(owner, *args, **given)

        return settled

    return wrap


class MarkedSensor:
    """A pad with markers: frames to readings, zero, streams; `estimate` is that of each kind.

    Parameters
    ----------
    markers : Markers, optional
        Those of the eye where not given; places alone take its noise.
    eye : Eye, optional
        Turns images into motion.
    depth : Depths, optional
        Windows of a depth map that is measured beside the markers.
    contact : ContactLaw
    """

    name = "tactile sensor"

    def __init__(
        self, markers: Markers | ArrayLike | None, eye: Eye | None, depth: Depths | None, contact: ContactLaw
    ) -> None:
        self.markers, self.eye, self.depth, self.contact = observed(markers, eye), eye, depth, contact
        self._offset = np.zeros(self.markers.readings_count + (0 if depth is None else len(depth.points)))

    @property
    def constrained(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.contact.constrains

    @property
    def offset(self) -> Array:
        """What is taken off the readings of every frame (m,) in m, markers first: the zero, as `zero` finds it."""
        return self._offset.copy()

    @offset.setter
    def offset(self, values: ArrayLike) -> None:
        self._offset = shaped(values, self._offset.shape, where="offset", what="no zero of this sensor")

    def estimate(self, found: ArrayLike, depth: DepthMap | None = None) -> ForceMap:
        """Force map of one frame."""
        raise NotImplementedError

    def follow(self, found: ArrayLike, depth: DepthMap | None = None) -> ForceMap:
        """Force map of one of many frames, as fast as this sensor can."""
        return self.estimate(found, depth)

    def stream(self, frames: Iterable[Any], depths: Iterable[DepthMap] | None = None) -> ForceStream:
        """Force maps of frames, one after another, as they come; dead frames are left out, see `ForceStream`.

        `frames` are images or motions, as `estimate` takes them, or `tactile.frames(...)` of a folder, video or camera.
        """
        return ForceStream(self, frames, depths)

    def zero(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None) -> Self:
        """Take the mean of unloaded frames as zero. Returns the sensor.

        Raises
        ------
        InputError
            Without frames.
        """
        self._offset = np.zeros_like(self._offset)
        listed = self._listed(frames, depths)
        if not listed:
            raise InputError("no frames to take zero from", where="zero", found="none", expected="unloaded frames")
        stack = np.array(listed)
        known = np.isfinite(stack)
        self._offset = np.where(known, stack, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        return self

    def readings(self, found: ArrayLike, depth: DepthMap | None = None) -> Array:
        """Readings (m,) of a frame, markers first, zero taken off; NaN where lost."""
        y = self._readings(found, depth)[0]
        self._require_depth(y)
        return y

    def _listed(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None) -> list[Array]:
        return [self._readings(f, None if depths is None else depths[i])[0] for i, f in enumerate(frames)]

    def _gel(self) -> Pad | None:
        """The pad, where there is one that has a base and edges."""
        return None

    def _of_frame(
        self, found: ArrayLike, depth: DepthMap | None, wrench: Wrench | None
    ) -> tuple[Array, list[Flag | None]]:
        """Readings of a frame of which something is seen, and what was found on the way."""
        y, flags = self._readings(found, depth)
        self._require_depth(y)
        pad = self._gel()
        if wrench is not None and pad is not None and pad.material == "elastomer":
            wrench.require_scale(pad.E, pad.nu, pad.size, pad.thickness)
        left = int(np.sum(np.isfinite(y[: self.markers.readings_count]))) // len(self.markers.axes)
        if left < FEWEST:
            raise UnusableFrame(
                "too few markers are left in this frame", where="frame", found=left, expected=f"at least {FEWEST}",
                hint="look at the image: light, focus, occlusion",
            )  # fmt: skip
        return y, flags

    def _require_depth(self, y: Array) -> None:
        """Refuse a depth map that no press makes of the pad."""
        pad, deep = self._gel(), y[self.markers.readings_count :]
        if pad is not None and self.depth is not None and np.isfinite(deep).any():
            settled_depth(float(np.nanmin(deep)), float(np.nanmax(deep)), pad.thickness, self.depth.noise)

    def _readings(self, found: ArrayLike, depth: DepthMap | None) -> tuple[Array, list[Flag | None]]:
        """Readings, NaN where there is none, and what was found on the way."""
        if found is None:
            raise UnusableFrame("no image", where="frame", found="nothing", expected="an image, or motion of markers")
        seen: Any = as_array(found, where="frame")
        flags: list[Flag | None] = []
        count = len(self.markers)
        _refuse_turned(seen, count)
        if is_image(seen, count):
            if self.eye is None:
                raise InputError(
                    "this sensor has no eye: it cannot read images", where="frame", found=f"an image {seen.shape}",
                    expected="displacements (markers, 2 or 3) in m",
                    hint="build it with eye=tactile.Eye(view, reference)",
                )  # fmt: skip
            seen, flags = self.eye.read(seen, depth)
        parts = [self.markers.readings(seen)]
        if self.depth is not None:
            parts.append(np.full(len(self.depth.points), np.nan) if depth is None else self.depth.readings(depth))
        elif depth is not None and self.eye is None:
            raise not_built_for_depth()
        return np.concatenate(parts) - self._offset, flags


class ForceStream:
    """Force maps of frames as they come: an iterator.

    A frame that tells nothing (black, saturated, of another size, unreadable, None, fewer than three markers) has no
    map: nothing is held or invented for it. The next map says so by W604 and names it, and so do `skipped` and the log.
    Frames of which none is answered end in the error of the first.

    Attributes
    ----------
    number : int
        Of the frame that was read last, from 1: after a map, its own.
    time : float or None
        Its stamp (s), where the source has one.
    skipped : tuple of int
        Numbers of the frames that were left out.
    """

    def __init__(self, sensor: MarkedSensor, frames: Iterable[Any], depths: Iterable[DepthMap] | None) -> None:
        self._sensor, self._source = sensor, frames
        self._frames = each(frames)
        self._depths = None if depths is None else iter(depths)
        self._lost: list[int] = []
        self._first: InputError | None = None
        self._answered = False
        self.number = 0
        self.time: float | None = None

    @property
    def skipped(self) -> tuple[int, ...]:
        """Numbers of the frames that were left out, from 1."""
        return tuple(self._lost)

    def __iter__(self) -> ForceStream:
        return self

    def __next__(self) -> ForceMap:
        before, why = len(self._lost), ""
        while True:
            frame, depth = self._pair()
            try:
                if isinstance(frame, UnusableFrame):
                    raise frame
                found = self._sensor.follow(frame, depth)
            except UnusableFrame as error:
                self._first, why = self._first or error, why or error.what
                self._lost.append(self.number)
                _LOG.warning("frame %d left out: %s", self.number, error)
                continue
            self._answered = True
            gap = guards.skipped(self._lost[before:], why)
            return found if gap is None else replace(found, flags=collect([*found.flags, gap]))

    def _pair(self) -> tuple[Any, DepthMap | None]:
        """The next frame and its depth map; both sources end together."""
        end: Any = object()
        frame = next(self._frames, end)
        depth = None if self._depths is None else next(self._depths, end)
        if frame is end and (depth is end or depth is None):
            if self._first is not None and not self._answered:
                raise self._first
            raise StopIteration
        if frame is end or depth is end:
            raise InputError(
                "frames and depth maps do not go together", where=f"frame {self.number + 1}",
                found=f"no {'frame' if frame is end else 'depth map'} {self.number + 1}",
                expected="one depth map for each frame",
            )  # fmt: skip
        self.number += 1
        self.time = self._source.time if isinstance(self._source, Frames) else None
        return frame, depth


def observed(markers: Markers | ArrayLike | None, eye: Eye | None) -> Markers:
    """Markers as a user gave them, or as an eye sees them; refused where neither gives them, or their noise."""
    if isinstance(markers, Markers):
        return markers
    if eye is None:
        raise unknown_markers(markers is not None)
    return Markers(eye.markers if markers is None else markers, eye.noise, slope=eye.slope)  # type: ignore[arg-type]


def is_image(found: NDArray[Any], markers: int) -> bool:
    """Whether an array is a picture: bytes, three axes, or more columns than a motion has."""
    if found.dtype == np.uint8 or found.ndim == 3:
        return True
    return found.ndim == 2 and found.shape[1] > 3 and len(found) != markers


def _refuse_turned(seen: NDArray[Any], markers: int) -> None:
    """Many frames at once, and motions with rows and columns swapped, are no images."""
    if seen.dtype == np.uint8:
        return
    if seen.ndim == 3 and seen.shape[1:] in ((markers, 2), (markers, 3)):
        raise InputError("many frames at once", where="frame", found=f"shape {seen.shape}",
                         expected=f"({markers}, 2 or 3)", hint="sensor.stream(frames)")  # fmt: skip
    if seen.ndim == 2 and seen.shape in ((2, markers), (3, markers)) and seen.shape[0] != markers:
        raise InputError("rows and columns are swapped", where="displacements", found=f"shape {seen.shape}",
                         expected=f"({markers}, {seen.shape[0]})", hint="motion.T")  # fmt: skip


def not_built_for_depth() -> InputError:
    """A depth map for a sensor that expects none."""
    return InputError(
        "this sensor was not built for a depth map", where="depth", found="a depth map", expected="none",
        hint="build it with depth= a map of the kind that it will see",
    )  # fmt: skip
