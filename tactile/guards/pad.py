"""Guards of the pad: E110 impossible mesh counts, W111 modulus, W112 large strain, W115 too coarse in depth."""

from __future__ import annotations

from typing import Any

from structures.advice import Advice, Spelling
from structures.errors import InputError
from structures.flags import Evidence, Flag
from structures.values import integer

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
        As in `structures.solids.block`.
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
