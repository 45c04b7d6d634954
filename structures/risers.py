"""Risers: vertical tensioned beams, pinned at both ends, whose tension falls from the top by their own weight.

A riser lies along X from its lower end (x = 0) to its top (x = length) and deflects along Z, as the beams do. Under
tension the modes are those of a string with a little bending: neighbouring frequencies lie close together, and vortices
excite whichever the current happens to meet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import beams
from .beams import Varying
from .damping import Damping, Rayleigh
from .errors import InputError
from .structure import Structure
from .values import integer, number, positive

WHERE = "riser"
Array = NDArray[np.float64]


def riser(
    *,
    length: float,
    EI: Varying,
    mass_per_length: Varying,
    top_tension: float,
    weight_per_length: float = 0.0,
    elements: int = 60,
    damping: Damping | float | None = None,
) -> Structure:
    """Riser pinned at both ends, under the tension at its top less the weight below it.

    Parameters
    ----------
    length : float
        m.
    EI, mass_per_length : float or callable
        Bending stiffness (N m^2) and mass per length (kg/m), contents and added mass of the water included.
    top_tension : float
        Tension at x = length (N), positive.
    weight_per_length : float
        Submerged weight (N/m): the tension at x is ``top_tension - weight_per_length (length - x)``.
    elements : int
        Equal elements.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping of the structure; `loss_factor` gives that of a hysteretic material at one frequency.

    Returns
    -------
    Structure
        DOFs as those of `beams.beam`; its parameter "tension" scales the tension.

    Raises
    ------
    InputError
        If a value is not possible, or the weight leaves the lower end without tension.
    """
    span = positive("length", length, where=WHERE, unit="m")
    top = positive("top_tension", top_tension, where=WHERE, unit="N")
    weight = number("weight_per_length", weight_per_length, where=WHERE, unit="N/m")
    if weight < 0 or top - weight * span <= 0:
        raise InputError(
            "the riser is not in tension over its whole length",
            where=WHERE,
            found=f"{top:g} N at the top, {top - weight * span:g} N at the lower end",
            expected="a positive tension at both ends, and a weight that is not negative",
            hint="raise top_tension above weight_per_length * length",
        )
    tension: Varying = top if weight == 0 else lambda x: top - weight * (span - x)
    return beams.simply_supported(
        length=span, elements=elements, EI=EI, mass_per_length=mass_per_length, tension=tension, damping=damping
    )


def loss_factor(eta: float, frequency: float) -> Rayleigh:
    """Damping proportional to the stiffness that is the loss factor `eta`, ``K (1 + i eta)``, at one frequency (Hz).

    Exact on that line of a frequency response, where a hysteretic material has no counterpart in time; elsewhere the
    loss grows with the frequency.

    Raises
    ------
    InputError
        If the loss factor is negative or the frequency is not positive.
    """
    line = positive("frequency", frequency, where="loss_factor", unit="Hz")
    loss = number("eta", eta, where="loss_factor")
    if loss < 0:
        raise InputError("a loss factor is not negative", where="loss_factor", found=eta, expected=">= 0",
                         hint="the imaginary part of the stiffness over its real part: 0.01, for example")  # fmt: skip
    return Rayleigh(0.0, loss / (2 * np.pi * line))


def frequencies(*, length: float, EI: float, mass_per_length: float, tension: float, count: int) -> Array:
    """Natural frequencies (Hz) of a riser of constant tension in closed form, (count,).

    ``f_n = n / (2 L) sqrt(T / m + EI / m (n pi / L)^2)``: modes ``sin(n pi x / L)``.

    Raises
    ------
    InputError
        If a value is not possible.
    """
    span = positive("length", length, where=WHERE, unit="m")
    stiffness, mass = positive("EI", EI, where=WHERE), positive("mass_per_length", mass_per_length, where=WHERE)
    pull, n = (
        number("tension", tension, where=WHERE, unit="N"),
        np.arange(1, integer("count", count, where=WHERE, limit=10_000) + 1),
    )
    inside = pull / mass + stiffness / mass * (n * np.pi / span) ** 2
    if inside[0] <= 0:
        raise InputError("the riser buckles", where=WHERE, found=f"tension {pull:g} N",
                         expected=f"above {-stiffness * (np.pi / span) ** 2:.4g} N", hint="check its sign")  # fmt: skip
    return np.asarray(n / (2 * span) * np.sqrt(inside), float)
