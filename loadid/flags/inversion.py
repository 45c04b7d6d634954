"""Guards of the inversion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError
from structures.flags import Evidence, Flag

from ..inverse.decay import Decay
from ..inverse.refine import Refinement

PRESSURES = {"Pa", "kPa", "MPa", "GPa", "bar", "mbar", "psi", "N/m^2", "N/m²", "N/mm^2", "N/mm²"}
FEW = 3.0  # effective degrees of freedom below which even a resultant is biased
AMPLE = 2.0  # effective degrees of freedom over recoverable modes that a good lambda may use ...
SPARE = 5.0  # ... and some more
OTHERWISE = 1.2  # ratio of two gains that are told apart


def resolution(nullity: int, prior: str, width: float, unit: str, bias: float | None = None) -> Flag:
    """N303: what regularisation did, always said."""
    if nullity == 0 and bias == 0 and unit == "loads":
        return Flag(
            "N303",
            Evidence("resolution width", float(width), None),
            "nothing was filled in: each load is determined by the data, at full height",
            "judge the loads by their std",
        )
    null = f"{nullity} components in ker(H) are set by the prior ({prior}); " if nullity else ""
    peak = "" if bias is None else f"; a single-sample peak is shown at {1 - bias:.0%} of its height"
    return Flag(
        "N303",
        Evidence("resolution width", float(width), None),
        f"{null}nothing finer than {width:.3g} {unit} is resolved{peak}",
        "claim no detail below this width",
    )


def nodal_as_pressure(kind: str, quantity: str) -> Flag | None:
    """W106: nodal forces under the unit or the name of a pressure; `kind` of the load basis, `quantity` or unit."""
    if kind != "nodal" or (quantity not in PRESSURES and quantity.lower() not in ("pressure", "traction", "stress")):
        return None
    return Flag(
        "W106",
        Evidence("shown as", quantity, "N"),
        "nodal forces scale with element size; not a pressure",
        "convert them with to_traction() (estimate.traction(), quantity='traction')",
    )


def refined(found: Refinement) -> Flag | None:
    """W107: a finer load basis shows no more modes above the noise."""
    if found.gained > 0:
        return None
    return Flag(
        "W107",
        Evidence("modes above the noise", found.after, found.before),
        f"n rose from {found.coarse} to {found.fine}; modes above noise stayed {found.after} "
        f"(relative noise {found.eta:.2g})",
        "keep the coarse basis, pressure patches or a smooth basis: a finer mesh of loads shows nothing new",
    )


def recoverable(plateau: int, rank: int, edf: float | None = None, requested: float | None = None) -> Flag | None:
    """W304: more detail is claimed or used than the data hold.

    Parameters
    ----------
    plateau, rank : int
        Modes before the data coefficients reach the noise, and modes of the operator.
    edf : float, optional
        Effective degrees of freedom that lambda lets through, per frame.
    requested : float, optional
        Number of components whose resolution is promised.
    """
    asked = requested is not None and requested > plateau
    used = edf is not None and edf > AMPLE * plateau + SPARE
    if plateau > 0 and not asked and not used:
        return None
    value, name = (requested, "components asked for") if asked else (edf, "effective degrees of freedom")
    if value is None:
        value, name = 0.0, "recoverable modes"
    tail = "the data are all noise" if plateau == 0 else f"{name} {value:.3g}"
    return Flag(
        "W304",
        Evidence(name, float(value), float(plateau)),
        f"i* = {plateau} recoverable modes of {rank}; {tail}",
        "claim no more; a coarser load basis, more sensors, less noise, or sensors nearer to the load",
    )


def resolution_law(decay: Decay, claimed: str, gain: float = 100.0, snr: float = 100.0) -> Flag | None:
    """W305: a gain of resolution is promised by another law than that of the singular values.

    Parameters
    ----------
    decay : Decay
        Of the singular values.
    claimed : str
        ``gaussian`` (square root of the logarithm of the SNR), ``exponential`` or ``algebraic``.
    gain, snr : float
        How much the signal-to-noise ratio is to be raised, and from where.
    """
    if decay.law in ("unknown", claimed):
        return None
    true = decay.buys(gain, snr)
    other = (np.log(snr * gain) / np.log(snr)) ** {"gaussian": 0.5, "exponential": 1.0}.get(claimed, 0.0)
    promised = gain if claimed == "algebraic" else float(other)
    if max(true / promised, promised / true) < OTHERWISE:
        return None
    power = f" k^-{decay.rate:.2g}" if decay.law == "algebraic" else ""
    return Flag(
        "W305",
        Evidence(f"resolution that {gain:g} x SNR buys", true, promised),
        f"singular values decay {decay.law}{power}, not {claimed}: {gain:g} x better SNR buys x {true:.2g}",
        "decide between better sensors and another geometry with the law of this operator",
    )


def over_smoothed(
    edf: float | None,
    plateau: int,
    resultant: ArrayLike | None = None,
    measured: ArrayLike | None = None,
    std: ArrayLike | None = None,
    labels: Sequence[str] = (),
) -> Flag | None:
    """W310: lambda is so large that even resultants are biased.

    Parameters
    ----------
    edf : float or None
        Effective degrees of freedom, per frame.
    plateau : int
        Recoverable modes: with fewer than three of them few are used rightly.
    resultant, measured, std : array, shape (R,), optional
        Resultants of the estimate that were not imposed, measured ones, and the std of their difference.
    labels : sequence of str
        Names of the resultants.
    """
    if resultant is not None and measured is not None and std is not None:
        off = np.abs(np.subtract(resultant, measured)) / np.maximum(np.asarray(std, float), np.finfo(float).tiny)
        k = int(np.argmax(off))
        if np.ravel(off)[k] > 3:
            name = labels[k] if len(labels) > k else "the resultant"
            ours, theirs = float(np.ravel(resultant)[k]), float(np.ravel(measured)[k])
            return Flag(
                "W310",
                Evidence("distance in standard deviations", float(np.ravel(off)[k]), 3.0),
                f"lambda is so large that even the resultant is biased: {name} {ours:.4g}, measured {theirs:.4g}",
                "lower lambda, or impose the resultant as a constraint; else look for a gain error of the model",
            )
    if edf is None or not edf < FEW <= plateau:
        return None
    return Flag(
        "W310",
        Evidence("effective degrees of freedom", float(edf), FEW),
        f"lambda is so large that even the resultant is biased: {edf:.2g} effective degrees of freedom are left of "
        f"{plateau} recoverable modes",
        "lower lambda; impose the resultant",
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
