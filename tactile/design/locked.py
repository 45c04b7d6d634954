"""Locking: by how much plain bricks are too stiff as nu goes to one half."""

from __future__ import annotations

from structures.values import positive


def locking(
    nu: float, *, size: float = 16e-3, thickness: float = 4e-3, elements: tuple[int, int, int] = (16, 16, 4),
    side: float = 6e-3,
) -> float:  # fmt: skip
    """Depth of a pressed patch of a bonded pad of plain Hex-8 bricks over that of B-bar bricks on the same mesh.

    Parameters
    ----------
    nu : float
        Poisson's ratio, below 0.5.
    size, thickness : float
        Of the square pad (m).
    elements : (nx, ny, nz)
        Bricks along X, Y, Z.
    side : float
        Of the pressed square in the middle (m).

    Returns
    -------
    float
        1 where plain bricks do as well; towards 0 as they lock. No modulus and no force enters.
    """
    from structures import solids
    from structures.factor import Factor
    from structures.hexfield import HexField
    from structures.materials import Material

    a = positive("size", size, where="design.locking", unit="m")
    half = positive("side", side, where="design.locking", unit="m") / 2
    depths = []
    for element in ("standard", "bbar"):
        block = solids.block(
            lengths=(a, a, positive("thickness", thickness, where="design.locking", unit="m")), elements=elements,
            material=Material(E=1e5, rho=1e3, nu=nu), element=element, origin=(-a / 2, -a / 2, 0.0), allow=("E109",),
        )  # fmt: skip
        assert isinstance(block.field, HexField)
        f = block.field.traction("top", ((-half, half), (-half, half)), 3)[block.free]
        depths.append(float(f @ Factor(block.K_free, check=False).solve(f)))
    return depths[0] / depths[1]
