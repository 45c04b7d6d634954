"""A record over a state space as every recursion reads it: penalty as state, raw data, gaps, start, moving loads.

With ``w = L g`` as input, ``min |H g - y|^2 + lambda^2 |L g|^2`` is a linear-quadratic problem over the record:

    xi_{k+1} = F xi_k + G w_k,    y_k = C xi_k + D w_k,    g_k = E xi_k + w_k.

=================  ===================  =======================  ==============  =============  ===========
penalty            state                F                        G               C              E
=================  ===================  =======================  ==============  =============  ===========
identity           x                    A                        B               C              0
first difference   x, g_{k-1}           [A B; 0 I]               [B; I]          [C D]          [0 I]
second difference  x, g_{k-1}, d_{k-1}  [A B B; 0 I I; 0 0 I]    [B; I; I]       [C D D]        [0 I I]
leaky difference   x, g_{k-1}           [A phi B; 0 phi I]       [B; I]          [C phi D]      [0 phi I]
=================  ===================  =======================  ==============  =============  ===========

A difference of any order adds as many states: the last load, its first difference, and so on.

Correlated noise and a missing channel do not commute: what is left of a covariance is whitened by a root of its own,
one for each pattern of channels that occurs. A moving load gives every sample its own matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._models.statespace import StateSpace
from structures.errors import InputError

from ..penalties import order
from ..problem import LEAVES, Cholesky, Noise, Whitener, whitener
from .compiled import STRIDE
from .roots import Array


@dataclass(frozen=True)
class Augmented:
    """A model with its penalty, sensors whitened: states n, inputs p, sensors m.

    Parameters
    ----------
    F, G, C, D, E : array, shapes (n, n), (n, p), (m, n), (m, p), (p, n)
    nx : int
        States of the model itself; the rest is the load's history.
    free : array of int
        States that start free: load states (unless the load starts at zero), and all of x where it is not known.
    """

    F: Array
    G: Array
    C: Array
    D: Array
    E: Array
    nx: int
    free: NDArray[np.int_]

    @property
    def n(self) -> int:
        """States."""
        return len(self.F)

    @property
    def p(self) -> int:
        """Loads."""
        return int(self.G.shape[1])

    @property
    def m(self) -> int:
        """Sensors."""
        return len(self.C)


def augment(
    A: Array, B: Array, C: Array, D: Array, penalty: str = "identity", *, leak: float | None = None,
    from_zero: bool = False, unknown_start: bool | int = False,
) -> Augmented:  # fmt: skip
    """State space of a penalty over a model; C and D whitened.

    Parameters
    ----------
    A, B, C, D : array
        Discrete model.
    penalty : str
        Named penalty, a difference of any order.
    leak : float, optional
        The first difference becomes ``g_k - leak g_{k-1}``, 0 < leak < 1.
    from_zero : bool
        The load is zero before the record, and its first difference counts; else its start is free.
    unknown_start : bool or int
        The state of the model at the first sample is an unknown of the data; a number: its first so many states.
    """
    degree, nx, p = order(penalty), len(A), B.shape[1]
    if leak is not None and (degree != 1 or not 0 < leak < 1):
        raise InputError("a leak belongs to the first difference", where="penalty", found=f"{penalty!r}, leak {leak!r}",
                         expected="penalty='first_difference' and a leak between 0 and 1")  # fmt: skip
    phi, one = 1.0 if leak is None else float(leak), np.eye(p)
    E = np.hstack([np.zeros((p, nx)), *([phi * one] * degree)])
    history = np.kron(np.triu(np.ones((degree, degree))), phi * one)
    F = np.block([[np.hstack([A, np.zeros((nx, degree * p))]) + B @ E], [np.zeros((degree * p, nx)), history]])
    G = np.vstack([B, *([one] * degree)])
    Caug = np.hstack([C, np.zeros((len(C), degree * p))]) + D @ E
    # a leaky load has a proper prior: it comes from zero, whatever was asked
    loose = np.arange(nx, nx + degree * p) if not from_zero and leak is None else np.arange(0)
    free = np.concatenate([np.arange(nx if unknown_start is True else int(unknown_start)), loose]).astype(int)
    return Augmented(F, G, Caug, np.array(D, float), E, nx, free)


def of_model(system: StateSpace, rows: Array, W: Array, penalty: str, **options: object) -> Augmented:
    """As `augment`, from some sensors of a model whitened by the matrix `W` (kept, rows)."""
    return augment(system.A, system.B, W @ system.C[rows], W @ system.D[rows], penalty, **options)  # type: ignore[arg-type]


@dataclass(frozen=True)
class WhitenedRecord:
    """Whitened data over an augmented system whose matrices may change from sample to sample.

    Parameters
    ----------
    F, G, C, D : array, shapes (kinds, n, n), (kinds, n, p), (kinds, m, n), (kinds, m, p)
        Matrices of each kind of sample: without and with missing channels, or of each place of a moving load.
    E : array (p, n)
    kind : array of int, shape (samples,)
        Which matrices each sample has.
    y : array, shape (samples, m)
        Whitened data; 0 where nothing was measured, with a row of zeros in C and D.
    free : array of int
        States that start free.
    data : int
        Number of data.
    """

    F: Array
    G: Array
    C: Array
    D: Array
    E: Array
    kind: NDArray[np.int32]
    y: Array
    free: NDArray[np.int_]
    data: int

    @property
    def samples(self) -> int:
        """Samples."""
        return len(self.kind)

    @property
    def n(self) -> int:
        """States."""
        return int(self.F.shape[1])

    @property
    def p(self) -> int:
        """Loads."""
        return int(self.G.shape[2])

    @property
    def m(self) -> int:
        """Sensors."""
        return int(self.C.shape[1])

    @property
    def unknowns(self) -> int:
        """Inputs of all samples and free states."""
        return self.samples * self.p

    @cached_property
    def settles(self) -> bool:
        """No free state stays for ever whatever the inputs are: of such a one every sample tells more."""
        one = np.eye(self.n)
        return not any(np.all(self.F[:, i] == one[i]) and not self.G[:, i].any() for i in self.free)

    @property
    def stride(self) -> int:
        """Samples between two looks at whether a recursion has settled; beyond the record where it does not."""
        return STRIDE if self.settles else self.samples + 1

    @cached_property
    def entries(self) -> tuple[NDArray[np.int_], Array]:
        """Places (2, entries) at which any F is not zero, and its values there (kinds, entries): few in modal form."""
        at = np.array(np.nonzero(np.any(self.F != 0, axis=0)))
        return at, np.ascontiguousarray(self.F[:, at[0], at[1]])


def record(system: Augmented, y: Array, missing: NDArray[np.bool_] | None = None) -> WhitenedRecord:
    """Record of a system that does not change, of whitened data (samples, m); `missing` data are left out.

    Raises
    ------
    InputError
        Data that do not fit, or NaN that is not declared as missing.
    """
    y = np.array(y, float)
    if y.ndim != 2 or y.shape[1] != system.m:
        raise InputError("the data do not fit the system", where="state-space path", found=f"shape {y.shape}",
                         expected=f"(samples, {system.m})")  # fmt: skip
    kind: NDArray[np.int32] = np.zeros(len(y), np.int32)
    shown = np.ones((1, system.m), bool)
    if missing is not None and np.any(missing):
        y[missing] = 0.0
        shown, places = np.unique(~missing, axis=0, return_inverse=True)
        kind = places.reshape(-1).astype(np.int32)
    if not np.all(np.isfinite(y)):
        raise InputError("NaN or inf in the data", where="state-space path", expected="finite numbers",
                         hint="declare what is missing")  # fmt: skip
    count = len(shown)
    return WhitenedRecord(
        np.repeat(system.F[None], count, 0), np.repeat(system.G[None], count, 0),
        np.ascontiguousarray(system.C * shown[:, :, None]), np.ascontiguousarray(system.D * shown[:, :, None]),
        np.ascontiguousarray(system.E), kind, y, system.free, int(np.sum(shown.sum(axis=1)[kind])),
    )  # fmt: skip


def measured(systems: Augmented | Sequence[Augmented], y: ArrayLike, noise: Noise | None = None) -> WhitenedRecord:
    """Record of raw data over systems that are not whitened.

    Parameters
    ----------
    systems : Augmented, or one for each sample
        In the units of the sensors; those of a moving load from `moving`.
    y : array, shape (samples, sensors)
        NaN where nothing was measured.
    noise : array or Cholesky, optional
        Std (sensors,), covariance (sensors, sensors), which may be singular, or a Cholesky factor of it; default 1.

    Raises
    ------
    InputError
        Data that do not fit the systems or the range of a singular covariance, inf in the data, or no noise.
    """
    each = [systems] if isinstance(systems, Augmented) else list(systems)
    y, first = np.array(y, float), each[0]
    if y.ndim != 2 or y.shape[1] != first.m or len(each) not in (1, len(y)):
        raise InputError("the data do not fit the system", where="state-space path", found=f"shape {y.shape}",
                         expected=f"({'samples' if len(each) == 1 else len(each)}, {first.m})")  # fmt: skip
    if np.any(np.isinf(y)):
        raise InputError("inf in the data", where="state-space path", expected="finite numbers, NaN where missing",
                         hint="declare clipped samples as missing")  # fmt: skip
    noise = np.ones(first.m) if noise is None else noise
    whitener(noise, first.m)  # judged as a whole, whatever is missing
    data, pattern, roots = whitened(y, noise)
    # a fixed system has one kind for each pattern, a moving one for each sample
    at = np.arange(len(roots)) if len(each) == 1 else pattern
    parts = each * len(roots) if len(each) == 1 else each
    kind = pattern if len(each) == 1 else np.arange(len(y))
    C, D = (np.zeros((len(at), first.m, width)) for width in (first.n, first.p))
    for j, one in enumerate(parts):
        root = roots[at[j]]
        C[j, : len(root)], D[j, : len(root)] = root @ one.C, root @ one.D
    total = int(np.array([len(root) for root in roots])[pattern].sum())
    F, G = np.array([one.F for one in parts]), np.array([one.G for one in parts])
    return WhitenedRecord(F, G, C, D, np.ascontiguousarray(first.E), kind.astype(np.int32), data, first.free, total)


def whitened(y: Array, noise: Noise) -> tuple[Array, NDArray[np.intp], list[Array]]:
    """Whitened data of raw ones (samples, sensors) with NaN, the pattern of channels of each sample, and its root."""
    patterns, pattern = np.ones((1, y.shape[1]), bool), np.zeros(len(y), np.intp)
    if np.isnan(y).any():
        patterns, places = np.unique(~np.isnan(y), axis=0, return_inverse=True)
        pattern = np.asarray(places).reshape(-1)
    roots, data = [_root(noise, there) for there in patterns], np.zeros(y.shape)
    for i, (there, root) in enumerate(zip(patterns, roots, strict=True)):
        own = pattern == i
        data[own, : root.shape[0]] = _white(noise, there, root, y[own])
    return data, pattern, roots


def moving(
    A: Array, B: Array, C: Array, D: Array, samples: int, penalty: str = "identity", *,
    leak: float | None = None, from_zero: bool = False, unknown_start: bool | int = False,
) -> list[Augmented]:  # fmt: skip
    """One augmented system for each sample; B and D may be led by time, other parameters as in `augment`."""
    options = {"leak": leak, "from_zero": from_zero, "unknown_start": unknown_start}
    Bs, Ds = (np.broadcast_to(M, (samples, *M.shape[-2:])) for M in (B, D))
    return [augment(A, b, C, d, penalty, **options) for b, d in zip(Bs, Ds, strict=True)]  # type: ignore[arg-type]


def _root(noise: Noise, there: NDArray[np.bool_]) -> Array:
    """Whitening matrix (kept, sensors) of the channels that are there, zero in the columns of those that are not."""
    root = np.zeros((0, len(there)))
    if there.any():
        own = _part(noise, there).apply(np.eye(int(there.sum())), 0)
        root = np.zeros((len(own), len(there)))
        root[:, there] = own
    return root


def _white(noise: Noise, there: NDArray[np.bool_], root: Array, y: Array) -> Array:
    """Whitened data (samples, kept) of one pattern."""
    if there.any():
        share = _part(noise, there).outside(y[:, there], axis=1)
        if share > LEAVES:
            raise InputError(
                "the data leave the range of the singular noise covariance", where="noise",
                found=f"a share of {share:.3g} of their norm outside it", expected=f"at most {LEAVES:g}",
                hint="give the covariance of the data as they are, or invert the readings before interpolation",
            )  # fmt: skip
    return np.where(there, y, 0.0) @ root.T


def _part(noise: Noise, there: NDArray[np.bool_]) -> Whitener:
    """Whitener of some channels."""
    if isinstance(noise, Cholesky):
        # rows of a factor are a root of their covariance; their QR makes it triangular, without squares
        lower = np.asarray(np.linalg.qr(np.asarray(noise.factor, float)[there].T, mode="r")).T
        return whitener(Cholesky(lower * np.where(np.diag(lower) < 0, -1.0, 1.0)), int(there.sum()))
    values = np.asarray(noise, float)
    return whitener(values[there] if values.ndim == 1 else values[np.ix_(there, there)], int(there.sum()))


HORIZON = 4096  # samples over which a state may show itself
UNSEEN = 1e-10  # of the largest singular value of the free responses


def observed_first(A: Array, B: Array, C: Array, samples: int) -> tuple[Array, Array, Array, int]:
    """The same system in coordinates whose first ones are what the sensors see of the state at the first sample.

    Parameters
    ----------
    A, B, C : array, shapes (n, n), ([samples,] n, p), (m, n)
        C in units of the noise.
    samples : int
        Length of the record.

    Returns
    -------
    A, B : array
        In the new coordinates z, x = back z; unchanged where all states are seen.
    back : array, shape (n, n)
    seen : int
    """
    rows, block = [], np.array(C)
    for _ in range(min(samples, HORIZON)):
        rows.append(block)
        block = block @ A
    free = np.concatenate(rows)
    size = np.linalg.norm(free, axis=0)
    size = np.maximum(size, 1e-12 * size.max(initial=1e-300))
    _, s, Vt = np.linalg.svd(free / size, full_matrices=False)
    seen = int(np.sum(s > UNSEEN * s.max(initial=0.0)))
    if seen == len(A):
        return A, B, np.eye(len(A)), seen
    to, back = Vt * size, Vt.T / size[:, None]
    return to @ A @ back, to @ B, back, seen
