"""E, nu and thickness from presses of known force, on gels of other finite elements (`case_studies.bodies`)."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from case_studies.bodies import Patch, surfaces
from structures.errors import InputError
from tactile import DepthMap, Markers, MultilayerPad, Pad, Tolerances, material

SIZE, THICKNESS, E, NU, NOISE = (14e-3, 12e-3), 3e-3, 120e3, 0.45, 3e-6
DECLARED = {"E": 147e3, "nu": 0.43, "thickness": 3.15e-3}
PRIOR = Tolerances(E=0.3, nu=0.05, thickness=0.08)
TRUE = np.array([np.log(E), NU, np.log(THICKNESS)])
BALLS = ((1.2e-3, 0.06, (-1e-3, 0.4e-3)), (2e-3, 0.15, (0.7e-3, -0.6e-3)), (1.6e-3, 0.1, (1.4e-3, 1e-3)),
         (2.2e-3, 0.2, (-0.6e-3, -0.9e-3)))  # fmt: skip  # radius of contact (m), force (N), place (m)
POINTS = np.stack(np.meshgrid(np.arange(-6e-3, 6.1e-3, 1e-3), np.arange(-5e-3, 5.1e-3, 1e-3)), axis=-1).reshape(-1, 2)


@cache
def truth() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motion of the markers, of pixels of 0.25 mm, and forces."""
    presses = [(Patch("round", at, (a, a), 0.0, (0.2 * f, 0.1 * f, -f)),) for a, f, at in BALLS]
    x, y = ((np.arange(4e3 * s) - 2e3 * s + 0.5) * 0.25e-3 for s in SIZE)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    found = surfaces(presses, "fe", SIZE, THICKNESS, NU)
    motion = np.array([u(POINTS) for u in found]) / E
    depth = np.array([u(grid.reshape(-1, 2))[:, 2].reshape(grid.shape[:2]) for u in found]) / E
    return motion, depth, np.array([p[0].force for p in presses])


def declared(**changed: Any) -> Pad:
    return Pad(size=SIZE, elements=(16, 14), **{**DECLARED, **changed})


def fitted(pad: Pad, seed: int, *, deep: bool = True, prior: Tolerances = PRIOR, held: int = 1) -> material.InSitu:
    rng = np.random.default_rng(seed)
    motion, depth, F = truth()
    frames = (motion + NOISE * rng.standard_normal(motion.shape))[..., :2]
    maps = [DepthMap(d + 5e-6 * rng.standard_normal(d.shape), 0.25e-3, 5e-6) for d in depth]

    def build(pad: Pad) -> MultilayerPad:
        return MultilayerPad(pad, Markers(POINTS, NOISE), depth=maps[0] if deep else None, choice=0.05)

    F = F + 0.002 * rng.standard_normal(F.shape)
    return material.in_situ(build, pad, list(frames), F, depths=maps if deep else None, prior=prior, held=held)


@cache
def known() -> material.InSitu:
    """With a depth map, of a gel that was declared wrong."""
    return fitted(declared(), 0)


def away(found: material.InSitu) -> np.ndarray:
    """Errors of log E, nu, log thickness over their std."""
    at = np.array([np.log(found.pad.E), found.pad.nu, np.log(found.pad.thickness)])
    std = np.sqrt(np.diag(found.covariance))
    return np.divide(at - TRUE, std, out=np.zeros(3), where=std > 0)


def test_a_gel_that_was_declared_wrong_is_found() -> None:
    found = known()
    print(found)
    assert pytest.approx(E, rel=0.06) == found.pad.E
    assert found.pad.nu == pytest.approx(NU, abs=0.01)
    assert found.pad.thickness == pytest.approx(THICKNESS, rel=0.04)
    assert found.contacts[:, 2] == pytest.approx([a for a, *_ in BALLS[:3]], rel=0.1)
    assert found.told == ("E", "nu", "thickness")
    assert "W117" not in {f.code.removeprefix("LID-") for f in found.flags}
    assert np.all(np.abs(away(found)) < 3)
    assert "motion within" in str(found)


def test_what_is_declared_as_known_is_kept() -> None:
    found = fitted(declared(nu=NU, thickness=THICKNESS), 1, deep=False, prior=Tolerances(E=0.3))
    assert (found.pad.nu, found.pad.thickness, found.std.nu, found.std.thickness) == (NU, THICKNESS, 0, 0)
    assert found.told == ("E",)
    assert found.std.E < 0.1
    assert np.abs(away(found)[0]) < 3


def test_motion_in_the_plane_leaves_more_open() -> None:
    flat, deep = fitted(declared(), 0, deep=False), known()
    assert flat.std.nu > 2 * deep.std.nu
    assert flat.std.thickness <= PRIOR.thickness
    assert np.all(np.abs(away(flat)) < 3)


def test_a_gel_that_is_no_such_pad_is_said() -> None:
    found = fitted(declared(E=1.5 * E, nu=NU, thickness=THICKNESS), 3, prior=Tolerances(thickness=0.01))
    assert "W117" in {f.code.removeprefix("LID-") for f in found.flags}


def test_presses_that_do_not_fit_are_refused() -> None:
    pad, motion = declared(), truth()[0]

    def build(pad: Pad) -> MultilayerPad:
        return MultilayerPad(pad, Markers(POINTS, NOISE), choice=0.05)

    with pytest.raises(InputError, match="forces do not fit"):
        material.in_situ(build, pad, list(motion), np.zeros((4, 3)))
    with pytest.raises(InputError, match="no press is left"):
        material.in_situ(build, pad, list(motion), truth()[2], held=4)


def test_tolerances_are_stds() -> None:
    assert Tolerances(E=0.1) == Tolerances(0.1, 0.0, 0.0)
    for name, value in (("E", -0.1), ("nu", 0.6), ("thickness", 2.0), ("E", np.nan)):
        with pytest.raises(InputError, match="Tolerances"):
            Tolerances(**{name: value})
