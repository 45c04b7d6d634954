"""Guards of spectral targets and of drives under limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures._flags import Evidence, Flag

OUTSIDE = 0.05  # share of sensors and lines outside the tolerance that no drives of these shakers avoid
COST = 0.5  # dB rms that limits may cost
RIGID = 0.9  # share of the power of sensors around a point that a rigid motion explains
PLACED = 3.0  # power over that of the noise; 1.0 where all is right, 6 for hits 1 mm off and FRFs to 1 %


def unreachable(error: NDArray[np.float64], tolerance: float, names: tuple[str, ...]) -> Flag | None:
    """W317: no drives at these places reach the target, whatever their power.

    Parameters
    ----------
    error : array, shape (lines, sensors)
        dB, of the best drives without any limit.
    """
    out = np.abs(error) > tolerance
    share = float(np.mean(out))
    if share <= OUTSIDE:
        return None
    worst = int(np.argmax(out.mean(axis=0)))
    rms = float(np.sqrt(np.mean(error**2)))
    return Flag(
        "W317",
        Evidence(f"share of sensors and lines outside {tolerance:g} dB without limits", share, OUTSIDE),
        f"the target cannot be reached: the best that these loads do is {rms:.2g} dB rms off, and {share:.0%} of the "
        f"sensors and lines stay outside {tolerance:g} dB, most at {names[worst]} ({out[:, worst].mean():.0%})",
    )


def held_back(free: NDArray[np.float64], held: NDArray[np.float64], bound: tuple[str, ...]) -> Flag | None:
    """W316: limits keep the drives from the target.

    Parameters
    ----------
    free, held : array, shape (lines, sensors)
        Error in dB without the limits and under them.
    bound : tuple of str
        The limits that are met, in words.
    """
    before, after = (float(np.sqrt(np.mean(x**2))) for x in (free, held))
    if not bound or after - before <= COST:
        return None
    return Flag(
        "W316",
        Evidence("rms error that the limits add, dB", after - before, COST),
        f"limits hold the response back: {after:.2f} dB rms off the target, {before:.2f} without them "
        f"({'; '.join(bound[:4])})",
    )


def alone(channels: int) -> Flag:
    """E221 overridden: autospectra were taken for a matrix of cross spectra."""
    return Flag(
        "E221", Evidence("channels without any cross spectrum", float(channels), 1.0),
        f"the cross spectra of {channels} channels were taken for zero: no responses of one structure are so",
    )  # fmt: skip


def coupled(matrix: NDArray[np.complex128]) -> bool:
    """Whether any two channels that move have a cross spectrum; True for a single channel."""
    power = np.einsum("kii->ki", matrix).real
    moving = np.any(power > 0, axis=0)
    if np.sum(moving) < 2:
        return True
    off = matrix[:, ~np.eye(matrix.shape[1], dtype=bool)]
    return bool(np.any(off))


def not_rigid(name: str, share: NDArray[np.float64], frequencies: NDArray[np.float64]) -> Flag | None:
    """W119: the sensors around a virtual point move in ways that no rigid part does.

    Parameters
    ----------
    share : array, shape (lines,)
        Of their power that a rigid motion explains.
    """
    low = share < RIGID
    if np.mean(low) <= OUTSIDE:
        return None
    return Flag(
        "W119",
        Evidence(f"share of the lines on which {name} is not rigid", float(np.mean(low)), OUTSIDE),
        f"around {name} a rigid motion explains less than {RIGID:.0%} of the power on {np.mean(low):.0%} of the lines, "
        f"from {frequencies[low][0]:.4g} Hz on (least {share.min():.0%})",
    )


def misplaced(name: str, ratio: float | None) -> Flag | None:
    """W119: the FRFs of the loads around a virtual point contradict their places.

    Parameters
    ----------
    ratio : float or None
        Power of what they do as on no rigid part, over that of their noise; None where that is not known.
    """
    if ratio is None or ratio <= PLACED:
        return None
    return Flag(
        "W119",
        Evidence(f"contradiction of the loads around {name} over their noise, power", ratio, PLACED),
        f"the loads around {name} act as on no rigid part with the places stated: their FRFs contradict each other "
        f"{ratio:.3g} times more than noise does, and the moments at {name} are off by more than their band",
        "measure the places and directions of the hits again (millimetres matter), or take them as single forces",
    )
