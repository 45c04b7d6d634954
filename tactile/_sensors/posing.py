"""How a sensor poses its problem: surface, who may be loaded, constraints, lambda, and the strain of its maps.

UPRE takes the noise of the unloaded camera for all there is. Where that level is far too low, or the errors of the mesh
are larger, its lambda is far too small; GCV does not ask for a level, and stands in wherever its lambda is larger.
With few markers, or axes of unequal noise, GCV in turn may smooth the load away. So its lambda does not count at the
end of the range, nor where its residual lies above a noise level that the data confirm; where they leave that open, the
discrepancy bounds it. Where both lie far below the discrepancy, they follow an error of the mesh: robust GCV decides.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from loadid._families import smoothness
from loadid._families.data import readings
from loadid._families.static import StaticInversion
from loadid._inverse import rules
from loadid._inverse.rules import RuleResult, Sweep, discrepancy_level
from loadid.constraints import Bounds, Constraint, FrictionCone, Resultant
from structures._channels import Channel
from structures._flags import Flag
from structures._models.arrays import MatrixModel
from structures.errors import InputError, plain

from .._arrays import Array, Index
from .._guards import LINEAR, large_strain
from .marked import ContactLaw
from .observation import Wrench
from .prior import ContactPrior

if TYPE_CHECKING:
    from loadid._families.frozen import Calibration
    from loadid._inverse.choice import Choice
    from loadid._results.estimate import LoadEstimate

    from .._pad.pad import Pad


AXES = "XYZ"
RESULTANTS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def of_pad(pad: Pad, kind: str = "hats") -> dict[str, Any]:
    """Geometry of the surface of a pad, for tractions (``"hats"``) or nodal forces (``"nodal"``)."""
    surface = pad.surface
    mass = surface.mass.tocsr()
    whole = wrenches(surface.coordinates, pad.top)
    if kind == "hats":
        whole = np.asarray((sparse.kron(mass, sparse.eye_array(3)).T @ whole.T).T)
    mass_arrays = {"mass_data": mass.data, "mass_indices": mass.indices, "mass_indptr": mass.indptr}
    return _geometry(surface.coordinates, surface.cells, kind, surface.areas, whole, pad.top) | mass_arrays


def of_points(places: Array, area: float, about: Any) -> dict[str, Any]:
    """Geometry of point forces on a grid, each with its share of the area."""
    areas = np.full(len(places), float(area))
    return _geometry(places, None, "nodal", areas, wrenches(places, about), about)


def _geometry(
    places: Array, cells: Index | None, kind: str, areas: Array, resultant: Array, about: Any
) -> dict[str, Any]:
    return {
        "coordinates": places,
        "cells": cells,
        "components": ["+X", "+Y", "+Z"],
        "kind": kind,
        "extents": None,
        "measures": areas,
        "resultant": resultant,
        "resultant_labels": list(RESULTANTS),
        "traction": None,
        "about": np.asarray(plain(about), float),
    }


def wrenches(places: Array, about: Any) -> Array:
    """Force and moment (6, 3 n) of unit forces at places (n, 3)."""
    arms = places - np.asarray(plain(about), float)
    out = np.zeros((6, len(places), 3))
    for k, unit in enumerate(np.eye(3)):
        out[k, :, k] = 1.0
        out[3:, :, k] = np.cross(arms, unit).T
    return out.reshape(6, -1)


def channels(points: int, kind: str) -> list[Channel]:
    """A load for each node and component."""
    quantity, unit = ("pressure", "Pa") if kind == "hats" else ("force", "N")
    return [Channel(label=f"n{i}+{a}", quantity=quantity, unit=unit) for i in range(points) for a in AXES]


def neighbours(cells: Index | None, places: Array) -> sparse.csr_array:
    """Which points share a cell; on a grid without cells, which lie within one and a half pitches."""
    count = len(places)
    if cells is not None:
        corners = np.asarray(cells)
        n = corners.shape[1]
        i, j = np.repeat(corners, n, axis=1).ravel(), np.tile(corners, (1, n)).ravel()
        return sparse.csr_array((np.ones(len(i), bool), (i, j)), shape=(count, count))
    from scipy.spatial import cKDTree

    tree = cKDTree(places[:, :2])
    pitch = float(np.median(tree.query(places[:, :2], k=2)[0][:, 1]))
    pairs = tree.query_pairs(1.5 * pitch, output_type="ndarray")
    i, j = np.vstack([pairs, pairs[:, ::-1]]).T
    return sparse.csr_array((np.ones(len(i), bool), (i, j)), shape=(count, count))


LIKE = 1.2  # by how much a peak may change until its ratio to the strain is found anew
GROWN = 3.0  # by how much it may grow, however recent that was: what came before may have been noise
REST = 120  # frames between two solves, at least: a solve costs as much as some maps


class StrainWatch:
    """Guard W112 over frames. Strain is linear in the load: maps of one shape need one solve.

    Presses far below the linear range need none: by the ratio of another shape they are below a third of it. A loop
    that no frame may hold up has its solves done `beside` it: W112 comes some frames after the press that it is of.
    """

    def __init__(self, pad: Pad) -> None:
        self.pad, self.beside = pad, False
        self._last = 0.0, 0.0, REST  # peak and ratio of the last solve, frames since: one value, for threads
        self._found: tuple[float, float] | None = None  # peak and ratio of a solve beside the loop

    def check(self, forces: Array) -> Flag | None:
        """W112 of nodal forces (P, 3) in N, if the pad is strained beyond the linear range."""
        peak = float(np.abs(forces).max(initial=0.0))
        if peak == 0:
            return None
        (known, ratio, rested), found = self._last, self._found
        if found is not None:
            (known, ratio), self._found = found, None
        rested += 1
        other = not known / LIKE < peak < known * LIKE
        near = ratio == 0 or GROWN * ratio * peak > LINEAR
        if near and ((other and rested > REST) or peak > GROWN * known):
            known, rested = peak, 0
            if self.beside and ratio:
                threading.Thread(target=self._find, args=(np.array(forces), peak), daemon=True).start()
            else:
                ratio = self._ratio(forces, peak)
        self._last = known, ratio, rested
        return large_strain(ratio * peak)

    def _ratio(self, forces: Array, peak: float) -> float:
        return float(np.abs(self.pad.strain(forces)).max()) / peak

    def _find(self, forces: Array, peak: float) -> None:
        self._found = peak, self._ratio(forces, peak)


RULES = ("upre", "gcv")
LAST = (*RULES, "robust_gcv", "discrepancy")  # the order in which they are asked where one cannot run
BELOW = 0.1  # of the lambda of the discrepancy, below which no rule that aims at the same noise can lie
END = 0.5  # relative lambda from which a rule has found nothing
SPARE = 0.3  # share of the data that a fit to the stated noise must leave free, if it is to confirm that level
CHANCE = 1e-2  # of a residual as far above the noise level as that of a lambda that does not count


def estimated(family: StaticInversion, found: Any) -> LoadEstimate:
    """Estimate of one frame or of several together; where no rule is set, by UPRE or GCV."""
    if family.choice is not None:
        return family.estimate(found)
    first, rule = _asked(family, found)
    assert first.choice is not None
    return first if rule == first.choice.rule else _with_rule(family, rule).estimate(found)


def calibrated(family: StaticInversion, records: Sequence[Any]) -> Calibration:
    """One lambda for all records; where no rule is set, by UPRE or GCV."""
    if family.choice is not None:
        return family.calibrate(records)
    rule = _asked(family, np.array(records))[1]
    family.calibration = _with_rule(family, rule).calibrate(records)
    return family.calibration


def chosen(choice: Choice, count: int) -> str:
    """Which rule to take of those that were asked, over `count` data of known noise."""
    asked = {rule.rule: rule for rule in choice.rules if rule.lam is not None}
    lam = {name: float(rule.lam or 0.0) for name, rule in asked.items()}
    if RULES[0] not in lam:
        return RULES[1]
    best = RULES[1] if lam[RULES[0]] < lam.get(RULES[1], 0.0) < END else RULES[0]
    met = lam.get("discrepancy")
    if met is None or asked["discrepancy"].edge:  # the stated noise is nowhere met
        return best
    if lam[best] < BELOW * met:  # both follow what is left of an error of the mesh
        return LAST[-2] if met < lam.get(LAST[-2], 1.0) < END else LAST[-1]
    if best == RULES[0] or lam[best] <= met or lam[RULES[0]] < BELOW * met:
        return best
    return _smooth(choice, count, met, lam[best])


def _smooth(choice: Choice, count: int, met: float, lam: float) -> str:
    """Which rule to take where GCV at `lam` leaves more than the stated noise, which is left at `met`."""
    sweep, sigma = choice.sweep, choice.sigma
    if sweep is None or sweep.edf is None or sigma is None:
        return RULES[1]
    at = np.log(sweep.lam)
    if count - np.interp(np.log(met), at, sweep.edf) < SPARE * count:
        return LAST[-1]  # the level is neither confirmed nor refuted: no more than what it leaves
    residual = float(np.interp(np.log(lam), at, sweep.residual_norm))
    return RULES[0] if residual**2 > discrepancy_level(count, sigma, 1 - CHANCE) else RULES[1]


def _asked(family: StaticInversion, found: Any) -> tuple[LoadEstimate, str]:
    """Estimate by the first rule that can run on these readings, and the rule to take."""
    for rule in LAST:
        try:
            first: LoadEstimate = _with_rule(family, rule).estimate(found)
        except InputError:
            if rule == LAST[-1]:
                raise
            continue
        assert first.choice is not None
        assert first.response is not None
        return first, chosen(first.choice, first.response.size) if rule == RULES[0] else rule
    raise AssertionError("a rule or its refusal")


THREE = ("upre", "gcv", "evidence")
APART = 2.0  # decades that no two of the three may lie apart, if they are to say anything together


def middle(sweep: Sweep) -> RuleResult:
    """The middle one of UPRE at the stated noise, GCV, and the evidence without a level: no two fail for one reason.

    UPRE errs where the noise level is wrong, GCV where few data are left or noise is correlated, the evidence where the
    load is unlike its prior.
    """
    free = replace(sweep, sigma=None)
    asked = [rules.run(name, free if name == "evidence" else sweep) for name in THREE]
    told = sorted(_inside(asked), key=lambda r: float(r.lam or 0.0))
    if not told:
        raise rules.Refusal("none of UPRE, GCV and the evidence finds a lambda")
    return replace(told[len(told) // 2], rule=middle.__name__)


def _apart(lams: list[float]) -> float:
    """Decades between the two of some lambdas that lie nearest to each other; none of a single one."""
    return float(np.diff(np.log10(np.sort(lams))).min(initial=np.inf)) if len(lams) > 1 else 0.0


def _inside(asked: Sequence[RuleResult]) -> list[RuleResult]:
    """Rules that found a lambda; those that ended at an edge of its range only where all did."""
    found = [r for r in asked if r.lam]
    return [r for r in found if not r.edge] or found


def chosen_on(family: StaticInversion, y: Array) -> Choice:
    """Lambda of readings (m,); where no rule is set, by the middle of three."""
    asked = family if family.choice is not None else _with_rule(family, middle)
    found = asked.choose(asked.pose(readings(y, family.model, family.sensors)))
    if family.choice is not None:
        return found
    asked_as = f"{middle.__module__}.{middle.__qualname__}"
    named = tuple(replace(r, rule=middle.__name__) if r.rule == asked_as else r for r in found.rules)
    return replace(found, rule=middle.__name__, rules=named)


def together(
    family: StaticInversion, records: Sequence[Array], off: Callable[[float], float] | None = None
) -> Calibration:
    """One lambda for readings (m,) of several frames; where no rule is set, by the middle of three.

    Where forces were measured beside them `off` says how far the resultants at a lambda are from these: the rule is
    taken that comes nearest.

    Raises
    ------
    InputError
        Rules that lie decades apart, and no measured force to tell which is right.
    """
    if family.choice is not None:
        return family.calibrate(records)
    asked = _with_rule(family, middle)
    found = asked.choose(asked.pose(readings(np.array(records), family.model, family.sensors)))
    lams = {r.rule: float(r.lam or 0.0) for r in _inside([r for r in found.rules if r.rule in THREE])}
    lam, rule = found.lam, middle.__name__
    if off is not None:
        rule = min(lams, key=lambda name: off(lams[name]))
        lam = lams[rule]
    elif all(r.edge for r in found.rules if r.rule in THREE and r.lam):
        raise InputError(
            "no rule for lambda finds an optimum in these frames", where="calibrate",
            found=f"{found.rule} at the end of its range, {found.lam:.2g}", expected="presses that move the markers",
            hint="press for calibration: unloaded frames are for zero()",
        )  # fmt: skip
    elif (decades := _apart(list(lams.values()))) > APART:
        raise InputError(
            "the rules for lambda lie decades apart on these presses", where="calibrate",
            found=", ".join(f"{name} {value:.2g}" for name, value in lams.items()) + f": {decades:.1f} decades",
            expected=f"two of UPRE, GCV and the evidence within {APART:g} decades",
            hint="give the forces of a force sensor or of weights (wrenches=), press harder, or set choice= to a rule",
        )  # fmt: skip
    return replace(asked.calibrate(list(records)), lam=lam, rule=rule)


def _with_rule(family: StaticInversion, rule: Any) -> StaticInversion:
    """The same family with a rule of its own: the one of the sensor, which threads may share, stays as it is."""
    other = copy(family)
    other.choice = rule
    return other


class PadModel(MatrixModel):
    """A transfer matrix on the surface of a pad, with the basis of its loads where there is one.

    `words` say what is pressed and read: a training set that was drawn for it says the same.
    """

    def __init__(
        self, H: Array, sensors: Sequence[Any], loads: Sequence[Any], basis: Any, flags: Sequence[Flag],
        words: str = "",
    ) -> None:  # fmt: skip
        super().__init__(H, sensors=sensors, loads=loads)
        self.basis, self.flags, self._words = basis, tuple(flags), words

    @property
    def described(self) -> str:
        """What is pressed and read, in words."""
        return self._words


def cut(penalty: Any, basis: Any, kept: Index) -> Any:
    """A penalty on the loads that may act."""
    if penalty is None or isinstance(penalty, ContactPrior) or (isinstance(penalty, str) and penalty == "identity"):
        return penalty
    if basis is None and isinstance(penalty, str):
        raise InputError(
            "this penalty needs to know which loads are neighbours", where="penalty", found=penalty,
            expected="'identity', or a matrix",
        )  # fmt: skip
    L: Any = smoothness.matrix(penalty, np.shape(penalty)[-1] if basis is None else len(basis), basis)
    dense = np.asarray(L.toarray() if hasattr(L, "toarray") else L)[:, kept]
    return dense[np.any(dense != 0, axis=1)]


WIDE = 100.0  # friction of a cone that only forbids pulling, where a surface is curved


def constraints(
    loads: int, contact: ContactLaw, resultant: Array, wrench: Wrench | None, normals: Array | None = None
) -> list[Constraint]:
    """Constraints of the static family: friction cones or pressures that are not negative, and a resultant.

    `normals` (P, 3) are those of a curved surface at the nodes that may be loaded; of a flat one it is Z.
    """
    triples = np.arange(loads).reshape(-1, 3)
    out: list[Constraint] = []
    if contact.friction is not None or (contact.no_pull and normals is not None):
        inward = np.tile([0.0, 0.0, -1.0], (len(triples), 1)) if normals is None else -normals
        out.append(FrictionCone(WIDE if contact.friction is None else contact.friction, triples, normals=inward))
    elif contact.no_pull:
        out.append(Bounds(upper=0.0, loads=triples[:, 2]))
    if wrench is not None:
        spread = None if wrench.std is None else wrench.std**2
        out.append(Resultant(resultant[: len(wrench.value)], wrench.value, covariance=spread))
    return out


def constrained(family: StaticInversion, found: list[Any]) -> StaticInversion:
    """The same family under constraints."""
    return family if not found else StaticInversion(family.model, constraints=found, **_settings(family))


def fewer(family: StaticInversion, sensors: list[str]) -> StaticInversion:
    """The same family on fewer sensors, at the same relative lambda."""
    other = StaticInversion(family.model, **{**_settings(family), "sensors": sensors})
    other.calibration = family.calibration
    return other


def resultant_covariance(posterior: Any, R: Array) -> Array:
    """Covariance (6, 6) of the resultant from variances of sums of its rows; zero where nothing is known."""
    if posterior is None:
        return np.zeros((6, 6))
    alone = np.array([float(posterior.variance(r)) for r in R])
    # rows of forces and moments differ in size: scaled, so that neither drowns the other
    size = np.sqrt(np.maximum(alone, 0.0))
    rows = R / np.where(size > 0, size, 1.0)[:, None]
    out = np.diag(alone)
    for i in range(6):
        for j in range(i):
            a, b = (float(posterior.variance(rows[i] + s * rows[j])) for s in (1, -1))
            out[i, j] = out[j, i] = (a - b) / 4 * size[i] * size[j]
    return out


def _settings(family: StaticInversion) -> dict[str, Any]:
    return {
        "penalty": family.penalty,
        "choice": family.choice,
        "noise": family.noise,
        "allow": list(family.allow),
        "sensors": family.sensors,
    }
