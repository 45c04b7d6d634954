"""Size of the operator that a record sees: its largest and smallest generalised singular values, and its free part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .passes import backward, forward
from .record import Record
from .riccati import feedback

LONG = 1 << 14  # samples beyond which the largest value is extrapolated
LINES = 512


def unforced(record: Record) -> NDArray[np.float64]:
    """Responses (samples * m, free) to each free state alone."""
    still, none = feedback(record), np.zeros((record.samples, record.p))
    columns = [forward(record, still, none, start)[2].reshape(-1) for start in np.eye(record.n)[record.free]]
    return np.array(columns).T.reshape(-1, len(record.free))


def largest(record: Record) -> float:
    """Largest generalised singular value of (H, L): of ``L g`` to the data, free states fitted.

    That of a record beyond `LONG` samples is extrapolated by its growth over the last doubling: flat where the response
    has been forgotten by then, a power of the length where a difference of a static load is asked for. A moving load is
    followed over its whole way.
    """
    if record.samples <= LONG or np.ptp(record.F, axis=0).any() or np.ptp(record.G, axis=0).any():
        return _largest(record)
    half, whole = _largest(beginning(record, LONG // 2)), _largest(beginning(record, LONG))
    if half <= 0:
        return whole
    return float(whole * (record.samples / LONG) ** max(np.log2(whole / half), 0.0))


def _largest(record: Record) -> float:
    from scipy.sparse.linalg import LinearOperator, eigsh

    still, start = feedback(record), np.zeros(record.n)
    count = record.samples * record.p
    Q = np.linalg.qr(unforced(record))[0] if len(record.free) else np.zeros((record.samples * record.m, 0))

    def normal(w: NDArray) -> NDArray:
        y = forward(record, still, np.ascontiguousarray(w.reshape(-1, record.p)), start)[2].reshape(-1)
        y = (y - Q @ (Q.T @ y)).reshape(-1, record.m)
        return backward(record, still, y, None)[0].reshape(-1)

    if count <= 2:
        matrix = np.array([normal(e) for e in np.eye(count)])
        return float(np.sqrt(np.abs(np.linalg.eigvalsh(matrix)).max()))
    first = np.random.default_rng(0).standard_normal(count)
    reach = normal(first)
    size = float(np.linalg.norm(reach))
    if not np.isfinite(size) or size == 0.0:
        return size
    # the operator is scaled to order one: the solver's own tolerances know no units
    operator = LinearOperator((count, count), matvec=lambda w: normal(w) / size, dtype=float)
    top = eigsh(operator, k=1, v0=reach / size, tol=1e-9, return_eigenvectors=False)
    return float(np.sqrt(size * max(float(top[0]), 0.0)))


def smallest(record: Record) -> float:
    """Smallest singular value of the steady system from ``L g`` to the data, over all frequencies."""
    return float(lines(record).min())


def layout(record: Record) -> tuple[float, int, int]:
    """Condition number of the part that the data see, rank and nullity, by the lines of the steady system."""
    values, unknowns = lines(record), record.samples * record.p
    seen = values > record.samples * record.p * np.finfo(float).eps * values.max()
    rank = min(round(unknowns * float(np.sum(seen)) / (LINES * record.p)), record.data)
    return float(values.max() / values[seen].min()), rank, max(unknowns - rank, 0)


def lines(record: Record) -> NDArray[np.float64]:
    """Singular values of the steady system from ``L g`` to the data, (lines, min(m, p)), up to Nyquist."""
    return np.asarray(np.linalg.svd(transfer(record)[0], compute_uv=False), float)


def transfer(record: Record) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Steady transfer of ``L g`` to the data (lines, m, p) and to the loads (lines, p, p), up to Nyquist."""
    z = np.exp(1j * np.pi * np.arange(1, LINES + 1) / LINES)
    kind = fullest(record)
    F, G, C, D = record.F[kind], record.G[kind], record.C[kind], record.D[kind]
    states = np.linalg.solve(z[:, None, None] * np.eye(record.n) - F, np.broadcast_to(G, (LINES, *G.shape)))
    return np.asarray(C @ states + D, complex), np.asarray(record.E @ states + np.eye(record.p), complex)


def beginning(record: Record, samples: int) -> Record:
    """So many samples with the most complete of the sets of sensors."""
    return replace(record, kind=np.full(samples, fullest(record), np.int32), y=record.y[:samples])


def fullest(record: Record) -> int:
    """Kind of sample with the most sensors."""
    return int(np.argmax(np.abs(record.C).sum(axis=(1, 2)) + np.abs(record.D).sum(axis=(1, 2))))
