"""What is wrong with the FRF of every line: how large it is, learned from the data.

The FRF in use errs: ``Y = (H + E) g + n``. E is random, of a size that nobody states, and has three parts: of every
entry in proportion to itself (gains, phases, calibration); in proportion to the mean of its column on that line (shapes
of modes, noise of a measured FRF), which fills antiresonances; and along the derivative of the FRF (natural
frequencies, damping), which is largest at resonances. Given loads whose variances v change slowly over the
lines, the data of a line are complex normal with covariance

    S = H V H^H + nu N + sum_c theta_c C_c(v).

Noise nu, sizes theta and variances v of the largest evidence are the fixed point of ratios,
``theta_c <- theta_c sum a^H C_c a / sum tr S^-1 C_c`` with ``a = S^-1 Y`` (D. J. C. MacKay, Neural Computation 4 (1992)
415). What spare sensors do not fit is in that evidence, and so is what loads of smooth size would never do in the
directions that a line hardly sees. A few data that show the floor are added: sizes of which the lines say nothing stay
there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import Array, Numbers
from .spectral import window

FLOOR = 0.05  # relative std of an entry of the FRF where the data tell nothing
FLOORS = np.array([0.5 * FLOOR**2, 0.5 * FLOOR**2, (FLOOR / 10) ** 2])  # of the three parts
NODES = ((-2.857, 0.01126), (-1.3556, 0.2221), (1.3556, 0.2221), (2.857, 0.01126))  # Gauss and Hermite, without 0
NEAREST = 0.05  # to a pole between lines, over the distance of the line
FAIR = 5.0  # times the floor, which no model that serves its purpose exceeds
GIVEN = 0.5  # data that show the floor
DATA = 900  # numbers that are asked
STEPS = 10  # of the fixed point, which then moves by less than chance
FEW = 8  # lines from which on sizes are learned
LEAST = 5.0  # data that show sizes, below which the floor decides
TINY = 1e-300


@dataclass(frozen=True)
class Discrepancy:
    """Errors of an FRF.

    Parameters
    ----------
    sizes : array (3,)
        Relative variances: of entries, of the mean over the sensors, of the frequencies.
    entries : array, shape (lines, sensors, loads)
        Variance of the entries by the first two.
    shift : array, shape (lines, sensors, nodes x loads)
        Errors of the entries by those of the frequencies, whose covariance is that of the columns of each load.
    load : array, shape (lines, loads)
        Variances of the loads around each line.
    noise : float
        Variance of the whitened noise.
    H : array, shape (lines, sensors, loads)
    shown : float
        Data that the sizes rest on; of few the floor stands.
    """

    sizes: Array
    entries: Array
    shift: NDArray[np.complex128]
    load: Array
    noise: float
    H: NDArray[np.complex128]
    shown: float

    @property
    def by_floor(self) -> bool:
        """Whether too few data show the sizes: the floor stands."""
        return self.shown < LEAST

    @property
    def fair(self) -> tuple[Array, NDArray[np.complex128]]:
        """`entries` and `shift` of sizes as a fair model has them: from the floor's to `FAIR` times these."""
        of, on = (np.sqrt(np.clip(s, f, FAIR**2 * f) / max(s, TINY)) for s, f in zip(
            (np.sum(self.sizes[:2]), self.sizes[2]), (np.sum(FLOORS[:2]), FLOORS[2]), strict=True))  # fmt: skip
        return self.entries * of**2, self.shift * on

    def columns(self, load: Array, w: Array) -> NDArray[np.complex128]:
        """Errors of the shapes at the loads, (lines, sensors, loads), for loads of such sizes.

        With w the weights of the sensors: each load imitates, in equal shares, what errors as large as those of the
        shapes at the sensors make of all loads.
        """
        size = np.linalg.norm(self.H * w[..., None], axis=1)
        made = np.sqrt(np.mean((size * load) ** 2, axis=1, keepdims=True))
        return np.asarray(np.sqrt(self.sizes[1]) * (made / np.maximum(size, TINY))[:, None, :] * self.H)

    @property
    def nodes(self) -> int:
        """Columns of `shift` for each load."""
        return int(self.shift.shape[2] // self.load.shape[1])

    @property
    def entry(self) -> float:
        """Relative std of an entry."""
        return float(np.sqrt(np.sum(self.sizes[:2])))


def learned(
    H: Numbers, X: Numbers, power: Array, f: Array, *, known: bool, neighbours: int, averages: float = 1.0
) -> Discrepancy:
    """Errors of the largest evidence, from evenly chosen lines.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    X : array, shape (lines, sensors, snapshots)
    power : array, shape (lines, sensors)
        Variance of the noise, or a scale where it is not `known`.
    f : array, shape (lines,)
        Hz, ascending.
    neighbours : int
        Lines to either side over which loads are as large as here.
    averages : float
        Behind the data.
    """
    lines, sensors, loads = H.shape
    root = np.sqrt(power)[..., None]
    H, X = H / root, X / root
    slope = _slope(H, f)
    step = max(1, -(-lines // max(DATA // sensors, 40)))
    pick = slice(step // 2, None, step)
    near, given = max(neighbours // step, 2), GIVEN / averages
    sizes, v, noise, shown = _fixed_point(H[pick], X[pick], slope[pick], known, near, given)
    shift = _shifted(H, f, float(np.sqrt(sizes[2])))
    at, every = np.arange(lines)[pick], np.arange(lines)
    load = np.exp(np.column_stack([np.interp(every, at, np.log(v[:, j])) for j in range(loads)]))
    entries = sizes[0] * np.abs(H) ** 2 + sizes[1] * _filled(np.abs(H) ** 2)
    return Discrepancy(
        sizes, entries * root**2, shift * root, load, noise, np.asarray(H * root, complex), shown * averages
    )


def _shifted(H: Numbers, f: Array, size: float) -> NDArray[np.complex128]:
    """Change of the FRF where its frequencies are off by one std, (lines, sensors, loads x nodes).

    Over a resonance that is no small change: the columns are nodes of a quadrature over the normal distribution.
    """
    return np.concatenate([np.sqrt(weight) * (_between(H, f, f * (1 + node * size)) - H)
                           for node, weight in NODES], axis=2)  # fmt: skip


def _between(H: Numbers, f: Array, at: Array) -> NDArray[np.complex128]:
    """The FRF between its lines: around each a rational function, with one pole for all entries.

    ``H(x) (1 + c x) = H_0 + d x`` through a line and its neighbours; c by least squares over the entries.
    """
    if len(f) < 3:
        return H.copy()
    at = np.clip(np.where(at > f[-1], 2 * f[-1] - at, np.where(at < f[0], 2 * f[0] - at, at)), f[0], f[-1])  # mirrored
    near = np.clip(np.searchsorted(0.5 * (f[1:] + f[:-1]), at), 1, len(f) - 2)
    below, here, above = H[near - 1], H[near], H[near + 1]
    a, b, x = (np.asarray(z - f[near])[:, None, None] for z in (f[near - 1], f[near + 1], at))
    bent, turned = (below - here) / a - (above - here) / b, above - below
    each = 1 / np.maximum(np.mean(np.abs(H) ** 2, axis=0), TINY)  # no unit decides
    c = np.sum(each * turned.conj() * bent, axis=(1, 2), keepdims=True)
    c /= np.maximum(np.sum(each * np.abs(turned) ** 2, axis=(1, 2), keepdims=True), TINY)
    d = 0.5 * ((below * (1 + c * a) - here) / a + (above * (1 + c * b) - here) / b)
    pole = 1 + c * x
    return np.asarray((here + d * x) / np.where(np.abs(pole) < NEAREST, NEAREST, pole))


def _slope(H: Numbers, f: Array) -> NDArray[np.complex128]:
    """Derivative over the logarithm of the frequency."""
    if len(f) < 2 or f[-1] <= 0:
        return np.zeros_like(H)
    return np.asarray(np.gradient(H, np.log(np.maximum(f, f[f > 0][0] / 2)), axis=0))


def _filled(size: Array) -> Array:
    """Squared entries as large as those of all sensors, over their noise."""
    return np.asarray(np.broadcast_to(np.mean(size, axis=1, keepdims=True), size.shape))


def _fixed_point(
    H: Numbers, X: Numbers, D: Numbers, known: bool, neighbours: int, given: float
) -> tuple[Array, Array, float, float]:
    """Sizes (3,), variances of the loads (lines, loads), noise, and how many data show the sizes."""
    lines, sensors, loads = H.shape
    near, _ = window(lines, neighbours)
    size, i = np.abs(H) ** 2, np.arange(sensors)
    filled = _filled(size)
    energy, power = np.sum(size, axis=1), np.sum(np.abs(X) ** 2, axis=(1, 2))
    v = near(power[:, None] * energy) / np.maximum(near(energy**2), TINY) / loads + TINY
    rest, theta, least = 0.0, FLOORS, 1.0 if known else 1e-12 * float(np.mean(power)) + TINY
    noise = 1.0 if known else 1e-3 * float(np.mean(power)) / sensors + TINY
    for _ in range(STEPS):
        both = np.concatenate([H, np.sqrt(theta[2]) * D], axis=2)
        scaled = both * np.sqrt(np.concatenate([v, v], axis=1))[:, None, :]
        S = scaled @ scaled.conj().swapaxes(1, 2)
        S[:, i, i] += noise + np.einsum("ksj,kj->ks", theta[0] * size + theta[1] * filled, v)
        solved = np.linalg.solve(S, np.concatenate([X, both, np.broadcast_to(np.eye(sensors), S.shape)], axis=2))
        a, along_both, inverse = np.split(solved, [X.shape[2], X.shape[2] + 2 * loads], axis=2)
        shown, due = np.sum(np.abs(a) ** 2, axis=2), np.einsum("kss->ks", inverse).real
        along = np.sum(np.abs(both.conj().swapaxes(1, 2) @ a) ** 2, axis=2)
        told = np.einsum("ksj,ksj->kj", both.conj(), along_both).real
        # of each part and load: what the data show of its share of S, and what is due
        parts = [
            np.stack([*(t * np.einsum("ksj,ks->kj", c, of) for t, c in zip(theta, (size, filled), strict=False)),
                      slope[:, loads:]])
            for of, slope in ((shown, along), (due, told))
        ]  # fmt: skip
        v_next = near(v**2 * (along[:, :loads] + parts[0].sum(axis=0))) / np.maximum(
            near(v * (told[:, :loads] + parts[1].sum(axis=0))), TINY
        )
        if lines >= FEW:
            seen, expected = (np.sum(v * part, axis=(1, 2)) for part in parts)
            rest = float(np.sum(expected)) if sensors > 1 else 0.0  # what one reads, loads explain as well
            theta = theta * np.clip((seen + given * FLOORS / theta) / (expected + given), 0.1, 10.0)
        noise = max(noise * float(np.sum(shown) / np.sum(due)), least)
        v = v_next + TINY
    return theta, v, noise, rest
