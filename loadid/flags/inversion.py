"""Guards of the inversion."""

from __future__ import annotations

from structures.errors import InputError
from structures.flags import Evidence, Flag


def resolution(nullity: int, prior: str, width: float, unit: str, bias: float | None = None) -> Flag:
    """N303: what regularisation did, always said."""
    null = f"{nullity} components in ker(H) are set by the prior ({prior}); " if nullity else ""
    peak = "" if bias is None else f"; a single-sample peak is shown at {1 - bias:.0%} of its height"
    return Flag(
        "N303",
        Evidence("resolution width", float(width), None),
        f"{null}nothing finer than {width:.3g} {unit} is resolved{peak}",
        "claim no detail below this width",
    )


def index_offset(ratio: float, load: str, shift: int | None) -> InputError:
    """E506: the first sample of the impulse response is zero and no shift helps."""
    return InputError(
        f"the impulse response of load {load} has no usable diagonal: |h(0)| is {ratio:.2g} of its maximum "
        "and no shift helps",
        where="deconvolution",
        found="a zero impulse response" if shift is None else f"first usable sample {shift}",
        expected="a response that begins within the record",
        hint="check sensors and loads; a first-order hold gives displacement an answer at once",
        code="LID-E506",
    )


def overridden(code: str, what: str, value: float, threshold: float) -> Flag:
    """A refusal (E506, E306) that the user allowed: it stays as a flag on everything made from the result."""
    return Flag(
        code,
        Evidence(what, value, threshold),
        f"refused by default, allowed by the user: {what} is {value:.3g}",
        "do not use the result where this matters",
    )
