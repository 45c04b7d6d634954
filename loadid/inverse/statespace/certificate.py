"""How exactly a solve solved: the gradient of the objective, by a pass that knows nothing of the gains."""

from __future__ import annotations

import numpy as np

from .passes import Solved, backward
from .record import Record
from .riccati import feedback


def gradient(record: Record, lam: float, solved: Solved) -> float:
    """Norm of ``H^T (H g - y) + lam^2 L^T L g`` over that of ``H^T y``, by inputs and free states."""
    still, free = feedback(record), record.free
    rest, start, _ = backward(record, still, solved.response - record.y, None)
    whole, first, _ = backward(record, still, record.y, None)
    rest += lam**2 * solved.inputs
    size = np.hypot(np.linalg.norm(whole), np.linalg.norm(first[free]))
    return float(np.hypot(np.linalg.norm(rest), np.linalg.norm(start[free])) / max(size, np.finfo(float).tiny))
