"""Dummy displacements as what they are: a prior that the loads leave the structure near its rest.

Accelerometers alone let the mean of a load drift. A customary cure feeds the filter displacements of zero that nobody
measured, with a std. As data these would enter the innovations, their tests and the likelihood. Here they enter the
prior: the process of structure and loads, given that its displacements stay near zero at all times, is again a linear
one. With the cost-to-go ``x^T Lam x`` of leaving zero, which solves the Riccati equation dual to the filter's, its
step is ``(I + Q Lam)^-1 F`` and its noise ``(Q^-1 + Lam)^-1``: a smoother with it says what one says that is fed with
zeros before, during and after the record.

Sources: F. Naets, J. Cuadrado, W. Desmet, Mech. Syst. Signal Process. 50-51 (2015) 235-248, for the dummy measurements;
the conditioned process is Doob's transform of a Gauss-Markov chain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.values import positive

from .doubling import Riccati, fixed_point
from .model import FilterModel
from .roots import backward, forward, lower


def near_rest(model: FilterModel, rows: NDArray, std: float) -> FilterModel:
    """The same structure and sensors, with displacements that stay near zero.

    Parameters
    ----------
    model : FilterModel
    rows : array, shape (displacements, n)
        Displacements of the states.
    std : float
        Of each displacement at each sample, in the units of the rows: a thousand samples within it are a stronger
        belief than one.

    Raises
    ------
    InputError
        Correlated noises, no std, displacements that the loads do not settle.
    """
    std = positive("the std of a dummy displacement", std, where="dummy", unit="m")
    if model.S is not None:
        raise InputError("dummy displacements do not go with ambient loads", where="dummy", found="ambient given",
                         expected="one of them")  # fmt: skip
    cost, _, settled = fixed_point(Riccati(model.F.T, rows.T / std, model.LQ))
    if not settled:
        raise InputError("displacements near zero do not settle this load", where="dummy", found=f"std {std:.3g}",
                         expected="a model whose displacements are finite",
                         hint="a smaller std, or an OU prior")  # fmt: skip
    pull = cost.T @ model.LQ  # (any, noises)
    root = lower(np.eye(pull.shape[1]), pull.T)
    return replace(
        model,
        F=model.F - model.LQ @ backward(root, forward(root, pull.T @ (cost.T @ model.F))),
        LQ=forward(root, model.LQ.T).T,
        L0=forward(lower(np.eye(model.L0.shape[1]), (cost.T @ model.L0).T), model.L0.T).T,
    )


def words(std: float) -> str:
    """What is believed, for reports: a prior, and no data."""
    return f"displacements at the loads near zero within {std:.3g} m at every sample (a belief, not measured)"
