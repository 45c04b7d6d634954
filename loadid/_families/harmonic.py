"""Loads on one frequency line, from the complex amplitudes of the responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model, as_model
from structures.errors import InputError, plain, positive

from .. import _guards as guards
from .. import _objects
from .._inverse.choice import Choice, checked, choose, moved, named
from .._inverse.diagnosis import identifiability
from .._inverse.problem import NOT_KNOWN, STATED, LinearProblem
from .._inverse.svd import SVDPath
from .._record import Record
from .._results.again import Again
from .._results.estimate import Axis, LoadEstimate
from .._spellings import Progress, takes
from ..settings import ChoiceLike, Guards, Lambda, Noise
from . import detection
from . import smoothness as spatial
from .amplitudes import LineReadings, of_record
from .answer import Amplitudes, answer, of_path, undetermined
from .data import gather, rows_of
from .field import told_apart
from .noise import NoiseLevel, noise_level
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
        Rule by name or itself, or relative lambda; None chooses as `loadid.paths.choose` says.
    noise : float, array (sensors,) or Noise, optional
        Standard deviation of the complex amplitudes, ``sqrt(mean |error|^2)``; of the samples, where records are given.
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
        self.space, self.length, self.choice = space, length, checked(Lambda.of(choice).choice)
        self.noise, self.sensors = Noise.of(noise), sensors
        told_of = Guards.of(allow)
        self.allow, self.coverage = told_of.codes, told_of.coverage
        self._progress = Progress(progress)
        self.basis = model.basis
        self.rows = rows_of(sensors, model)
        self.H: Complex = model.frf([self.frequency])[0][self.rows]
        rank = told_apart(self.H[None])
        self.W = spatial.root(space, length, self.H.shape[1], self.basis, rank)

    def estimate(self, found: Any) -> LoadEstimate:
        """Rebuild the loads behind complex amplitudes.

        Parameters
        ----------
        found : array (sensors,) or mapping of label to number, complex, or Record
            In the units of the sensors; ``y(t) = Re[Y exp(i 2 pi f t)]``. Of a record the amplitudes are fitted over
            its whole length; how much of it they explain is ``facts.explained``, and what lies on the lines beside this
            one is their noise (`loadid._families.amplitudes`).

        Returns
        -------
        LoadEstimate
            Loads (2, loads): the part in phase, Re G, and the part in quadrature, Im G, each with its std;
            `complex_load` puts them together.

        Raises
        ------
        InputError
            Amplitudes that do not fit, NaN; a record that does not hold the frequency, or does not move.
        NotIdentifiable
            With lambda 0, where the sensors do not determine the load (LID-E306).
        """
        line = self._readings(found)
        self._progress(0.1, "posing the problem")
        noise = line.noise or self._noise(line.values)
        path = self._pose(line.values, noise)
        self._refuse_undetermined(path)
        self._progress(0.4, "choosing lambda")
        choice = choose(path, self.choice, sigma=noise.sigma, source=noise.source)
        self._progress(1.0, "done")
        return self._kept(line, path, noise, choice)

    def _kept(self, line: LineReadings, path: SVDPath, noise: NoiseLevel, choice: Choice) -> LoadEstimate:
        """The answer, with the problem that it can be asked of at another lambda; not without regularisation."""
        found = self._answered(line, path, noise, choice)
        return found if self._free else replace(found, again=Again(path, partial(self._at, line, path, noise, choice)))

    def _at(self, line: LineReadings, path: SVDPath, noise: NoiseLevel, choice: Choice, lam: float) -> LoadEstimate:
        own = copy(self)
        own.choice = lam
        return own._kept(line, path, noise, moved(choice, path, lam))

    def _answered(self, line: LineReadings, path: SVDPath, noise: NoiseLevel, choice: Choice) -> LoadEstimate:
        sigma = noise_level(path, choice, noise)
        solution = path.solution(choice.lam, sigma)
        Y = line.values
        rest = Y - self.H @ (solution.load[0] + 1j * solution.load[1])
        facts: dict[str, Any] = {"path": "dense SVD, real and imaginary parts", "frequency": self.frequency}
        if line.explained is not None:
            facts["explained"] = line.explained
        layout = identifiability.layout(path.singular_values, self.unknowns)
        found = of_path(
            path, choice, solution, sigma, noise, layout=layout, axis=Axis("part", "", np.arange(2.0)),
            response=np.stack([Y.real, Y.imag]), residual=np.stack([rest.real, rest.imag]),
            facts={**facts, "n": self.unknowns}, hidden_by=path, along=-1,
        )  # fmt: skip
        return answer(
            self, line.measured,
            replace(found, geometry=None if self.basis is None else _geometry(self.basis),
                    not_told=detection.of_line(path, choice.lam, noise.sigma, self.H, noise.level, self.model.loads)),
            choice,
            known=noise.known, searched=path, solved=path, free=self._free, settings=self._named_settings(noise),
            prior=f"in space {spatial.spatial_words(self.space, self.length)}",
            flags=[guards.null_space(path.m, self.unknowns, path.rank)],
        )  # fmt: skip

    # -- inside -----------------------------------------------------------------------------------------------------
    @property
    def unknowns(self) -> int:
        """Real and imaginary parts of all loads."""
        return 2 * int(self.H.shape[1])

    def _named_settings(self, noise: NoiseLevel) -> dict[str, Any]:
        return {
            "frequency": self.frequency,
            "space": self.space if self.space is None or isinstance(self.space, str) else "matrix",
            "length": self.length, "choice": named(self.choice), "noise_source": noise.source.text,
            "sensors": None if self.sensors is None else [str(s) for s in self.sensors],
        }  # fmt: skip

    def _readings(self, given: Any) -> LineReadings:
        if isinstance(given, Record) or _objects.tabled(given):
            return of_record(gather(given, None, self.model, self.sensors, timed=False), self.frequency, self.noise)
        measured = Amplitudes([self.model.sensors[i] for i in self.rows], self.rows)
        return LineReadings(self._amplitudes(given), measured)

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

    def _pose(self, Y: Complex, noise: NoiseLevel) -> SVDPath:
        """The line as a real problem: real parts before imaginary ones."""
        H = self.H
        loads = H.shape[1]
        both = np.stack([np.hstack([H.real, -H.imag]), np.hstack([H.imag, H.real])])
        L = None if self.W is None else np.kron(np.eye(2), self.W)
        problem = LinearProblem.whitened(both, np.stack([Y.real, Y.imag]), noise.level, L, (2, loads))
        labels = [f"{part} {c.label}" for part in ("Re", "Im") for c in self.model.loads]
        return SVDPath(problem, labels=labels)

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
        return self.choice == 0

    def _refuse_undetermined(self, path: SVDPath) -> None:
        rank, n = path.rank, self.unknowns
        if self._free and rank < n and "LID-E306" not in self.allow:
            raise undetermined(rank // 2, f"{n // 2} complex unknowns", f"{len(self.rows)} sensors",
                               "add sensors, give lambda > 0, or use fewer loads")  # fmt: skip


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
