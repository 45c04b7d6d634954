"""Guards of pads, materials, images, force maps and a gel in use, in the order of their codes' stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._advice import Advice, Spelling
from structures._flags import Evidence, Flag
from structures.errors import InputError, integer

from ._arrays import Array

if TYPE_CHECKING:
    from ._sensors.image import ImageShift


def above(code: str, name: str, value: float, limit: float, message: str, advice: str) -> Flag | None:
    """A flag where a value exceeds its limit."""
    return Flag(code, Evidence(name, value, limit), message, advice) if value > limit else None


# -- pad and material -------------------------------------------------------------------------------------------------
SOFTEST, STIFFEST = 1e3, 1e7  # Pa, elastomers
LINEAR = 0.1  # principal strain up to which small-strain theory is taken
ENOUGH = 3  # layers from which on W115 is silent
MOST, NAMES = 10**9, ("cells", "nodes")
# Relative map error of the exact displacements of a Hertz patch (a = h) read with n layers: at nu .3223, .475, .49
# (tests/benchmarks/tactile_pad.py prints it)
MAP_ERROR = {1: (0.54, 2.6, 6.2), 2: (0.13, 0.64, 1.6)}


def counts(
    cells: int, nodes: int, *, layers: int = 1, boundary_edges: int | None = None, where: str = "mesh counts"
) -> None:
    """E110: element and node counts of a whole pad that no conforming mesh of hexahedral layers can have.

    By Euler's formula for a simply connected surface of Q quadrilaterals with B boundary edges: V = Q + B/2 + 1 nodes.
    The outline of one layer has 4 to 2 Q + 2 edges, an even number; every one of them is tried where it is not given.
    """
    quads, rest = divmod(cells, layers)
    if rest:
        raise _impossible(where, f"{cells} cells in {layers} layers", "the same number of cells in every layer")
    edges = (4, 2 * quads + 2) if boundary_edges is None else (boundary_edges, boundary_edges)
    if edges[0] % 2 or edges[0] < 4 or edges[1] > 2 * quads + 2:
        found = f"an outline of {boundary_edges} edges around {quads} quadrilaterals"
        raise _impossible(where, found, f"an even number from 4 to {2 * quads + 2}")
    low, high = ((layers + 1) * (quads + e // 2 + 1) for e in edges)
    if not low <= nodes <= high or nodes % (layers + 1):
        expected = f"{low} nodes" if low == high else f"{low} to {high} nodes, a multiple of {layers + 1}"
        raise _impossible(where, f"{cells} cells in {layers} layer{'s'[: layers > 1]} and {nodes} nodes", expected)


def published(pair: Any, layers: Any) -> None:
    """E110 for the counts (cells, nodes) that a publication gives for its mesh, two positive integers, as `counts`."""
    found = list(pair) if isinstance(pair, tuple | list) else []
    if len(found) != 2:
        raise InputError("counts of a mesh are two", where="Pad, counts", found=repr(pair), expected="(cells, nodes)")
    cells, nodes = (integer(n, v, where="Pad, counts", limit=MOST) for n, v in zip(NAMES, found, strict=True))
    deep = integer("layers", layers, where="Pad, layers", limit=MOST)
    counts(cells, nodes, layers=deep, where="Pad, counts")


def _impossible(where: str, found: str, expected: str) -> InputError:
    return InputError(
        "these element and node counts cannot be one conforming mesh", where=where, found=found,
        expected=expected + " (Euler's formula)",
        hint="do not rebuild a mesh from published counts: give size and pitch, or the mesh file", code="LID-E110",
    )  # fmt: skip


def modulus(E: float) -> Flag | None:
    """W111: a Young's modulus (Pa) that no elastomer has."""
    if SOFTEST <= E <= STIFFEST:
        return None
    return Flag(
        "W111",
        Evidence("Young's modulus in Pa", E, SOFTEST if E < SOFTEST else STIFFEST),
        f"E = {E:.4g} Pa is outside the range of elastomers, 1 kPa to 10 MPa; E is a pure gain: a factor 1000 here is "
        "a factor 1000 in every force, and no residual shows it",
        "check the unit and the decimal point; one press with a known force settles the gain",
    )


def large_strain(strain: float) -> Flag | None:
    """W112: a largest principal strain of the reconstructed field beyond what linear elasticity describes."""
    return above(
        "W112", "largest principal strain", abs(strain), LINEAR,
        f"linear range exceeded: principal strain of {100 * abs(strain):.1f} % in the reconstructed field; large "
        "strain is outside what this version models",
        "press less hard, or take the map as an estimate to that order",
    )  # fmt: skip


def one_of_two(rate: str, linear: str) -> Flag | None:
    """W113: of rate independence and linearity, by their verdicts, not both were tested."""
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


def too_coarse(layers: int, nu: float, element: str) -> Flag | None:
    """W115: too few layers of elements (as in `structures._elements.solids.block`) for a map of tractions."""
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


AGREES, EXPLAINED = 2.0, 2.0  # rms of forces, and of motion, over their std


def unlike(errors: float, count: int, misfit: float) -> Flag | None:
    """W117: a gel that is not as its fitted model: forces held out, or motion, by their rms over their std."""
    advice = (
        "check base, edges, shape of the surface and units: no modulus, Poisson's ratio or thickness explains these"
    )
    if errors > AGREES:
        return Flag(
            "W117", Evidence("rms error of held-out forces over their std", errors, AGREES),
            f"the sensor misses the known force of {count} presses that were held out by {errors:.2g} std",
            advice,
        )  # fmt: skip
    return above(
        "W117", "rms of the motion that is left over its std", misfit, EXPLAINED,
        f"the best model leaves {misfit:.2g} times as much of the motion of the presses as it should",
        f"{advice}; or the presses are no single blunt contacts",
    )  # fmt: skip


# -- images and markers -----------------------------------------------------------------------------------------------
REJECTED, LOST = 0.02, 0.02  # share of the markers, of the readings
FROZEN = 0.05  # share of exact repetitions among successive places of a dot
TOO_DEEP = 0.3  # relative error of the forces that noise alone makes
MISFIT = 5.0  # rms residual of the markers over their noise
RAYS = "viewing angle and index"
PROJECTION = (
    "image motion mixes tangential motion with the shift of projection, d tan(beta), beta = arcsin(sin(alpha) / gamma)"
)
CALIBRATE = (
    "calibrate the viewing angle and the index of refraction, give the normal motion, and subtract the shift; "
    "otherwise report the motion in the image only"
)
STATE_NOISE = "measure the noise on uncompressed images (PNG, NPY), or state it"


def too_deep(error: float) -> Flag | None:
    """W304: noise alone makes more than 30 % error of the forces, without regularisation."""
    return above(
        "W304", "expected relative error of the forces", error, TOO_DEEP,
        f"the markers lie too deep for the pitch of the forces: noise alone would make {100 * error:.0f} % error",
        "markers nearer to the surface, a coarser grid of forces, or regularisation (choice=None)",
    )  # fmt: skip


def frozen(repeated: float) -> Flag | None:
    """W406: a noise level from frames of which a share of the dots repeats exactly, as a lossy codec makes them."""
    return above(
        "W406", "share of dots that stand exactly still", repeated, FROZEN,
        f"the unloaded frames: {repeated:.0%} of the dots are where they were to the last digit; a lossy "
        "codec freezes still areas, and their jitter says nothing about the camera",
        STATE_NOISE,
    )  # fmt: skip


def lossy(codec: str) -> Flag:
    """W406: frames from a lossy codec, by its four letters."""
    message = f"the video is compressed with loss ({codec}): motion may be read from it, a noise level may not"
    return Flag("W406", Evidence("codec", codec), message, STATE_NOISE)


def misfit(ratio: float) -> Flag | None:
    """W406: what is left of the motion is far above the noise of the markers."""
    return above(
        "W406", "rms residual of the markers over their noise", ratio, MISFIT,
        f"the map leaves {ratio:.1f} times the noise of the markers unexplained; bands are widened by as much",
        "look at the order of the markers, the zero, thickness and nu, a lambda that is too large, or the noise stated",
    )  # fmt: skip


def tangential(optics_known: bool, normal_known: bool, *, allow: Sequence[str] = ()) -> Flag | None:
    """E603: tangential motion or load claimed while the shift of projection is unknown; `allow` makes it a flag."""
    if optics_known and normal_known:
        return None
    missing = [words for words, known in ((RAYS, optics_known), ("normal motion", normal_known)) if not known]
    if any(code.upper().removeprefix("LID-") == "E603" for code in allow):
        return Flag("E603", Evidence("missing", " and ".join(missing)), PROJECTION, CALIBRATE)
    raise not_tangential(missing)


def not_tangential(missing: Sequence[str]) -> InputError:
    """E603 as an error to raise, with what is not known."""
    return InputError(
        f"tangential motion cannot be told from the image: {PROJECTION}", where="tangential motion",
        found=f"not known: {' and '.join(missing)}",
        hint=Advice(f"{CALIBRATE}; ", Spelling("allow=['E603']", "--allow E603"), " overrides"), code="LID-E603",
    )  # fmt: skip


def vanished(markers: int, lost: int, rejected: int, unmatched: int) -> Flag | None:
    """W604: markers without a dot near their prediction, or with one that was refused; dots that are no marker's."""
    return above(
        "W604", "share of the markers without a motion", (lost + rejected) / max(markers, 1), REJECTED,
        f"{rejected} of {markers} markers rejected, {lost} lost, {unmatched} dots unmatched; none of them is filled in",
        "track every frame, leave their nodes out, and carry the covariance of the interpolation",
    )  # fmt: skip


def leapt(step: float, pitch: float, frame: int) -> Flag | None:
    """W604: in a frame (from 1) the dots moved so far (px) that a neighbour could have taken their place."""
    return above(
        "W604", "motion of one frame over the pitch", step / pitch, 0.5,
        f"in frame {frame} the dots moved by {step:.1f} px, more than half of their distance ({pitch:.1f} px): from "
        "there on a marker may be its neighbour",
        "take more frames per second, or move more slowly; start again from an unloaded frame",
    )  # fmt: skip


def missing_frames(missing: Sequence[int], folder: str) -> Flag | None:
    """W604: numbers that are missing in a folder of images."""
    shown = ", ".join(map(str, missing[:8])) + (", ..." if len(missing) > 8 else "")
    return above(
        "W604", "missing frames", float(len(missing)), 0.0,
        f"frames are missing in {folder}: {shown}; the motion over a gap counts as that of one frame",
        "copy the missing images, or split the sequence where they are missing",
    )  # fmt: skip


def skipped(numbers: Sequence[int], why: str) -> Flag | None:
    """W604: frames (numbers from 1) that told nothing were left out; `why` the first of them did not."""
    shown = ", ".join(map(str, numbers[:8])) + (", ..." if len(numbers) > 8 else "")
    return above(
        "W604", "frames that tell nothing", float(len(numbers)), 0.0,
        f"{'frames' if len(numbers) > 1 else 'frame'} {shown} left out, with no map: {why}",
        "look at light, cable and occlusion; the motion over the gap counts as that of one frame",
    )  # fmt: skip


def lost(rows: int, total: int) -> Flag | None:
    """W604: readings were lost in this frame."""
    return above(
        "W604", "share of readings lost", rows / max(total, 1), LOST,
        f"{rows} of {total} readings are missing in this frame; the map is exact for the others, its std is larger",
        "look at the image; where markers vanish under the contact the map there is the prior's",
    )  # fmt: skip


def strays(count: int) -> Flag | None:
    """W604: markers that contradict all others were left out."""
    return above(
        "W604", "markers that contradict all others", count, 0,
        f"{count} markers moved as no load moves them beside the others: they were left out, as other dots",
        "look at the frame; from frame to frame markers must move by less than half their pitch",
    )  # fmt: skip


def interpolation_noise(nodes: int, effective: float, rank: int) -> Flag | None:
    """W605: interpolation onto nodes correlates the noise (W203 on the marker field).

    With C the correlation matrix of the noise at the nodes, `effective` is (tr C)^2 / tr(C^2), `rank` that of C.
    """
    from loadid._guards.measurement import CORRELATED  # the command line reads pad files without scipy

    if rank == nodes and effective > CORRELATED * nodes:
        return None
    return Flag(
        "W605",
        Evidence("effective number of values", effective, CORRELATED * nodes),
        f"{nodes} interpolated values carry the information of {effective:.1f}; rank of their noise covariance {rank}",
        "invert on the markers themselves, or carry the covariance W Sigma W^T and whiten on its range",
    )


# -- force maps -------------------------------------------------------------------------------------------------------
BIAS = 0.02  # share of the resultant that regularisation may take
LEANING = 0.1  # share of a pressure that is read as shear
STILL, CUT = 2.0, 0.01  # stds of the noise, and share of the largest motion, at the edge of a window
SEEN = 0.8  # share of a normal force that must be found


def stopped(converged: bool, steps: int) -> Flag | None:
    """W410: the constrained solver ended on its limit."""
    message = "the constrained map was not solved to the end in this frame"
    advice = "leave the friction cone out, or choose a larger lambda"
    return None if converged else Flag("W410", Evidence("Newton steps", float(steps)), message, advice)


def completed(provided: Mapping[str, str]) -> Flag | None:
    """N606: a component of the motion (``{"x": "tracked", "z": "completed"}``) was completed from an assumption."""
    assumed = [name for name, label in provided.items() if label == "completed"]
    if not assumed:
        return None
    return Flag(
        "N606",
        Evidence("components completed", ", ".join(assumed), "none"),
        ", ".join(f"{name} {label}" for name, label in provided.items()),
        "do not validate with what supplied it; measure the normal motion where it decides",
    )


def taken(hidden: Array, resultant: Array, covariance: Array) -> Flag | None:
    """W608: regularisation is expected to have lowered the resultant by more than 2 % and more than its noise."""
    size = float(np.linalg.norm(resultant[:3]))
    if size == 0:
        return None
    along = resultant[:3] / size
    loss = -float(along @ hidden[:3]) / size
    noise = float(np.sqrt(max(float(along @ covariance[:3, :3] @ along), 0.0))) / size
    if not loss > noise:
        return None
    return above(
        "W608", "share of the resultant lost", loss, BIAS, f"regularisation lowers the resultant by {100 * loss:.1f} %",
        Advice(
            "give the resultant of a force/torque sensor (",
            Spelling("wrench=", "in Python: wrench="),
            "), or take a smaller lambda",
            Spelling("", " (--lam)"),
        ),
    )  # fmt: skip


def unseen(share: float, contacts: bool = False) -> Flag | None:
    """W608: of a plain press as wide as the pad is thick only a share of its force would be found, without noise.

    Where `contacts` make good the rest their band holds it; how thick the gel is their readings do not tell either.
    """
    if share >= SEEN:
        return None
    seen = f"of a press as wide as the pad is thick {100 * share:.0f} % of the normal force would be found"
    return Flag(
        "W608",
        Evidence("share of a normal force that would be found", share, SEEN),
        f"{seen} by loads anywhere: the rest follows from what contacts may be, and the band holds how well it is told"
        if contacts else f"{seen}: the readings or the penalty hide the rest, and no band shows it",
        "measure the normal motion (a depth map, markers in depth)"
        + ("; state how well the thickness is known (tolerances=), which motion in the plane does not tell" if contacts
           else ", or take a smaller lambda"),
    )  # fmt: skip


def no_map(numbers: int) -> Flag:
    """N610: a method that gives so many resultants, and no map."""
    return Flag(
        "N610",
        Evidence("numbers in the output", numbers, "a map"),
        f"a method of {numbers} resultants: there is no map to plot, and none to validate",
        "compare it at level resultant only",
    )


def slipped(
    shift: Array, turn: float, ratio: float, threshold: float, force: Array, pixel: float | None
) -> Flag | None:
    """W611: markers that no contact reaches moved together, by `shift` (2,) m and `turn` rad.

    `ratio` is the F statistic of that motion, `threshold` what chance exceeds once in a million frames, `force` (3,)
    what the map makes of it alone (N), and `pixel` the side of a pixel on the pad (m).
    """
    x, y = 1e6 * shift
    px = "" if pixel is None else f" ({float(np.hypot(x, y)) * 1e-6 / pixel:.2g} px)"
    fx, fy, fz = force
    return above(
        "W611", "F statistic of a rigid motion of the far markers", ratio, threshold,
        f"the markers that no contact reaches moved together by ({x:.3g}, {y:.3g}) um{px} and turned by "
        f"{np.degrees(turn):.2g} degrees: the force may be wrong by ({fx:.2g}, {fy:.2g}, {fz:.2g}) N, which is "
        "what this motion alone gives; no band shows it",
        "unload the sensor and zero() it again; fasten the camera and the gel",
    )  # fmt: skip


MOVED = 5.0  # mean square of a motion of the image over its variance


def moved(image: ImageShift, pixel: float | None) -> Flag | None:
    """W611: camera or gel moved as a whole, and that is taken out of the load."""
    if not image.size > image.chance:
        return None
    (x, y), (dx, dy) = 1e6 * image.values[:2], 1e6 * image.std[:2]
    px = "" if pixel is None else f" ({float(np.hypot(x, y)) * 1e-6 / pixel:.2g} px)"
    return above(
        "W611", "mean square of the motion of the image over its variance", image.ratio, MOVED,
        f"camera or gel moved by ({x:.3g} +- {dx:.1g}, {y:.3g} +- {dy:.1g}) um{px} and turned by "
        f"{np.degrees(image.values[2]):.2g} degrees: that is taken out of the load, and the band holds what it leaves "
        "open",
        "unload the sensor and zero() it again; fasten the camera and the gel",
    )  # fmt: skip


def read_as_shear(share: float, nu: float) -> Flag | None:
    """W612: no normal load allowed on a gel whose pressure is read as shear to this share, at a wave of 2 pi h."""
    return above(
        "W612", "shear read of a pressure, over it", share, LEANING,
        f"no normal load is allowed (t_z = 0): where there is one, {100 * share:.0f} % of it is read as shear "
        f"at a wave of six thicknesses (nu = {nu:g})",
        'normal="unknown", with motion along Z where it can be had: in-plane motion alone tells little of pressure',
    )  # fmt: skip


def cut_off(level: float, share: float) -> Flag | None:
    """W613: places at the edge of a window move, by `level` stds of the noise and a `share` of the largest motion."""
    if level <= STILL:
        return None
    return above(
        "W613", "motion at the edge of the window over the largest", share, CUT,
        f"places at the edge of the window move by {level:.1f} times their noise, {100 * share:.0f} % of the largest "
        "motion: loads near it or beyond are cut off, and the layer is taken to stand still there",
        "a wider window, or frame=(x0, y0, x1, y1) where nothing acts beyond it",
    )  # fmt: skip


SHEARED = 4.0  # stds of a shear


def unpressed(force: Array, covariance: Array) -> Flag | None:
    """W614: a shear (3,) N that is clear of its band where nothing presses, though a press would be seen."""
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    shear = float(np.hypot(*force[:2]))
    clear = shear / max(float(np.hypot(*std[:2])), np.finfo(float).tiny)
    if -force[2] > std[2] or std[2] > shear:
        return None
    return above(
        "W614", "shear over its std, where nothing presses", clear, SHEARED,
        f"a shear of {shear:.2g} N and no press ({-force[2]:.2g} +- {std[2]:.1g} N): no contact carries that",
        "look for a gel that comes off, markers that were mistaken, or a camera that turned; zero() it unloaded",
    )  # fmt: skip


UNLIKE = 1.6  # rms of readings over what is expected of them; rings on a coarse mesh reach 1.5
SURE = 6.0  # std of that rms


def unlike_pad(rest: float, readings: int) -> Flag | None:
    """W615: so many readings are, by the rms over what is expected of them, not those of contacts on this pad."""
    if not (rest**2 - 1) * np.sqrt(readings / 2) > SURE:
        return None
    return above(
        "W615", "rms of the readings over what contacts on this pad let expect", rest, UNLIKE,
        f"contacts on this pad leave {rest:.2g} times as much of the readings as noise and the error of its mesh let "
        "expect: it is no such pad, and the force may be wrong by far more than its band",
        "look for a domed surface that is modelled as flat, for thickness, nu and edges; material.in_situ tells them "
        "from presses of known force",
    )  # fmt: skip


OPEN = 0.02  # chance of another number of contacts


def contacts_open(chances: Mapping[int, float]) -> Flag | None:
    """N617: the chances of numbers of contacts leave open how many there are."""
    (count, most), *others = sorted(chances.items(), key=lambda item: -item[1])
    left = 1.0 - most
    words = " or ".join(str(n) for n, chance in others if chance > OPEN / 2)
    return above(
        "N617", "chance of another number of contacts", left if words else 0.0, OPEN,
        f"most likely {count} contact{'' if count == 1 else 's'} ({most:.0%}), but the readings leave open {words}",
        "measure normal motion, or press harder; two contacts that are read as one share its place and its band",
    )  # fmt: skip


def contact_hidden(force: float) -> Flag:
    """N618: no contact is found in readings in the plane, which hide a press of up to `force` (N)."""
    return Flag(
        "N618",
        Evidence("normal force in N that a hidden contact may have", force, "a contact that is found"),
        f"no contact is found; readings in the plane hide a press of up to {force:.2g} N",
        "press harder, or measure the normal motion (a depth map, markers in depth)",
    )


# -- a gel in use -----------------------------------------------------------------------------------------------------
SAME_SHAPE = 0.98  # correlation from which two maps have the same shape
GAIN = (0.9, 1.1)
SHAPE = 0.04  # share of a map that no gain explains, noise taken out
SIGNIFICANT = 4.0  # sd of the noise by which that share must stand out
DRIFT = 2.0  # rms offset of unloaded markers over what their noise explains
PERIOD = 30.0  # days


def drift(offset: float, expected: float, calibrated: datetime) -> Flag | None:
    """W607: rms offset (m) of markers of the unloaded gel since it was zeroed, beyond what noise explains."""
    return above(
        "W607", "rms offset of the unloaded markers in m", offset, DRIFT * expected,
        f"calibration of {calibrated:%Y-%m-%d}; unloaded offset {1e6 * offset:.3g} um, where noise explains "
        f"{1e6 * expected:.3g} um",
        "zero the sensor, then press again: magnitudes off by a constant mean E; a wrong shape means nu, thickness or "
        "boundary",
    )  # fmt: skip


def age(days: float, period: float, calibrated: datetime) -> Flag | None:
    """W607: the calibration is older (days) than its period."""
    return above(
        "W607", "age of the calibration in days", days, period,
        f"calibration date {calibrated:%Y-%m-%d}, {days:.0f} days ago",
        "repeat the reference presses with a known force",
    )  # fmt: skip


def change(gain: float, correlation: float, share: float, significance: float) -> str:
    """What has changed between two sets of maps: ``"shape"``, ``"gain"`` or ``"unchanged"``; as `gain_or_shape`."""
    if share > SHAPE and significance > SIGNIFICANT:
        return "shape"
    if GAIN[0] <= gain <= GAIN[1]:
        return "unchanged"
    return "shape" if correlation <= SAME_SHAPE and significance > SIGNIFICANT else "gain"


def gain_or_shape(gain: float, correlation: float, share: float, significance: float) -> Flag | None:
    """W705: the same presses give another gain (E), or another shape (thickness, boundary, nu); as `GelCheck`.

    A layer 15 % thinner keeps a correlation of 0.996: the share that no gain explains is what tells it from a gain.
    Holds for displacements, and for force maps that are unregularised or have lambda relative to sigma_1.
    """
    found = change(gain, correlation, share, significance)
    if found == "unchanged":
        return None
    if found == "gain":
        return Flag(
            "W705",
            Evidence("gain of the maps", gain, GAIN[0] if gain < 1 else GAIN[1]),
            f"shape right (correlation {correlation:.4f}), gain {gain:.3g}: recheck E",
            f"E is off by a factor {1 / gain:.3g} if the force of the presses is right: calibrate the gain",
        )
    if share > SHAPE:
        return Flag(
            "W705",
            Evidence("share of the map that no gain explains", share, SHAPE),
            f"shape wrong: {share:.1%} of the map is no gain (correlation {correlation:.4f}, gain {gain:.3g})",
            "thickness (wear), boundary (a bond that lets go), Poisson's ratio, or presses at another place, in that "
            "order; E is not the cause",
        )
    return Flag(
        "W705",
        Evidence("correlation of the maps", correlation, SAME_SHAPE),
        f"shape wrong: correlation {correlation:.3f}, gain {gain:.3g}",
        "thickness, boundary, Poisson's ratio, or presses at another place",
    )


def other_calibration(validated: datetime, calibrated: datetime) -> Flag | None:
    """W706: the validation is older than the calibration in use."""
    if validated >= calibrated:
        return None
    return Flag(
        "W706",
        Evidence("validated on", f"{validated:%Y-%m-%d}", f"{calibrated:%Y-%m-%d}"),
        f"validated on {validated:%Y-%m-%d} with another calibration than that of {calibrated:%Y-%m-%d}",
        "repeat the validation with the calibration in use",
    )
