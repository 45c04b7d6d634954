"""How lambda was chosen: what every rule said, how far they agree, and what that agreement is worth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RuleResult:
    """What one rule said.

    Parameters
    ----------
    rule : str
        Name.
    lam : float or None
        Relative lambda (lambda over the scale of the problem); None when the rule refused.
    edge : bool
        The answer sits at an end of the sweep.
    note : str
        Why it refused, or what is odd about it.
    """

    rule: str
    lam: float | None
    edge: bool = False
    note: str = ""


@dataclass(frozen=True)
class Sweep:
    """The path over a grid of relative lambdas, for pictures: all arrays (points,)."""

    lam: NDArray[np.float64]
    residual_norm: NDArray[np.float64]
    penalty_norm: NDArray[np.float64]
    edf: NDArray[np.float64] | None = None
    gcv: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Choice:
    """The lambda that was used and what every rule said.

    Parameters
    ----------
    lam : float
        Relative lambda; ``lam * scale`` is the absolute one (whitened data).
    scale : float
        Scale of the problem, its largest generalised singular value.
    rule : str
        Rule that chose it, or ``"given"``.
    rules : tuple of RuleResult
        All rules that were asked.
    spread : float
        Decades between the smallest and the largest lambda of the rules that ran.
    verdict : str
        ``determined``, ``usable``, ``rules disagree`` or ``not determined``.
    odds : str
        What the verdict is worth, as measured on test problems.
    sigma : float or None
        Noise level of the whitened data (1 where the noise is known).
    sigma_source : str
        Where the noise level comes from.
    edf : float or None
        Effective degrees of freedom at `lam`.
    sweep : Sweep or None
        For the pictures.
    """

    lam: float
    scale: float
    rule: str
    rules: tuple[RuleResult, ...] = ()
    spread: float = 0.0
    verdict: str = "determined"
    odds: str = ""
    sigma: float | None = None
    sigma_source: str = "not known"
    edf: float | None = None
    sweep: Sweep | None = field(default=None, repr=False)
