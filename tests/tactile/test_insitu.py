"""E and nu from presses with a known force, in the sensor itself."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from structures.errors import InputError
from tactile import Markers, MultilayerPad, Pad, Press
from tactile.material import Gain, gain, poisson

from .rigs import NOISE, markers, motion, nodal, sensor

TRUE_E, TRUE_NU = 120e3, 0.45
PRESSES = [Press(radius=a, force=f, shear=(0.1 * f, 0.0)) for a, f in ((1.5e-3, 0.5), (2.2e-3, 1.0), (3e-3, 1.5))]


def body(nu: float, E: float, cells: tuple[int, int], layers: int) -> Pad:
    return Pad(size=(14e-3, 12e-3), thickness=3e-3, E=E, nu=nu, elements=cells, layers=layers)


@cache
def known() -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Motion and forces, on the mesh of the sensor: on another one its error is that of nu too (see the case study)."""
    fine, rng = body(TRUE_NU, TRUE_E, (14, 12), 4), np.random.default_rng(0)
    rows = fine.from_surface(markers())
    out, forces = [], []
    for press in PRESSES:
        f = fine.surface.forces(press.traction(fine.nodes2d))
        forces.append(f.sum(axis=0))
        U = fine.displacements(f)
        u = np.asarray(rows @ U.ravel()).reshape(-1, 3)
        out.append(u + 1e-6 * rng.standard_normal(u.shape))
    return tuple(out), np.array(forces)


def build(nu: float) -> MultilayerPad:
    return MultilayerPad(
        body(nu, 147e3, (14, 12), 4), Markers(markers(), 1e-6, "XYZ"), choice=0.003, penalty="identity"
    )


def test_a_modulus_is_a_gain() -> None:
    estimated = np.array([s.estimate(f * motion()).resultant().value for s in [sensor(1e-4)] for f in (0.5, 1.0, 2.0)])
    truth = 0.8 * np.outer([0.5, 1.0, 2.0], nodal().sum(axis=0))
    found = gain(147e3, estimated, truth)
    assert pytest.approx(0.8 * 147e3, rel=2e-3) == found.E
    assert found.residual < 2e-3
    assert not found.flags


def test_its_std_is_that_of_the_scatter() -> None:
    rng = np.random.default_rng(0)
    F = np.outer(np.linspace(0.5, 2.0, 12), [0.1, 0.0, -1.0])
    found = [gain(1e5, F, 1.1 * F * (1 + 0.03 * rng.standard_normal((12, 1)))) for _ in range(400)]
    assert np.mean([g.E for g in found]) == pytest.approx(1.1e5, rel=5e-3)
    assert np.std([g.E for g in found]) == pytest.approx(np.sqrt(np.mean([g.std**2 for g in found])), rel=0.2)


def test_an_implausible_modulus_is_questioned() -> None:
    found = gain(147e3, [[0.0, 0.0, -1.0]], [[0.0, 0.0, -1000.0]])
    assert [f.code for f in found.flags] == ["LID-W111"]
    assert found.std == np.inf


def test_nu_and_modulus_from_presses_of_several_sizes() -> None:
    found = poisson(build, [0.42, 0.44, 0.46, 0.48], *known())
    print(found)
    assert found.inside
    assert found.nu == pytest.approx(TRUE_NU, abs=0.004)
    assert pytest.approx(TRUE_E, rel=0.02) == found.gain.E


def test_a_minimum_outside_is_a_bound() -> None:
    found = poisson(build, [0.25, 0.28, 0.31, 0.34], known()[0][:1], known()[1][:1])
    assert not found.inside
    assert "bound" in str(found)


@pytest.mark.parametrize(
    ("estimated", "measured"),
    [([[1.0]], [[1.0], [2.0]]), ([[np.nan]], [[1.0]]), ([[0.0]], [[1.0]]), ([[1.0]], [[-1.0]]), ([], [])],
)
def test_forces_that_do_not_fit(estimated: list, measured: list) -> None:
    with pytest.raises(InputError):
        gain(1e5, estimated, measured)


def test_too_few_values() -> None:
    with pytest.raises(InputError, match="four"):
        poisson(build, [0.4, 0.45], *known())


def test_a_gain_speaks() -> None:
    assert "Pa" in str(Gain(1e5, 1e3, 1.02, 0.01))
    assert NOISE > 0
