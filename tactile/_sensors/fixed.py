"""Frame after frame at a lambda that is fixed, and whether the markers agree with each other and with the maps.

What the others predict for a reading is known from the inverse alone: its residual over ``1 - A_ii`` (leave-one-out).

W611, a camera or a gel that moved as a whole, is told from a load. A uniform shift of all markers is fitted by a shear
of the whole surface, so that no residual shows it. But a load acts near a contact, which stands out once the shift of
most markers is taken off; and what the loads about it do not explain of the markers far from it should be noise. The
medians over cells as wide as the gel is thick are the data: a multiple of the motion that these loads explain, a shift
and a turn are fitted to them, and an F test asks whether shift and turn explain more than chance. What scatters beyond
the noise are errors of the model, which are alike over two thicknesses: they count for a quarter of their number.
"""

from __future__ import annotations

from collections.abc import Callable
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
from .._arrays import Array, Index, Mask
from .._results import forcemap
from .._results.forcemap import ForceFacts
from .evidence import EvenEvidence
from .gaussian import ForceBand, GaussianProblem
from .image import ImageFit, ImageShift
from .inversion import Answer, Inverse, Pressed, RegionSolver, carried, held, met, prepare
from .local import Z95, ContactFit, LocalLoad
from .looks import Undetected
from .marked import ContactLaw
from .observation import Markers, Wrench
from .search import WORTH, score

MANY = 12  # markers from which one can be told to contradict the others
STRAYS = 20  # of them that are left out, at most
STRAY, PART = 10.0, 0.6  # distance over its std or the typical one, and over the largest motion
BESIDE = 4.0  # and over the second largest distance of its neighbours, which a contact raises alike
AROUND = 8  # neighbours
TURNS, ALIKE = 4, 0.5  # of them that may be the other half of a swap; its distance over that of the first
FREE = 0.02  # 1 - A_ii below which a reading explains itself: no other tells of it
NORMAL = 1.4826  # standard deviation over median absolute value of a normal law


@dataclass(eq=False)
class Consistency:
    """Leave-one-out errors of the markers (N, 2) of a frozen inverse; their readings come first, `axes` for each."""

    inverse: Inverse
    places: Array
    axes: int
    near: Index = field(init=False)

    def __post_init__(self) -> None:
        from scipy.spatial import cKDTree

        rows = len(self.places) * self.axes
        count = min(AROUND + 1, len(self.places))
        self.near = np.atleast_2d(cKDTree(self.places).query(self.places, k=count)[1])[:, 1:]
        self.free = np.maximum(1 - np.diagonal(self.inverse.influence)[:rows], 1e-3)
        self.judged = np.repeat((self.free.reshape(-1, self.axes) > FREE).all(axis=1), self.axes)
        # single precision where the products of the map are: it is asked for every frame
        self.rows = np.ascontiguousarray(self.inverse.influence[:rows], self.inverse.matrix.dtype)

    def checked(self, y: Array) -> tuple[Array, int, float]:
        """Readings without those of markers that contradict all others, how many these are, and the misfit left.

        One at a time, the worst first, as a stray marker pulls the predictions of its neighbours with it. The misfit is
        the rms residual of the markers over what their noise lets expect: 1 where model and noise are right.
        """
        found, rest = 0, self._rest(y)
        while len(self.places) >= MANY and found < STRAYS and (worst := self._stray(y, *rest)) is not None:
            before, y = y, self._left_out(y, worst)
            partner = self._partner(before, y, worst)
            y = y if partner is None else self._left_out(y, partner)
            found += 1 if partner is None else 2
            rest = self._rest(y)
        return y, found, self._misfit(*rest[1:])

    def _partner(self, before: Array, y: Array, stray: int) -> int | None:
        """The neighbour that was taken for the stray marker in turn: as far from its place, if there is one.

        Alone it might explain itself, so it is held against what all others say without both.
        """
        far = self._distance(before, y, stray)
        seen = [int(j) for j in self.near[stray][:TURNS] if np.isfinite(y[j * self.axes])]
        away = [self._distance(before, self._left_out(y, j), j) for j in seen]
        return seen[int(np.argmax(away))] if away and max(away) > ALIKE * far else None

    def _distance(self, before: Array, y: Array, marker: int) -> float:
        """Whitened distance of a marker that was left out from what the others predict for it."""
        here = slice(marker * self.axes, (marker + 1) * self.axes)
        return float(np.linalg.norm(before[here] / self.inverse.noise[here] - self.inverse.filled(y)[0][here]))

    def _misfit(self, gone: Mask, rest: Array) -> float:
        kept = ~gone & self.judged
        return float(np.sqrt(np.sum(rest[kept] ** 2) / max(np.sum(self.free[kept]), 1.0))) if kept.any() else 0.0

    def _stray(self, y: Array, z: Array, gone: Mask, rest: Array) -> int | None:
        apart = self._apart(gone, rest)
        free = self.free.reshape(-1, self.axes)
        size = np.linalg.norm(apart, axis=1)
        scaled = size / np.sqrt(np.sum(1 / free, axis=1))
        worst = int(np.argmax(scaled))
        moved = np.linalg.norm(z.reshape(-1, self.axes), axis=1).max(initial=0.0)
        if not size[worst] > PART * moved or not scaled[worst] > STRAY * max(1.0, NORMAL * float(np.median(scaled))):
            return None
        others = self._apart(*self._rest(self._left_out(y, worst))[1:])[self.near[worst]]
        beside = np.sort(np.linalg.norm(others, axis=1))
        # the second largest: two dots that were swapped are each other's neighbours
        return worst if size[worst] > BESIDE * beside[-2] else None

    def _left_out(self, y: Array, marker: int) -> Array:
        y = y.copy()
        y[marker * self.axes : (marker + 1) * self.axes] = np.nan
        return y

    def _apart(self, gone: Mask, rest: Array) -> Array:
        """Whitened distance (markers, axes) from what the others predict."""
        return np.where(self.judged & ~gone, rest / self.free, 0.0).reshape(-1, self.axes)

    def _rest(self, y: Array) -> tuple[Array, Mask, Array]:
        """Whitened motion of the markers, which are lost, and the residual."""
        z, lost = self.inverse.filled(y)
        count = len(self.free)
        gone = np.zeros(len(z), bool)
        gone[lost] = True
        rest = z[:count] - self.rows @ z.astype(self.rows.dtype, copy=False)
        return z[:count], gone[:count], np.where(gone[:count], 0.0, rest)


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
        load = about.load if found is None else found.load
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


NEAR, FAR = 1.0, 2.0  # thicknesses from the contact: loads that count as its own, markers that it does not reach
CELLS = 5  # fewest with far markers
CHANCE = 1e-6  # of so large a motion in a frame at rest
UNKNOWNS = 3  # shift along X and Y, turn
SHARING = 4  # cells that share an error of the model
MEDIAN = np.pi / 2  # variance of a median over that of a mean


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A shift (2,) m and a turn (rad) about a point (2,) m, and what makes them more than chance.

    The F statistic, what chance exceeds once in a million frames, and the number of cells of far markers it stands on.
    """

    shift: Array
    turn: float
    about: Array
    ratio: float
    threshold: float
    cells: int

    def field(self, places: Array) -> Array:
        """In-plane motion (n, 2) in m of places (n, 2)."""
        x, y = (places - self.about).T
        return self.shift + self.turn * np.column_stack([-y, x])


def typical(motion: Array, noise: Array) -> Array:
    """Shift (2,) of most markers, the median of their motion (N, 2); zero where it is below their noise."""
    seen = np.isfinite(motion).all(axis=1)
    if not seen.any():
        return np.zeros(2)
    shift = np.median(motion[seen], axis=0)
    return np.asarray(shift if np.linalg.norm(shift) > np.sqrt(np.mean(noise**2)) else np.zeros(2))


def contact(load: Array, std: Array) -> Mask:
    """Nodes (P,) that are pressed, of loads (3 P,)."""
    pressure = -load[2::3]
    return np.asarray((pressure > forcemap.SHARE * pressure.max(initial=0.0)) & (pressure > forcemap.CLEAR * std[2::3]))


def away(
    motion: Array, explained: Callable[[Mask], Array], touched: Mask, nodes: Array,
    markers: Array, noise: Array, thickness: float,
) -> RigidMotion | None:  # fmt: skip
    """Rigid motion of the markers that the contact does not reach; None where it is chance, or cannot be told.

    `motion` (N, 2) in m is NaN where a marker is lost, `noise` (N, 2) its std; `explained` gives the motion (N, 2) by
    the loads of a mask of nodes (P,), of which those `touched` are pressed; nodes, markers and thickness of the gel in
    m.
    """
    far, loaded = np.isfinite(motion).all(axis=1), np.zeros_like(motion)
    if touched.any():
        from scipy.spatial import cKDTree

        tree = cKDTree(nodes[touched])
        far &= tree.query(markers)[0] > FAR * thickness
        if far.any():
            loaded = explained(tree.query(nodes)[0] <= NEAR * thickness)
    found = _fitted(motion[far], loaded[far], markers[far], noise[far], thickness)
    if found is None or found.ratio <= found.threshold:
        return None
    size = np.sqrt(np.mean(found.field(markers[far]) ** 2))
    return found if size > np.sqrt(np.mean(noise[far] ** 2)) else None  # below the noise of one marker it is none


def _fitted(motion: Array, loaded: Array, places: Array, noise: Array, side: float) -> RigidMotion | None:
    """Rigid motion of the medians over cells of a side, beside a multiple of what the loads explain."""
    from scipy.special import fdtri

    if len(places) < CELLS:
        return None
    which = np.unique(np.floor(places / side).astype(int), axis=0, return_inverse=True)[1].ravel()
    members = [np.flatnonzero(which == k) for k in range(int(which.max()) + 1)]
    if len(members) < CELLS:
        return None
    data, known = (np.array([np.median(v[m], axis=0) for m in members]).T.ravel() for v in (motion, loaded))
    place = np.array([places[m].mean(axis=0) for m in members])
    about = place.mean(axis=0)
    x, y = (place - about).T
    one, zero = np.ones(len(members)), np.zeros(len(members))
    rigid = np.vstack([np.column_stack([one, zero, -y]), np.column_stack([zero, one, x])])
    other = known[:, None] if known.any() else np.empty((len(data), 0))
    without = _rest(other, data)
    answer = np.linalg.lstsq(_rest(other, rigid), without, rcond=None)[0]
    within = _rest(np.column_stack([other, rigid]), data)
    spare = len(data) - other.shape[1] - UNKNOWNS
    chance = float(np.mean([MEDIAN ** (len(m) > 2) * np.mean(noise[m] ** 2) / len(m) for m in members]))
    beyond = max(float(within @ within) / spare - chance, 0.0)
    variance = chance + SHARING * beyond
    ratio = float(without @ without - within @ within) / UNKNOWNS / variance
    threshold = float(fdtri(UNKNOWNS, spare, 1 - CHANCE))
    return RigidMotion(np.asarray(answer[:2], float), float(answer[2]), about, ratio, threshold, len(members))


def _rest(columns: Array, values: Array) -> Array:
    """What columns do not explain of values, by least squares."""
    if columns.shape[1] == 0:
        return values
    scaled = columns / np.linalg.norm(columns, axis=0)
    return np.asarray(values - scaled @ np.linalg.lstsq(scaled, values, rcond=None)[0])


def whole_motion(
    motion: Array, load: Array, std: Array, markers: Markers, nodes: Array, thickness: float,
    alone: Callable[[Callable[[Array], Array]], Array], explained: Callable[[Array], Array], resultant: Array,
    pixel: float | None,
) -> Flag | None:  # fmt: skip
    """W611 of a frame: the in-plane motion (N, 2) of the markers (m), NaN where lost, load and std (3 P,) found of it.

    `alone` takes a motion in the plane as a function of places (n, 2) and gives the load (3 P,) that the map makes of
    it alone, `explained` takes a load and gives the in-plane motion of the markers under it; nodes (P, 2), thickness of
    the gel and side of a pixel on the pad in m.
    """
    places, noise = markers.points[:, :2], markers.noise[:, :2]
    shift = typical(motion, noise)
    local = load - alone(lambda x: np.broadcast_to(shift, x.shape)) if shift.any() else load
    found = away(motion, lambda near: explained(local * np.repeat(near, 3)), contact(local, std), nodes, places, noise,
                 thickness)  # fmt: skip
    if found is None:
        return None
    force = resultant[:3] @ alone(found.field)
    return guards.slipped(found.shift, found.turn, found.ratio, found.threshold, force, pixel)
