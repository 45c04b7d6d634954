import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from structures.damping import Modal, Rayleigh
from structures.errors import InputError
from structures.structure import Structure

from .kinds import EVERY


@given(st.floats(0.1, 1e4), st.floats(1.01, 100), st.floats(1e-4, 0.5), st.floats(0, 1))
def test_rayleigh_reproduces_the_two_ratios(f1, spread, z1, share):
    f2 = f1 * spread
    z2 = min(z1 * (1 / spread + share * (spread - 1 / spread)), 0.99)
    damping = Rayleigh.from_ratios(f1, z1, f2, z2)
    omega = 2 * np.pi * np.array([f1, f2])
    assert damping.ratio(omega) == pytest.approx([z1, z2], rel=1e-7, abs=1e-12)
    assert damping.coefficient(omega) == pytest.approx(2 * damping.ratio(omega) * omega)
    assert Rayleigh.from_ratios(f2, z2, f1, z1) == damping


def test_equal_ratios_have_the_closed_form_and_its_minimum():
    z, w1, w2 = 0.02, 2 * np.pi * 10, 2 * np.pi * 90
    damping = Rayleigh.from_ratios(10, z, 90, z)
    assert damping.alpha == pytest.approx(2 * z * w1 * w2 / (w1 + w2))
    assert damping.beta == pytest.approx(2 * z / (w1 + w2))
    omega = np.linspace(w1, w2, 20001)
    assert damping.ratio(omega).min() == pytest.approx(2 * z * np.sqrt(w1 * w2) / (w1 + w2), rel=1e-7)


@pytest.mark.parametrize(("z1", "z2", "name"), [(0.001, 0.05, "alpha"), (0.2, 0.01, "beta")])
def test_impossible_ratios_are_refused_and_named(z1, z2, name):
    with pytest.raises(InputError, match=f"ratios {z1} at 10 Hz and {z2} at 30 Hz make {name} negative"):
        Rayleigh.from_ratios(10, z1, 30, z2)


@pytest.mark.parametrize(
    "bad",
    [lambda: Rayleigh(-1.0, 0.0), lambda: Rayleigh(0.0, np.nan), lambda: Rayleigh.from_ratios(5, 0.01, 5, 0.02),
     lambda: Rayleigh.from_ratios(0, 0.01, 5, 0.02), lambda: Rayleigh.from_ratios(1, 2.0, 5, 2.0), lambda: Modal(2.0),
     lambda: Modal(np.nan), lambda: Modal([]), lambda: Modal([0.01, -0.01]), lambda: Rayleigh(1, 1).ratio(0.0)],
)  # fmt: skip
def test_bad_damping_raises(bad):
    with pytest.raises(InputError):
        bad()


def test_rayleigh_matrix_has_the_modal_ratios():
    structure = EVERY["shear building"]().with_damping(Rayleigh(0.3, 2e-3))
    import scipy.linalg

    w2, X = scipy.linalg.eigh(structure.K_free.toarray(), structure.M_free.toarray())
    C = X.T @ structure.C_free @ X
    assert np.diag(C) == pytest.approx(structure.damping.coefficient(np.sqrt(w2)))
    assert np.abs(C - np.diag(np.diag(C))).max() < 1e-9 * np.abs(C).max()


def test_modal_ratios_are_kept_above_the_last_one():
    omega = np.array([1.0, 2.0, 5.0])
    assert Modal(0.01).coefficient(omega) == pytest.approx(0.02 * omega)
    assert Modal([0.01, 0.03]).ratio(omega) == pytest.approx([0.01, 0.03, 0.03])
    assert hash(Modal(np.array([0.01, 0.02]))) == hash(Modal([0.01, 0.02]))


def test_scaling_multiplies_the_damping():
    assert Rayleigh(1.0, 2.0).scaled(3.0) == Rayleigh(3.0, 6.0)
    assert Modal([0.01, 0.02]).scaled(2.0) == Modal([0.02, 0.04])


def test_dashpots_and_rayleigh_add_but_modal_ratios_replace():
    chain = EVERY["chain fixed-free"]()
    both = chain.with_damping(Rayleigh(0.5, 0.0))
    assert np.allclose((both.C_free - chain.C_free).toarray(), 0.5 * chain.M_free.toarray())
    with pytest.raises(InputError, match="modal ratios at once"):
        chain.with_damping(Modal(0.01))
    beam = EVERY["beam clamped-free"]().with_damping(Modal(0.01))
    assert beam.C_free is None
    with pytest.raises(InputError, match="mass matrix"):
        Structure.from_matrices([[1.0]], damping=Rayleigh(1.0, 0.0))
