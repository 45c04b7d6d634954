"""Frame after frame at a lambda that is fixed: the map, its band, and what is said of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from loadid._families.static import StaticInversion
from loadid._inverse.choice import Choice
from structures._flags import Flag
from structures.errors import InputError

from .. import _guards as guards
from .._arrays import Array
from .._results.forcemap import ForceFacts
from .evidence import EvenEvidence
from .gaussian import ForceBand, GaussianProblem
from .image import ImageFit, ImageShift
from .inversion import Answer, Inverse, Pressed, RegionSolver, carried, held, met, prepare
from .local import Z95, ContactFit, LocalLoad
from .looks import Undetected
from .marked import ContactLaw
from .observation import Wrench
from .search import WORTH, score
from .strays import Consistency

WIDER = 1.2  # times the stated noise, from which it is taken for wrong
TOUCH = 0.05  # of the peak pressure of the unconstrained map: where the constrained one looks for contact
CLEAR = 2.0  # stds of the unconstrained map
DOUBT = 30.0  # log evidence that a mesh may cost a contact which is finer than it


@dataclass(frozen=True, eq=False)
class FrameAnswer:
    """What came of one frame: load (n,) and std, covariance of the resultant (6, 6), facts, flags, image's motion.

    And the std (n,) by noise alone, where that is less than all that may be wrong.
    """

    load: Array
    std: Array
    wrench: Array
    facts: ForceFacts
    flags: list[Flag | None]
    image: ImageShift | None = None
    noise: Array | None = None


@dataclass(eq=False)
class QuickMap:
    """The frozen inverse of a sensor at a calibrated or given lambda, with what it keeps from frame to frame.

    `resultant` is (6, n); `places` (n / 3, 3) are the nodes that may be loaded, `neighbours` sparse which of them share
    a cell, `markers` (N, 2), whose readings come first, `axes` for each; `reach` is the radius of the press whose
    recovery is told, `about` the middle of the surface (3,); all in m. `problem` is that of a contact prior, with the
    `choice` that was made on the frame itself, where lambda is not fixed; `contacts` fits loads about those of a frame,
    `normal` says whether normal motion is read, `normals` (n / 3, 3) are those of a curved surface; lambda is `scale`
    times that of the calibration.
    """

    family: StaticInversion
    resultant: Array
    places: Array
    neighbours: Any
    markers: Array
    axes: int
    reach: float
    about: Array
    contact: ContactLaw
    problem: GaussianProblem | None = None
    choice: Choice | None = None
    contacts: ContactFit | None = None
    normal: bool = True
    normals: Array | None = None
    scale: float = 1.0
    _solver: RegionSolver | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.inverse: Inverse = self._prepared()
        problem = self.problem
        motion = None if problem is None else problem.motion
        self.image = None
        if problem is not None and motion is not None:
            self.image = ImageFit(problem, motion, self.inverse, self.places, self.reach)
        self.consistency = Consistency(self.inverse, self.markers, self.axes)
        self.recovery = self.inverse.recovery(self._press())

    def __call__(self, y: Array, wrench: Wrench | None = None, quick: bool = False) -> FrameAnswer:
        """Map of readings (m,), NaN where one is lost; by the product alone where it must be `quick`."""
        band = self.inverse.band
        return self._plain(y, wrench) if band is None else self._under_prior(y, wrench, band, quick)

    def told(self, y: Array) -> Array:
        """Readings (m,), NaN where lost, over the noise that they show, without strays: (m,), lost ones as foretold."""
        kept, _, misfit = self.consistency.checked(y)
        return self.inverse.filled(kept)[0] / max(1.0, misfit)

    def _plain(self, y: Array, wrench: Wrench | None) -> FrameAnswer:
        """Under a penalty that knows of no contact."""
        inverse = self.inverse
        y, strays, misfit = self.consistency.checked(y)
        answer = inverse(y, None if self.contact.constrains else wrench)
        load, std, covariance = answer.load, answer.std, answer.wrench
        flags: list[Flag | None] = []
        if wrench is None:
            hidden = inverse.hidden(load)
            flags += [guards.unseen(self.recovery), guards.taken(hidden, inverse.resultant @ load, covariance)]
            covariance = covariance + np.outer(hidden, hidden) + self._blind(inverse.resultant @ load)
        found = self.pressed(y, wrench, answer) if self.contact.constrains else None
        if found is not None:
            load, std = found.load, found.std
            covariance = found.wrench if wrench is not None or found.touched else covariance
        wide = max(1.0, misfit)  # as far as the markers contradict their noise, so does the map
        return self._answered(y, load, wide * std, wide**2 * covariance, (strays, misfit), found, flags)

    def _under_prior(self, y: Array, wrench: Wrench | None, band: ForceBand, quick: bool) -> FrameAnswer:
        """Under a contact prior, which knows how far the model may be off, beside the motion of the whole image."""
        inverse, (steady, shift) = self.inverse, self._steadied(y)
        steady, strays, misfit = self.consistency.checked(steady)
        wide, kept = max(1.0, misfit), np.where(np.isfinite(steady), y, np.nan)
        if strays or wide > WIDER:  # without the strays, and by the noise that there is
            steady, shift = self._steadied(kept, wide)
        known = None if shift is None or self.image is None else self.image.steady_load(kept, shift)
        answer, about = inverse(steady, load=known), None
        if self.contacts is not None and wrench is None and not quick:  # a wrench says more
            about = self._about(steady, wide)
        if strays and about is not None:
            whole = y if shift is None or self.image is None else self.image.steadied(y, shift)
            about = self._doubted(whole, steady, about)
        if about is not None and not self.normal:
            return self._by_contacts(steady, about, (strays, misfit), shift)
        found = self.pressed(steady, None, answer) if self.contact.constrains else None
        load = answer.load if found is None else found.load
        hidden = not quick and wrench is None and about is None  # so may be a load
        if hidden and self.contacts is not None:
            noisy = self.contacts.erring(steady / inverse.noise, wide)
            unseen = self.contacts.undetected(steady / inverse.noise / noisy).times(noisy)
            if not self.normal and not self._everywhere(steady, noisy):
                return self._undetected(steady, unseen, found, (strays, misfit), shift)
        told = answer.load if hidden else load  # a contact that is not seen makes no band smaller
        variance, covariance = band.std(told, wide) ** 2, band.covariance(told, wide)
        if answer.std is not inverse.std:  # readings are lost: the posterior says how much wider it all is
            variance = variance + np.maximum(answer.std**2 - inverse.std**2, 0.0)
            covariance = covariance + answer.wrench - inverse.resultant @ inverse.reach
        if shift is not None and self.image is not None:
            moved = wide * self.image.open(shift)
            felt = inverse.resultant @ moved
            variance, covariance = variance + np.sum(moved**2, axis=1), covariance + felt @ felt.T
        asked = wrench if about is None else Wrench(inverse.resultant[:3] @ about.load)
        if asked is not None:
            R = inverse.resultant
            force, covariance = met(R @ load, covariance, asked) if about is None else (R @ about.load, about.wrench)
            if found is None:
                if about is not None:
                    load, variance = about.beside(load, variance, band.left_open(about.load, wide))
                load = band.corrected(load, force)
            else:
                found = self.pressed(steady, held(force, asked, self.contact.friction, self._along(load)), answer)
                load = found.load
                covariance = covariance + np.outer(R @ load - force, R @ load - force)
        flags = [guards.unseen(self.recovery) if wrench is None and about is None else None]
        if (found is None or hidden) and wrench is None and about is None:
            apart = inverse.resultant @ (load - told)
            covariance = covariance + self._blind(inverse.resultant @ told) + np.outer(apart, apart)
        if self.contacts is not None and hidden:
            covariance[2, 2] += unseen.wrench[2, 2] + float(inverse.resultant[2] @ unseen.load) ** 2
        done = self._answered(steady, load, np.sqrt(variance), covariance, (strays, misfit), found, flags, shift, about)
        return replace(done, noise=np.minimum(wide * np.sqrt(band.noise), done.std))

    def _about(self, y: Array, wide: float) -> LocalLoad | None:
        """Loads about the contacts of readings (m,), NaN where lost; None where they are not what the readings say.

        The motion of the image is an unknown beside them; what was found of it is taken off before, as a model errs by
        a share of what a load moves.
        """
        assert self.contacts is not None
        z = y / self.inverse.noise
        wide = self.contacts.erring(z, wide)
        level = self._even(z / wide) if np.isfinite(z).all() else -np.inf
        return self.contacts(z, wide, level)

    def _doubted(self, y: Array, kept: Array, about: LocalLoad) -> LocalLoad:
        """Loads without strays; what they would be with them is in the band, where a small contact may have moved them.

        A stray may be anywhere, so how likely its readings are is known. Under a contact that is finer than the mesh a
        single marker moves much further than its neighbours.
        """
        assert self.contacts is not None
        z = y / self.inverse.noise
        left = np.isfinite(z) & ~np.isfinite(kept)
        anywhere = -np.log(2 * np.nanmax(np.abs(z)) / about.wide / np.sqrt(2 * np.pi))
        whole = self.contacts(z, about.wide, score(about.best) + np.sum(left) * float(anywhere) - DOUBT)
        if whole is None:
            return about
        apart = self.inverse.resultant @ (whole.load - about.load)
        return replace(about, wrench=about.wrench + np.outer(apart, apart))

    @cached_property
    def _even(self) -> EvenEvidence:
        assert self.contacts is not None
        return EvenEvidence.of(self.inverse, self.contacts.moved)

    def _by_contacts(
        self, steady: Array, about: LocalLoad, checked: tuple[int, float], shift: ImageShift | None
    ) -> FrameAnswer:
        """What loads about the contacts say, where the readings do not tell of normal motion."""
        assert self.contacts is not None
        found = None
        if self.contact.constrains:
            z = steady / self.inverse.noise
            found = self.contacts.pressed(z, about, self.contact.friction, self.normals)
        load = self.contacts.cell_means(about.load) if found is None else found.load
        flags = [guards.unseen(self.recovery, contacts=True)]
        return self._answered(steady, load, about.std, about.wrench, checked, found, flags, shift, about)

    def _everywhere(self, y: Array, wide: float) -> bool:
        """Whether readings (m,), NaN where lost, ask for loads all over the surface, as they must for a contact."""
        assert self.contacts is not None
        z = y / self.inverse.noise / wide
        return bool(np.isfinite(z).all()) and self._even(z) > self.contacts.nothing(z) + WORTH

    def _undetected(
        self, steady: Array, unseen: Undetected, found: Pressed | None, checked: tuple[int, float],
        shift: ImageShift | None,
    ) -> FrameAnswer:  # fmt: skip
        """What a contact may be that readings in the plane do not show, wherever the image has moved to."""
        load = unseen.load if found is None else found.load
        off = load - unseen.load
        felt = self.inverse.resultant @ off
        std, wrench = np.sqrt(unseen.variance + off**2), unseen.wrench + np.outer(felt, felt)
        most = max(Z95 * float(np.sqrt(wrench[2, 2])) - float(self.inverse.resultant[2] @ load), 0.0)
        flags = [guards.unseen(self.recovery, contacts=True), guards.contact_hidden(most)]
        done = self._answered(steady, load, std, wrench, checked, found, flags, shift)
        return replace(done, facts=replace(done.facts, path=f"{done.facts.path}, no contact found"))

    def _steadied(self, y: Array, wide: float = 1.0) -> tuple[Array, ImageShift | None]:
        """Readings without what moved all of them, and what that was."""
        if self.image is None:
            return y, None
        shift = self.image(y, wide)
        return self.image.steadied(y, shift), shift

    def _answered(
        self, y: Array, load: Array, std: Array, covariance: Array, checked: tuple[int, float],
        found: Pressed | None, flags: list[Flag | None], image: ImageShift | None = None,
        about: LocalLoad | None = None,
    ) -> FrameAnswer:  # fmt: skip
        (strays, misfit), inverse = checked, self.inverse
        path, lost = "frozen inverse", int(np.sum(~np.isfinite(y)))
        path += "" if about is None else f", contacts: {len(about.best.discs)}"
        unlike = None if about is None else guards.unlike_pad(about.rest, len(y) - lost)
        parted = None if about is None else guards.contacts_open(about.regions)
        flags = [guards.strays(strays), guards.misfit(misfit), unlike, parted, *flags]
        if found is not None:
            path = f"active sets on the contact region, {found.steps} steps"
            flags.append(guards.stopped(found.converged, found.steps))
        facts = ForceFacts(
            path=path, m=len(y) - lost, n=len(load), lost=lost, strays=strays, misfit=misfit, lam=inverse.lam,
            lambda_rule=inverse.rule,
        )  # fmt: skip
        return FrameAnswer(load, std, covariance, facts, flags, image)

    def _prepared(self) -> Inverse:
        family = self.family
        if self.choice is not None and self.problem is not None:
            return self.problem.inverse(self.choice.lam * self.choice.scale / self.problem.scale, self.choice.rule)
        lam = family.calibration.lam if family.calibration is not None else family.choice
        if not isinstance(lam, int | float):
            raise InputError(
                "lambda is not fixed yet", where="sensor", found=f"choice={lam!r}",
                expected="a calibration, or a relative lambda", hint="sensor.calibrate([press, press, ...])",
            )  # fmt: skip
        rule = "given" if family.calibration is None else family.calibration.rule
        if self.problem is None:
            return prepare(family, self.resultant, float(lam), rule)
        return self.problem.inverse(self.scale * float(lam), rule)

    def pressed(self, y: Array, wrench: Wrench | None = None, answer: Answer | None = None) -> Pressed:
        """The map that only presses, where the unconstrained answer does; not for penalties that couple loads."""
        if wrench is not None:
            carried(wrench, self.contact.friction, self.normals)
        if answer is None:
            y = self._steadied(y)[0]
            answer = self.inverse(y)
        z = y / self.inverse.noise
        if self.problem is not None:  # what the model errs by is noise to loads that are held, as to those that are not
            z = solve_triangular(self._erring, self.inverse.filled(y)[0], lower=True)
        if self.inverse.band is not None and wrench is None:
            touched = self.inverse.band.loaded(answer.load)
            return self._region.solve(z, touched, wrench, answer)
        pressure, spread = self._pressure(answer.load), answer.std[2::3]
        touched = pressure > TOUCH * pressure.max()
        if wrench is None:
            touched &= pressure > CLEAR * spread
        return self._region.solve(z, touched, wrench, answer)

    def _pressure(self, load: Array) -> Array:
        """Pressure (n / 3,) of a load (n,), along the normals of its nodes."""
        return -load[2::3] if self.normals is None else -np.sum(load.reshape(-1, 3) * self.normals, axis=1)

    def _along(self, load: Array) -> Array | None:
        """Normal (3,) of a curved surface about a load (n,): that of its nodes, by their pressures."""
        if self.normals is None:
            return None
        mean = np.maximum(self._pressure(load), 0.0) @ self.normals
        size = float(np.linalg.norm(mean))
        return mean / size if size > 0 else np.array([0.0, 0.0, 1.0])

    def _blind(self, resultant: Array) -> Array:
        """Variance of a normal force that the readings hardly see: as large as what they may hide."""
        out = np.zeros((6, 6))
        if self.recovery < guards.SEEN:
            out[2, 2] = (resultant[2] * (1 / max(self.recovery, 1e-3) - 1)) ** 2
        return out

    @cached_property
    def _erring(self) -> Array:
        """Lower factor (m, m) of the covariance of whitened readings by noise and the errors of the model."""
        assert self.problem is not None
        return self.problem.erring(self.inverse.lam * self.inverse.scale)

    @property
    def _region(self) -> RegionSolver:
        if self._solver is None:
            inverse, problem = self.inverse, self.problem
            if problem is not None:
                weights = partial(problem.weights, inverse.lam * inverse.scale)
                self._solver = RegionSolver(
                    solve_triangular(self._erring, problem.whitened, lower=True), weights, inverse.resultant,
                    self.neighbours, self.contact.friction, self.normals,
                )  # fmt: skip
                return self._solver
            if self.family.L is not None:
                raise InputError(
                    "constrained maps at a fixed lambda take the identity as their penalty",
                    where="penalty", found=self.family.penalty, expected="'identity'",
                    hint="leave lambda to be chosen per frame, or leave the constraints out",
                )  # fmt: skip
            prior = np.full(inverse.shape[0], inverse.lam * inverse.scale)
            H = self.family.H[: inverse.shape[1]] / inverse.noise[:, None]  # markers first, depth after them
            R, friction = inverse.resultant, self.contact.friction
            self._solver = RegionSolver(H, prior, R, self.neighbours, friction, self.normals)
        return self._solver

    def _press(self) -> Array:
        """A plain press in the middle of the surface (n,), of no particular size."""
        press = np.zeros((len(self.places), 3))
        press[:, 2] = -np.exp(-np.sum((self.places[:, :2] - self.about[:2]) ** 2, axis=1) / self.reach**2)
        return press.ravel()
