"""What a map answers: all loads of a model or their resultants, with names, units, and what is known of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from structures._model import Model
from structures.errors import InputError, finite, reals

from .._results.estimate import LoadEstimate
from .adaptation import Told
from .novelty import WORDS, Verdict

Array = NDArray[np.float64]

FRAMES = 64  # whose correlations between loads are asked for


@dataclass(frozen=True, eq=False)
class Outputs:
    """Names and units of what is answered.

    Parameters
    ----------
    labels, units : tuple of str
    matrix : array (outputs, loads) or None
        Outputs of loads; None where they are the loads.
    group_of : array of int (outputs,)
        Outputs of one unit and direction.
    sums : array (resultants, outputs)
        Resultants of the outputs, empty where there are none.
    sum_labels : tuple of str
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    matrix: Array | None
    group_of: NDArray[np.int_]
    sums: Array
    sum_labels: tuple[str, ...]

    @classmethod
    def of(cls, model: Model, output: str) -> Self:
        """Those of a model.

        Raises
        ------
        InputError
            Resultants of loads that have none.
        """
        labels, units = tuple(c.label for c in model.loads), tuple(c.unit for c in model.loads)
        basis = model.basis
        if basis is not None:
            sums, names = np.asarray(basis.resultant(), float), tuple(map(str, basis.resultant_labels))
        elif len(set(units)) == 1:
            sums, names = np.ones((1, len(labels))), ("sum",)
        else:
            sums, names = np.zeros((0, len(labels))), ()
        if output == "load":
            step = 1 if basis is None else max(len(basis.components), 1)
            kinds = [(unit, i % step) for i, unit in enumerate(units)]
            group_of = np.array([list(dict.fromkeys(kinds)).index(kind) for kind in kinds])
            return cls(labels, units, None, group_of, sums, names)
        if not names:
            raise InputError("these loads have no resultant", where="output", found=f"units {sorted(set(units))}",
                             expected="loads of a basis, or of one unit", hint='output="load"')  # fmt: skip
        own = tuple(units[0] if basis is None else "N m" if n.startswith("M") else "N" for n in names)
        return cls(names, own, sums, np.arange(len(names)), np.eye(len(names)), names)

    @property
    def groups(self) -> list[NDArray[np.int_]]:
        """Outputs of each group."""
        return [np.flatnonzero(self.group_of == g) for g in range(int(self.group_of.max()) + 1)]

    def known(self, given: Any) -> Known:
        """Known loads or resultants of a record, checked.

        Raises
        ------
        InputError
            They do not fit.
        """
        if isinstance(given, Mapping):
            for label in given:
                if label not in self.sum_labels:
                    raise InputError("no such resultant", where="more", found=repr(label),
                                     expected=f"one of {list(self.sum_labels)}")  # fmt: skip
            rows = np.array([self.sum_labels.index(label) for label in given])
            return Known(_finite(list(given.values())), self.sums[rows], rows)
        values = _finite(given)
        width = len(self.labels) if self.matrix is None else self.matrix.shape[1]
        if values.ndim == 1 and width == 1 and len(values) > 1:
            values = values[:, None]
        if values.ndim not in (1, 2) or values.shape[-1] != width:
            raise InputError("the known load does not fit the map", where="more", found=f"shape {values.shape}",
                             expected=f"(..., {width}), or a mapping from resultant to value")  # fmt: skip
        return Known(values if self.matrix is None else values @ self.matrix.T, None, np.zeros(0, int))

    def of_estimate(self, found: LoadEstimate) -> LoadEstimate:
        """An estimate of all loads as one of these outputs."""
        if self.matrix is None:
            return found
        load = found.load @ self.matrix.T
        return replace(found, load=load, std=np.sqrt(_variances(found, self.matrix)), labels=self.labels,
                       units=self.units, bias=None, posterior=None, geometry=None, again=None)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of one record.

    Parameters
    ----------
    values : array
        Outputs ([samples,] outputs), or resultants (k,).
    sums : array (k, outputs) or None
        What these resultants are of the outputs.
    rows : array of int
        Which resultants these are.
    """

    values: Array
    sums: Array | None
    rows: NDArray[np.int_]

    @property
    def any(self) -> bool:
        """Whether a load acts."""
        return bool(np.any(self.values))

    def against(
        self,
        mean: Array,
        std: Array,
        W: Array | None,
        together: float,
        of_sums: Callable[[Array, Array], Array] | None = None,
    ) -> Told:
        """What is known beside what a map says.

        Parameters
        ----------
        mean, std : array (1, [samples,] outputs)
        W : array (k, outputs) or None
            Factor of the correlation of the outputs.
        together : float
            Samples that err together.
        of_sums : callable, optional
            Std of all resultants, of outputs and their std.
        """
        mean, std = mean[0], std[0]
        if self.sums is None:
            return Told(mean, None, np.broadcast_to(self.values, mean.shape), std, W, together)
        each = std.reshape(-1, std.shape[-1]).mean(axis=0)
        if of_sums is not None:
            error = of_sums(mean.reshape(-1, mean.shape[-1]).mean(axis=0), each)[self.rows]
        else:
            error = np.sqrt(self.sums**2 @ each**2) if W is None else np.linalg.norm((W * each) @ self.sums.T, axis=0)
        return Told(mean, self.sums, self.values, error, None, 1.0)


def _finite(given: Any) -> Array:
    values = reals(given, where="more")
    finite(values, where="more", hint="leave records of unknown force out")
    return values


def words(verdict: Verdict) -> str:
    """The scores of a verdict, each with its limit."""
    return ", ".join(f"{WORDS[k]} {verdict.scores[k]:.3g} (limit {verdict.limits[k]:.3g})" for k in verdict.scores)


def _variances(found: LoadEstimate, matrix: Array) -> Array:
    """Variance of sums of loads (rows of a matrix), in every sample or frame; at most, where nobody knows more."""
    posterior, load = found.posterior, np.asarray(found.load)
    if posterior is None or (load.ndim == 2 and len(load) > FRAMES):
        return np.asarray((found.std @ np.abs(matrix).T) ** 2)
    rows = np.atleast_2d(load)
    out = np.zeros((len(rows), len(matrix)))
    for i in range(len(rows)):
        for j, row in enumerate(matrix):
            weights = np.zeros(load.shape)
            weights[i if load.ndim == 2 else ...] = row
            out[i, j] = float(np.asarray(posterior.variance(weights)).item())
    return out.reshape(*load.shape[:-1], len(matrix))
