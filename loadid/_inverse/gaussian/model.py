"""Linear systems driven by noise: a filter's model, what is left of it where channels are missing, loads near rest.

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

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, plain, positive

from .roots import Array, Riccati, fixed_point, lower, solve_lower, solve_lower_transposed


@dataclass(frozen=True, eq=False)
class FilterModel:
    """``x_{k+1} = F x_k + w_k``, ``y_k = H x_k + v_k``, load ``p_k = Cp x_k``; covariances are kept as roots.

    Parameters
    ----------
    F : array, shape (n, n)
    LQ : array, shape (n, q)
        ``E[w w^T] = LQ LQ^T``.
    H : array, shape (m, n)
    LR : array, shape (m, m)
        ``E[v v^T] = LR LR^T``, lower triangular.
    Cp : array, shape (p, n)
        Reads the loads off the state.
    x0 : array, shape (n,)
        Mean before the first sample.
    L0 : array, shape (n, r)
        Root of its covariance.
    nx : int
        States of the structure; the rest belongs to the priors of the loads.
    S : array, shape (n, m), optional
        ``E[w_k v_k^T]``.
    held : bool
        Loads change with a sample, not between two.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN.
    """

    F: Array
    LQ: Array
    H: Array
    LR: Array
    Cp: Array
    x0: Array
    L0: Array
    nx: int
    S: Array | None = None
    held: bool = True

    def __post_init__(self) -> None:
        n, m = len(self.F), len(self.H)
        shapes = {
            "F": (n, n), "H": (m, n), "LR": (m, m), "x0": (n,), "LQ": (n, self.LQ.shape[-1]),
            "L0": (n, self.L0.shape[-1]), "Cp": (len(self.Cp), n), "S": (n, m),
        }  # fmt: skip
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(plain(value), float)  # float32 is raised: filters lose their sign in it
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise InputError("the filter's matrices do not fit", where=f"FilterModel.{name}",
                                 found=f"shape {array.shape}, or NaN in it", expected=f"finite, {shape}")  # fmt: skip
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def n(self) -> int:
        """States."""
        return len(self.F)

    @property
    def m(self) -> int:
        """Sensors."""
        return len(self.H)

    @property
    def p(self) -> int:
        """Loads."""
        return len(self.Cp)


IMPOSSIBLE = 1e-7  # by which a correlation may exceed one, or leave the range of the process noise


@dataclass(frozen=True, eq=False)
class Present:
    """``x_{k+1} = F x_k + T y_k + w_k``, ``y_k = H x_k + v_k`` of the channels that are there, w and v uncorrelated.

    Parameters
    ----------
    mask : array of bool, shape (m,)
    F : array, shape (n, n)
    LQ : array, shape (n, q)
    H : array, shape (present, n)
    LR : array, shape (present, present)
    T : array, shape (n, present), or None
        What a sample tells of the process noise that moved it; None where the two are not correlated.
    """

    mask: NDArray[np.bool_]
    F: Array
    LQ: Array
    H: Array
    LR: Array
    T: Array | None

    def moved(self, x: Array, y: Array | None) -> Array:
        """Mean one sample later; y (m,) the data of this one."""
        ahead = self.F @ x
        return ahead if self.T is None or y is None else ahead + self.T @ y[self.mask]


def present(model: FilterModel, mask: NDArray[np.bool_]) -> Present:
    """The model for one set of channels.

    With ``S = E[w v^T]``: ``F - S R^-1 H``, ``Q - S R^-1 S^T`` and the known input ``S R^-1 y`` (Kailath, Sayed &
    Hassibi, Linear Estimation, 2000, ch. 9). The difference is taken inside the root: ``S = LQ C LR^T`` with C a matrix
    of correlations, and ``Q - S R^-1 S^T = LQ (I - C C^T) LQ^T``.

    Raises
    ------
    InputError
        S that no pair of noises has, or that belongs to a channel without noise.
    """
    H = np.ascontiguousarray(model.H[mask])
    LR = lower(model.LR[mask])
    if model.S is None or not mask.any():
        return Present(mask, model.F, model.LQ, H, LR, None)
    if not np.all(np.diag(LR)):
        raise InputError("a channel without noise cannot be correlated with the process noise", where="FilterModel.LR",
                         found="a singular root", expected="a positive definite covariance of the noise")  # fmt: skip
    white = solve_lower(LR, model.S[:, mask].T)  # LR^-1 S^T
    size = np.linalg.norm(model.LQ, axis=1)
    size[size == 0] = 1.0
    C = np.linalg.lstsq(model.LQ / size[:, None], white.T / size[:, None], rcond=None)[0]
    U, s, _ = np.linalg.svd(C)
    miss = float(np.max(np.abs((model.LQ @ C - white.T) / size[:, None]), initial=0.0))
    if miss > IMPOSSIBLE or s.max(initial=0.0) > 1 + IMPOSSIBLE:
        raise InputError("S is the covariance of no pair of noises with these Q and R", where="FilterModel.S",
                         found=f"largest correlation {s.max(initial=0.0):.3g}, outside the range of Q by {miss:.1g}",
                         expected="correlations of at most 1, within the range of Q")  # fmt: skip
    left = np.ones(len(U))
    left[: len(s)] = np.sqrt(np.maximum((1 - s) * (1 + s), 0.0))
    T = solve_lower_transposed(LR, white).T
    return Present(mask, model.F - T @ H, model.LQ @ (U * left), H, LR, np.ascontiguousarray(T))


def near_rest(model: FilterModel, rows: Array, std: float) -> FilterModel:
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
        F=model.F - model.LQ @ solve_lower_transposed(root, solve_lower(root, pull.T @ (cost.T @ model.F))),
        LQ=solve_lower(root, model.LQ.T).T,
        L0=solve_lower(lower(np.eye(model.L0.shape[1]), (cost.T @ model.L0).T), model.L0.T).T,
    )


def words(std: float) -> str:
    """What is believed, for reports: a prior, and no data."""
    return f"displacements at the loads near zero within {std:.3g} m at every sample (a belief, not measured)"
