"""Interpolation against fields that it must carry exactly, its covariance against drawn noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import LinearNDInterpolator

from structures._flags import codes
from structures.errors import InputError
from tactile import Interpolation
from tactile.vision._images import grid
from tactile.vision._interpolation import fitted_weights


def scattered(seed: int = 0, count: int = 120) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.01, 0.01, (count, 2))


NODES = np.vstack([grid(15, 15, 0.0013), [[0.02, 0.0]]])  # the last is outside every hull


@pytest.mark.parametrize("kind", ["linear", "local"])
@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.integers(0, 1000), st.sampled_from([1e-6, 1.0, 1e6]))
def test_affine_fields_are_carried_exactly_and_quadratic_ones_by_the_local_fit(kind, seed: int, unit: float) -> None:
    rng = np.random.default_rng(seed)
    markers = unit * scattered(seed)
    terms = [np.ones, lambda p: p[:, 0] / unit, lambda p: p[:, 1] / unit]
    if kind == "local":
        terms += [lambda p: (p[:, 0] / unit) ** 2, lambda p: p[:, 0] * p[:, 1] / unit**2]
    c = rng.standard_normal((len(terms), 2))

    def field(p: np.ndarray) -> np.ndarray:
        return sum(
            np.outer(t(p) if t is not np.ones else np.ones(len(p)), row) for t, row in zip(terms, c, strict=True)
        )

    onto = Interpolation(markers, unit * NODES, kind)
    found = onto(field(markers))
    np.testing.assert_allclose(found[onto.inside], field(unit * NODES[onto.inside]), atol=1e-9)
    assert np.isnan(found[~onto.inside]).all()
    assert onto.inside.sum() > 100
    assert not onto.inside[-1]
    np.testing.assert_allclose(onto.W.sum(axis=1), onto.inside.astype(float), atol=1e-9)


@pytest.mark.parametrize("kind", ["linear", "local"])
def test_a_node_that_carries_a_marker_has_its_value(kind: str) -> None:
    markers, values = scattered(), np.random.default_rng(1).standard_normal((120, 2))
    onto = Interpolation(markers, np.vstack([markers[::3], NODES]), kind)
    np.testing.assert_allclose(onto(values)[:40], values[::3], atol=1e-9)
    np.testing.assert_allclose(onto.covariance(2.0).toarray()[:40, :40], 4 * np.eye(40), atol=1e-9)


def test_linear_is_that_of_scipy() -> None:
    markers, values = scattered(), np.random.default_rng(1).standard_normal((120, 2))
    expected = LinearNDInterpolator(markers, values)(NODES)
    np.testing.assert_allclose(Interpolation(markers, NODES)(values), expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["linear", "local"])
def test_the_covariance_is_that_of_drawn_noise(kind: str) -> None:
    rng, markers = np.random.default_rng(0), scattered(count=40)
    onto = Interpolation(markers, NODES[90:130], kind)
    root = rng.standard_normal((40, 2, 2))
    each = root @ root.transpose(0, 2, 1)
    noise = np.einsum("nij,tnj->tni", root, rng.standard_normal((20_000, 40, 2)))
    at_nodes = np.einsum("kn,tni->tki", onto.W.toarray(), noise)[:, onto.inside].reshape(20_000, -1)
    expected = np.cov(at_nodes.T)
    found = onto.covariance(each).toarray()
    rows = np.flatnonzero(np.repeat(onto.inside, 2))
    np.testing.assert_allclose(found[np.ix_(rows, rows)], expected, atol=0.05 * np.abs(expected).max())
    assert np.abs(found).sum() == pytest.approx(np.abs(found[np.ix_(rows, rows)]).sum())


def test_every_form_of_the_noise_means_the_same() -> None:
    markers, std = scattered(), np.random.default_rng(0).uniform(1, 2, 120)
    onto = Interpolation(markers, NODES)
    W = onto.W.toarray()
    np.testing.assert_allclose(onto.covariance(2.0).toarray(), 4 * W @ W.T, atol=1e-14)
    one = onto.covariance(std).toarray()
    np.testing.assert_allclose(one, (W * std**2) @ W.T, atol=1e-14)
    both = onto.covariance(np.column_stack([std, 3 * std])).toarray()
    np.testing.assert_allclose(both[::2, ::2], one, atol=1e-14)
    np.testing.assert_allclose(both[1::2, 1::2], 9 * one, atol=1e-13)
    assert np.abs(both[::2, 1::2]).max() == 0
    full = np.einsum("n,ij->nij", std**2, np.diag([1.0, 9.0]))
    np.testing.assert_allclose(onto.covariance(full).toarray(), both, atol=1e-13)


def test_lost_markers_are_left_out_and_cost_nothing_else() -> None:
    markers, rng = scattered(), np.random.default_rng(3)
    lost = rng.random(120) < 0.2
    values = rng.standard_normal((120, 2))
    values[lost] = np.nan
    onto = Interpolation(markers, NODES)
    found = onto(values)
    np.testing.assert_allclose(found, Interpolation(markers[~lost], NODES)(values[~lost]), atol=1e-13)
    reduced = onto.without(lost)
    assert reduced is onto.without(lost)  # the triangles are kept while the same markers are lost
    assert reduced.W[:, lost].nnz == 0
    assert onto.without(np.zeros(120, bool)) is onto
    assert reduced.covariance(1.0).diagonal()[reduced.inside].mean() > 0.4
    noise = np.where(lost, np.nan, 1.0)
    np.testing.assert_allclose(reduced.covariance(noise).toarray(), reduced.covariance(1.0).toarray())


def test_interpolated_noise_is_correlated_and_that_is_said() -> None:
    markers = grid(10, 10, 1e-3)
    fine = Interpolation(markers, grid(28, 28, 0.3e-3))
    effective, rank = fine.effective()
    C = fine.covariance(1.0).toarray()
    C /= np.sqrt(np.outer(C.diagonal(), C.diagonal()))
    assert effective == pytest.approx(np.trace(C) ** 2 / np.sum(C**2))
    assert rank == np.linalg.matrix_rank(C, hermitian=True)
    flag = fine.flag()
    assert flag is not None
    assert codes([flag]) == {"W605"}
    assert flag.evidence.value == pytest.approx(effective)
    assert Interpolation(markers, markers).flag() is None  # nodes on the markers: nothing is mixed


def test_a_node_on_the_hull_is_inside() -> None:
    onto = Interpolation(grid(3, 3, 1e-3), [[1e-3, 0.0], [1e-3, 1e-3], [1.0001e-3, 0.0]])
    assert onto.inside.tolist() == [True, True, False]


@pytest.mark.parametrize("kind", ["linear", "local"])
def test_three_markers_are_enough_and_two_are_not(kind: str) -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    np.testing.assert_allclose(Interpolation(corners, [[0.25, 0.5]], kind)([[0.0], [4.0], [2.0]]), [[2.0]], atol=1e-12)
    for markers in (corners[:2], np.vstack([corners[:2], [[np.nan, np.nan]]])):
        with pytest.raises(InputError, match="too few markers"):
            Interpolation(markers, [[0.25, 0.5]], kind)
    with pytest.raises(InputError, match="line"):
        Interpolation([[0, 0], [1, 1], [2, 2]], [[0.25, 0.5]], kind)


@pytest.mark.parametrize(
    "make",
    [
        lambda onto: Interpolation(onto.markers, NODES, "cubic"),
        lambda onto: Interpolation(onto.markers, [[np.nan, 0.0]]),
        lambda onto: Interpolation(onto.markers[:, :1], NODES),
        lambda onto: onto(np.zeros((3, 2))),
        lambda onto: onto.without([True]),
        lambda onto: onto.covariance(np.ones(3)),
        lambda onto: onto.covariance(-1.0),
        lambda onto: onto.covariance(np.nan),
        lambda onto: onto.effective(0.0),
    ],
)
def test_what_does_not_fit_is_refused(make) -> None:
    with pytest.raises(InputError):
        make(Interpolation(scattered(), NODES))


def test_markers_on_two_lines_carry_affine_fields_and_rows_still_sum_to_one() -> None:
    index, weights = fitted_weights(grid(2, 20, 1e-3), grid(3, 7, 0.3e-3))
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    markers = grid(2, 20, 1e-3)
    np.testing.assert_allclose((weights * markers[index, 0]).sum(axis=1), grid(3, 7, 0.3e-3)[:, 0], atol=1e-12)
    on_a_line = fitted_weights(grid(1, 20, 1e-3), grid(1, 3, 0.4e-3))[1]
    np.testing.assert_allclose(on_a_line.sum(axis=1), 1, atol=1e-12)
