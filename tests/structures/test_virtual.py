"""Virtual points against rigid bodies in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from structures import FrfModel
from structures._models import mapped as virtual
from structures.errors import InputError, NotIdentifiable

CORNERS = np.array([[0.1, 0.1, 0.0], [-0.1, 0.1, 0.02], [-0.1, -0.1, 0.0]])
POSITIONS = np.repeat(CORNERS, 3, axis=0)
DIRECTIONS = np.tile(np.eye(3), (3, 1))
CENTRE = np.array([0.02, -0.01, 0.05])


def test_motions_of_a_rigid_body_come_back() -> None:
    rng = np.random.default_rng(0)
    u, theta = rng.standard_normal((2, 3))
    moved = np.einsum("ij,ij->i", DIRECTIONS, u + np.cross(theta, POSITIONS - CENTRE))
    found = virtual.motions_of(POSITIONS, 3 * DIRECTIONS, CENTRE) @ moved
    assert np.allclose(found, np.r_[u, theta], atol=1e-12)


def test_forces_have_the_resultant_that_was_asked() -> None:
    T = virtual.loads_of(POSITIONS, DIRECTIONS, CENTRE)
    force = np.einsum("lk,lj->kj", T, DIRECTIONS)
    moment = np.einsum("lk,lj->kj", T, np.cross(POSITIONS - CENTRE, DIRECTIONS))
    assert np.allclose(np.concatenate([force, moment], axis=1), np.eye(6), atol=1e-12)


def test_a_free_rigid_body_has_its_closed_form_at_the_point() -> None:
    """Accelerance of a free body about its centre of mass: 1/m and 1/J, whatever forces stand around it."""
    mass, inertia = 2.0, np.array([0.01, 0.02, 0.03])
    R = virtual.rigid(POSITIONS, DIRECTIONS)
    H = R @ np.diag(1 / np.r_[mass, mass, mass, inertia]) @ R.T
    model = FrfModel.from_frf([10.0, 20.0], np.stack([H, H]).astype(complex), kind="accelerance",
                              variance=np.full((2, 9, 9), 1e-4))  # fmt: skip
    point = virtual.at_point(model, POSITIONS, DIRECTIONS)
    found = virtual.motions_of(POSITIONS, DIRECTIONS) @ point.frf([10.0])[0]
    assert np.allclose(found, np.diag(1 / np.r_[mass, mass, mass, inertia]), atol=1e-9)
    assert [c.label for c in point.loads] == [f"point+{m}" for m in virtual.MOTIONS]
    assert point.loads[-1].unit == "N*m"
    assert np.allclose(point.frf_variance([10.0])[0, 0], 1e-4 * np.sum(point.T**2, axis=0))


def test_motions_that_nothing_sees_are_named() -> None:
    with pytest.raises(NotIdentifiable, match="open: X, Y, RZ"):
        virtual.motions_of(POSITIONS[2::3], DIRECTIONS[2::3])
    with pytest.raises(InputError, match="no length"):
        virtual.rigid(POSITIONS, 0 * DIRECTIONS)
    with pytest.raises(InputError, match="do not fit"):
        virtual.rigid(POSITIONS, DIRECTIONS[:3])
