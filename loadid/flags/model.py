"""Guards of the forward model."""

from __future__ import annotations

from structures.advice import Advice, Spelling
from structures.flags import Evidence, Flag
from structures.model import WRONG, Certificate


def not_verified(certificate: Certificate | None) -> Flag | None:
    """W114: the forward model was never checked against a known load, or failed that check."""
    if certificate is not None and certificate.wrong:
        told = zip(certificate.error, certificate.gain, certificate.sensors, strict=True)
        worst = max(x for x in told if x[2] in certificate.wrong)
        return Flag(
            "W114",
            Evidence("residual over response", worst[0], WRONG),
            f"forward model disagrees with {certificate.source} on {len(certificate.wrong)} of "
            f"{len(certificate.sensors)} sensors: residual {worst[0]:.0%} of the response at {worst[2]}, gain "
            f"{worst[1]:.3g}",
            "check signs, units and places of these sensors, then geometry and supports, and verify again",
        )
    if certificate is not None:
        return None
    return Flag(
        "W114",
        Evidence("certificates", 0, 1),
        "forward model not verified: no residual and no parameter rule can find an error of the model",
        Advice(
            "hang a known mass or apply a measured hit, and ",
            Spelling("", "in Python "),
            "call model.verify(load, response)",
        ),
    )
