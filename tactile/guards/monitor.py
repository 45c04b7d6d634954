"""Guards of a gel in use: W607 drift and age, W705 wrong gain or shape, W706 validated with another calibration."""

from __future__ import annotations

from datetime import datetime

from structures.flags import Evidence, Flag

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
