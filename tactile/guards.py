"""Guards of pads, materials (E110, W111, W112, W113, W115) and images (E603, W604, W605, W406 of a codec)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from structures.advice import Advice, Spelling
from structures.errors import InputError, integer
from structures.flags import Evidence, Flag


def one_of_two(rate: str, linear: str) -> Flag | None:
    """W113: of rate independence and linearity, not both were tested.

    Parameters
    ----------
    rate, linear : str
        Verdicts of the two tests; "not tested" where there was none.
    """
    tested = [name for name, verdict in (("rate independence", rate), ("linearity", linear)) if verdict != "not tested"]
    if len(tested) == 2:
        return None
    missing = "linearity" if tested == ["rate independence"] else "rate independence"
    message = (
        f"{tested[0]} was tested, {missing} was not: neither shows the other"
        if tested
        else "neither rate independence nor linearity was tested"
    )
    return Flag(
        "W113",
        Evidence("tests of rate independence and linearity", len(tested), 2),
        message,
        "repeat at speeds that span a factor of 3 or more; load to the strain that will be used, 5 points or more",
    )


SOFTEST, STIFFEST = 1e3, 1e7  # Pa, elastomers
LINEAR = 0.1  # principal strain up to which small-strain theory is taken
ENOUGH = 3  # layers from which on W115 is silent
MOST, NAMES = 10**9, ("cells", "nodes")
# Relative map error of the exact displacements of a Hertz patch (a = h) read with n layers: at nu .3223, .475, .49
# (tests/benchmarks/tactile_pad.py prints it)
MAP_ERROR = {1: (0.54, 2.6, 6.2), 2: (0.13, 0.64, 1.6)}


def modulus(E: float) -> Flag | None:
    """W111: a modulus that no elastomer has.

    Parameters
    ----------
    E : float
        Young's modulus of the pad (Pa).
    """
    if SOFTEST <= E <= STIFFEST:
        return None
    threshold = SOFTEST if E < SOFTEST else STIFFEST
    return Flag(
        "W111",
        Evidence("Young's modulus in Pa", E, threshold),
        f"E = {E:.4g} Pa is outside the range of elastomers, 1 kPa to 10 MPa; E is a pure gain: a factor 1000 here is "
        "a factor 1000 in every force, and no residual shows it",
        "check the unit and the decimal point; one press with a known force settles the gain",
    )


def large_strain(strain: float) -> Flag | None:
    """W112: strain beyond what linear elasticity describes.

    Parameters
    ----------
    strain : float
        Largest principal strain of the reconstructed field, by size (1).
    """
    if abs(strain) <= LINEAR:
        return None
    return Flag(
        "W112",
        Evidence("largest principal strain", abs(strain), LINEAR),
        f"linear range exceeded: principal strain of {100 * abs(strain):.1f} % in the reconstructed field; large "
        "strain is outside what this version models",
        "press less hard, or take the map as an estimate to that order",
    )


def too_coarse(layers: int, nu: float, element: str) -> Flag | None:
    """W115: too few layers of elements through the thickness for a map of tractions.

    Parameters
    ----------
    layers : int
        Elements through the thickness.
    nu : float
        Poisson's ratio.
    element : str
        As in `structures.elements.solids.block`.
    """
    if layers >= ENOUGH:
        return None
    low, high, top = MAP_ERROR[layers]
    plain = f"{100 * low:.0f} % at nu = 0.32 and, with plain bricks, {100 * high:.0f} to {100 * top:.0f} % near 0.48"
    return Flag(
        "W115",
        Evidence("layers through the thickness", layers, ENOUGH),
        ("single layer" if layers == 1 else f"{layers} layers")
        + f": resultants may pass while the map of a patch as wide as the pad is thick is wrong by {plain} "
        f"(nu = {nu:g}, {element} here)",
        Advice(
            Spelling("layers=4 with B-bar elements", "in the pad file, [pad] layers = 4"),
            ", or compare once with displacements of a finer pad",
        ),
    )


def counts(
    cells: int, nodes: int, *, layers: int = 1, boundary_edges: int | None = None, where: str = "mesh counts"
) -> None:
    """E110: element and node counts that no conforming mesh of hexahedral layers can have.

    Parameters
    ----------
    cells, nodes : int
        Hexahedra and nodes of the whole pad.
    layers : int
        Layers of cells through the thickness.
    boundary_edges : int, optional
        Edges of the outline of one layer; without it every outline is tried.
    where : str
        Named in the error.

    Raises
    ------
    InputError
        Code LID-E110.

    Notes
    -----
    Euler's formula for a simply connected surface of Q quadrilaterals with B boundary edges: V = Q + B/2 + 1 nodes. The
    outline has 4 to 2 Q + 2 edges, an even number.
    """
    quads, rest = divmod(cells, layers)
    if rest:
        raise _impossible(where, f"{cells} cells in {layers} layers", "the same number of cells in every layer")
    low, high = (layers + 1) * (quads + 3), (layers + 1) * (2 * quads + 2)
    if boundary_edges is not None:
        if boundary_edges % 2 or not 4 <= boundary_edges <= 2 * quads + 2:
            raise _impossible(
                where,
                f"an outline of {boundary_edges} edges around {quads} quadrilaterals",
                f"an even number from 4 to {2 * quads + 2}",
            )
        low = high = (layers + 1) * (quads + boundary_edges // 2 + 1)
    if low <= nodes <= high and nodes % (layers + 1) == 0:
        return
    expected = f"{low} nodes" if low == high else f"{low} to {high} nodes, a multiple of {layers + 1}"
    raise _impossible(where, f"{cells} cells in {layers} layer{'s'[: layers > 1]} and {nodes} nodes", expected)


def published(pair: Any, layers: Any) -> None:
    """E110 for the counts that a publication gives for its mesh.

    Parameters
    ----------
    pair : (cells, nodes)
    layers : int
        Layers of the pad that stands for it.

    Raises
    ------
    InputError
        If they are no two positive integers; code LID-E110 as `counts`.
    """
    found = list(pair) if isinstance(pair, tuple | list) else []
    if len(found) != 2:
        raise InputError("counts of a mesh are two", where="Pad, counts", found=repr(pair), expected="(cells, nodes)")
    cells, nodes = (integer(n, v, where="Pad, counts", limit=MOST) for n, v in zip(NAMES, found, strict=True))
    deep = integer("layers", layers, where="Pad, layers", limit=MOST)
    counts(cells, nodes, layers=deep, where="Pad, counts")


def _impossible(where: str, found: str, expected: str) -> InputError:
    return InputError(
        "these element and node counts cannot be one conforming mesh",
        where=where,
        found=found,
        expected=expected + " (Euler's formula)",
        hint="do not rebuild a mesh from published counts: give size and pitch, or the mesh file",
        code="LID-E110",
    )


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
    from loadid.guards.measurement import CORRELATED

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
