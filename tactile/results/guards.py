"""Guards of force maps and of a gel in use: lost markers, resultants, rigid motion, N606, N610, W607, W705, W706.

A uniform shift of all markers is fitted by a shear of the whole surface, so that no residual shows it. But a load acts
near a contact, which stands out once the shift of most markers is taken off; and what the loads about it do not explain
of the markers far from it should be noise. The medians over cells as wide as the gel is thick are the data: a multiple
of the motion that these loads explain, a shift and a turn are fitted to them, and an F test asks whether shift and turn
explain more than chance. What scatters beyond the noise are errors of the model, which are alike over two thicknesses:
they count for a quarter of their number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, Spelling
from structures.flags import Evidence, Flag

from .forcemap import CLEAR, SHARE

PROVIDED = ("tracked", "measured", "completed")


def completed(provided: Mapping[str, str], source: str = "") -> Flag | None:
    """N606: a component of the motion was completed from an assumption.

    Parameters
    ----------
    provided : mapping of component to label
        ``{"x": "tracked", "y": "tracked", "z": "completed"}``.
    source : str
        What completed it: an indenter, a condition on the traction.
    """
    assumed = [name for name, label in provided.items() if label == "completed"]
    if not assumed:
        return None
    words = ", ".join(f"{name} {label}" for name, label in provided.items())
    return Flag(
        "N606",
        Evidence("components completed", ", ".join(assumed), "none"),
        f"{words}" + (f" from {source}" if source else ""),
        "do not validate with what supplied it; measure the normal motion where it decides",
    )


def resultant_output(method: str, numbers: int = 6) -> Flag:
    """N610: a method that gives resultants, and no map.

    Parameters
    ----------
    method : str
    numbers : int
        Resultants that it gives.
    """
    return Flag(
        "N610",
        Evidence("numbers in the output", numbers, "a map"),
        f"{method} gives {numbers} resultants: there is no map to plot",
        "compare it at level resultant only",
    )


SAME_SHAPE = 0.98  # correlation from which two maps have the same shape
GAIN = (0.9, 1.1)
SHAPE = 0.04  # share of a map that no gain explains, noise taken out
SIGNIFICANT = 4.0  # sd of the noise by which that share must stand out
DRIFT = 2.0  # rms offset of unloaded markers over what their noise explains
PERIOD = 30.0  # days


def drift(offset: float, expected: float, calibrated: datetime) -> Flag | None:
    """W607: markers of the unloaded gel do not lie where they lay when it was zeroed.

    Parameters
    ----------
    offset : float
        Rms offset of the unloaded markers (m).
    expected : float
        Rms offset that the noise explains (m).
    calibrated : datetime
    """
    if offset <= DRIFT * expected:
        return None
    return Flag(
        "W607",
        Evidence("rms offset of the unloaded markers in m", offset, DRIFT * expected),
        f"calibration of {calibrated:%Y-%m-%d}; unloaded offset {1e6 * offset:.3g} um, where noise explains "
        f"{1e6 * expected:.3g} um",
        "zero the sensor, then press again: magnitudes off by a constant mean E; a wrong shape means nu, thickness or "
        "boundary",
    )


def age(days: float, period: float, calibrated: datetime) -> Flag | None:
    """W607: the calibration is older than its period.

    Parameters
    ----------
    days, period : float
        Age of the calibration, and how old it may be.
    calibrated : datetime
    """
    if days <= period:
        return None
    return Flag(
        "W607",
        Evidence("age of the calibration in days", days, period),
        f"calibration date {calibrated:%Y-%m-%d}, {days:.0f} days ago",
        "repeat the reference presses with a known force",
    )


def change(gain: float, correlation: float, share: float, significance: float) -> str:
    """What has changed between two sets of maps: ``"shape"``, ``"gain"`` or ``"unchanged"``; as `gain_or_shape`."""
    if share > SHAPE and significance > SIGNIFICANT:
        return "shape"
    if GAIN[0] <= gain <= GAIN[1]:
        return "unchanged"
    return "shape" if correlation <= SAME_SHAPE and significance > SIGNIFICANT else "gain"


def gain_or_shape(gain: float, correlation: float, share: float, significance: float) -> Flag | None:
    """W705: the same presses give another gain (E), or another shape (thickness, boundary, nu).

    Parameters
    ----------
    gain : float
        Scale of the maps now over the reference.
    correlation : float
        Of the two, noise included.
    share : float
        Share of the map that no gain explains, with the noise taken out. A layer 15 % thinner keeps a correlation of
        0.996: this share is what tells it from a gain.
    significance : float
        By how many sd of the noise the share stands out.

    Notes
    -----
    Holds for displacements, and for force maps that are unregularised or have lambda relative to sigma_1.
    """
    found = change(gain, correlation, share, significance)
    if found == "shape" and share > SHAPE:
        return Flag(
            "W705",
            Evidence("share of the map that no gain explains", share, SHAPE),
            f"shape wrong: {share:.1%} of the map is no gain (correlation {correlation:.4f}, gain {gain:.3g})",
            "thickness (wear), boundary (a bond that lets go), Poisson's ratio, or presses at another place, in that "
            "order; E is not the cause",
        )
    if found == "unchanged":
        return None
    if found == "shape":
        return Flag(
            "W705",
            Evidence("correlation of the maps", correlation, SAME_SHAPE),
            f"shape wrong: correlation {correlation:.3f}, gain {gain:.3g}",
            "thickness, boundary, Poisson's ratio, or presses at another place",
        )
    return Flag(
        "W705",
        Evidence("gain of the maps", gain, GAIN[0] if gain < 1 else GAIN[1]),
        f"shape right (correlation {correlation:.4f}), gain {gain:.3g}: recheck E",
        f"E is off by a factor {1 / gain:.3g} if the force of the presses is right: calibrate the gain",
    )


def other_calibration(validated: datetime, calibrated: datetime) -> Flag | None:
    """W706: the validation is older than the calibration in use.

    Parameters
    ----------
    validated, calibrated : datetime
    """
    if validated >= calibrated:
        return None
    return Flag(
        "W706",
        Evidence("validated on", f"{validated:%Y-%m-%d}", f"{calibrated:%Y-%m-%d}"),
        f"validated on {validated:%Y-%m-%d} with another calibration than that of {calibrated:%Y-%m-%d}",
        "repeat the validation with the calibration in use",
    )


Array = NDArray[np.float64]
NEAR, FAR = 1.0, 2.0  # thicknesses from the contact: loads that count as its own, markers that it does not reach
CELLS = 5  # fewest with far markers
CHANCE = 1e-6  # of so large a motion in a frame at rest
UNKNOWNS = 3  # shift along X and Y, turn
ALIKE = 4  # cells that share an error of the model
MEDIAN = np.pi / 2  # variance of a median over that of a mean


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A shift (m) and a turn (rad) about a point (m), and what makes them more than chance.

    Parameters
    ----------
    shift, about : array (2,)
    turn : float
    ratio, threshold : float
        F statistic, and what chance exceeds once in a million frames.
    cells : int
        Cells of far markers that it stands on.
    """

    shift: Array
    turn: float
    about: Array
    ratio: float
    threshold: float
    cells: int

    def field(self, places: Array) -> Array:
        """In-plane motion (n, 2) in m of places (n, 2)."""
        x, y = (places - self.about).T
        return self.shift + self.turn * np.column_stack([-y, x])


def typical(motion: Array, noise: Array) -> Array:
    """Shift (2,) of most markers, the median of their motion (N, 2); zero where it is below their noise."""
    seen = np.isfinite(motion).all(axis=1)
    if not seen.any():
        return np.zeros(2)
    shift = np.median(motion[seen], axis=0)
    return np.asarray(shift if np.linalg.norm(shift) > np.sqrt(np.mean(noise**2)) else np.zeros(2))


def contact(load: Array, std: Array) -> NDArray[np.bool_]:
    """Nodes (P,) that are pressed, of loads (3 P,)."""
    pressure = -load[2::3]
    return np.asarray((pressure > SHARE * pressure.max(initial=0.0)) & (pressure > CLEAR * std[2::3]))


def away(
    motion: Array, explained: Callable[[NDArray[np.bool_]], Array], touched: NDArray[np.bool_], nodes: Array,
    markers: Array, noise: Array, thickness: float,
) -> RigidMotion | None:  # fmt: skip
    """Rigid motion of the markers that the contact does not reach; None where it is chance, or cannot be told.

    Parameters
    ----------
    motion : array (N, 2)
        In-plane motion of the markers (m), NaN where one is lost.
    explained : callable
        Takes a mask of nodes (P,) and returns the motion (N, 2) that their loads explain.
    touched : array of bool (P,)
        Nodes that are pressed.
    nodes, markers : array (P, 2), (N, 2)
        Places (m).
    noise : array (N, 2)
        Std of the motion (m).
    thickness : float
        Of the gel (m).
    """
    far, loaded = np.isfinite(motion).all(axis=1), np.zeros_like(motion)
    if touched.any():
        from scipy.spatial import cKDTree

        tree = cKDTree(nodes[touched])
        far &= tree.query(markers)[0] > FAR * thickness
        if far.any():
            loaded = explained(tree.query(nodes)[0] <= NEAR * thickness)
    found = _fitted(motion[far], loaded[far], markers[far], noise[far], thickness)
    if found is None or found.ratio <= found.threshold:
        return None
    size = np.sqrt(np.mean(found.field(markers[far]) ** 2))
    return found if size > np.sqrt(np.mean(noise[far] ** 2)) else None  # below the noise of one marker it is none


def _fitted(motion: Array, loaded: Array, places: Array, noise: Array, side: float) -> RigidMotion | None:
    """Rigid motion of the medians over cells of a side, beside a multiple of what the loads explain."""
    from scipy.special import fdtri

    if len(places) < CELLS:
        return None
    which = np.unique(np.floor(places / side).astype(int), axis=0, return_inverse=True)[1].ravel()
    members = [np.flatnonzero(which == k) for k in range(int(which.max()) + 1)]
    if len(members) < CELLS:
        return None
    data, known = (np.array([np.median(v[m], axis=0) for m in members]).T.ravel() for v in (motion, loaded))
    place = np.array([places[m].mean(axis=0) for m in members])
    about = place.mean(axis=0)
    x, y = (place - about).T
    one, zero = np.ones(len(members)), np.zeros(len(members))
    rigid = np.vstack([np.column_stack([one, zero, -y]), np.column_stack([zero, one, x])])
    other = known[:, None] if known.any() else np.empty((len(data), 0))
    without = _rest(other, data)
    answer = np.linalg.lstsq(_rest(other, rigid), without, rcond=None)[0]
    within = _rest(np.column_stack([other, rigid]), data)
    spare = len(data) - other.shape[1] - UNKNOWNS
    chance = float(np.mean([MEDIAN ** (len(m) > 2) * np.mean(noise[m] ** 2) / len(m) for m in members]))
    beyond = max(float(within @ within) / spare - chance, 0.0)
    variance = chance + ALIKE * beyond
    ratio = float(without @ without - within @ within) / UNKNOWNS / variance
    threshold = float(fdtri(UNKNOWNS, spare, 1 - CHANCE))
    return RigidMotion(np.asarray(answer[:2], float), float(answer[2]), about, ratio, threshold, len(members))


def _rest(columns: Array, values: Array) -> Array:
    """What columns do not explain of values, by least squares."""
    if columns.shape[1] == 0:
        return values
    scaled = columns / np.linalg.norm(columns, axis=0)
    return np.asarray(values - scaled @ np.linalg.lstsq(scaled, values, rcond=None)[0])


BIAS, LOST_SHARE = 0.02, 0.02
SEEN = 0.8  # share of a normal force that must be found
MISFIT = 5.0  # rms residual of the markers over their noise


def lost(rows: int, total: int) -> Flag | None:
    """W604: readings were lost in this frame."""
    share = rows / max(total, 1)
    if not share > LOST_SHARE:
        return None
    return Flag(
        "W604",
        Evidence("share of readings lost", share, LOST_SHARE),
        f"{rows} of {total} readings are missing in this frame; the map is exact for the others, its std is larger",
        "look at the image; where markers vanish under the contact the map there is the prior's",
    )


def strays(count: int) -> Flag | None:
    """W604: markers that contradict all others were left out."""
    if count == 0:
        return None
    return Flag(
        "W604",
        Evidence("markers that contradict all others", count, 0),
        f"{count} markers moved as no load moves them beside the others: they were left out, as other dots",
        "look at the frame; from frame to frame markers must move by less than half their pitch",
    )


def misfit(ratio: float) -> Flag | None:
    """W406: what is left of the motion is far above the noise of the markers."""
    if not ratio > MISFIT:
        return None
    return Flag(
        "W406",
        Evidence("rms residual of the markers over their noise", ratio, MISFIT),
        f"the map leaves {ratio:.1f} times the noise of the markers unexplained; bands are widened by as much",
        "look at the order of the markers, the zero, thickness and nu, a lambda that is too large, or the noise stated",
    )


def moved(found: RigidMotion | None, force: NDArray, pixel: float | None) -> Flag | None:
    """W611: markers that no contact reaches moved together.

    Parameters
    ----------
    found : RigidMotion or None
    force : array (3,)
        What the map makes of this motion alone (N).
    pixel : float or None
        Side of a pixel on the pad (m).
    """
    if found is None:
        return None
    x, y = 1e6 * found.shift
    px = "" if pixel is None else f" ({np.linalg.norm(found.shift) / pixel:.2g} px)"
    fx, fy, fz = force
    return Flag(
        "W611",
        Evidence("F statistic of a rigid motion of the far markers", found.ratio, found.threshold),
        f"the markers that no contact reaches moved together by ({x:.3g}, {y:.3g}) um{px} and turned by "
        f"{np.degrees(found.turn):.2g} degrees: the force may be wrong by ({fx:.2g}, {fy:.2g}, {fz:.2g}) N, which is "
        "what this motion alone gives; no band shows it",
        "unload the sensor and zero() it again; fasten the camera and the gel",
    )


def taken(hidden: NDArray, resultant: NDArray, covariance: NDArray) -> Flag | None:
    """W608: regularisation is expected to have lowered the resultant by more than 2 % and more than its noise."""
    size = float(np.linalg.norm(resultant[:3]))
    if size == 0:
        return None
    along = resultant[:3] / size
    loss = -float(along @ hidden[:3]) / size
    noise = float(np.sqrt(max(along @ covariance[:3, :3] @ along, 0.0))) / size
    if not (loss > BIAS and loss > noise):
        return None
    return Flag(
        "W608",
        Evidence("share of the resultant lost", loss, BIAS),
        f"regularisation lowers the resultant by {100 * loss:.1f} %",
        Advice(
            "give the resultant of a force/torque sensor (",
            Spelling("wrench=", "in Python: wrench="),
            "), or take a smaller lambda",
            Spelling("", " (--lam)"),
        ),
    )


def unseen(share: float, limit: float = SEEN) -> Flag | None:
    """W608: of a plain press in the middle of the pad a good part of its force would not be found.

    Parameters
    ----------
    share : float
        Of the normal force of a press as wide as the pad is thick, without noise.
    limit : float
    """
    if share >= limit:
        return None
    return Flag(
        "W608",
        Evidence("share of a normal force that would be found", share, limit),
        f"of a press as wide as the pad is thick {100 * share:.0f} % of the normal force would be found: the readings "
        "or the penalty hide the rest, and no band shows it",
        "measure the normal motion (a depth map, markers in depth), or take a smaller lambda",
    )


def stopped(converged: bool, steps: int) -> Flag | None:
    """W410: the constrained solver ended on its limit."""
    if converged:
        return None
    return Flag(
        "W410",
        Evidence("Newton steps", float(steps)),
        "the constrained map was not solved to the end in this frame",
        "leave the friction cone out, or choose a larger lambda",
    )


def too_deep(error: float, limit: float = 0.3) -> Flag | None:
    """W304: noise alone makes more than 30 % error of the forces, without regularisation."""
    if not error > limit:
        return None
    return Flag(
        "W304",
        Evidence("expected relative error of the forces", error, limit),
        f"the markers lie too deep for the pitch of the forces: noise alone would make {100 * error:.0f} % error",
        "markers nearer to the surface, a coarser grid of forces, or regularisation (choice=None)",
    )
