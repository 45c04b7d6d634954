"""Guards of loads that are unknown in space and time."""

from __future__ import annotations

from structures.errors import NotIdentifiable


def undetermined_field(rank: int, loads: int, sensors: int, samples: int) -> NotIdentifiable:
    """E514: the sensors do not tell so many places apart, and nothing was said of the field between them.

    Parameters
    ----------
    rank : int
        Combinations of the loads that the sensors tell apart at a frequency, at most.
    loads, sensors, samples : int
        Unknowns of one sample; what is measured, and how often.
    """
    return NotIdentifiable(
        f"the load is unknown in space and time: {sensors} sensors tell {rank} of {loads} places apart, so that the "
        f"stacked operator has rank {rank * samples} for {loads * samples} unknowns, nullity "
        f"{(loads - rank) * samples}",
        advice=f"a low-order basis of at most {rank} loads (bases.hats, bases.polynomials, shapes=), a spatial prior "
        "(space='gradient'), or more sensors",
        code="LID-E514",
    )
