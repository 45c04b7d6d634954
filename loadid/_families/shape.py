"""Distributed load of a plate by shape sensing: gauges to deflection, deflection to load, by the plate equation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures import ForwardModel, Structure, bases
from structures.errors import InputError, shown
from structures.shape_sensing import InverseFEM, SensedField

from .. import _guards as guards
from .._inverse.choice import checked
from .._inverse.diagnosis import identifiability
from .._inverse.posterior import DensePosterior
from .._inverse.problem import whiten
from .._inverse.shape import choosing, moving
from .._inverse.shape.edged import EdgedLoads
from .._inverse.shape.plate import ThinPlate, thin_plate
from .._inverse.shape.radial import FALL, ROUGH, RadialBasis
from .._record import Record
from .._results.estimate import LoadEstimate
from .._results.facts import Facts
from .._spellings import Progress, takes
from ..settings import ChoiceLike, Guards, Lambda, Noise
from . import noise as noises
from .answer import SolvedLoad, answer, beyond_noise, over_time
from .data import gather, readings
from .detection import NotTold, of_fields
from .noise import NoiseLevel
from .smoothness import geometry

Array = NDArray[np.float64]
GRID = 12  # patches along the longer side
SMALLEST, STEP = 0.7, 2**0.5  # shape parameter, times the longer side; from one that is tried to the next
FINEST = 0.75  # times the distance of the gauges: functions that are narrower, the gauges do not tell from noise
UNSEEN = (0.75, 1.06, 1.5)  # the same of loads as strong at short wavelengths, which the gauges see in part
AT_EDGES = ((0.0, 2.0), (0.3, 2.0), (1.0, 2.0), (2.0, 3.0), (8.0, 4.0))  # `sizes` of pressures there
LOST = 0.3  # share of the data (rms) that the finest field leaves, above which it cannot hold them
EXCESS = 5.0  # the same over noise that is known
PRIOR = "a load whose second derivatives are as likely at every wavelength down to the narrowest function; edges held"


class ShapeSensing:
    """Distributed load of a thin rectangular plate from strains (or deflections), through its shape.

    Gauges are fitted by a deflection of Gaussian radial basis functions that obeys the edges, and the load follows from
    the equation of motion, ``q = D nabla^4 w + c w_t + rho h w_tt``, its fourth derivatives in closed form and those in
    time by a state-space smoother. Shape parameter and ridge are chosen together, and all that the data cannot tell
    from the best pair is in the band. The deflection alone is `field`, by inverse finite elements.

    A fit to the nodes of `field` that carries the covariance of these nodes and the response of the elements is the
    fit to the gauges (the covariance has no more directions than there are gauges): it is computed as that, so that
    nothing of a mesh is differentiated.

    Parameters
    ----------
    plate : Structure
        Of `structures.plates.plate`: its edges, rigidity, mass and damping.
    gauges : sequence of StrainGauge or Displacement
        Where they are.
    loads : Basis, optional
        Patches or hats of `structures.bases` on which the pressure is answered: the mean of a patch, the value at the
        node of a hat. Default: 12 patches along the longer side.
    choice : str, callable, float, None or Lambda
        Rule of the ridge for each shape (``"robust_gcv"``, ``"discrepancy"``, ...); the shape is then that of the
        largest evidence. None: both by the evidence, averaged over what it leaves open.
    noise : float, array or Noise, optional
        Std of the gauges.
    allow : sequence of str, or Guards
        As in `StaticInversion`.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Raises
    ------
    InputError
        Another structure, prestress, edges held in part, gauges outside the plate or of another kind.

    Notes
    -----
    Source of the route: strains, inverse finite elements (Tessler & Spangler), Gaussian radial basis functions, plate
    equation, as Li et al. (2025) join them. Multiscale functions, edges, pressures that do not vanish at the edges and
    bands are this package's.
    """

    name = "shape sensing"

    @takes(choice=(Lambda, ""), noise=(Noise, "source"), allow=(Guards, "coverage"))
    def __init__(
        self,
        plate: Structure,
        gauges: Sequence[Any],
        *,
        loads: bases.Basis | None = None,
        choice: ChoiceLike = None,
        noise: Any = None,
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        self.plate, self.gauges = plate, tuple(gauges)
        self._still = thin_plate(plate, moving=False)
        wrong = [g.label for g in self.gauges if g.derivative or g.quantity not in ("strain", "displacement")]
        if wrong or not self.gauges:
            raise InputError(
                "shape sensing takes strains and deflections",
                where="gauges",
                found=wrong or "no gauges",
                expected="StrainGauge or Displacement on the plate",
            )
        self.choice = checked(Lambda.of(choice).choice, choosing.LOW)
        self.noise = Noise.of(noise)
        told_of = Guards.of(allow)
        self.allow, self.coverage = told_of.codes, told_of.coverage
        self._progress = Progress(progress)
        self.basis = loads if loads is not None else _patches(plate, self._still)
        if self.basis.kind not in ("patches", "hats"):
            raise InputError(
                "the pressure is answered on patches or at the nodes of hats",
                where="loads",
                found=shown(self.basis.kind),
                expected="bases.patches or bases.hats of the plate",
            )
        self.model = ForwardModel(plate, self.gauges, self.basis)
        self._sensed: InverseFEM | None = None
        self._posed: _Posed | None = None

    def estimate(self, found: Any, dt: float | None = None, *, still: bool = False) -> LoadEstimate:
        """The pressure behind static readings, or over a record.

        Parameters
        ----------
        found : array (gauges,) or (frames, gauges), mapping of label to reading, or Record
            In m/m (and m). A Record, or an array with `dt`, is a history: the inertia of the plate is in it.
        dt : float, optional
            Step of a bare array that is a history (s).
        still : bool
            The plate is at rest in every frame of a Record: no inertia, as in `StaticInversion`. A Record of one sample
            is so without it.

        Returns
        -------
        LoadEstimate
            Pressure in Pa, (loads,), (frames, loads) or (samples, loads).

        Raises
        ------
        InputError
            Readings that do not fit the gauges, or a field that the functions cannot hold.
        """
        history = isinstance(found, Record) and not still and len(found.values) > 1
        if dt is not None or history:
            return self._over_time(found, dt)
        given = readings(found, self.model, None)
        noise = noises.steady(self.noise, self.model, given)
        posed, chosen, said = self._fitted(given.values, noise)
        self._progress(0.8, "from the field to the load")
        spread = choosing.spread(chosen, [rows[0] for rows in posed.loads], noise.sigma)
        variance = np.sum(spread.root**2, axis=1) + spread.apart**2 + spread.hidden**2
        shape = (len(self.basis.coordinates),)
        single = given.axis is None
        predicted = self._predicted(posed, chosen)
        one = (lambda x: x[0]) if single else (lambda x: x)
        solved = SolvedLoad(
            load=one(spread.mean),
            std=one(np.sqrt(variance)),
            bias=one(spread.hidden),
            axis=given.axis,
            response=one(given.values),
            residual=one(given.values - predicted),
            facts=self._facts(posed, chosen, noise, len(given.values)),
            geometry=geometry(self.basis),
            posterior=DensePosterior(spread.root, shape, frames=None if single else len(spread.mean)),
            excess=self._excess(chosen, noise),
        )
        return self._answer(given, solved, posed, chosen, noise, said)

    def field(self, readings: Any) -> SensedField:
        """Deflection of the whole plate behind readings (gauges,) or (frames, gauges), by inverse finite elements."""
        if self._sensed is None:
            noise = self.noise.std if self.noise.stated else None
            self._sensed = InverseFEM(self.plate, self.gauges, noise=noise)
        return self._sensed.estimate(readings)

    # -- inside -----------------------------------------------------------------------------------------------------
    def _over_time(self, record: Any, dt: float | None) -> LoadEstimate:
        data = gather(record, dt, self.model, None)
        noise = noises.resolve(self.noise, self.model, data)
        posed, chosen, said = self._fitted(data.values, noise)
        best = chosen.best
        self._progress(0.5, "smoothing over time")
        sigma = choosing.noise_of(best, noise.sigma)
        path, (gains, V) = best.path, choosing.seen_by(best.path)
        y = np.atleast_2d(path.problem.y.T)
        size = 1 / (best.lam * float(path.scale))
        motion = moving.smoothed(y @ path.U[:, : len(gains)] / sigma, gains, size, data.dt)
        plate, candidate = thin_plate(self.plate), posed.candidates[best.candidate]
        functions = RadialBasis(plate.sides, plate.edges, candidate.shape, posed.ends, candidate.fall)
        rows = np.stack(self._rows(plate, functions), axis=-1) * candidate.sizes[:, None]  # (loads, f, 3)
        seen = np.einsum("pfd,fr->rpd", rows, V)
        load = sigma * np.einsum("trd,rpd->tp", motion.mean, seen)
        variance = np.zeros(load.shape)
        for k, row in enumerate(seen):
            pairs = np.einsum("pi,pj->ijp", row, row).reshape(9, -1)
            variance += motion.covariance[:, k].reshape(-1, 9) @ pairs
        rest = rows - np.einsum("rpd,fr->pfd", seen, V)
        variance += np.einsum("pfi,ij,pfj->p", rest, motion.prior, rest)
        predicted = sigma * (motion.mean[..., 0] * gains) @ path.U[:, : len(gains)].T
        predicted = self._unwhitened(predicted, posed, noise)
        facts = {**self._facts(posed, chosen, noise, len(load)), "time_constant": motion.length}
        solved = SolvedLoad(
            load=load,
            std=sigma * np.sqrt(np.maximum(variance, 0.0)),
            axis=over_time(len(load), data.dt),
            response=data.values,
            residual=data.values - predicted,
            facts=Facts.of(facts),
            geometry=geometry(self.basis),
            excess=self._excess(chosen, noise),
        )
        return self._answer(data, solved, posed, chosen, noise, said)

    @property
    def posed(self) -> _Posed:
        """Rows of gauges and loads for every shape parameter; the geometry decides them."""
        if self._posed is None:
            plate = self._still
            places = {tuple(np.round(np.asarray(g.at, float) / plate.size, 9)) for g in self.gauges}
            apart = float(np.sqrt(plate.sides[0] * plate.sides[1] / len(places)))
            count = max(1 + int(np.floor(np.log(FINEST / apart / SMALLEST) / np.log(STEP))), 2)
            ends = EdgedLoads(plate.sides, plate.edges, plate.nu)
            functions = [RadialBasis(plate.sides, plate.edges, SMALLEST * STEP**k, ends) for k in range(count)]
            functions += [RadialBasis(plate.sides, plate.edges, k / apart, ends, ROUGH) for k in UNSEEN]
            rows = [(f, self._gauge_rows(plate, f), self._rows(plate, f)) for f in functions]
            self._posed = _Posed(
                tuple(
                    _Candidate(f.shape, sizes, gauges * sizes, tuple(load * sizes for load in loads), f.fall)
                    for f, gauges, loads in rows
                    for sizes in (f.sizes(*edged) for edged in (AT_EDGES if f.fall == FALL else AT_EDGES[2:3]))
                ),
                ends,
                apart,
            )
        return self._posed

    def _gauge_rows(self, plate: ThinPlate, functions: RadialBasis) -> Array:
        """Readings per coefficient, (gauges, functions)."""
        x, y = plate.places(np.array([g.at for g in self.gauges], float))
        out = functions.rows(x, y)
        strain = np.array([g.quantity == "strain" for g in self.gauges])
        if strain.any():
            c, s = (f([getattr(g, "angle", 0.0) for g in self.gauges]) for f in (np.cos, np.sin))
            fibre = np.array([getattr(g, "fibre", 0.0) for g in self.gauges], float) / plate.size**2
            kx, ky, kxy = (functions.rows(x, y, *order) for order in ((2, 0), (0, 2), (1, 1)))
            bent = -(fibre * c * c)[:, None] * kx - (fibre * s * s)[:, None] * ky - (2 * fibre * c * s)[:, None] * kxy
            out[strain] = bent[strain]
        down = np.array([str(getattr(g, "direction", "+Z")).startswith("-") for g in self.gauges])
        out[down] *= -1
        return out

    def _rows(self, plate: ThinPlate, functions: RadialBasis) -> tuple[Array, Array, Array]:
        """Pressure of each load per deflection, velocity and acceleration: means over 2 x 2 points of a patch."""
        if self.basis.kind == "hats":
            return plate.load_rows(functions, np.asarray(self.basis.coordinates, float)[:, :2])
        extents = np.asarray(self.basis.extents, float)
        middle, half = extents.mean(axis=-1), np.ptp(extents, axis=-1) / (2 * np.sqrt(3))
        parts = [plate.load_rows(functions, middle + half * sign) for sign in ((-1, -1), (-1, 1), (1, -1), (1, 1))]
        w, v, a = (np.mean([part[k] for part in parts], axis=0) for k in range(3))
        return w, v, a

    def _fitted(self, values: Array, noise: NoiseLevel) -> tuple[_Posed, choosing.Chosen, NotTold | None]:
        self._progress(0.1, "posing the problem")
        posed = self.posed
        paths = choosing.paths(posed.gauges, values, noise.level)
        self._refuse_unheld(paths[sum(c.fall == FALL for c in posed.candidates) - 1], noise)
        self._progress(0.3, "choosing shape and ridge")
        seen = whiten(np.asarray(self.model.static(), float).sum(axis=1), noise.level, 0)
        said = of_fields(paths, noise.sigma, seen, self.model.loads[0].unit)
        return posed, choosing.chosen(paths, self.choice, sigma=noise.sigma, source=noise.source), said

    def _refuse_unheld(self, path: Any, noise: NoiseLevel) -> None:
        """Refuse readings that even the finest functions do not explain."""
        point = path.at(choosing.LOW)
        free = max(float(np.asarray(point.left)), 1.0)
        left = float(np.sqrt(point.residual2 / path.m))
        size = float(np.sqrt(np.mean(np.asarray(path.problem.y) ** 2)))
        level = None if noise.sigma is None else float(np.sqrt(point.residual2 / free)) / noise.sigma
        if left > LOST * size and free > 0.1 * path.m and (level is None or level > EXCESS):
            raise InputError(
                "the readings are those of no smooth deflection with these edges",
                where="ShapeSensing",
                found=f"{100 * left / size:.0f} % of the readings (rms) unexplained by the finest functions",
                expected=f"less than {100 * LOST:.0f} %",
                hint="check places, angles and fibres of the gauges, their units (m/m), and the edges of the plate",
            )

    def _predicted(self, posed: _Posed, chosen: choosing.Chosen) -> Array:
        """Readings of the fitted field."""
        parts = [
            fit.weight * np.atleast_2d(fit.path.solution(fit.lam, None).load) @ posed.gauges[fit.candidate].T
            for fit in chosen.fits
        ]
        return np.asarray(np.sum(parts, axis=0))

    def _unwhitened(self, y: Array, posed: _Posed, noise: NoiseLevel) -> Array:
        level = np.asarray(noise.level, float)
        return np.asarray(y * level if level.ndim == 1 else y @ np.linalg.cholesky(level).T)

    def _excess(self, chosen: choosing.Chosen, noise: NoiseLevel) -> float | None:
        path = chosen.best.path
        return beyond_noise(float(np.asarray(path.at(chosen.best.lam).residual2)), path.m, noise)

    def _facts(self, posed: _Posed, chosen: choosing.Chosen, noise: NoiseLevel, frames: int) -> Facts:
        best = chosen.best
        path, shape = best.path, posed.candidates[best.candidate].shape
        kappa, rank, nullity = identifiability.layout(path.singular_values, path.X.shape[0])
        edf = path.at(best.lam).edf
        return Facts.of(
            {
                "m": len(self.gauges),
                "n": int(path.X.shape[0]),
                "rank": rank,
                "nullity": nullity,
                "kappa": kappa,
                "edf": None if edf is None else float(edf),
                "frames": frames,
                "noise_level": choosing.noise_of(best, noise.sigma),
                "length": self._still.size / shape,
                **noise.source.facts,
                "chosen": f"shape parameter {shape / self._still.size:.3g} 1/m and its ridge, "
                f"with {len(chosen.fits) - 1} others that the data do not rule out",
                "band": "noise, ridge and shape; detail that no function holds lies outside",
                "path": "radial basis functions, SVD",
                "places": len(self.basis.coordinates),
            }
        )

    def _answer(
        self,
        given: Any,
        solved: SolvedLoad,
        posed: _Posed,
        chosen: choosing.Chosen,
        noise: NoiseLevel,
        said: NotTold | None,
    ) -> LoadEstimate:
        self._progress(1.0, "done")
        if said is not None:
            solved = replace(solved, facts=replace(solved.facts, **said.facts))
        rough = sum(fit.weight for fit in chosen.fits if posed.candidates[fit.candidate].fall == ROUGH)
        path = chosen.best.path
        settings = {"family": self.name, "choice": "evidence" if self.choice is None else shown(self.choice)}
        return answer(
            self,
            given,
            solved,
            chosen.choice,
            known=noise.known,
            prior=PRIOR,
            settings=settings,
            flags=[
                guards.between_gauges(rough, posed.apart * self._still.size),
                *([] if said is None else [said.flag]),
            ],
            searched=path,
            solved=path,
            judged=False,
        )


@dataclass(frozen=True, eq=False)
class _Candidate:
    """What the geometry decides, for a shape parameter, a size of the pressures at the edges and a fall."""

    shape: float
    sizes: Array
    gauges: Array
    loads: tuple[Array, ...]
    fall: float


@dataclass(frozen=True, eq=False)
class _Posed:
    """All candidates, smooth ones first, and the distance of the gauges over the longer side."""

    candidates: tuple[_Candidate, ...]
    ends: EdgedLoads
    apart: float

    @property
    def gauges(self) -> tuple[Array, ...]:
        """Rows of the gauges."""
        return tuple(c.gauges for c in self.candidates)

    @property
    def loads(self) -> tuple[tuple[Array, ...], ...]:
        """Rows of the loads per deflection, velocity and acceleration."""
        return tuple(c.loads for c in self.candidates)


def _patches(plate: Structure, thin: ThinPlate) -> bases.Basis:
    a, b = thin.sides
    return bases.patches(plate, (max(round(GRID * a), 2), max(round(GRID * b), 2)))
