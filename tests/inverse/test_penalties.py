"""Penalties against their definitions, in time and over frequency."""

import math
from functools import partial

import numpy as np
import pytest
import scipy.spatial

from loadid._inverse import penalties
from structures.errors import InputError

from . import reference


@pytest.mark.parametrize("name", ["first_difference", "second_difference"])
@pytest.mark.parametrize("samples", [3, 4, 11])
def test_matrix_is_the_difference_of_each_load_in_time(name: str, samples: int) -> None:
    L = penalties.matrix(name, samples, loads=3)
    g = np.random.default_rng(1).standard_normal((samples, 3))
    expected = np.diff(g, n=1 if name == "first_difference" else 2, axis=0)
    assert L is not None
    np.testing.assert_allclose((L @ g.ravel()).reshape(-1, 3), expected, atol=1e-14)
    np.testing.assert_allclose(penalties.matrix(name, samples), reference.penalty(name, samples), atol=0)


def test_identity_needs_no_matrix_and_names_have_synonyms() -> None:
    assert penalties.matrix("identity", 7) is None
    np.testing.assert_array_equal(penalties.matrix("gradient", 7), penalties.matrix("first_difference", 7))
    np.testing.assert_array_equal(penalties.matrix("laplacian", 7), penalties.matrix("second_difference", 7))


@pytest.mark.parametrize(("name", "stencil"), [("identity", [1]), ("gradient", [1, -1]), ("laplacian", [1, -2, 1])])
def test_symbol_is_the_transform_of_the_stencil(name: str, stencil: list[float]) -> None:
    padded = 30
    theta = 2 * np.pi * np.arange(padded // 2 + 1) / padded
    np.testing.assert_allclose(penalties.symbol(name, theta), np.abs(np.fft.rfft(stencil, padded)), atol=1e-14)


@pytest.mark.parametrize("order", range(6))
def test_difference_of_any_order(order: int) -> None:
    """Binomial coefficients of both signs, and polynomials below the order are free."""
    expected = [(-1) ** (order - k) * math.comb(order, k) for k in range(order + 1)]
    np.testing.assert_array_equal(penalties.stencil(order), expected)
    L, t = penalties.difference(12, order), np.linspace(-1, 1, 12)
    assert L.shape == (12 - order, 12)
    assert np.linalg.matrix_rank(L) == 12 - order
    np.testing.assert_allclose(L @ np.vander(t, order), 0, atol=1e-12)


@pytest.mark.parametrize(
    "wrong", ["ridge", np.eye(4), np.full((2, 6), np.nan), np.ones((2, 6)) * np.inf, np.ones((2, 2, 6))]
)
def test_what_is_no_penalty_is_refused(wrong: object) -> None:
    with pytest.raises(InputError, match="penalty"):
        penalties.matrix(wrong, 3, loads=2)


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(InputError, match="too few samples"):
        penalties.matrix("second_difference", 2)


def test_a_vector_of_weights_is_no_matrix() -> None:
    with pytest.raises(InputError, match=r"np\.diag\(w\)"):
        penalties.matrix(np.ones(6), 3, 2)
    assert penalties.matrix(np.ones((1, 6)), 3, 2).shape == (1, 6)
    assert penalties.matrix(np.diag(np.ones(6)), 3, 2).shape == (6, 6)


# -- over places -----------------------------------------------------------------------------------------------------
RNG = np.random.default_rng(6)
X, Z = np.cumsum(RNG.uniform(0.5, 1.5, 7)), np.cumsum(RNG.uniform(0.2, 0.6, 5))  # uneven axes of a grid


def quads(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (last axis fastest) and quadrilaterals of a rectangular mesh."""
    places = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    i = np.arange(len(places)).reshape(len(x), len(z))
    return places, np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 4)


def halves(cells: np.ndarray) -> np.ndarray:
    return np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])


def cloud(n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Unstructured triangles over the unit square."""
    places = np.concatenate([RNG.uniform(0, 1, (n, 2)), [(0, 0), (0, 1), (1, 0), (1, 1)]])
    return places, scipy.spatial.Delaunay(places).simplices


def meshes() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Flat meshes of triangles, rectangles and skew quadrilaterals."""
    places, cells = quads(X, Z)
    skew = places + 0.06 * RNG.standard_normal(places.shape)
    return {
        "cloud": cloud(),
        "triangles": (places, halves(cells)),
        "rectangles": (places, cells),
        "skew": (skew, cells),
    }


MESHES = meshes()
SURFACES = {
    **{
        f"{mesh} {kind}": partial(penalties.surface, *MESHES[mesh], kind)
        for mesh in MESHES
        for kind in (1, "laplacian")
    },
    "grid gradient": partial(penalties.grid, (4, 3, 5), "gradient", (0.3, [1.0, 2.0], 0.1)),
    "grid laplacian": partial(penalties.grid, (4, 3, 5), "laplacian", (0.3, [1.0, 2.0], 0.1)),
    "line 1": partial(penalties.line, 9, 1, np.arange(1.0, 9)),
    "line 2": partial(penalties.line, 9, 2, np.arange(1.0, 9)),
    "graph": partial(penalties.graph, 5, [(0, 1), (1, 2), (4, 2), (3, 2)], [1.0, 2.0, 3.0, 4.0]),
    "graph laplacian": partial(penalties.graph, 5, [(0, 1), (1, 2), (4, 2), (3, 2)], kind="laplacian"),
}


@pytest.mark.parametrize("name", SURFACES)
def test_constants_cost_nothing(name: str) -> None:
    L = SURFACES[name]()
    assert np.abs(L @ np.ones(L.shape[1])).max() < 1e-12 * np.abs(L).max()
    assert np.linalg.matrix_rank(L.toarray()) == L.shape[1] - (2 if name == "line 2" else 1)  # and nothing else does


def test_line_is_the_plain_difference_at_spacing_one() -> None:
    for order, name in ((1, "first_difference"), (2, "second_difference"), ("gradient", "gradient")):
        np.testing.assert_allclose(penalties.line(8, order).toarray(), penalties.matrix(name, 8), atol=1e-14)
    np.testing.assert_allclose(penalties.grid((8,), "laplacian").toarray(), penalties.line(8, 2).toarray())


def test_line_is_exact_where_it_should_be() -> None:
    x = np.cumsum(RNG.uniform(0.1, 2, 30))
    second = penalties.line(30, 2, np.diff(x))
    np.testing.assert_allclose(second @ (3 * x - 7), 0, atol=1e-10)
    # a parabola has the second derivative 2 everywhere, whatever the spacing
    inner = (x[-1] + x[-2] - x[1] - x[0]) / 2
    assert np.sum((second @ x**2) ** 2) == pytest.approx(4 * inner, rel=1e-9)
    assert np.sum((penalties.line(30, 1, np.diff(x)) @ x) ** 2) == pytest.approx(x[-1] - x[0], rel=1e-12)


def test_integrals_over_a_line_converge() -> None:
    for order, exact in ((1, np.pi**2 / 2), (2, np.pi**4 / 2)):
        error = []
        for n in (41, 81):
            x = np.linspace(0, 1, n) ** 1.3
            error.append(abs(np.sum((penalties.line(n, order, np.diff(x)) @ np.cos(np.pi * x)) ** 2) / exact - 1))
        assert error[1] < 0.5 * error[0] < 0.05


@pytest.mark.parametrize("mesh", MESHES)
def test_gradient_of_a_linear_field_is_exact(mesh: str) -> None:
    places, cells = MESHES[mesh]
    corners = places[cells] - places[cells].mean(axis=1, keepdims=True)
    turned = np.roll(corners, -1, axis=1)
    area = np.abs(np.sum(corners[..., 0] * turned[..., 1] - corners[..., 1] * turned[..., 0], axis=1)).sum() / 2
    L = penalties.surface(places, cells, "gradient")
    assert np.sum((L @ (places @ [3.0, -4.0])) ** 2) == pytest.approx(25 * area, rel=1e-12)
    assert L.shape[0] == len(cells) * (2 if cells.shape[1] == 3 else 3)


@pytest.mark.parametrize("mesh", MESHES)
def test_linear_fields_have_no_laplacian_in_the_interior(mesh: str) -> None:
    places, cells = MESHES[mesh]
    L = penalties.surface(places, cells, "laplacian")
    edges = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    found, count = np.unique(edges, axis=0, return_counts=True)
    interior = np.setdiff1d(np.arange(len(places)), found[count == 1])
    assert len(interior) > 10
    slope = np.abs(L @ (places @ [1.0, 2.0]))
    assert slope[interior].max() < 1e-11 * np.abs(L).max()
    assert slope.max() > 0.01  # at the edge, a slope across it costs


def test_cotangent_formula() -> None:
    """Stiffness: half the cotangents opposite to each edge. Mass: a third of the areas around."""
    places, cells = MESHES["cloud"]
    K, mass = np.zeros((len(places), len(places))), np.zeros(len(places))
    for cell in cells:
        for k in range(3):
            i, j, o = cell[k], cell[(k + 1) % 3], cell[(k + 2) % 3]
            a, b = places[i] - places[o], places[j] - places[o]
            cot = a @ b / abs(a[0] * b[1] - a[1] * b[0])
            K[i, j] -= cot / 2
            K[j, i] -= cot / 2
            mass[o] += abs(a[0] * b[1] - a[1] * b[0]) / 6
    K -= np.diag(K.sum(axis=1))
    gradient = penalties.surface(places, cells).toarray()
    np.testing.assert_allclose(gradient.T @ gradient, K, atol=1e-10 * np.abs(K).max())
    laplacian = penalties.surface(places, cells, "laplacian").toarray()
    np.testing.assert_allclose(laplacian, K / np.sqrt(mass)[:, None], atol=1e-10 * np.abs(laplacian).max())


@pytest.mark.parametrize("shape", ["triangles", "quads"])
@pytest.mark.parametrize("kind", ["gradient", "laplacian"])
def test_integrals_over_a_surface_converge(kind: str, shape: str) -> None:
    """cos(pi x) cos(pi z / 2) on [0, 1] x [0, 2]: no slope across the edge."""
    total = np.pi**2 + np.pi**2 / 4
    exact, error = (total / 2 if kind == "gradient" else total**2 / 2), []
    for n in (10, 20, 40):
        places, cells = quads(np.linspace(0, 1, n + 1), np.linspace(0, 2, n + 4))
        g = np.cos(np.pi * places[:, 0]) * np.cos(np.pi * places[:, 1] / 2)
        L = penalties.surface(places, cells if shape == "quads" else halves(cells), kind)
        error.append(abs(np.sum((L @ g) ** 2) / exact - 1))
    assert error[0] / error[1] == pytest.approx(4, rel=0.15)  # second order
    assert error[1] / error[2] == pytest.approx(4, rel=0.08)


@pytest.mark.parametrize("kind", ["gradient", "laplacian"])
def test_a_sphere_has_the_eigenvalues_of_its_harmonics(kind: str) -> None:
    """On the unit sphere a harmonic of degree l has |grad|^2 = l (l + 1) |Y|^2 and Laplacian -l (l + 1) Y."""
    rng = np.random.default_rng(2)
    places = rng.standard_normal((3000, 3))
    places /= np.linalg.norm(places, axis=1)[:, None]
    for _ in range(10):  # spread the points a little
        near = scipy.spatial.cKDTree(places).query(places, 7)[1][:, 1:]
        places += 0.3 * (places - places[near].mean(axis=1))
        places /= np.linalg.norm(places, axis=1)[:, None]
    L = penalties.surface(places, scipy.spatial.ConvexHull(places).simplices, kind)
    Y2 = places[:, 0] * places[:, 1]  # degree 2; its square integrates to 4 pi / 15
    exact = (6 if kind == "gradient" else 36) * 4 * np.pi / 15
    assert np.sum((L @ Y2) ** 2) == pytest.approx(exact, rel=0.02 if kind == "gradient" else 0.25)


@pytest.mark.parametrize("kind", ["gradient", "laplacian"])
def test_a_grid_is_a_surface_of_rectangles(kind: str) -> None:
    surface, grid = penalties.surface(*quads(X, Z), kind), penalties.grid((7, 5), kind, (np.diff(X), np.diff(Z)))
    g = RNG.standard_normal((35, 4))
    np.testing.assert_allclose(np.sum((grid @ g) ** 2, axis=0), np.sum((surface @ g) ** 2, axis=0), rtol=1e-12)
    if kind == "laplacian":
        np.testing.assert_allclose(grid.toarray(), surface.toarray(), atol=1e-12 * np.abs(surface).max())


@pytest.mark.parametrize("kind", ["gradient", "laplacian"])
@pytest.mark.parametrize("mesh", MESHES)
def test_numbering_turning_and_bending_change_nothing(mesh: str, kind: str) -> None:
    places, cells = MESHES[mesh]
    g, L = RNG.standard_normal(len(places)), penalties.surface(places, cells, kind)
    cost = np.sum((L @ g) ** 2)
    new = RNG.permutation(len(places))  # point k becomes new[k]
    moved, values = np.empty_like(places), np.empty_like(g)
    moved[new], values[new] = places, g
    shuffled = [np.roll(new[c][:: RNG.choice([-1, 1])], RNG.integers(4)) for c in RNG.permutation(cells)]
    assert np.sum((penalties.surface(moved, shuffled, kind) @ values) ** 2) == pytest.approx(cost, rel=1e-10)
    frame = np.linalg.qr(RNG.standard_normal((3, 3)))[0][:2]
    assert np.sum((penalties.surface(places @ frame + 5, cells, kind) @ g) ** 2) == pytest.approx(cost, rel=1e-9)
    if kind == "gradient":  # a pressure over an area has no unit of length in |grad g|^2
        assert np.sum((penalties.surface(1e-3 * places, cells, kind) @ g) ** 2) == pytest.approx(cost, rel=1e-9)
    if mesh in ("rectangles", "triangles"):  # folded along a grid line: lengths on the surface stay
        bent = np.column_stack([np.minimum(places[:, 0], X[3]), places[:, 1], np.maximum(places[:, 0] - X[3], 0)])
        assert np.sum((penalties.surface(bent, cells, kind) @ g) ** 2) == pytest.approx(cost, rel=1e-10)


def test_triangles_and_quadrilaterals_mix() -> None:
    places, cells = quads(X, Z)
    mixed = [list(c) for c in cells[:10]] + [list(c) for c in halves(cells[10:])]
    g = places @ [3.0, -4.0]
    assert np.sum((penalties.surface(places, mixed) @ g) ** 2) == pytest.approx(25 * np.ptp(X) * np.ptp(Z), rel=1e-12)


def test_graph() -> None:
    edges, w, g = np.array([(0, 1), (1, 2), (2, 0), (2, 3)]), np.array([1.0, 4.0, 9.0, 0.25]), RNG.standard_normal(4)
    differences = g[edges[:, 1]] - g[edges[:, 0]]
    assert np.sum((penalties.graph(4, edges, w) @ g) ** 2) == pytest.approx(np.sum(w * differences**2))
    change = penalties.graph(4, edges, w, "laplacian") @ g
    gradient = penalties.graph(4, edges, w).toarray()
    np.testing.assert_allclose(change, gradient.T @ (gradient @ g), atol=1e-12)
    chain = np.column_stack([np.arange(6), np.arange(1, 7)])
    np.testing.assert_allclose(penalties.graph(7, chain).toarray(), penalties.matrix("first_difference", 7))


def test_components_are_penalised_each_for_itself() -> None:
    L, g = penalties.line(6, 2), RNG.standard_normal((6, 3))
    both = penalties.components(L, 3)
    np.testing.assert_allclose((both @ g.ravel()).reshape(-1, 3), L @ g, atol=1e-13)
    assert both.shape == (12, 18)
    np.testing.assert_allclose(penalties.components(L.toarray(), 3).toarray(), both.toarray())


@pytest.mark.parametrize(
    "wrong",
    [
        partial(penalties.line, 2, 2),
        partial(penalties.line, 5, 3),
        partial(penalties.line, 5, "identity"),
        partial(penalties.line, 5, 1, [1.0, 1.0]),
        partial(penalties.line, 5, 1, [1.0, 0.0, 1.0, 1.0]),
        partial(penalties.line, 5, 1, np.nan),
        partial(penalties.grid, (5, 1)),
        partial(penalties.grid, (5, 3), "gradient", (1.0, 1.0, 1.0)),
        partial(penalties.grid, (5, 3), "ridge"),
        partial(penalties.graph, 3, [(0, 3)]),
        partial(penalties.graph, 3, [(1, 1)]),
        partial(penalties.graph, 3, []),
        partial(penalties.graph, 3, [(0, 1)], [0.0]),
        partial(penalties.graph, 3, [(0, 1)], [1.0, 2.0]),
        partial(penalties.surface, np.eye(3), [(0, 1, 2)], "ridge"),
        partial(penalties.surface, np.eye(3), [(0, 1, 3)]),
        partial(penalties.surface, np.eye(3), [(0, 1, 1)]),
        partial(penalties.surface, np.eye(3), [(0, 1)]),
        partial(penalties.surface, np.eye(3), []),
        partial(penalties.surface, np.full((3, 3), np.nan), [(0, 1, 2)]),
        partial(penalties.surface, np.ones((3, 1)), [(0, 1, 2)]),
        partial(penalties.surface, [(0, 0), (1, 1), (2, 2)], [(0, 1, 2)]),  # no area
        partial(penalties.surface, [(0, 0), (1, 0), (0, 1), (1, 1)], [(0, 1, 2, 3)]),  # crosses itself
        partial(penalties.surface, [(0, 0), (1, 0), (0, 1), (1, 1)], [(0, 1, 2)]),  # a point without a cell
    ],
)
def test_places_that_make_no_penalty_are_refused(wrong: partial) -> None:
    with pytest.raises(InputError, match="penalty"):
        wrong()
