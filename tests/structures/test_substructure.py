"""Reduction to kept degrees of freedom: against the full model, within the bound that it states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from structures import ForwardModel, InputError, beams, damping, loads, plates, sensors
from structures._models import substructure
from structures._models.reduction import modes
from structures._models.substructure import lowest, reduce
from structures._system import dissection
from structures._system.factor import Factor

KEEP = ["116+Z", "40+Z", "100+Z"]
BAND = 400.0


def plate(edges="CFFF", loss=None):
    return plates.plate(lengths=(0.5, 0.4), thickness=0.003, material=beams.materials.steel, elements=(12, 10),
                        edges=edges, damping=damping.Structural(0.02) if loss is None else loss)  # fmt: skip


def answers(structure, f, **settings):
    S, B = [sensors.Displacement(k) for k in KEEP], [loads.Point(k) for k in KEEP[:2]]
    return ForwardModel(structure, S, B).frf(f, **settings)


@pytest.fixture(scope="module", params=["CFFF", "FFFF"])
def pair(request):
    """A plate, held and free, and what it answers to every line by a direct solve."""
    structure = plate(request.param)
    f = np.linspace(5.0, 395.0, 40)
    return structure, f, answers(structure, f, method="direct")


@pytest.mark.parametrize(("method", "worst"), [("modes", 1e-3), ("craig-bampton", 0.1)])
def test_the_error_stays_within_its_bound(pair, method, worst):
    structure, f, H = pair
    made = reduce(structure, KEEP, BAND, method=method)
    off = answers(made.structure, f) - H
    assert np.max(np.linalg.norm(off, axis=(1, 2)) / np.linalg.norm(H, axis=(1, 2))) < worst
    bound = made.error(f)
    assert np.all(np.abs(off) <= 1.001 * bound.bound[:, :, :2])
    if method == "modes":  # and says something: within a factor of ten on the median line
        assert np.median(bound.normwise) < 10 * np.median(
            np.linalg.norm(off, axis=(1, 2)) / np.linalg.norm(H, axis=(1, 2))
        )
    assert [str(d) for d in made.structure.dofs[:3]] == KEEP


def test_rigid_motions_and_frequencies_survive(pair):
    structure, _, _ = pair
    made = reduce(structure, KEEP, BAND)
    found, wanted = modes(made.structure), modes(structure, 12)
    assert found.rigid == wanted.rigid == np.sum(made.frequencies == 0)
    below = wanted.frequencies < BAND
    assert found.frequencies[: below.sum()] == pytest.approx(wanted.frequencies[below], rel=1e-9)


def test_a_damping_matrix_is_projected():
    rayleigh = damping.Rayleigh(5.0, 2e-6)
    structure = plate(loss=rayleigh)
    f = np.linspace(5.0, 395.0, 20)
    as_matrix = plate(loss=damping.Rayleigh(0.0, 0.0))
    as_matrix = type(structure)(as_matrix.K, as_matrix.M, rayleigh.matrix(as_matrix.K, as_matrix.M),
                                as_matrix.dofs, as_matrix.coordinates, as_matrix.supports)  # fmt: skip
    H = answers(structure, f, method="direct")
    for given in (structure, as_matrix):
        h = answers(reduce(given, KEEP, BAND).structure, f)
        assert np.linalg.norm(h - H) < 1e-3 * np.linalg.norm(H)


def test_block_lanczos_finds_every_mode_of_a_square_plate():
    """Double frequencies too."""
    structure = plates.plate(lengths=(0.4, 0.4), thickness=0.003, material=beams.materials.steel, elements=8)
    wanted = modes(structure, 20)
    top = wanted.lam[15] * 1.0001
    lam, phi = lowest(Factor(structure.K_free), structure.M_free, 0.0, top)
    assert lam == pytest.approx(wanted.lam[: len(lam)], rel=1e-8)
    assert len(lam) >= 17
    assert phi.T @ (structure.M_free @ phi) == pytest.approx(np.eye(len(lam)), abs=1e-8)


def test_dissection_orders_every_row_once_and_fills_in_less(monkeypatch):
    structure = plates.plate(lengths=(1.0, 1.0), thickness=0.003, material=beams.materials.steel, elements=40)
    monkeypatch.setattr(dissection, "LARGE", 1)
    order = dissection.elimination_of(structure).order
    assert np.sort(order).tolist() == list(range(structure.free.size))
    from scipy.sparse.linalg import splu

    K, options = structure.K_free.tocsc(), {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    natural = splu(K, permc_spec="NATURAL", **options).nnz
    assert splu(K[order][:, order].tocsc(), permc_spec="NATURAL", **options).nnz < 0.7 * natural
    b = np.random.default_rng(0).standard_normal((structure.free.size, 2))
    assert Factor(structure.K_free, structure=structure).solve(b) == pytest.approx(Factor(K).solve(b), rel=1e-6)


def bricks(*nodes):
    """Matrix and places of the nodes of trilinear bricks."""
    lines = [sparse.diags_array([np.ones(n - 1), np.ones(n), np.ones(n - 1)], offsets=[-1, 0, 1]) for n in nodes]
    near = sparse.kron(lines[2], sparse.kron(lines[1], lines[0]))
    A = sparse.kron(near, -np.ones((3, 3))) + 100 * sparse.eye_array(3 * near.shape[0])
    grid = np.meshgrid(*(np.arange(float(n)) for n in nodes[::-1]), indexing="ij")
    return A.tocsr(), np.repeat(np.column_stack([g.ravel() for g in grid[::-1]]), 3, axis=0)


@pytest.mark.parametrize("nodes", [(10, 10, 10), (24, 4, 4)])
def test_the_fill_is_known_before_it_is_made(nodes):
    from scipy.sparse.linalg import splu

    A, places = bricks(*nodes)
    found = dissection.dissected(A, places)
    options = {"permc_spec": "NATURAL", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    made = splu(A[found.order][:, found.order].tocsc(), **options).L.nnz
    assert made <= found.entries < 1.4 * made


def test_a_factor_beyond_the_memory_is_refused_before_it_is_begun(monkeypatch):
    structure, told = plate(), []
    monkeypatch.setattr(dissection, "LARGE", 1)
    monkeypatch.setattr(substructure, "machine_memory", lambda: 1e4)
    monkeypatch.setattr(substructure, "Factor", None)
    with pytest.raises(InputError, match=r"does not fit the memory(?s:.*)export a reduced model"):
        reduce(structure, KEEP, BAND, progress=told.append)
    assert "GB" in told[0]


def test_refusals():
    free, held = plate("FFFF"), plate()
    with pytest.raises(InputError, match="do not hold the structure"):
        reduce(free, ["100+Z"], BAND, method="craig-bampton")
    with pytest.raises(InputError, match="held cannot be kept"):
        reduce(held, [held.supports[0]], BAND)
    with pytest.raises(InputError, match="no such method"):
        reduce(held, KEEP, BAND, method="guyan")
    with pytest.raises(InputError, match="band must be positive"):
        reduce(held, KEEP, 0.0)
    with pytest.raises(InputError, match="no degree of freedom is kept"):
        reduce(held, [], BAND)


def test_families_take_the_reduced_model():
    """Truth by the full plate, four times the modes: histories and spectra of a load through the reduced one."""
    from loadid import Deconvolution, LoadTracker

    structure = plate(loss=damping.Rayleigh(20.0, 1e-5))
    S, B = [sensors.Accelerometer("116+Z"), sensors.Displacement("40+Z")], [loads.Point("100+Z")]
    small = ForwardModel(reduce(structure, ["116+Z", "40+Z", "100+Z"], 400.0).structure, S, B)
    dt, n = 5e-4, 200
    t = dt * np.arange(n)
    force = np.where((t > 0.01) & (t < 0.03), np.sin(np.pi * (t - 0.01) / 0.02) ** 2, 0.0)[:, None]
    y = ForwardModel(structure, S, B, modes=150).predict(force, dt)
    noise = 1e-3 * np.abs(y).max(axis=0)
    y = y + noise * np.random.default_rng(0).standard_normal(y.shape)
    found = Deconvolution(small, noise=noise).estimate(y, dt=dt)
    assert np.linalg.norm(found.load - force) < 0.1 * np.linalg.norm(force)
    tracked = LoadTracker(small, noise=noise).fit(y, dt=dt).smooth(y, dt)
    assert np.linalg.norm(tracked.load - force) < 0.2 * np.linalg.norm(force)
