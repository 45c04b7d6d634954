"""Truths for the FE pad: plane waves in an endless mesh, and the consistent forces of a round press."""

from functools import cache

import numpy as np

from structures._elements.cells import Brick
from tactile import Layer

GEL = {"E": 147e3, "thickness": 3e-3}


def recovered(kh, nu, *, layers, side, element="bbar", traction=(0.0, 0.0, 1.0), angle=0.0):
    """Traction that an endless mesh returns for the exact surface motion of a plane wave of `traction`, (3,) complex.

    The motion comes from the kernel of the layer; the interior is free of load. `side` is the cell's in thicknesses,
    `angle` that of the wave against x. Nodal force over cell area.
    """
    h, E = GEL["thickness"], GEL["E"]
    k = kh / h * np.array([np.cos(angle), np.sin(angle)])
    a = side * h
    Ke = E * Brick(np.array([a, a, h / layers]), nu, element).stiffness
    corners = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in range(8)])
    phases = np.exp(1j * a * corners[:, :2] @ k)
    K = np.zeros((3 * (layers + 1),) * 2, complex)
    for level in range(layers):
        P = np.zeros((24, len(K)), complex)
        for c in range(8):
            at = 3 * (level + corners[c, 2])
            P[3 * c : 3 * c + 3, at : at + 3] = phases[c] * np.eye(3)
        K += P.conj().T @ Ke @ P
    top, inner = slice(3 * layers, None), slice(3, 3 * layers)
    U = Layer(h, E, nu).kernel(*k) @ np.array(traction)
    F = K[top, top] @ U
    if layers > 1:
        F = F - K[top, inner] @ np.linalg.solve(K[inner, inner], K[inner, top] @ U)
    return F / a**2


def consistent(pad, press, sub=20):
    """Consistent nodal forces (P, 3) of a press by fine quadrature of the hats of a regular pad."""
    return _hat_means(tuple(pad.elements), tuple(pad.size), press, sub)


@cache
def _hat_means(elements, size, press, sub):
    """The same by what it depends on: pads of other materials and layers have the same hats."""
    (nx, ny), (a, b) = elements, size
    xs, ys = ((np.arange(n * sub) + 0.5) / (n * sub) * s - s / 2 for n, s in ((nx, a), (ny, b)))
    hats = [
        np.clip(1 - np.abs(v[:, None] - np.linspace(-s / 2, s / 2, n + 1)) / (s / n), 0, None)
        for v, n, s in ((xs, nx, a), (ys, ny, b))
    ]
    X, Y = np.meshgrid(xs, ys)
    t = press.traction(np.column_stack([X.ravel(), Y.ravel()])).reshape(len(ys), len(xs), 3)
    weight = a / nx * b / ny / sub**2
    return np.einsum("yj,yxc,xi->jic", hats[1], t, hats[0], optimize=True).reshape(-1, 3) * weight


def map_error(pad, press):
    """Resultant (N), relative error and peak ratio of F = K U for the exact motion under a press, 2 mm off the rim."""
    F, f = pad.forces(press.displacement(pad.layer, pad.nodes2d)), consistent(pad, press)
    inner = np.all(np.abs(pad.nodes2d) < np.array(pad.size) / 2 - 2e-3 * (1 + 1e-6), axis=1)
    error = np.linalg.norm((F - f)[inner]) / np.linalg.norm(f[inner])
    return F[inner].sum(axis=0), float(error), float(F[inner, 2].min() / f[:, 2].min())
