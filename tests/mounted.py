"""A source on a plate, whose blocked forces have a closed form: the truth of transfer path analysis.

The source is a rigid foot on one node of a simply supported plate. It carries two masses on springs beside the node;
forces act on these masses. Blocked, the foot feels what the springs hand on, ``k / (k - omega^2 m)`` of each force, and
its moments about the node. The assembly is the plate's mesh with the source added to it, solved line by line; its FRFs
are "measured" by hits on the foot beside the node and on a second point of the plate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from structures import Channel, FrfModel, beams, plates
from structures._models.mapped import rigid

Complex = NDArray[np.complex128]
FOOT, LX, LY = (0.20, 0.15), 0.6, 0.4
LOSS = 0.02  # structural, of plate and springs
CARRIED = (((0.03, 0.01), 0.15, 9e4), ((-0.02, -0.025), 0.08, 2.4e5))  # place beside the node, kg, N/m
HITS = {"h1": (0.02, 0.0, 0.0), "h2": (-0.02, 0.01, 0.0), "h3": (0.0, -0.02, 0.0), "h4": (0.01, 0.02, 0.0)}
AROUND = {"i1": (0.025, 0.02, 0.0), "i2": (-0.025, 0.02, 0.0), "i3": (-0.02, -0.025, 0.0), "i4": (0.025, -0.02, 0.0)}
SEEN = {
    "a1": (0.10, 0.10), "a2": (0.30, 0.25), "a3": (0.45, 0.10), "a4": (0.50, 0.30), "a5": (0.35, 0.05),
    "a6": (0.15, 0.30), "a7": (0.25, 0.10), "k1": (0.40, 0.20), "k2": (0.55, 0.15),
}  # fmt: skip
KEPT = ("k1", "k2")


@dataclass(frozen=True)
class Mounted:
    """The test of the assembly, its operation and the truth.

    Parameters
    ----------
    model : FrfModel
        Sensors a, k and i over four hits on the foot and a force beside it, with noise.
    operation : array, shape (lines, sensors)
        Accelerations of all sensors while the source runs, with noise.
    blocked : array, shape (lines, 3)
        Force Z and moments RX, RY about the node.
    noise : float
        Std of the operation.
    """

    model: FrfModel
    operation: Complex
    blocked: Complex
    noise: float


@lru_cache(maxsize=4)
def made(lines: int = 80, noise: float = 0.01, bent: float = 0.0, seed: int = 0) -> Mounted:
    """`bent`: an interface sensor reads this share of a motion that no rigid foot has."""
    rng = np.random.default_rng(seed)
    f = np.linspace(30.0, 500.0, lines)
    s = plates.plate(lengths=(LX, LY), thickness=4e-3, material=beams.materials.aluminium, elements=(12, 8))
    free = {int(d): k for k, d in enumerate(s.free)}
    at = np.asarray(s.coordinates)[:, :2]

    def dofs(place: tuple[float, float]) -> list[int]:
        """Deflection and its two slopes of the node next to a place."""
        node = int(np.argmin(np.linalg.norm(at - place, axis=1)))
        return [free[4 * node + c] for c in range(3)]

    w, wx, wy = dofs(FOOT)
    n, own = len(s.free), len(CARRIED)
    K, M = np.zeros((n + own, n + own), complex), np.zeros((n + own, n + own))
    K[:n, :n], M[:n, :n] = s.K_free.toarray() * (1 + 1j * LOSS), s.M_free.toarray()
    M[[w, wx, wy], [w, wx, wy]] += [0.3, 2e-4, 3e-4]  # the foot itself
    for i, ((x, y), mass, stiffness) in enumerate(CARRIED):
        arm = np.zeros(n + own)
        arm[[w, wx, wy]], arm[n + i] = [1.0, x, y], -1.0
        K += stiffness * (1 + 1j * LOSS) * np.outer(arm, arm)
        M[n + i, n + i] = mass
    inner = np.stack([2.0 * np.exp(2j * np.pi * rng.random(lines)), 1.0 * np.exp(2j * np.pi * rng.random(lines))], 1)
    # what pushes: the foot along (Z, RX, RY), where w = z + rx y - ry x, another place of the plate, the inner forces
    push = np.zeros((n + own, 4 + own))
    push[[w, wy, wx], [0, 1, 2]] = [1.0, 1.0, -1.0]
    push[dofs((0.45, 0.30))[0], 3] = 1.0
    push[n + np.arange(own), 4 + np.arange(own)] = 1.0
    reads = np.stack([np.eye(n + own)[dofs(p)[0]] for p in SEEN.values()])
    foot = push[:, :3].T
    Y, F = np.empty((lines, len(reads), 4 + own), complex), np.empty((lines, 3, 4 + own), complex)
    blocked = np.zeros((lines, 3), complex)
    for k, omega in enumerate(2 * np.pi * f):
        moved = -(omega**2) * np.linalg.solve(K - omega**2 * M, push)
        Y[k], F[k] = reads @ moved, foot @ moved
        for i, ((x, y), mass, stiffness) in enumerate(CARRIED):
            spring = stiffness * (1 + 1j * LOSS)
            blocked[k] += spring / (spring - omega**2 * mass) * inner[k, i] * np.array([1.0, y, -x])
    up = np.array([0.0, 0.0, 1.0])
    R = rigid(list(HITS.values()), [up] * len(HITS))[:, 2:5]
    A = rigid(list(AROUND.values()), [up] * len(AROUND))[:, 2:5]
    sensed = np.concatenate([Y, np.einsum("sm,kmj->ksj", A, F)], axis=1)
    if bent:
        sensed[:, -1] += (
            bent * np.sqrt(np.mean(np.abs(sensed[:, -4:]) ** 2)) * np.array([1, -1, 1, -1, 0, 0])[: 4 + own]
        )
    H = np.concatenate([sensed[..., :3] @ R.T, sensed[..., 3:4]], axis=2)
    y = np.einsum("ksj,kj->ks", sensed[..., 4:], inner)

    def noisy(x: Complex, level: NDArray) -> Complex:
        return x + level / np.sqrt(2) * (rng.standard_normal(x.shape) + 1j * rng.standard_normal(x.shape))

    spread = noise * (0.5 * np.abs(H) + 0.05 * np.sqrt(np.mean(np.abs(H) ** 2, axis=0)))
    H, level = noisy(H, spread), noise * float(np.sqrt(np.mean(np.abs(y) ** 2)))
    y = noisy(y, np.full(y.shape, level))
    sensors = [Channel(label=n, quantity="acceleration", unit="m/s^2") for n in (*SEEN, *AROUND)]
    loads = [Channel(label=n, quantity="force", unit="N") for n in (*HITS, "beside")]
    model = FrfModel(f, H, sensors=sensors, loads=loads, variance=spread**2 if noise else None)
    return Mounted(model, y, blocked, level)
