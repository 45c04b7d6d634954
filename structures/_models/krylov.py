"""Rational block Krylov reduction: a few vectors that hold the response of a whole band, and a bound of the error."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .._system.factor import Factor
from ..errors import InputError, NotIdentifiable
from .galerkin import Images, Pencil, Projection, feasible, project
from .reduction import Modes

TOLERANCE = 1e-6  # of every entry of the response, antiresonances included
MANY = 40  # loads or sensors, whichever are fewer: beyond, modes and their static residual are the better choice
PLACES = (0.5, 1.0)  # shifts over the band, beside the one at 0
OFF = 1.0001  # moves them off a natural frequency that lies on a round number
PROBES = 100  # lines on which the error is looked at
FIRST = 4  # depth below which no band is resolved: the error is not looked at
LARGEST = 900  # vectors: beyond, nothing is gained over modes
LOST = 1e-10  # share of a column left by the others below which it is rounding
DEPENDENT = 1e-12  # energy of a direction within a block, over the largest, that is rounding
ZERO = 1e-6  # of an entry's peak: an undamped antiresonance is not followed below

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Krylov:
    """A structure on a rational block Krylov basis.

    Parameters
    ----------
    projection : Projection
        The structure on the basis, and the bound of its error.
    band : float
        Highest frequency for which it was made (Hz).
    depth : int
        Blocks per shift.
    estimate : float
        Largest relative error of an entry on the lines that were looked at, rounding included.
    """

    projection: Projection
    band: float
    depth: int
    estimate: float

    @property
    def shapes(self) -> Modes:
        """The Ritz pairs: modes as far as the band goes, and beyond it what stands for all the others."""
        p = self.projection
        return Modes(p.lam, p.phi, p.pencil.rigid, p.pencil.shift, p.pencil.factor)

    @property
    def frequencies(self) -> NDArray[np.float64]:
        """Natural frequencies up to the band (Hz), ascending, 0 for rigid-body modes."""
        f = np.sqrt(self.projection.lam) / (2 * np.pi)
        return f[f <= self.band]


@dataclass(frozen=True)
class ReductionError:
    """Bound of the error of a reduced frequency response, line by line and entry by entry.

    Parameters
    ----------
    frequencies : array (lines,)
        Hz.
    truncation, rounding : array (lines, sensors, loads)
        Bound of what the basis leaves out, and expected rounding; in units of the response.
    size : array (lines, sensors, loads)
        Magnitude of the response.
    """

    frequencies: NDArray[np.float64]
    truncation: NDArray[np.float64]
    rounding: NDArray[np.float64]
    size: NDArray[np.float64]

    @property
    def bound(self) -> NDArray[np.float64]:
        """Both together (lines, sensors, loads)."""
        return self.truncation + self.rounding

    @property
    def entrywise(self) -> NDArray[np.float64]:
        """Relative error of every entry (lines, sensors, loads); infinite where only the response is zero."""
        return _over(self.bound, self.size)

    @property
    def normwise(self) -> NDArray[np.float64]:
        """Error of every line over its response (lines,), in the Frobenius norm."""
        return _over(np.linalg.norm(self.bound, axis=(1, 2)), np.linalg.norm(self.size, axis=(1, 2)))


def _over(bound: NDArray[Any], size: NDArray[Any]) -> NDArray[np.float64]:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bound > 0, bound / size, 0.0)


def krylov(structure: Any, S: Any, B: Any, band: float, tolerance: float = TOLERANCE) -> Krylov:
    """Reduce a structure to its response to some loads over a band.

    Parameters
    ----------
    structure : Structure
        With mass; damped by a matrix, structurally, or not at all.
    S, B : sparse (sensors, n_free), (n_free, loads)
        The basis is built from the fewer: the response is that of the transposed problem.
    band : float
        Highest frequency (Hz).
    tolerance : float
        Largest relative truncation of an entry, as bounded on random lines of the band; rounding may be above it.

    Returns
    -------
    Krylov

    Raises
    ------
    InputError
        With modal ratios, without mass, with more than 40 loads and sensors, with an unstable structure, or where the
        tolerance is not reached with 900 vectors.

    Notes
    -----
    Shifts at 0, in the middle and at the top of the band, one block of vectors ``(K - sigma M)^-1 M X`` after the
    other: A. Ruhe, "Rational Krylov sequence methods for eigenvalue computation", Linear Algebra Appl. 58 (1984)
    391-405; K. Gallivan, E. Grimme, P. Van Dooren, "A rational Lanczos algorithm for model reduction", Numer.
    Algorithms 12 (1996) 33-63. A damping matrix that is no multiple of K and M adds ``(K - sigma M)^-1 C X``: Z. Bai,
    Y. Su, "Dimension reduction of large-scale second-order dynamical systems", SIAM J. Sci. Comput. 26 (2005) 1692.
    """
    refuse(structure, S.shape[0], B.shape[1])
    pencil = Pencil.of(structure)
    images = _start(pencil, np.asarray(S.toarray(), float).T, np.asarray(B.toarray(), float))
    loaded = images.B.shape[1] <= images.S.shape[1]
    factors = [None, *(_shifted(pencil, (2 * np.pi * OFF * place * band) ** 2) for place in PLACES)]
    blocks = [images.ZB if loaded else images.ZS, *[images.B if loaded else images.S] * len(PLACES)]
    depth, omega = 0, 2 * np.pi * _probes(band)
    while True:
        before, depth = images.W.shape[1], depth + 1
        for j, factor in enumerate(factors):
            images, blocks[j] = _deeper(pencil, factor, images, blocks[j])
        size = images.W.shape[1]
        if depth < FIRST and size > before:
            continue
        found = project(pencil, images)
        H, truncation, rounding = found.errors(omega)
        estimate, floor = worst(H, truncation, rounding), worst(H, rounding, rounding)
        log.debug("krylov: depth %d, %d vectors, truncation %.1e, rounding %.1e", depth, size, estimate, floor)
        if estimate <= max(tolerance, floor) or size == before:  # below its rounding nothing is gained
            return Krylov(found, band, depth, worst(H, truncation + rounding, rounding))
        if size > LARGEST:
            raise InputError(
                "the Krylov reduction does not reach its tolerance",
                where="reduction='krylov'",
                found=f"{size} vectors with a relative error of {estimate:.2g}",
                expected=f"{tolerance:.2g} with at most {LARGEST}",
                hint="a lower band, fewer loads, or leave reduction= out: modes and their static residual",
            )


def worst(H: NDArray[Any], bound: NDArray[Any], rounding: NDArray[Any]) -> float:
    """Largest error of an entry over its response, down to a millionth of its peak.

    Entries of zeros are left out: those that are nowhere above their rounding, or tiny beside their row and column.
    """
    size = np.abs(H)
    peak = size.max(axis=0)
    seen = peak > np.maximum(1e-12 * np.sqrt(np.outer(peak.max(axis=1), peak.max(axis=0))), rounding.max(axis=0))
    return float(np.max((bound / np.maximum(size, ZERO * peak))[:, seen], initial=0.0))


def refuse(structure: Any, sensors: int, loads: int) -> None:
    """Refuse what a Krylov reduction does not serve: modal ratios, and many sensors under many loads."""
    feasible(structure.damping)
    if min(sensors, loads) > MANY:
        raise InputError(
            "a Krylov basis grows with the loads: modes and their static residual are the better choice here",
            where="reduction='krylov'",
            found=f"{loads} loads, {sensors} sensors",
            expected=f"at most {MANY} of one of them",
            hint="leave reduction= out: one set of modes serves any number of loads",
        )


def _probes(band: float) -> NDArray[np.float64]:
    """Random lines, one in every part of the band; the same in every run."""
    return band * (np.arange(PROBES) + np.random.default_rng(0).random(PROBES)) / PROBES


def _shifted(pencil: Pencil, sigma: float) -> Factor:
    """Factor of ``K - sigma M``; a shift that meets a natural frequency gives way."""
    for _ in range(5):
        try:
            factor = Factor(pencil.K_s + (pencil.shift - sigma) * pencil.M, check=False)
        except (InputError, NotIdentifiable):  # a zero pivot
            sigma *= 1.001
            continue
        return factor
    raise InputError(
        "the matrix cannot be factorised",
        where="reduction='krylov'",
        found=f"K - sigma M at {np.sqrt(sigma) / (2 * np.pi):.6g} Hz",
        expected="a regular matrix",
        hint="another band",
    )


def _start(pencil: Pencil, rows: NDArray[Any], columns: NDArray[Any]) -> Images:
    """The rigid-body modes, exactly: no load reaches them alone."""
    none = np.empty((len(rows), 0))
    images = Images(
        none,
        none,
        none,
        none,
        None if pencil.C is None else none,
        rows,
        columns,
        pencil.factor.solve(rows),
        pencil.factor.solve(columns),
    )
    if pencil.rigid == 0:
        return images
    X = np.random.default_rng(0).standard_normal((len(rows), pencil.rigid))
    for _ in range(20):  # each pass takes a factor 11 from the elastic modes
        X = orthonormal(pencil.factor.solve(pencil.M @ X), pencil.M, none, none)
    return _extended(pencil, images, X)


def _deeper(pencil: Pencil, factor: Factor | None, images: Images, block: NDArray[Any]) -> tuple[Images, NDArray[Any]]:
    """The basis with one more block of a shift, and the right-hand sides of the next.

    Those of the lowest shift (no factor) are solved for already: the error needs them.
    """
    if block.shape[1] == 0:
        return images, block
    block = block if factor is None else factor.raw(np.ascontiguousarray(block))
    X = orthonormal(block, pencil.M, images.W, images.MW)
    grown, new = _extended(pencil, images, X), slice(images.W.shape[1], None)
    following = [grown.MW[:, new] if factor is not None else grown.ZM[:, new]]
    if pencil.C is not None and grown.ZC is not None:
        following.append(pencil.C @ X if factor is not None else grown.ZC[:, new])
    return grown, np.hstack(following)


def _extended(pencil: Pencil, images: Images, X: NDArray[Any]) -> Images:
    if X.shape[1] == 0:
        return images
    MX = pencil.M @ X
    ZC = None
    if images.ZC is not None:
        ZC = np.hstack([images.ZC, pencil.factor.solve(pencil.C @ X)])
    return replace(
        images,
        W=np.hstack([images.W, X]),
        KW=np.hstack([images.KW, pencil.K_s @ X]),
        MW=np.hstack([images.MW, MX]),
        ZM=np.hstack([images.ZM, pencil.factor.solve(MX)]),
        ZC=ZC,
    )


def orthonormal(X: NDArray[Any], M: Any, W: NDArray[Any], MW: NDArray[Any]) -> NDArray[np.float64]:
    """M-orthonormal basis of what the columns of `X` add to the M-orthonormal `W`; dependent columns are dropped."""
    whole = _norms(X, M)
    for _ in range(2):
        X = X - W @ (MW.T @ X)
    left = _norms(X, M)
    kept = np.isfinite(left) & (left > LOST * whole)
    X = X[:, kept] / left[kept]
    for _ in range(2):
        if X.shape[1] == 0:
            break
        energy, u = linalg.eigh(X.T @ (M @ X))
        good = energy > DEPENDENT * energy[-1]
        X = X @ (u[:, good] / np.sqrt(energy[good]))
        X = X - W @ (MW.T @ X)
    return X


def _norms(X: NDArray[Any], M: Any) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(np.einsum("ij,ij->j", X, M @ X)))
