"""Guards of the way from images to displacements: E603, W604, W605, and W406 of a noise level that a codec made."""

from __future__ import annotations

from collections.abc import Sequence

from structures.advice import Advice, Spelling
from structures.errors import InputError
from structures.flags import Evidence, Flag

REJECTED = 0.02  # share of the markers
FROZEN = 0.05  # share of exact repetitions among successive places of a dot
RAYS = "viewing angle and index"
PROJECTION = (
    "image motion mixes tangential motion with the shift of projection, d tan(beta), beta = arcsin(sin(alpha) / gamma)"
)
CALIBRATE = (
    "calibrate the viewing angle and the index of refraction, give the normal motion, and subtract the shift; "
    "otherwise report the motion in the image only"
)


def tangential(optics_known: bool, normal_known: bool, *, allow: Sequence[str] = ()) -> Flag | None:
    """E603: tangential motion or load claimed while the shift of projection is unknown.

    Parameters
    ----------
    optics_known : bool
        Whether viewing angle and index are known (`View.knows_rays`).
    normal_known : bool
        Whether the normal motion of the markers is given.
    allow : sequence of str
        ``("E603",)`` turns the refusal into a flag.

    Raises
    ------
    InputError
        With code ``LID-E603``, where it is not allowed.
    """
    if optics_known and normal_known:
        return None
    missing = [words for words, known in ((RAYS, optics_known), ("normal motion", normal_known)) if not known]
    if any(code.upper().removeprefix("LID-") == "E603" for code in allow):
        return Flag("E603", Evidence("missing", " and ".join(missing)), PROJECTION, CALIBRATE)
    raise not_tangential(missing)


def not_tangential(missing: Sequence[str]) -> InputError:
    """E603 as an error to raise.

    Parameters
    ----------
    missing : sequence of str
        What is not known.
    """
    return InputError(
        f"tangential motion cannot be told from the image: {PROJECTION}",
        where="tangential motion",
        found=f"not known: {' and '.join(missing)}",
        hint=Advice(f"{CALIBRATE}; ", Spelling("allow=['E603']", "--allow E603"), " overrides"),
        code="LID-E603",
    )


def vanished(markers: int, lost: int, rejected: int, unmatched: int) -> Flag | None:
    """W604: markers without a motion in this frame.

    Parameters
    ----------
    markers : int
        Markers of the pattern.
    lost : int
        Those without a dot near their prediction.
    rejected : int
        Those whose dot was refused.
    unmatched : int
        Dots that are no marker's.
    """
    gone = lost + rejected
    if gone <= REJECTED * markers:
        return None
    return Flag(
        "W604",
        Evidence("share of the markers without a motion", gone / markers, REJECTED),
        f"{rejected} of {markers} markers rejected, {lost} lost, {unmatched} dots unmatched; none of them is filled in",
        "track every frame, leave their nodes out, and carry the covariance of the interpolation",
    )


def leapt(step: float, pitch: float, frame: int) -> Flag | None:
    """W604: from one frame to the next the dots moved so far that a neighbour could have taken their place.

    Parameters
    ----------
    step : float
        Median motion of the pattern from one frame to the next, px.
    pitch : float
        Distance of neighbouring dots, px.
    frame : int
        Number of the frame, from 1.
    """
    if not step > 0.5 * pitch:
        return None
    return Flag(
        "W604",
        Evidence("motion of one frame over the pitch", step / pitch, 0.5),
        f"in frame {frame} the dots moved by {step:.1f} px, more than half of their distance ({pitch:.1f} px): from "
        "there on a marker may be its neighbour",
        "take more frames per second, or move more slowly; start again from an unloaded frame",
    )


def interpolation_noise(nodes: int, effective: float, rank: int) -> Flag | None:
    """W605: interpolation onto nodes correlates the noise (W203 on the marker field).

    Parameters
    ----------
    nodes : int
        Nodes that carry an interpolated value.
    effective : float
        Effective number of values, (tr C)^2 / tr(C^2) of the correlation matrix C of their noise.
    rank : int
        Rank of C.
    """
    from loadid.flags.measurement import CORRELATED

    if rank == nodes and effective > CORRELATED * nodes:
        return None
    return Flag(
        "W605",
        Evidence("effective number of values", effective, CORRELATED * nodes),
        f"{nodes} interpolated values carry the information of {effective:.1f}; rank of their noise covariance {rank}",
        "invert on the markers themselves, or carry the covariance W Sigma W^T and whiten on its range",
    )


def frozen(repeated: float, *, source: str = "") -> Flag | None:
    """W406: a noise level from frames that repeat, as a lossy codec makes them.

    Parameters
    ----------
    repeated : float
        Share of places of dots that are exactly those of the frame before.
    source : str
        What the frames are.
    """
    if not repeated > FROZEN:
        return None
    return Flag(
        "W406",
        Evidence("share of dots that stand exactly still", repeated, FROZEN),
        f"{source or 'the unloaded frames'}: {repeated:.0%} of the dots are where they were to the last digit; a lossy "
        "codec freezes still areas, and their jitter says nothing about the camera",
        "measure the noise on uncompressed images (PNG, NPY), or state it",
    )


def lossy(codec: str) -> Flag:
    """W406: frames from a lossy codec.

    Parameters
    ----------
    codec : str
        Its four letters.
    """
    return Flag(
        "W406",
        Evidence("codec", codec),
        f"the video is compressed with loss ({codec}): motion may be read from it, a noise level may not",
        "measure the noise on uncompressed images (PNG, NPY), or state it",
    )


def missing_frames(missing: Sequence[int], folder: str) -> Flag | None:
    """W604: numbers that are missing in a folder of images.

    Parameters
    ----------
    missing : sequence of int
        Numbers that no file has.
    folder : str
        Name of the folder.
    """
    if not missing:
        return None
    shown = ", ".join(map(str, missing[:8])) + (", ..." if len(missing) > 8 else "")
    return Flag(
        "W604",
        Evidence("missing frames", float(len(missing)), 0.0),
        f"frames are missing in {folder}: {shown}; the motion over a gap counts as that of one frame",
        "copy the missing images, or split the sequence where they are missing",
    )
