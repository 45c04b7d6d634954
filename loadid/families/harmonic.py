"""Loads on one frequency line, from the complex amplitudes of the responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable, plain, positive
from structures.model import Model, as_model

from .. import guards
from ..inverse import rules
from ..inverse.choice import choose, residual_level
from ..inverse.diagnosis import diagnose
from ..inverse.noise_source import NOT_KNOWN, STATED
from ..inverse.problem import LinearProblem
from ..inverse.svd import SVDPath
from ..results.archive import provenance
from ..results.estimate import Axis, LoadEstimate
from ..settings import ChoiceLike, Guards, Lambda, Noise, takes
from . import smoothness as spatial
from .data import rows_of
from .field import told_apart
from .noise import NoiseLevel, graded, noise_level, unexplained_by
from .smoothness import geometry

Complex = NDArray[np.complex128]


class HarmonicInversion:
    """Loads of one frequency line from complex amplitudes, ``Y = H(f) G``.

    Minimises ``|R^(-1/2) (H G - Y)|^2 + lambda^2 |W G|^2`` at the line, real and imaginary parts as one real problem,
    so that every rule and the band are those of a static inversion. The response that the model gives to the estimate
    obeys the equation of motion exactly: after P. Mainçon, C. Barnardo, C. M. Larsen, "VIV force estimation using
    inverse FEM", OMAE 2008, 673-681.

    Parameters
    ----------
    model : Model
        Anything that gives ``frf``.
    frequency : float
        Hz.
    space : {"gradient", "laplacian"}, array or None
        Spatial prior; see `spatial.root`. None: ``|W G| = |G|``.
    length : float, optional
        Length of the spatial prior (m).
    choice : str, callable, float, None or Lambda
        Rule, or relative lambda; None chooses as `loadid.inverse.choice.choose` says.
    noise : float, array (sensors,) or Noise, optional
        Standard deviation of the complex amplitudes, ``sqrt(mean |error|^2)``.
    sensors, allow, progress
        As in `Deconvolution`.

    Raises
    ------
    InputError
        Settings that do not fit.
    """

    name = "harmonic inversion"

    @takes(choice=(Lambda, ""), noise=(Noise, "source"), allow=(Guards, "coverage"))
    def __init__(
        self,
        model: Model,
        frequency: float,
        *,
        space: str | ArrayLike | None = None,
        length: float | None = None,
        choice: ChoiceLike = None,
        noise: ArrayLike | Noise | None = None,
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        self.model = as_model(model, "HarmonicInversion", "frf")
        self.frequency = positive("frequency", frequency, where="HarmonicInversion", unit="Hz")
        self.space, self.length, self.choice = space, length, Lambda.of(choice).choice
        self.noise, self.sensors = Noise.of(noise), sensors
        told_of = Guards.of(allow)
        self.allow, self.coverage = told_of.codes, told_of.coverage
        self._progress = progress or (lambda fraction, text: None)
        self.basis = model.basis
        self.rows = rows_of(sensors, model)
        self.H: Complex = model.frf([self.frequency])[0][self.rows]
        rank = told_apart(self.H[None])
        self.W = spatial.root(space, length, self.H.shape[1], self.basis, rank)

    def estimate(self, amplitudes: Any) -> LoadEstimate:
        """Rebuild the loads behind complex amplitudes.

        Parameters
        ----------
        amplitudes : array (sensors,) or mapping of label to number, complex
            In the units of the sensors; ``y(t) = Re[Y exp(i 2 pi f t)]``.

        Returns
        -------
        LoadEstimate
            Loads (2, loads): the part in phase, Re G, and the part in quadrature, Im G, each with its std;
            `complex_load` puts them together.

        Raises
        ------
        InputError
            Amplitudes that do not fit, NaN.
        NotIdentifiable
            With lambda 0, where the sensors do not determine the load (LID-E306).
        """
        Y = self._amplitudes(amplitudes)
        self._progress(0.1, "posing the problem")
        posed = self._pose(Y)
        self._refuse_undetermined(posed)
        self._progress(0.4, "choosing lambda")
        choice = choose(posed.path, self.choice, sigma=posed.noise.sigma, source=posed.noise.source)
        sigma = noise_level(posed.path, choice, posed.noise)
        solution = posed.path.solution(choice.lam, sigma)
        parts, assumed = solution.load, solution.posterior
        assert assumed is not None
        bias = diagnose.hidden(posed.path, choice.lam, parts, assumed.std, axis=-1)
        rest = Y - self.H @ (parts[0] + 1j * parts[1])
        channels = [self.model.sensors[i] for i in self.rows]
        facts = self._facts(posed, choice.lam, sigma, parts)
        self._progress(1.0, "done")
        estimate = LoadEstimate(
            load=parts,
            std=np.maximum(assumed.std, np.abs(bias)),
            bias=bias,
            posterior=assumed,
            labels=[c.label for c in self.model.loads],
            units=[c.unit for c in self.model.loads],
            axis=Axis("part", "", np.arange(2.0)),
            choice=choice,
            response=np.stack([Y.real, Y.imag]),
            residual=np.stack([rest.real, rest.imag]),
            sensors=[c.label for c in channels],
            sensor_units=[c.unit for c in channels],
            flags=guards.collect(
                [
                    *self.model.flags,
                    *self._overridden(posed),
                    guards.not_verified(self.model.certificate),
                    guards.null_space(facts["m"], facts["n"], facts["rank"]),
                    guards.mixed_kinds(channels, posed.noise.known),
                    *guards.parameter(choice, posed.discrepancy),
                    guards.no_coverage(self.coverage),
                ]
            ),
            allowed=self.allow,
            certificate=self.model.certificate,
            geometry=None if self.basis is None else _geometry(self.basis),
            facts=facts,
            provenance=provenance(
                self.name,
                settings={"frequency": self.frequency, "space": self._said, "length": self.length,
                          "choice": self.choice, "noise_source": posed.noise.source.text,
                          "sensors": None if self.sensors is None else [str(s) for s in self.sensors]},
                inputs={},
                model=self.model.fingerprint,
                prior=f"in space {spatial.spatial_words(self.space, self.length)}",
            ),
        )  # fmt: skip
        return graded(estimate, unexplained_by(posed.path, choice.lam, posed.noise))

    # -- inside -----------------------------------------------------------------------------------------------------
    @property
    def _said(self) -> str | None:
        return self.space if self.space is None or isinstance(self.space, str) else "matrix"

    def _amplitudes(self, given: Any) -> Complex:
        labels = [self.model.sensors[i].label for i in self.rows]
        if isinstance(given, Mapping):
            missing = [x for x in labels if x not in given]
            if missing:
                raise InputError("there is no amplitude of a sensor of the model", where="estimate", found=list(given),
                                 expected=f"amplitudes of {missing}", hint="or leave out: sensors=[...]")  # fmt: skip
            given = [given[x] for x in labels]
        try:
            Y = np.array(plain(given), complex)
        except (TypeError, ValueError) as error:
            raise InputError("the amplitudes are no numbers", where="estimate", found=str(error)[:200],
                             expected="complex numbers") from None  # fmt: skip
        if Y.ndim == 1 and len(Y) == len(self.model.sensors) > len(self.rows):
            Y = Y[self.rows]
        if Y.shape != (len(self.rows),) or not np.all(np.isfinite(Y)):
            raise InputError("the amplitudes do not fit the model", where="estimate",
                             found=f"shape {Y.shape}" + ("" if np.all(np.isfinite(Y)) else " with NaN or infinity"),
                             expected=f"finite, ({len(self.rows)},): {labels[:12]}")  # fmt: skip
        return Y

    def _pose(self, Y: Complex) -> _Posed:
        """The line as a real problem: real parts before imaginary ones."""
        noise, H = self._noise(Y), self.H
        loads = H.shape[1]
        both = np.stack([np.hstack([H.real, -H.imag]), np.hstack([H.imag, H.real])])
        L = None if self.W is None else np.kron(np.eye(2), self.W)
        problem = LinearProblem.whitened(both, np.stack([Y.real, Y.imag]), noise.level, L, (2, loads))
        return _Posed(SVDPath(problem, labels=[f"{part} {c.label}" for part in ("Re", "Im") for c in self.model.loads]),
                      noise)  # fmt: skip

    def _noise(self, Y: Complex) -> NoiseLevel:
        """Std of the real and of the imaginary part of each amplitude; else a scale per unit."""
        count = len(self.rows)
        if self.noise.stated:
            level = np.asarray(self.noise.std, float)
            if level.shape not in ((), (count,)) or np.any(level <= 0):
                raise InputError("the noise does not fit the sensors", where="noise", found=str(self.noise.std)[:80],
                                 expected=f"a positive number, or ({count},)")  # fmt: skip
            return NoiseLevel(np.broadcast_to(level, (count,)) / np.sqrt(2), True, self.noise.origin or STATED)
        units = [self.model.sensors[i].unit for i in self.rows]
        size = {u: np.sqrt(np.mean([abs(y) ** 2 for y, v in zip(Y, units, strict=True) if v == u])) for u in units}
        if not all(size.values()):
            raise InputError("all amplitudes of a kind are zero", where="estimate",
                             found=[u for u, s in size.items() if s == 0], expected="a response",
                             hint="state the noise of the amplitudes (noise=)")  # fmt: skip
        return NoiseLevel(np.array([size[u] for u in units]), False, NOT_KNOWN)

    @property
    def _free(self) -> bool:
        return isinstance(self.choice, int | float) and self.choice == 0

    def _refuse_undetermined(self, posed: _Posed) -> None:
        rank, n = posed.path.rank, 2 * self.H.shape[1]
        if self._free and rank < n and "LID-E306" not in self.allow:
            raise NotIdentifiable(
                f"without regularisation the load is not determined: rank {rank // 2} of {n // 2} complex unknowns "
                f"from {len(self.rows)} sensors",
                advice="add sensors, give lambda > 0, or use fewer loads",
                code="LID-E306",
            )

    def _overridden(self, posed: _Posed) -> list[Any]:
        n = 2 * self.H.shape[1]
        if self._free and posed.path.rank < n:
            return [guards.overridden("E306", "rank", posed.path.rank, n)]
        return []

    def _facts(self, posed: _Posed, lam: float, sigma: float, load: NDArray) -> dict[str, Any]:
        path, n = posed.path, 2 * self.H.shape[1]
        kappa = diagnose.layout(path.singular_values, n)[0]
        point = path.at(lam)
        return {
            "path": "dense SVD, real and imaginary parts",
            "frequency": self.frequency,
            "m": int(path.m),
            "n": n,
            "rank": path.rank,
            "nullity": n - path.rank,
            "kappa": kappa,
            "edf": None if point.edf is None else float(point.edf),
            "residual_to_noise": residual_level(path, lam) if posed.noise.known else None,
            "noise_level": float(sigma),
            **posed.noise.source.facts,
        }


def complex_load(estimate: LoadEstimate) -> Complex:
    """Complex amplitudes (loads,) of an estimate of one line: ``g(t) = Re[G exp(i 2 pi f t)]``.

    Raises
    ------
    InputError
        If the estimate is not one of a line.
    """
    if estimate.axis is None or estimate.axis.name != "part":
        raise InputError("this is no estimate of a frequency line", where="complex_load",
                         found="a static load" if estimate.axis is None else f"a load over {estimate.axis.name}",
                         expected="what HarmonicInversion.estimate gives")  # fmt: skip
    return np.asarray(estimate.load[0] + 1j * estimate.load[1], complex)


def _geometry(basis: Any) -> dict[str, Any]:
    """Places of the loads; no resultants, as a sum over one part alone would tell half."""
    found = geometry(basis)
    return {**found, "resultant": found["resultant"][:0], "resultant_labels": []}


@dataclass(frozen=True)
class _Posed:
    """A line as a real problem, and its noise."""

    path: SVDPath
    noise: NoiseLevel

    def discrepancy(self, factor: float) -> float | None:
        """Lambda of the discrepancy rule at a multiple of the noise level."""
        return rules.discrepancy(rules.Sweep.over(self.path, self.noise.sigma), factor).lam
