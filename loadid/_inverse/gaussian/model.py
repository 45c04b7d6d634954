"""Linear systems driven by noise: a filter's model, its square-root recursion, missing channels, loads near rest.

The Kalman filter carries the root of its covariance: one QR factorisation a sample, exact with channels missing.

    [ LR   H L-  ]           [ Se^1/2       0 ]
    [ 0    L-    ]  =  [     [ P- H^T Se^-T/2   L ]  ]  Q        update
    [ F L   LQ   ]  =  [ L-  0 ] Q                               prediction

Both in one array where a sample follows a sample. The covariance cannot lose its sign, as those of the short and of
the Joseph form do when sensors are quiet.

Accelerometers alone let the mean of a load drift. A customary cure feeds the filter displacements of zero that nobody
measured, with a std. As data these would enter the innovations, their tests and the likelihood. Here they enter the
prior: the process of structure and loads, given that its displacements stay near zero at all times, is again a linear
one. With the cost-to-go ``x^T Lam x`` of leaving zero, which solves the Riccati equation dual to the filter's, its
step is ``(I + Q Lam)^-1 F`` and its noise ``(Q^-1 + Lam)^-1``: a smoother with it says what one says that is fed with
zeros before, during and after the record.

Sources: Kailath, Sayed & Hassibi, Linear Estimation, Prentice Hall 2000, ch. 12, and Grewal & Andrews, Kalman
Filtering, 4th ed., 2015, ch. 7, for the square-root forms; F. Naets, J. Cuadrado, W. Desmet, Mech. Syst. Signal
Process. 50-51 (2015) 235-248, for the dummy measurements;
the conditioned process is Doob's transform of a Gauss-Markov chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._readonly import ReadOnly
from structures.errors import InputError, plain, positive

from .roots import Array, Riccati, fixed_point, joined, lower, solve_lower, solve_lower_transposed, square


@dataclass(frozen=True, eq=False)
class FilterModel(ReadOnly):
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


MASKS = 512  # sets of channels whose arrays are kept
LOG2PI = float(np.log(2 * np.pi))


@dataclass(frozen=True, eq=False)
class FilterState:
    """Mean x (n,) and root L (n, r) of its covariance; `y` the sample (m,), kept where noises are correlated."""

    x: Array
    L: Array
    y: Array | None = None

    def to_tree(self) -> dict[str, Array | None]:
        """Plain arrays, for files."""
        return {"x": self.x, "L": self.L, "y": self.y}

    @classmethod
    def from_tree(cls, tree: Mapping[str, Any]) -> FilterState:
        """Inverse of `to_tree`; what else the tree holds does not matter."""
        y = None if tree["y"] is None else np.asarray(tree["y"], float)
        return cls(np.asarray(tree["x"], float), np.asarray(tree["L"], float), y)


@dataclass(frozen=True, eq=False)
class Innovation:
    """What a sample said beyond its prediction.

    Parameters
    ----------
    e : array, shape (m,)
        NaN where a channel is missing.
    root : array, shape (present, present)
        Lower triangular root of its covariance; signs on the diagonal are free.
    gain : array, shape (n, present)
        ``P- H^T Se^-T/2``: the mean moved by gain times the whitened innovation.
    present : array of bool, shape (m,)
    nis : float
        Normalised square; chi-square with as many degrees of freedom as channels are present.
    loglik : float
        Logarithm of the predictive density of the sample.
    """

    e: Array
    root: Array
    gain: Array
    present: NDArray[np.bool_]
    nis: float
    loglik: float

    @property
    def std(self) -> Array:
        """Predicted std of e (m,), NaN where missing."""
        out = np.full(len(self.present), np.nan)
        out[self.present] = np.linalg.norm(self.root, axis=1)
        return out

    @property
    def normalised(self) -> Array:
        """Innovation in units of its own std, channel by channel (m,)."""
        return self.e / self.std


@dataclass(frozen=True, eq=False)
class Stack:
    """The constant part of the array of a sample that follows a sample."""

    before: Present
    now: Present
    ahead: Array  # [H F; F], times L
    noise: Array  # triangular root of [H LQ, LR; LQ, 0]


class SquareRoot:
    """The recursion sample by sample.

    Parameters
    ----------
    model : FilterModel

    Raises
    ------
    InputError
        Noises whose correlation is impossible.
    """

    def __init__(self, model: FilterModel) -> None:
        self.model = model
        self._present: dict[bytes, Present] = {}
        self._stacks: dict[bytes, Stack] = {}
        self.whole = self.seen(np.ones(model.m, bool))

    def start(self) -> FilterState:
        """Mean and covariance before the first sample: update without predicting."""
        return FilterState(self.model.x0, self.model.L0)

    def predict(self, state: FilterState) -> FilterState:
        """One sample later."""
        part = self.whole if self.model.S is None else self.seen(_there(state.y, self.model.m))
        return FilterState(part.moved(state.x, state.y), lower(part.F @ state.L, part.LQ))

    def update(self, state: FilterState, y: ArrayLike) -> tuple[FilterState, Innovation]:
        """With the sample y (m,) of the same time; channels that are NaN are left out, exactly.

        Raises
        ------
        InputError
            A sample of another width, or infinite.
        """
        y = self.sample(y)
        part = self.seen(np.isfinite(y))
        return self._updated(_update_array(part, state.L), part, state.x, y)

    def advance(self, state: FilterState, y: ArrayLike) -> tuple[FilterState, Innovation]:
        """Prediction and update in one factorisation."""
        y = self.sample(y)
        stack = self.stack(None if self.model.S is None else _there(state.y, self.model.m), np.isfinite(y))
        x = stack.before.moved(state.x, state.y)
        return self._updated(joined(stack.noise, stack.ahead @ state.L), stack.now, x, y)

    # -- pieces that the steady gains stand on -----------------------------------------------------------------------
    def seen(self, mask: NDArray[np.bool_]) -> Present:
        """The model for one set of channels."""
        key = mask.tobytes()
        found = self._present.get(key)
        if found is None:
            if len(self._present) >= MASKS:
                self._present.clear()
            found = self._present[key] = present(self.model, mask)
        return found

    def stack(self, before: NDArray[np.bool_] | None, now: NDArray[np.bool_]) -> Stack:
        """Arrays of a sample with the channels `now` after one with those of `before`."""
        key = now.tobytes() if before is None else before.tobytes() + now.tobytes()
        found = self._stacks.get(key)
        if found is None:
            if len(self._stacks) >= MASKS:
                self._stacks.clear()
            found = self._stacks[key] = _stack(self.whole if before is None else self.seen(before), self.seen(now))
        return found

    def covariance(self, stack: Stack, L: Array) -> tuple[Array, Array, Array]:
        """Root of Se, gain ``P- H^T Se^-T/2`` and root of the filtered covariance, from that of the sample before."""
        return _parted(joined(stack.noise, stack.ahead @ L), len(stack.now.H))

    def update_root(self, part: Present, L: Array) -> Array:
        """Root of the filtered covariance from that of the predicted one."""
        return _parted(_update_array(part, L), len(part.H))[2]

    def sample(self, y: ArrayLike) -> Array:
        """A sample as float64 (m,).

        Raises
        ------
        InputError
            Another width, or an infinite number; NaN is a missing channel.
        """
        y = np.asarray(plain(y), float)
        if y.shape != (self.model.m,):
            raise InputError("a sample of the wrong width", where="sample", found=f"shape {y.shape}",
                             expected=f"({self.model.m},)")  # fmt: skip
        if np.isinf(y).any():
            raise InputError("an infinite number in a sample", where=f"channel {int(np.flatnonzero(np.isinf(y))[0])}",
                             expected="finite numbers, NaN where a channel is missing")  # fmt: skip
        return y

    def _updated(self, made: Array, part: Present, x: Array, y: Array) -> tuple[FilterState, Innovation]:
        m = len(part.H)
        root, gain, L = _parted(made, m)
        rest = y[part.mask] - part.H @ x
        if m and not np.all(np.diag(root)):
            raise InputError("a channel without noise repeats what is known exactly", where="FilterModel.LR",
                             found="a singular covariance of the innovation", expected="noise on it")  # fmt: skip
        white = solve_lower(root, rest)
        nis = float(white @ white)
        loglik = -0.5 * (nis + m * LOG2PI) - float(np.sum(np.log(np.abs(np.diag(root)))))
        e = np.full(len(y), np.nan)
        e[part.mask] = rest
        kept = y if self.model.S is not None else None
        return FilterState(x + gain @ white, L, kept), Innovation(e, root, gain, part.mask, nis, loglik)


def _there(y: Array | None, m: int) -> NDArray[np.bool_]:
    return np.zeros(m, bool) if y is None else np.isfinite(y)


def _update_array(part: Present, L: Array) -> Array:
    """The array of an update, made triangular."""
    m = len(part.H)
    wide = np.zeros((m + len(L), m + L.shape[1]))
    wide[:m, :m], wide[:m, m:], wide[m:, m:] = part.LR, part.H @ L, L
    return lower(wide)


def _stack(before: Present, now: Present) -> Stack:
    m, n, q = len(now.H), len(before.F), before.LQ.shape[1]
    noise = np.zeros((m + n, q + m))
    noise[:m, :q], noise[m:, :q], noise[:m, q:] = now.H @ before.LQ, before.LQ, now.LR
    return Stack(before, now, np.vstack([now.H @ before.F, before.F]), square(lower(noise)))


def _parted(made: Array, m: int) -> tuple[Array, Array, Array]:
    """Root of Se (m, m), gain (n, m), root (n, at most n) out of a triangular array."""
    return made[:m, :m], np.ascontiguousarray(made[m:, :m]), np.ascontiguousarray(made[m:, m:])
