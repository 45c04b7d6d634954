"""Guards of a force map: what was lost, what regularisation took from its resultant, markers that lie too deep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, Spelling
from structures.flags import Evidence, Flag

from ..rigid import RigidMotion

BIAS, SHARE = 0.02, 0.02
SEEN = 0.8  # share of a normal force that must be found
MISFIT = 5.0  # rms residual of the markers over their noise


def lost(rows: int, total: int) -> Flag | None:
    """W604: readings were lost in this frame."""
    share = rows / max(total, 1)
    if not share > SHARE:
        return None
    return Flag(
        "W604",
        Evidence("share of readings lost", share, SHARE),
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
