"""Settings of sensors that belong together, and the spellings of version 0.1, which gave them one by one."""

from __future__ import annotations

import functools
import inspect
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from loadid._inverse.problem import NoiseSourceLike
from structures.errors import InputError, plain, positive

from .._arrays import Index
from .observation import Markers


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
        given = np.asarray(plain(self.support))
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


class InversionSettings(TypedDict, total=False):
    """Settings of every linear sensor.

    Attributes
    ----------
    penalty : str or matrix
        ``identity`` (ridge; point-like contacts), ``gradient`` or ``laplacian`` (smooth ones), as `StaticInversion`;
        None for plain least squares.
    choice : str, float or None
        Rule for lambda, or a relative lambda; `calibrate` freezes it. None takes UPRE at the noise of the markers, or
        GCV where the data show that this is not all there is (errors of the mesh, a level that is too low).
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
