"""Guard of a record that was solved in pieces."""

from __future__ import annotations

from structures.flags import Evidence, Flag

NEGLIGIBLE = 0.01  # share of the std that the windows may leave open


def windows_apart(share: float) -> Flag | None:
    """W410: the windows were stopped while the load could still differ from that of the record in one piece.

    Parameters
    ----------
    share : float
        Bound on that difference over the std, both as norms over all samples and loads.
    """
    if not share > NEGLIGIBLE:
        return None
    return Flag(
        "W410",
        Evidence("bound on the error of the windows over the std", float(share), NEGLIGIBLE),
        f"the record was solved in windows; the load can differ from that of the record in one piece by up to "
        f"{share:.2g} of its std",
        "path='toeplitz' solves it in one piece; a larger lambda makes the windows forget their ends sooner",
    )
