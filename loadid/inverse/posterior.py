"""What is known of the error of a load: its covariance, kept in the form in which the solver has it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.spectra import multiplicity


@runtime_checkable
class Posterior(Protocol):
    """Covariance of a load estimate."""

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation, in the shape of the load."""
        ...

    def variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, or (k,) + that shape."""
        ...

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        ...


class DensePosterior:
    """Covariance ``factor @ factor.T`` of the flattened load.

    Parameters
    ----------
    factor : array, shape (unknowns, modes)
    shape : tuple
        Shape of the load.
    """

    kind = "dense"

    def __init__(self, factor: NDArray, shape: tuple[int, ...]) -> None:
        self.factor, self.shape = factor, tuple(int(i) for i in shape)

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation, in the shape of the load."""
        return np.sqrt(np.sum(self.factor**2, axis=1)).reshape(self.shape)

    def variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)``."""
        w = np.asarray(w, float)
        lead = w.shape[: w.ndim - len(self.shape)]
        return np.sum((w.reshape(*lead, -1) @ self.factor) ** 2, axis=-1)

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "factor": self.factor, "shape": list(self.shape)}


class SpectralPosterior:
    """Covariance that is stationary in time: one small matrix for each line of a padded spectrum.

    Parameters
    ----------
    lines : array, shape (lines, loads, loads)
        Covariance of the load spectrum over the padded length, for noise that fills the record.
    samples, padded : int
        Length of the record and of the padded transform.
    """

    kind = "spectral"

    def __init__(self, lines: NDArray, samples: int, padded: int) -> None:
        self.lines, self.samples, self.padded = lines, int(samples), int(padded)

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation, shape (samples, loads): the same at every sample."""
        diagonal = np.einsum("kii->ki", self.lines).real
        level = np.sqrt(multiplicity(self.padded) @ diagonal / (self.padded * self.samples))
        return np.tile(level, (self.samples, 1))

    def variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        W = np.fft.rfft(np.asarray(w, float), self.padded, axis=-2)
        quadratic = np.einsum("...ki,kij,...kj->...k", W.conj(), self.lines, W).real
        return quadratic @ multiplicity(self.padded) / (self.padded * self.samples)

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "lines": self.lines, "samples": self.samples, "padded": self.padded}


def from_arrays(tree: dict) -> Posterior:
    """Posterior from what `to_arrays` gave.

    Raises
    ------
    InputError
        If the kind is unknown.
    """
    if tree.get("kind") == DensePosterior.kind:
        return DensePosterior(np.asarray(tree["factor"]), tuple(tree["shape"]))
    if tree.get("kind") == SpectralPosterior.kind:
        return SpectralPosterior(np.asarray(tree["lines"]), tree["samples"], tree["padded"])
    raise InputError(
        "unknown kind of posterior", where="result file", found=tree.get("kind"), expected="dense or spectral"
    )
