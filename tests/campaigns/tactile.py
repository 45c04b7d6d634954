"""Force maps on gels that no sensor modelled (`tests.campaigns.gels`), as a user gets them from `MultilayerPad`.

A gel of 20 x 16 x 3 mm of three Poisson's ratios, three noises of the markers, presses of five shapes. Sensors: markers
in the plane, with a depth map, tracked along all axes, and in the plane where a contact only presses, or stays within a
friction of 0.8. Each is calibrated on three presses of its own and then maps each press at once; those without
constraints also choose lambda on each press.

`error` is what the user does not know: motion that no press made ("shift", "rotation", "scale", "creep"), modulus 10 %,
Poisson's ratio .03 or thickness 7 % off, or a cap where the user has a flat pad ("dome").
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tactile import ContactLaw, DepthMap, ForceMap, Markers, MultilayerPad, Pad

from .gels import GELS, NUISANCES, Case, E, cases, disturbed
from .scores import Z95, Array

ERRORS = ("none", *NUISANCES[1:], "E", "nu", "thickness", "dome")
SETUPS = ((0.45, 2e-6), (0.32, 5e-6), (0.49, 5e-6), (0.45, 20e-6))  # Poisson's ratio, noise of the markers (m)
CALIBRATING = 3  # presses
DRAWS = 10  # frames at rest, and shifted ones of each press, that are asked for W611
WORSE = 1.3  # map error over the best up to which a default is as it should be
NEAR = 0.05  # of the normal force: so near to the true one a force is right, whatever its band
KINDS: dict[str, dict[str, Any]] = {
    "in the plane": {}, "and depth": {"depth": True}, "all axes": {"axes": "XYZ"},
    "no pull": {"contact": ContactLaw(no_pull=True)}, "friction": {"contact": ContactLaw(friction=0.8)},
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Mapped:
    """One map beside its truth.

    Parameters
    ----------
    groups : tuple of str
        What it counts in: sensor and how lambda was chosen; Poisson's ratio and noise; shape.
    close, inside : bool array (3,)
        Whether each component of the force is within `NEAR` of the normal force, and within its 95 % band.
    width : float
        Of the band of the normal force, over that force.
    covered : array (3,)
        Share of the tractions under the press that lie in their band, by component.
    beside : float
        The same of all components where nothing presses.
    error, best, cosine : float
        Relative L2 error of the map, the same at the best lambda, and its cosine.
    alarms, found : float or None
        Shares of frames at rest, and of those whose image is shifted by a quarter of a pixel or more, that raise W611.
    shifted : float
        Error of the force in a shifted frame, over the force.
    force : float
        True normal force (N); the largest of a run is the full scale of its shifted frames.
    codes : frozenset of str
    """

    groups: tuple[str, ...]
    close: Array
    inside: Array
    width: float
    covered: Array
    beside: float
    error: float
    best: float
    cosine: float
    alarms: float | None
    found: float | None
    shifted: float
    force: float
    codes: frozenset[str]


def pad_of(case: Case, error: str) -> Pad:
    """The pad that the user believes in."""
    off = {"E": error == "E", "nu": error == "nu", "thickness": error == "thickness"}
    return Pad(size=case.size, thickness=case.thickness * (1 + 0.07 * off["thickness"]), E=E * (1 + 0.1 * off["E"]),
               nu=case.nu - 0.03 * off["nu"])  # fmt: skip


@dataclass(frozen=True, eq=False)
class User:
    """One sensor on one gel."""

    kind: str
    pad: Pad
    first: Case
    settings: dict[str, Any]

    def sensor(self, **more: Any) -> MultilayerPad:
        """Built as the user does."""
        given = {**KINDS[self.kind], **self.settings, **more}
        axes, depth = given.pop("axes", "XY"), given.pop("depth", False)
        template = DepthMap(*self.first.depth) if depth and self.first.depth else None
        return MultilayerPad(self.pad, Markers(self.first.points, self.first.noise, axes), depth=template, **given)

    def seen(self, case: Case, motion: Array | None = None) -> tuple[Array, DepthMap | None]:
        """What the sensor is given of a press; in its frame at another motion (N, 3)."""
        depth = DepthMap(*case.depth) if "depth" in KINDS[self.kind] and case.depth else None
        moved = case.motion if motion is None else motion
        return (moved if self.kind == "all axes" else moved[:, :2]), depth

    def map(self, sensor: MultilayerPad, case: Case, motion: Array | None = None) -> ForceMap:
        """Its answer."""
        return sensor.estimate(*self.seen(case, motion))

    def calibrated(self, presses: Sequence[Case]) -> MultilayerPad:
        """With lambda frozen on presses."""
        sensor, frames = self.sensor(), [self.seen(c) for c in presses]
        depths = [d for _, d in frames if d is not None]
        sensor.calibrate([f for f, _ in frames], depths or None)
        return sensor


def truth(case: Case, pad: Pad) -> Array:
    """True tractions (P, 3) at the nodes: means over a cell about each."""
    return case.traction(pad.nodes2d, float(np.sqrt(np.median(pad.surface.areas))))


def best_of(user: User, sensor: MultilayerPad, presses: Sequence[Case]) -> list[float]:
    """Map error of each press at its best lambda: by the SVD, or by sensors at several lambdas under constraints."""
    known = [truth(c, user.pad) for c in presses]
    if sensor.constrained:
        others = [user.sensor(choice=float(lam)) for lam in np.geomspace(0.02, 0.5, 4)]
        maps = [[user.map(o, c).traction() for o in others] for c in presses]
        return [min(_error(m, t) for m in listed) for listed, t in zip(maps, known, strict=True)]
    problem = sensor.problem
    assert problem is not None
    HC, _, made = problem._spread  # the same path, asked at many lambdas
    w, V = np.linalg.eigh(made)
    back, out = HC.T @ V, []
    for case, t in zip(presses, known, strict=True):
        part = V.T @ (sensor.readings(*user.seen(case)) / problem.noise)
        maps = [back @ (part / (w + lam**2 * w[-1])) for lam in np.geomspace(1e-3, 1, 31)]
        out.append(min(_error(m.reshape(-1, 3), t) for m in maps))
    return out


def _error(found: Array, true: Array) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def held(user: User, sensor: MultilayerPad, case: Case, best: float, how: str, shifted_too: bool = True) -> Mapped:
    """One map and what it is worth."""
    found, true = user.map(sensor, case), truth(case, user.pad)
    t, force = found.traction(), found.resultant()
    away = force.value - case.force
    inside = np.abs(t - true) <= Z95 * found.std.reshape(-1, 3)
    under, normal = np.any(true != 0, axis=1), abs(case.force[2])
    alarms = seen = None
    shifted = np.nan
    if how == "at once" and shifted_too:
        rng = np.random.default_rng(round(1e9 * normal))
        motions = [case.motion + disturbed(rng, "shift", case.points)[0] for _ in range(DRAWS)]
        rest = [sensor.estimate(*user.seen(at_rest(rng, case)))]
        rest += [sensor.follow(*user.seen(at_rest(rng, case))) for _ in range(DRAWS - 1)]
        moved = [user.map(sensor, case, motions[0]), *(sensor.follow(*user.seen(case, m)) for m in motions[1:])]
        alarms, seen = (float(np.mean([_slipped(f) for f in frames])) for frames in (rest, moved))
        shifted = float(np.linalg.norm(moved[0].resultant().value - case.force) / normal)
    return Mapped(
        (f"{user.kind}, {how}", f"nu {case.nu}, {1e6 * case.noise:.0f} um", case.shape), np.abs(away) <= NEAR * normal,
        np.abs(away) <= Z95 * force.std, float(2 * Z95 * force.std[2] / normal), inside[under].mean(axis=0),
        float(inside[~under].mean()), _error(t, true), best,
        float(np.sum(t * true) / np.linalg.norm(t) / np.linalg.norm(true)) if t.any() else 0.0, alarms, seen, shifted,
        float(normal), frozenset(f.code.removeprefix("LID-") for f in found.flags),
    )  # fmt: skip


def at_rest(rng: np.random.Generator, case: Case) -> Case:
    """A frame of the same gel under no load."""
    depth = case.depth and (case.depth[2] * rng.standard_normal(case.depth[0].shape), *case.depth[1:])
    return replace(case, motion=case.noise * rng.standard_normal(case.motion.shape), depth=depth)


def _slipped(found: ForceMap) -> bool:
    return any(f.code.endswith("W611") for f in found.flags)


def run(
    problems: int, seed: int, error: str = "none", sensor: str | None = None, single: bool = False, **settings: Any
) -> Iterator[Mapped]:
    """Maps of presses, as many on each gel, by one kind of sensor or by all; settings are those of the sensors.

    `single` frames alone are three times cheaper: none at rest, none shifted, lambda from presses before.
    """
    nuisance = error if error in NUISANCES else "none"
    draw = partial(cases, truth="dome" if error == "dome" else "fe", gel=GELS[0])
    for which, (nu, noise) in enumerate(SETUPS):
        count = len(range(which, problems, len(SETUPS)))
        if not count:
            continue
        presses = list(draw(count, 10 * seed + which, nu=nu, noise=noise, nuisance=nuisance))
        before = list(draw(CALIBRATING, 10 * seed + which + 5000, nu=nu, noise=noise))
        pad = pad_of(presses[0], error)
        for kind in [sensor] if sensor else KINDS:
            user = User(kind, pad, presses[0], settings)
            frozen = user.calibrated(before)
            best = best_of(user, frozen, presses)
            for case, least in zip(presses, best, strict=True):
                yield held(user, frozen, case, least, "at once", shifted_too=not single)
            if not frozen.constrained and not single:
                open_ = user.sensor()
                for case, least in zip(presses, best, strict=True):
                    yield held(user, open_, case, least, "each")


def line(name: str, found: Sequence[Mapped], full: float) -> str:
    """One row of the table; `full` scale in N."""
    close, inside, covered = (np.array([getattr(m, a) for m in found]) for a in ("close", "inside", "covered"))
    right, ratio = close | inside, np.array([m.error / m.best for m in found])
    parts = [
        f"{name:22s} {len(found):4d}  ",
        *(f"{np.mean(a[:, 2]):5.0%} {np.mean(a[:, :2]):5.0%}  " for a in (close, inside, right)),
        f"{np.median([m.width for m in found]):6.2f}  {np.mean(covered):5.0%} ",
        *(f"{share:5.0%} " for share in covered.mean(axis=0)),
        f"{np.mean([m.beside for m in found]):5.0%}  {np.median([m.error for m in found]):5.2f} ",
        f"{np.median(ratio):5.2f} {np.quantile(ratio, 0.9):5.2f} {np.mean(ratio <= WORSE):5.0%} ",
        f"{np.median([m.cosine for m in found]):5.2f}",
    ]
    told = [m for m in found if m.found is not None]
    if told:
        parts.append(f"  {np.mean([m.alarms for m in told]):5.1%} {np.mean([m.found for m in told]):5.1%} "  # type: ignore[misc]
                     f"{np.median([m.shifted for m in told]):6.2f} "
                     f"{np.median([m.shifted * m.force for m in told]) / full:6.1%}")  # fmt: skip
    return "".join(parts)


HEADING = (
    f"{'':22s} {'n':>4s}   {'5 %':>5s} {'shear':>5s}   {'band':>4s} {'shear':>5s}  {'right':>5s} {'shear':>5s}  "
    f"{'width':>6s}  {'there':>5s} {'x':>5s} {'y':>5s} {'z':>5s} {'else':>5s}  {'map':>5s} {'/best':>5s} {'90 %':>5s} "
    f"{'1.3':>5s} {'cos':>5s}  {'alarm':>5s} {'found':>5s} {'moved':>6s} {'full':>6s}"
)


def each(found: Mapped) -> str:
    """One press, as the rows of the table; its own force is full scale."""
    kind, gel, shape = found.groups
    return line(f"{kind}, {gel}, {shape}", [found], found.force)


def table(found: Sequence[Mapped]) -> None:
    """Print a row for each sensor, and of those for each gel.

    Columns: forces within 5 % of the normal force, normal and shear; within their 95 % band; either; width of that band
    over the normal force (median); tractions under the press in their band, all and by component, and elsewhere; map
    error (median), over that at the best lambda (median, 90 %, and share up to `WORSE`); cosine; W611 in frames at
    rest, and in frames whose image is shifted, and the error of the force in these, over the force and over the largest
    normal force of the run.
    """
    print(HEADING)
    full = max(m.force for m in found)
    for kind in dict.fromkeys(m.groups[0] for m in found):
        of = [m for m in found if m.groups[0] == kind]
        print(line(kind, of, full))
        for gel in dict.fromkeys(m.groups[1] for m in of):
            print(line(f"   {gel}", [m for m in of if m.groups[1] == gel], full))
    for code in sorted({c for m in found for c in m.codes}):
        by = {k: np.mean([code in m.codes for m in found if m.groups[0] == k]) for k in
              dict.fromkeys(m.groups[0] for m in found)}  # fmt: skip
        print(f"{code}: " + ", ".join(f"{k} {v:.0%}" for k, v in by.items() if v))
