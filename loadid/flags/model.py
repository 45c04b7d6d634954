"""Guards of the forward model."""

from __future__ import annotations

from structures.flags import Evidence, Flag


def not_verified(certificate: object | None) -> Flag | None:
    """W114: the forward model was never checked against a known load."""
    if certificate is not None:
        return None
    return Flag(
        "W114",
        Evidence("certificates", 0, 1),
        "forward model not verified: no residual and no parameter rule can find an error of the model",
        "hang a known mass or apply a measured hit, and call model.verify(load, response)",
    )
