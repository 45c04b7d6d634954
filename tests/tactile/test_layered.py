"""LayerSensor: against dense matrices of the same problem, exact motion of presses, and draws of its noise."""

from __future__ import annotations

import numpy as np
import pytest

from structures.errors import InputError
from tactile import DepthMap, Layer, LayerSensor, Markers, Press
from tactile._closed.waves import GRIDDING, Waves, odd_length

H = 3e-3
GEL = Layer(H, 147e3, 0.3223)
SHEAR = Press(radius=2.5e-3, force=0.0, shear=(0.25, 0.1))
PRESS = Press(at=(0.4e-3, -0.3e-3), radius=2.5e-3, force=1.0, shear=(0.25, 0.0))


def grid(nx: int, ny: int, side: float) -> np.ndarray:
    x, y = np.linspace(-side / 2, side / 2, nx), np.linspace(-side / 2, side / 2, ny)
    return np.array([(a, b) for b in y for a in x])


def scattered(count: int, side: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-side / 2, side / 2, (count, 2))


def torus(sensor: LayerSensor) -> tuple[np.ndarray, np.ndarray]:
    """Places (M, 2) of all nodes of the periodic grid, from the first of the box, and which of them the map covers."""
    lattice, (ny, nx) = sensor._lattice, sensor._spectrum.waves.shape
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    inside = np.zeros((ny, nx), bool)
    inside[lattice.loaded] = True
    places = np.stack([x * lattice.pitch[0], y * lattice.pitch[1]], axis=-1) + lattice.origin
    return places.reshape(-1, 2), inside.ravel()


def dense(sensor: LayerSensor, points: np.ndarray) -> np.ndarray:
    """Motion (3 n, 3 M) of points under band-limited unit tractions at the nodes, by sums over waves written out."""
    places, _ = torus(sensor)
    (ny, nx), (dx, dy) = sensor._spectrum.waves.shape, sensor._lattice.pitch
    ky, kx = np.meshgrid(2 * np.pi * np.fft.fftfreq(ny, dy), 2 * np.pi * np.fft.fftfreq(nx, dx), indexing="ij")
    kx, ky = kx.ravel(), ky.ravel()
    G = sensor.layer.interior(kx, ky, sensor._height)
    at, of = (np.exp(1j * (np.outer(p[:, 0], kx) + np.outer(p[:, 1], ky))) for p in (points, places))
    H = np.einsum("pk,kij,mk->pimj", at, G, of.conj(), optimize=True).real / len(kx)
    return H.reshape(3 * len(points), 3 * len(places))


def penalised(sensor: LayerSensor) -> np.ndarray:
    """The penalty ``|t|^2 + h^2 |grad t|^2`` (or ``|t|^2``) of one component at all nodes of the grid (M, M)."""
    (ny, nx), (dx, dy) = sensor._spectrum.waves.shape, sensor._lattice.pitch
    places, _ = torus(sensor)
    ky, kx = np.meshgrid(2 * np.pi * np.fft.fftfreq(ny, dy), 2 * np.pi * np.fft.fftfreq(nx, dx), indexing="ij")
    waves = np.exp(1j * (np.outer(places[:, 0], kx.ravel()) + np.outer(places[:, 1], ky.ravel())))
    weight = 1 + (H**2 * (kx**2 + ky**2)).ravel() * (sensor.penalty == "gradient")
    return np.asarray((waves * weight @ waves.conj().T).real / len(weight))


def written_out(sensor: LayerSensor, y: np.ndarray, alpha: float, loaded: np.ndarray, points: np.ndarray) -> tuple:
    """Load and covariance of the resultant of ``min |(H t - y) / noise|^2 + alpha^2 |t|^2``, all of it dense."""
    axes, loads = len(sensor.markers.axes), 3 if sensor.normal == "unknown" else 2
    places, inside = torus(sensor)
    keep = (3 * np.flatnonzero(loaded)[:, None] + np.arange(loads)).ravel()
    rows = (3 * np.arange(len(points))[:, None] + np.arange(axes)).ravel()
    H = dense(sensor, points)[rows][:, keep] / sensor._spectrum.noise[0]
    A = H.T @ H + alpha**2 * np.kron(penalised(sensor)[np.ix_(loaded, loaded)], np.eye(loads))
    t = np.linalg.solve(A, H.T @ y.ravel() / sensor._spectrum.noise[0])
    R = np.zeros((6, len(places), 3))
    R[:, inside] = sensor._resultant.reshape(6, -1, 3)
    R = R.reshape(6, -1)[:, keep]
    whole = np.zeros(3 * len(places))
    whole[keep] = t
    spread = np.zeros(3 * len(places))
    C = np.linalg.solve(A, np.eye(len(keep)))
    spread[keep] = np.sqrt(np.diag(C))
    on_map = np.repeat(inside, 3)
    return whole[on_map], spread[on_map], R @ C @ R.T


def outside(points: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Variance of the resultant by what moves beyond a window of places (N, 2) whose edge moves by some of u (N, 2)."""
    x, y = points[:, :2].T
    edge = np.isclose(x, x.min()) | np.isclose(x, x.max()) | np.isclose(y, y.min()) | np.isclose(y, y.max())
    pitch = (np.diff(np.unique(x.round(9))).mean() + np.diff(np.unique(y.round(9))).mean()) / 2
    std = np.zeros(6)
    std[:2] = 0.5 * 2 * H / np.pi * (GEL.E / 2 / (1 + GEL.nu) / H) * pitch * u[edge, :2].sum(axis=0)
    return np.outer(std, std)


CASES = [("XY", "free"), ("XY", "unknown"), ("XYZ", "unknown"), ("XYZ", "free")]


@pytest.mark.parametrize(("axes", "normal"), CASES)
@pytest.mark.parametrize(("z", "penalty"), [(H, "gradient"), (0.8 * H, "gradient"), (H, "identity")])
def test_a_full_grid_is_the_dense_problem_of_the_periodic_grid(axes: str, normal: str, z: float, penalty: str) -> None:
    points = np.column_stack([grid(7, 6, 8e-3), np.full(42, z)])
    s = LayerSensor(GEL, Markers(points, 2e-6, axes), normal=normal, choice=0.05, penalty=penalty)
    y = PRESS.displacement(GEL, points)[:, : len(axes)]
    found = s.estimate(y)
    places, _ = torus(s)
    held = s._spectrum.waves.held(y.T.reshape(-1, 6, 7)).reshape(len(axes), -1).T
    alpha = found.choice.lam * found.choice.scale
    load, spread, covariance = written_out(s, held, alpha, np.ones(len(places), bool), places)
    assert np.allclose(found.load, load, atol=1e-9 * np.abs(load).max())
    sigma = found.facts.noise_level
    std = np.maximum(sigma * spread, np.abs(found.bias))
    assert np.allclose(found.std, std, rtol=2e-5)
    taken = s._resultant @ found.bias
    expected = sigma**2 * covariance + np.outer(taken, taken) + outside(points, y)
    size = np.sqrt(np.diag(expected))
    assert np.allclose(found.geometry["resultant_covariance"], expected, atol=1e-4 * np.outer(size, size), rtol=0)


@pytest.mark.parametrize("penalty", ["gradient", "identity"])
@pytest.mark.parametrize("kind", ["scattered", "holes", "frame", "lost", "frame of scattered"])
def test_iterations_solve_the_dense_problem(kind: str, penalty: str) -> None:
    points, frame = grid(7, 6, 8e-3), None
    if "scattered" in kind:
        points = scattered(40, 8e-3)
    if kind == "holes":
        points = np.delete(points, [9, 10, 25], axis=0)
    if "frame" in kind:
        frame = (-2.8e-3, -2.5e-3, 3.1e-3, 2.5e-3)
    pitch = 1.4e-3 if "scattered" in kind else None
    s = LayerSensor(GEL, Markers(points, 2e-6, "XYZ"), frame=frame, choice=0.05, pitch=pitch, penalty=penalty)
    y = PRESS.displacement(GEL, points)
    places, inside = torus(s)
    loaded, seen, data = (inside if frame else np.ones(len(places), bool)), points, y
    if kind == "holes":
        loaded = inside
    if kind == "lost":
        gone = np.zeros(len(points), bool)
        gone[[8, 17, 30]] = True
        filled = s._filled(np.where(gone[:, None], np.nan, y).T, ~gone)
        beyond = s._spectrum.waves.held(filled.reshape(3, 6, 7)).reshape(3, -1).T
        window = np.flatnonzero(inside)
        kept = np.setdiff1d(np.arange(len(places)), window[gone])
        seen, data = places[kept], beyond[kept]
        y = np.where(gone[:, None], np.nan, y)
    elif kind == "scattered":
        loaded = inside
    found = s.estimate(y)
    load, _, covariance = written_out(s, data, found.choice.lam * found.choice.scale, loaded, seen)
    assert np.allclose(found.load, load, atol=2e-6 * np.abs(load).max())
    taken = s._resultant @ found.bias
    expected = found.facts.noise_level**2 * covariance + np.outer(taken, taken)
    if kind == "lost":
        expected += outside(points, filled.T)
    size = np.sqrt(np.diag(expected))
    assert np.allclose(found.geometry["resultant_covariance"], expected, atol=2e-3 * np.outer(size, size), rtol=0)
    assert found.facts["lost"] == (9 if kind == "lost" else 0)


# -- the physics ------------------------------------------------------------------------------------------------------
def shape(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Cosine of two fields, and the slope of the first over the second."""
    a, b = found.ravel(), truth.ravel()
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b)), float(a @ b / (b @ b))


@pytest.mark.parametrize("nu", [0.3223, 0.45, 0.49, 0.5])
def test_exact_motion_gives_the_tractions_of_a_shear_back(nu: float) -> None:
    gel, points = Layer(H, 147e3, nu), grid(97, 97, 24e-3)
    found = LayerSensor(gel, Markers(points, 1e-8)).estimate(SHEAR.displacement(gel, points)[:, :2])
    cosine, slope = shape(found.traction(), SHEAR.traction(points))
    assert cosine > 0.99
    assert slope == pytest.approx(1, abs=0.03)
    assert np.allclose(found.resultant().value, SHEAR.vector, atol=5e-3)
    assert not np.any(found.traction()[:, 2])


@pytest.mark.parametrize("side", [14e-3, 18e-3, 24e-3])
def test_what_moves_beyond_a_window_is_in_the_band_of_the_force(side: float) -> None:
    points = grid(61, 61, side)
    force = LayerSensor(GEL, Markers(points, 1e-9)).estimate(SHEAR.displacement(GEL, points)[:, :2]).resultant()
    away, std = np.abs(force.value - SHEAR.vector)[:2], force.std[:2]
    print(away / std, std / SHEAR.vector[:2])
    assert np.all(away < 1.5 * std)
    assert np.all(std < 4 * away)


@pytest.mark.parametrize(("nu", "pressed"), [(0.3223, 0.02), (0.45, 0.05), (0.49, 0.25)])
def test_all_three_components_give_a_press_back(nu: float, pressed: float) -> None:
    """A wide pressure is nearly hidden as nu goes to 0.5: what of the force is missing lies in its band."""
    gel, points = Layer(H, 147e3, nu), grid(97, 97, 30e-3)
    found = LayerSensor(gel, Markers(points, 1e-7, "XYZ")).estimate(PRESS.displacement(gel, points))
    cosine, slope = shape(found.traction(), PRESS.traction(points))
    assert cosine > 0.99
    assert slope == pytest.approx(1, abs=0.03)
    force = found.resultant()
    assert abs(force.value[2] + 1) < pressed
    inside = LayerSensor(gel, Markers(points, 1e-7, "XYZ"), frame=(-4e-3, -4e-3, 4e-3, 4e-3), choice=1e-3)
    assert inside.estimate(PRESS.displacement(gel, points)).resultant().value[2] == pytest.approx(-1, abs=0.02)


@pytest.mark.parametrize("kind", ["grid", "inside", "scattered"])
def test_the_band_of_the_resultant_holds_its_draws(kind: str) -> None:
    at = scattered(900, 24e-3) if kind == "scattered" else grid(53, 53, 30e-3)
    points = np.column_stack([at, np.full(len(at), H if kind == "grid" else 0.85 * H)])
    s = LayerSensor(GEL, Markers(points, 3e-6, "XYZ"), choice=0.004)
    u, rng = PRESS.displacement(GEL, points), np.random.default_rng(0)
    drawn = [s.estimate(u + 3e-6 * rng.standard_normal(u.shape)) for _ in range(24)]
    values, stds = (np.array(x) for x in zip(*[(d.resultant().value, d.resultant().std) for d in drawn], strict=True))
    assert np.all(np.abs(values - PRESS.vector) < 3.5 * stds)
    noise = np.std(values, axis=0)
    assert np.all(noise < stds.mean(axis=0) * 1.25)
    assert np.all(noise > 0.15 * stds.mean(axis=0))  # the prior is the rest


def test_the_band_of_a_node_is_that_of_noise_and_prior() -> None:
    """Loads drawn from the prior, their motion with noise: the errors have the std that is stated."""
    points, rng = grid(25, 25, 12e-3), np.random.default_rng(0)
    s = LayerSensor(GEL, Markers(points, 2e-6), choice=0.1, penalty="identity")
    alpha = 0.1 * s._spectrum.scale
    errors = []
    for _ in range(30):
        t = np.zeros((2, *s._spectrum.waves.shape))
        t[:, :25, :25] = rng.standard_normal((2, 25, 25)) / alpha
        u = s._spectrum.motion(t)[:, :25, :25] * 2e-6
        found = s.estimate(u.reshape(2, -1).T + 2e-6 * rng.standard_normal((625, 2)))
        inner = np.s_[5:20, 5:20]
        errors.append((found.traction()[:, :2].reshape(25, 25, 2) - np.moveaxis(t[:, :25, :25], 0, -1))[inner])
    std = s._spectrum.spread(alpha)
    assert np.std(errors, axis=(0, 1, 2)) == pytest.approx(std, rel=0.05)


def test_pressure_reads_as_shear_near_incompressibility_unless_it_is_sought() -> None:
    gel, points = Layer(H, 147e3, 0.49), grid(81, 81, 24e-3)
    push = Press(radius=3e-3, force=1.0)
    u = push.displacement(gel, points)
    free = LayerSensor(gel, Markers(points, 1e-7)).estimate(u[:, :2])
    sought = LayerSensor(gel, Markers(points, 1e-7, "XYZ")).estimate(u)
    false = [np.abs(f.traction()[:, :2]).max() / push.peak for f in (free, sought)]
    print(f"false shear over the pressure: {false[0]:.2f} with t_z = 0, {false[1]:.3f} with all of it")
    assert false[0] > 0.08
    assert false[1] < 0.01
    assert "W612" in free.codes
    assert not {"W612"} & sought.codes
    alone = LayerSensor(gel, Markers(points, 1e-7), normal="unknown").estimate(u[:, :2])
    assert "W608" in alone.codes  # in-plane motion shows little of a normal force, and that is said


def test_lost_places_cost_their_information_and_no_more() -> None:
    points, rng = grid(49, 49, 20e-3), np.random.default_rng(0)
    s = LayerSensor(GEL, Markers(points, 2e-6, "XYZ"), choice=0.004)
    u = PRESS.displacement(GEL, points) + 2e-6 * rng.standard_normal((len(points), 3))
    whole = s.estimate(u)
    u[rng.random(len(points)) < 0.1] = np.nan
    found = s.estimate(u)
    assert shape(found.traction(), whole.traction())[0] > 0.98
    assert np.all(found.resultant().std >= 0.999 * whole.resultant().std)
    assert "W604" in found.codes
    assert s.estimate(u).load == pytest.approx(found.load)


def test_the_order_of_places_and_the_modulus_change_nothing_else() -> None:
    points = grid(31, 31, 16e-3)
    u = SHEAR.displacement(GEL, points)[:, :2]
    found = LayerSensor(GEL, Markers(points, 1e-6)).estimate(u)
    mixed = np.random.default_rng(0).permutation(len(points))
    other = LayerSensor(GEL, Markers(points[mixed], 1e-6)).estimate(u[mixed])
    assert np.array_equal(other.load, found.load)
    stiff = LayerSensor(Layer(H, 147e6, 0.3223), Markers(points, 1e-6)).estimate(u)
    assert np.allclose(stiff.load, 1e3 * found.load, rtol=1e-9, atol=1e-9 * np.abs(stiff.load).max())


def test_calibration_freezes_lambda() -> None:
    points, rng = grid(31, 31, 16e-3), np.random.default_rng(0)
    u = SHEAR.displacement(GEL, points)[:, :2]
    frames = [u + 2e-6 * rng.standard_normal(u.shape) for _ in range(3)]
    s = LayerSensor(GEL, Markers(points, 2e-6))
    assert not s.frozen
    chosen = s.calibrate(frames)
    assert s.frozen
    assert s.estimate(frames[0]).choice.lam == chosen.lam
    assert len(list(s.stream(frames))) == 3
    with pytest.raises(InputError, match="calibrate"):
        s.calibrate([])


# -- what it is made of -----------------------------------------------------------------------------------------------
def test_gridding_is_the_sum_over_waves() -> None:
    waves = Waves(GEL, (21, 27), (5e-4, 4e-4), H)
    rng = np.random.default_rng(0)
    field, points = rng.standard_normal((3, 21, 27)), rng.uniform(-3, 30, (50, 2))
    lines = 2 * np.pi * np.fft.fftfreq(21), 2 * np.pi * np.fft.fftfreq(27)
    at = [np.exp(1j * np.outer(points[:, k], lines[k])) for k in range(2)]
    exact = np.einsum("cyx,py,px->cp", np.fft.fft2(field), *at).real / 21 / 27
    read = waves.gridding(points)
    found = read(waves.waves(field))
    assert np.abs(found - exact).max() < GRIDDING * np.abs(exact).max()
    other = rng.standard_normal(found.shape)
    back = waves.field(read.adjoint(other))
    assert np.sum(found * other) == pytest.approx(np.sum(field * back))


def test_a_window_is_let_down_beyond_its_edge() -> None:
    waves = Waves(GEL, (25, 27), (1e-3, 1e-3), H)
    field = np.random.default_rng(0).standard_normal((2, 13, 14))
    held = waves.held(field)
    assert np.array_equal(held[:, :13, :14], field)
    flat = waves.held(np.ones((1, 13, 14)))[0]
    assert np.all(np.diff(flat[12:19, 0]) < 0)
    assert np.all(np.diff(flat[19:, 0]) > 0)
    assert flat[18, 0] < 0.02
    assert np.abs(np.diff(np.append(flat[:, 0], flat[0, 0]))).max() < 0.3


@pytest.mark.parametrize("least", [1, 2, 100, 317, 4097])
def test_odd_lengths(least: int) -> None:
    n = odd_length(least)
    assert n % 2 == 1
    assert least <= n <= 1.25 * least + 2


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"layer": "gel"}, "no layer"),
        ({"normal": "zero"}, "normal"),
        ({"penalty": "laplacian"}, "penalty"),
        ({"frame": (1e-3, 0.0, -1e-3, 2e-3)}, "frame"),
        ({"frame": (0.01e-3, 0.01e-3, 0.02e-3, 0.02e-3)}, "no node"),
        ({"choice": -1.0}, "lambda"),
        ({"markers": Markers(np.column_stack([scattered(9, 8e-3), np.linspace(1e-3, 3e-3, 9)]), 1e-6)}, "one height"),
        ({"markers": Markers(np.column_stack([scattered(9, 8e-3), np.full(9, 4e-3)]), 1e-6)}, "one height"),
        ({"markers": Markers(scattered(9, 8e-3), 1e-6), "pitch": 1e-6}, "too many nodes"),
        ({"markers": Markers(scattered(9, 8e-3), 1e-6, slope=np.zeros((9, 2)))}, "themselves"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict, what: str) -> None:
    given = {"layer": GEL, "markers": Markers(grid(9, 9, 8e-3), 1e-6), **change}
    with pytest.raises(InputError, match=what):
        LayerSensor(given.pop("layer"), given.pop("markers"), **given)


def test_a_depth_map_is_refused() -> None:
    s = LayerSensor(GEL, Markers(grid(9, 9, 8e-3), 1e-6))
    with pytest.raises(InputError, match="depth"):
        s.estimate(np.zeros((81, 2)), DepthMap(np.zeros((4, 4)), 1e-4, 1e-6))


def test_its_map_is_a_force_map(tmp_path) -> None:
    points = grid(21, 21, 16e-3)
    found = LayerSensor(GEL, Markers(points, 1e-6, "XYZ")).estimate(PRESS.displacement(GEL, points))
    assert np.allclose(found.forces().sum(axis=0), found.resultant().value)
    assert found.contact().radius == pytest.approx(PRESS.radius, rel=0.15)
    found.save(tmp_path / "map.h5")
    again = type(found).read(tmp_path / "map.h5")
    assert np.array_equal(again.load, found.load)
    assert again.resultant().std == pytest.approx(found.resultant().std)
    found.report(tmp_path / "map.html", truth=PRESS.traction(points))
