"""Source, receiver and their assembly as chains of masses, by matrices of their own; estimates made by hand."""

from types import SimpleNamespace

import numpy as np

from loadid import LoadEstimate
from loadid._results.estimate import Axis
from structures import Channel, FrfModel

LINES = np.arange(5.0, 101.0, 0.5)  # Hz


def stiffness(springs, ground=0.0):
    """Matrix of a chain of springs between neighbours, the first mass on a spring to the ground."""
    n = len(springs) + 1
    K = np.zeros((n, n))
    K[0, 0] = ground
    for i, k in enumerate(springs):
        K[i : i + 2, i : i + 2] += k * np.array([[1, -1], [-1, 1]])
    return K


def accelerance(f, M, K, loss=0.03):
    """Responses of all masses to a force at each, (lines, n, n)."""
    w2 = (2 * np.pi * np.asarray(f))[:, None, None] ** 2
    return -w2 * np.linalg.solve((1 + 1j * loss) * K - w2 * M, np.broadcast_to(np.eye(len(M)), (len(f), *M.shape)))


def table(H, f=LINES, sensors=None, loads=None, variance=None):
    """Model of an FRF, accelerances named a0, a1, ... and forces f0, f1, ..."""
    rows = sensors or [f"a{i}" for i in range(H.shape[1])]
    columns = loads or [f"f{j}" for j in range(H.shape[2])]
    return FrfModel(
        f,
        H,
        sensors=[Channel(label=r, quantity="acceleration", unit="m/s^2") for r in rows],
        loads=[Channel(label=c, quantity="force", unit="N") for c in columns],
        variance=variance,
    )


def receiver(f=LINES, loads=(1, 4), sensors=(0, 2, 3, 5)):
    """FRFs of a chain of six masses on the ground."""
    H = accelerance(f, np.diag([2.0, 1.0, 1.5, 1.0, 0.7, 0.5]), stiffness([8e4, 6e4, 9e4, 7e4, 5e4], 1e5))
    return H[:, list(sensors)][:, :, list(loads)]


def spectra(lines, count, seed=0):
    """Complex amplitudes, circular, E|x|^2 = 1."""
    rng = np.random.default_rng(seed)
    return (rng.standard_normal((lines, count)) + 1j * rng.standard_normal((lines, count))) / np.sqrt(2)


def estimated(load, std=0.0, f=LINES, *, labels=None, covariance=None, cross=None, **changes):
    """Estimate over frequency."""
    trusted = np.ones(np.shape(load), bool)
    spectrum = SimpleNamespace(cross=cross, covariance=covariance, load=load, trust=lambda level=None: trusted)
    settings = {
        "load": load,
        "std": np.broadcast_to(std, np.shape(load)),
        "labels": labels or [f"f{j}" for j in range(load.shape[1])],
        "units": ["N" if cross is None else "N^2/Hz"] * load.shape[1],
        "axis": Axis("frequency", "Hz", f),
        "spectrum": spectrum if (cross is not None or covariance is not None) else None,
    }
    return LoadEstimate(**(settings | changes))


def densities(cross, std=0.0, f=LINES, **changes):
    """Estimate of cross spectra (lines, loads, loads)."""
    return estimated(np.einsum("ljj->lj", cross).real, std, f, cross=cross, **changes)


def solved(H, Y, noise):
    """Least squares line by line: loads, their std and covariance (lines, loads, loads)."""
    rows = noise[:, None]
    U, s, Vh = np.linalg.svd(H / rows, full_matrices=False)
    F = np.einsum("lkj,lk,lik,li->lj", Vh.conj(), 1 / s, U.conj(), Y / noise)
    C = np.einsum("lkj,lk,lki->lji", Vh.conj(), s**-2.0, Vh)
    return F, np.sqrt(np.einsum("ljj->lj", C).real), C
