"""Guard W113: one property of a material taken for the other. The modulus itself is W111's (`guards.pad.modulus`)."""

from __future__ import annotations

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
