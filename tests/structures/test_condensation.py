"""Condensation onto chosen DOFs: stiffness, compliance, the check of a poor factor."""

import numpy as np
import pytest
from scipy import sparse

from structures import InputError, NotIdentifiable, plates, solids
from structures import factor as c
from structures import factor as f
from structures._elements.members import Material, steel
from structures._system.factor import Factor, compliance, mirrored


@pytest.fixture(scope="module")
def pad():
    return solids.block(lengths=(0.02, 0.02, 4e-3), elements=(5, 4, 2), material=Material(E=1.0, rho=1.0, nu=0.48))


def flexibility(K, dofs):
    return np.linalg.solve(K.toarray(), np.eye(K.shape[0]))[np.ix_(dofs, dofs)]


def top(structure):
    nodes = structure.field.surface("top").nodes
    return np.searchsorted(structure.free, (3 * nodes[:, None] + np.arange(3)).ravel())


def test_both_ways_to_a_compliance_agree_with_a_dense_solver(pad, monkeypatch):
    K, dofs = pad.K_free, top(pad)
    exact = flexibility(K, dofs)
    found = []
    for share in (0.0, 2.0):  # condensed, and one solve for each
        monkeypatch.setattr(f, "DENSE_SHARE", share)
        factor = Factor(K)
        found.append(factor.compliance(dofs))
        assert factor.solves == len(dofs)
    for A in found:
        assert np.array_equal(A, A.T)
        assert np.abs(A - exact).max() < 1e-12 * np.abs(exact).max()


def test_a_transfer_between_many_dofs_of_a_surface_is_condensed(pad, monkeypatch):
    monkeypatch.setattr(f, "MANY", 10)
    K, dofs, rng = pad.K_free, top(pad), np.random.default_rng(3)
    S, B = (
        sparse.csr_array(
            (np.ones(len(dofs)), (np.arange(len(dofs)), rng.permutation(dofs))), shape=(len(dofs), K.shape[0])
        )
        for _ in range(2)
    )
    used = []
    monkeypatch.setattr(
        Factor, "compliance", lambda self, d, real=Factor.compliance: used.append(len(d)) or real(self, d)
    )
    H = Factor(K).transfer(S, 2 * B.T)
    exact = S @ np.linalg.solve(K.toarray(), 2 * B.T.toarray())
    assert used == [len(dofs)]
    assert np.abs(H - exact).max() < 1e-11 * np.abs(exact).max()
    indefinite = sparse.csc_array(K - 0.5 * sparse.diags_array(K.diagonal()))
    H = Factor(indefinite).transfer(S, B.T)
    exact = S @ np.linalg.solve(indefinite.toarray(), B.T.toarray())
    assert np.abs(H - exact).max() < 1e-6 * np.abs(exact).max()


def test_order_and_choice_of_dofs_are_kept(pad):
    K, rng = pad.K_free, np.random.default_rng(0)
    for count in (1, 2, 30, K.shape[0]):
        dofs = rng.permutation(K.shape[0])[:count]
        exact = flexibility(K, dofs)
        assert np.abs(Factor(K).compliance(dofs) - exact).max() < 1e-11 * np.abs(exact).max()


def test_stiffness_and_compliance_at_once(pad):
    dofs = top(pad)
    stiffness = Factor(pad.K_free).condense(dofs)
    identity = stiffness @ compliance(stiffness.copy(order="F"))
    assert np.abs(identity - np.eye(len(dofs))).max() < 1e-10
    # F = Kbar U: the forces that hold a rigid shift of the whole top are those of the structure
    u = np.zeros(pad.n)
    u[pad.free[dofs]] = np.tile([0, 0, 1.0], len(dofs) // 3)
    force = stiffness @ u[pad.free[dofs]]
    full = np.linalg.solve(pad.K_free.toarray(), np.eye(pad.free.size)[:, dofs] @ force)
    assert full[dofs] == pytest.approx(u[pad.free[dofs]], abs=1e-9)


def test_a_poor_factor_is_found_and_mended(pad):
    """An unpivoted factor may lose digits: the random combination sees it, and refinement puts it right."""
    K, s = pad.K_free, top(pad)
    exact = Factor(K).condense(s)

    class Poor(Factor):
        def _apply(self, B):
            return super()._apply(B) * (1 + 1e-5)

    mended = c.schur(K, s, lambda inner: Poor(inner))
    assert np.abs(mended - exact).max() < 1e-9 * np.abs(exact).max()
    assert np.abs(exact - exact.T).max() == 0


def test_complex_stiffness_keeps_its_plain_transpose(pad):
    K, dofs = sparse.csc_array(pad.K_free * (1 + 0.1j)), top(pad)[:7]
    exact = flexibility(K, dofs)
    assert np.abs(Factor(K).compliance(dofs) - exact).max() < 1e-11 * np.abs(exact).max()


@pytest.mark.parametrize("n", [1, 5, 512, 1100])
def test_mirrored_copies_the_lower_triangle(n):
    A = np.random.default_rng(n).standard_normal((n, n))
    lower = np.tril(A)
    assert np.array_equal(mirrored(A), lower + np.tril(A, -1).T)


def test_what_has_no_compliance_is_refused():
    K = plates.plate(lengths=(0.5, 0.4), thickness=3e-3, material=steel, elements=(4, 4), edges="CFFF").K_free
    with pytest.raises(InputError, match="not positive definite"):
        Factor(K - 10 * sparse.diags_array(K.diagonal()), check=False).compliance(np.arange(K.shape[0]))
    free = plates.plate(lengths=(0.5, 0.4), thickness=3e-3, material=steel, elements=(4, 4), edges="FFFF").K_free
    with pytest.raises(NotIdentifiable):
        Factor(free).condense([0, 4, 8])
    for dofs in ([0, 0], [-1], [10_000], [], [0.5]):
        with pytest.raises(InputError, match="compliance"):
            Factor(K).compliance(dofs)
