"""Metrics of force maps: ideals, closed forms, invariances, and the benchmark of several sensors."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from loadid import StaticInversion
from loadid.validate import ReferenceWrench, validate
from structures import Channel, MatrixModel
from structures._flags import codes
from structures.errors import InputError
from tactile import Layer, Press, metrics
from tactile.metrics import compare_resultants

PITCH = 1e-3


def grid(n: int = 25) -> np.ndarray:
    x = PITCH * (np.arange(n) - (n - 1) / 2)
    return np.stack(np.meshgrid(x, x, indexing="xy"), axis=-1).reshape(-1, 2)


POINTS = grid()
AREAS = np.full(len(POINTS), PITCH**2)


def bump(x: float, y: float, a: float, p: float, q: float = 0.0) -> np.ndarray:
    """Hertz pressure and shear on a disc."""
    r2 = ((POINTS - [x, y]) ** 2).sum(axis=1) / a**2
    shape = np.sqrt(np.maximum(1 - r2, 0.0))
    return np.stack([q * shape, 0 * shape, -p * shape], axis=1)


TRUTH = bump(-5e-3, 0, 3e-3, 2e4, 5e3) + bump(6e-3, 3e-3, 2e-3, 1e4)
NOISY = TRUTH + 700 * np.random.default_rng(1).standard_normal(TRUTH.shape)


def test_a_perfect_map_gives_the_ideals() -> None:
    m = metrics.compare(TRUTH, TRUTH, areas=AREAS, points=POINTS)
    assert (m.error, m.dtma, m.dma, m.dtmb, m.centroid_error) == (0, 0, 0, 0, 0)
    assert m.cosine == pytest.approx(1, abs=1e-14)
    assert (m.iou, m.peak_ratio, m.radius_ratio, m.snr, m.patches) == (1, 1, 1, math.inf, 2)
    assert m.components == (0, 0, 0)
    assert m.resultant == m.reference
    assert m.kind == "distribution"
    assert not m.partial


@pytest.mark.parametrize(("force", "length"), [(1e6, 1.0), (1e-6, 1e3), (3.7, 1e-6)])
def test_no_unit_of_force_or_length_matters(force: float, length: float) -> None:
    a = metrics.compare(NOISY, TRUTH, areas=AREAS, points=POINTS)
    b = metrics.compare(force * NOISY, force * TRUTH, areas=length**2 * AREAS, points=length * POINTS)
    for name in ("error", "cosine", "iou", "peak_ratio", "radius_ratio", "dtma", "dma", "dtmb", "snr"):
        assert getattr(b, name) == pytest.approx(getattr(a, name), rel=1e-9), name
    assert b.components == pytest.approx(a.components, rel=1e-9)
    assert b.centroid_error == pytest.approx(length * a.centroid_error, rel=1e-9)


def test_formulas_written_out_point_by_point() -> None:
    labels = metrics.patches(TRUTH, POINTS)
    size, own = np.linalg.norm(TRUTH, axis=1), np.linalg.norm(NOISY, axis=1)
    sets, outside = [labels == 1, labels == 2], labels == 0
    assert sorted(s.sum() for s in sets) == [9, 25]  # nodes within 2 and 3 mm, the rim excluded
    dtma = np.mean([(own[s].mean() - size[s].mean()) / size[s].mean() for s in sets])
    dma = np.mean([(own[s].max() - size[s].max()) / size[s].max() for s in sets])
    dtmb = own[outside].mean() / np.mean([size[s].mean() for s in sets])
    std = math.sqrt(sum(NOISY[outside, i].var() for i in range(3)))
    snr = np.mean([own[s].mean() / std for s in sets])
    m = metrics.compare(NOISY, TRUTH, areas=AREAS, points=POINTS, labels=labels)
    assert (m.dtma, m.dma, m.dtmb, m.snr) == pytest.approx((dtma, dma, dtmb, snr), rel=1e-12)
    assert m.error == pytest.approx(np.linalg.norm(NOISY - TRUTH) / np.linalg.norm(TRUTH), rel=1e-12)
    assert m.components[1] == pytest.approx(np.linalg.norm(NOISY[:, 1]) / np.linalg.norm(TRUTH), rel=1e-12)
    assert m.components[0] == pytest.approx(
        np.linalg.norm(NOISY[:, 0] - TRUTH[:, 0]) / np.linalg.norm(TRUTH[:, 0]), rel=1e-12
    )


def test_std_outside_is_that_of_known_noise() -> None:
    rng = np.random.default_rng(0)
    truth = np.zeros((20_000, 3))
    truth[:10, 2] = -1.0
    noisy = truth + rng.standard_normal(truth.shape) * [0.1, 0.2, 0.05]
    noisy[:10] = truth[:10]
    assert metrics.snr(noisy, truth) == pytest.approx(1 / math.sqrt(0.01 + 0.04 + 0.0025), rel=0.02)


def test_a_gain_changes_peak_and_magnitude_and_not_the_shape() -> None:
    m = metrics.compare(1.25 * TRUTH, TRUTH, areas=AREAS, points=POINTS)
    assert m.error == pytest.approx(0.25)
    assert (m.dtma, m.dma) == pytest.approx((0.25, 0.25))
    assert (m.cosine, m.iou, m.radius_ratio, m.peak_ratio) == pytest.approx((1, 1, 1, 1.25))


def test_a_shifted_and_a_widened_press_are_seen() -> None:
    truth = bump(0, 0, 3e-3, 1e4)
    shifted = bump(2e-3, 1e-3, 3e-3, 1e4)
    assert metrics.centroid_error(shifted, truth, POINTS) == pytest.approx(math.hypot(2e-3, 1e-3), rel=1e-9)
    assert metrics.spread(bump(0, 0, 8e-3, 1e4), bump(0, 0, 4e-3, 1e4), POINTS) == pytest.approx(2, rel=0.03)
    assert metrics.iou(shifted, truth) < 0.6
    # areas of discs: theta = 0.2 lies at sqrt(1 - 0.04) of the radius; the wide disc holds four times the area
    assert metrics.iou(bump(0, 0, 8e-3, 1e4), bump(0, 0, 4e-3, 1e4)) == pytest.approx(0.25, rel=0.08)  # 45 nodes of 193


def test_a_coarse_part_of_a_mesh_weighs_by_its_area() -> None:
    truth = np.array([[0, 0, -1.0], [0, 0, -1.0], [0, 0, 0.0]])
    found = np.array([[0, 0, -1.0], [0, 0, -2.0], [0, 0, 0.0]])
    areas = np.array([1.0, 3.0, 5.0])
    assert metrics.relative_error(found, truth, areas) == pytest.approx(math.sqrt(3 / 4))
    assert metrics.dtma(found, truth, areas=areas) == pytest.approx(0.75)
    m = metrics.compare(found * areas[:, None], truth * areas[:, None], areas=areas, quantity="forces")
    assert (m.error, m.peak_ratio) == pytest.approx((math.sqrt(3 / 4), 2.0))


def test_resultants_per_axis() -> None:
    f = np.zeros((2, 3))
    f[0], f[1] = (1.0, 0, -2.0), (0, 0.5, -1.0)
    x = np.array([[2.0, 0, 1.0], [0, 3.0, 1.0]])
    moment = np.cross(x - [0, 0, 1.0], f).sum(axis=0)
    assert metrics.resultant(f, x, [0, 0, 1.0]) == pytest.approx([1, 0.5, -3, *moment])
    assert metrics.resultant(f, x[:, :2]) == pytest.approx([1, 0.5, -3, *moment])
    rng = np.random.default_rng(3)
    known = rng.uniform(-1, 1, (4000, 6)) * [1, 1, 10, 1, 1, 1]
    errors = metrics.resultant_errors(known + 0.1 + 0.2 * rng.standard_normal(known.shape), known)
    assert errors.std == pytest.approx([0.2] * 6, rel=0.05)
    assert errors.bias == pytest.approx([0.1] * 6, abs=0.01)
    assert errors.share[2] == pytest.approx(math.sqrt(0.05) / 20, rel=0.05)
    expected = 0.2 * math.sqrt(2 / math.pi) * math.exp(-0.125) + 0.1 * math.erf(0.1 / 0.2 / math.sqrt(2))
    assert errors.mae == pytest.approx([expected] * 6, rel=0.05)  # mean of a folded normal
    assert "level resultant" in errors.table()


def test_a_resultant_alone_is_partial() -> None:
    m = compare_resultants([0.5, 0, -2.01], [0.5, 0, -2.0], loads=1071)
    assert m.partial
    assert codes(m.flags) == {"N701"}
    assert m.error is None
    assert "infinitely many maps" in m.table()


def test_slope_of_error_against_noise() -> None:
    levels = np.array([2e-6, 5e-6, 10e-6, 20e-6])
    errors = 0.05 + 9e3 * levels[:, None] + 0.002 * np.random.default_rng(0).standard_normal((4, 40))
    fit = metrics.noise_slope(levels, errors)
    assert fit.slope == pytest.approx(9e3, abs=4 * fit.std)
    assert fit.std == pytest.approx(0.002 / math.sqrt(40 * np.sum((levels - levels.mean()) ** 2)), rel=0.3)
    assert fit.intercept == pytest.approx(0.05, abs=0.002)
    assert fit.misfit < 0.02
    for bad in (levels[:3], levels[[0, 0, 1, 2]]):
        with pytest.raises(InputError, match="too little"):
            metrics.noise_slope(bad, errors[: len(bad)])
    with pytest.raises(InputError, match="too little"):
        metrics.noise_slope(levels, errors[:, :9])


def test_cells_keep_the_resultant_and_give_the_mean_error() -> None:
    f = TRUTH * PITCH**2
    cells = metrics.to_cells(f, POINTS, (25e-3, 25e-3))
    assert cells.shape == (24, 32, 3)
    assert cells.sum(axis=(0, 1)) == pytest.approx(f.sum(axis=0), rel=1e-12)
    one = metrics.to_cells(np.array([[0, 0, -1.0]]), [[11e-3, -12e-3]], (25e-3, 25e-3))
    assert np.argwhere(one[..., 2]).tolist() == [[0, 30]]  # column 23.5 / 25 * 32, row of the lowest Y
    truth = np.stack([cells, 2 * cells])
    found = truth.copy()
    found[:, 3, 4, 0] += [0.3, 0.5]
    e = metrics.cell_errors(found, truth)
    assert e.total[0] == pytest.approx(0.4)
    assert e.total_std[0] == pytest.approx(0.1)
    assert e.cell[0] == pytest.approx(0.4 / (24 * 32))
    assert e.cell[2] == 0
    hard = np.array([[0, 0, -10.0], [0, 0, -41.0]])
    assert metrics.cell_errors(found, truth, hard).left_out == 1
    with pytest.raises(InputError, match="no sample is left"):
        metrics.cell_errors(found, truth, hard - [0, 0, 40])
    with pytest.raises(InputError, match="outside the grid"):
        metrics.to_cells(f, POINTS, (20e-3, 25e-3))


def test_benchmark_of_known_sensors() -> None:
    """A sensor that reads force directly: error and slope are those of the noise, and a gain shows as a gain."""
    gain = 1e3  # N/m
    truths = [bump(0, 0, 3e-3, 1e4, 2e3), bump(4e-3, 2e-3, 4e-3, 2e4)]
    presses = [metrics.Case(t * PITCH**2 / gain, t) for t in truths]
    seen: list[float] = []
    table = metrics.benchmark(
        {"direct": lambda u: gain * u, "soft": lambda u: 0.8 * gain * u},
        presses,
        areas=AREAS,
        points=POINTS,
        noise=(0.0, 1e-6, 2e-6, 4e-6),
        progress=lambda share, text: seen.append(share),
    )
    size = [np.linalg.norm(c.displacements) for c in presses]
    per_metre = math.sqrt(3 * len(POINTS)) * np.mean([1 / s for s in size])
    assert table.slopes["direct"].slope == pytest.approx(per_metre, rel=0.02)
    assert table["direct", 0.0].metrics.error == pytest.approx(0, abs=1e-12)
    assert table["soft", 0.0].metrics.error == pytest.approx(0.2)
    assert table["soft", 0.0].force == pytest.approx(0.2)
    assert table["soft", 0.0].force_z > 0.19  # less pull downwards
    assert table["soft", 0.0].metrics.cosine == pytest.approx(1)
    assert table["direct", 4e-6].worst >= table["direct", 4e-6].metrics.error
    assert seen[-1] == 1
    assert len(seen) == 8
    text = table.table()
    assert text.count("per um") == 2
    assert table.plot().axes[0].get_title(loc="left").startswith("relative L2")
    estimate = {"direct": lambda u: SimpleNamespace(load=(gain * u).ravel())}  # as a sensor's estimate has it
    short = metrics.benchmark(estimate, presses, areas=AREAS, points=POINTS, noise=(0, 1e-6))
    assert short.slopes["direct"] is None
    assert "too few levels" in short.table()


@pytest.mark.parametrize("shape", ["hat", "patch"])
def test_cases_hold_the_force_and_the_motion_of_their_presses(shape: str) -> None:
    layer = Layer(h=3e-3, E=0.147e6, nu=0.4)
    pair = [
        Press(at=(1.3e-3, 0.2e-3), radius=2e-3, force=0.5, shear=(0.2, 0)),
        Press(at=(-4e-3, 2e-3), radius=1.2e-3, force=1),
    ]
    one, both = metrics.cases([pair[0], pair], layer, POINTS, POINTS, pitch=PITCH, shape=shape)
    assert one.tractions.sum(axis=0) * PITCH**2 == pytest.approx([0.2, 0, -0.5], rel=1e-6)
    assert both.tractions.sum(axis=0) * PITCH**2 == pytest.approx([0.2, 0, -1.5], rel=1e-6)
    assert both.displacements == pytest.approx(sum(p.displacement(layer, POINTS) for p in pair))
    points = Press(radius=2e-3, force=1.0).traction(POINTS).sum(axis=0)[2] * PITCH**2
    assert points == pytest.approx(-0.87, abs=0.01)  # what values at the points would lose
    if shape == "hat":  # against a fine sum
        x = (np.arange(400) + 0.5) / 200 - 1
        X, Y = np.meshgrid(x, x)
        t = pair[0].traction(np.stack([PITCH + PITCH * X.ravel(), PITCH * Y.ravel()], axis=1))
        expected = ((1 - np.abs(X)) * (1 - np.abs(Y))).ravel() @ t / 200**2
        node = np.argmin(np.linalg.norm(POINTS - [PITCH, 0], axis=1))
        assert one.tractions[node] == pytest.approx(expected, rel=2e-3)


def test_the_package_validates_maps_of_presses_and_calls_a_resultant_partial() -> None:
    nodes = grid(7)
    areas = np.full(49, PITCH**2)
    press = Press(at=(0.4e-3, 0), radius=2e-3, force=1.0, shear=(0.3, 0.0))
    truth = metrics.known([press], nodes, areas, pitch=PITCH)
    channels = [[Channel(label=f"{k}{i}", quantity=q, unit=u) for i in range(147)] for k, q, u in
                (("u", "displacement", "m"), ("f", "force", "N"))]  # fmt: skip
    away = np.linalg.norm(nodes[:, None] - nodes, axis=2)
    H = np.kron(1e-3 * np.exp(-away / PITCH), np.eye(3))
    model = MatrixModel(H, sensors=channels[0], loads=channels[1])
    noisy = H @ np.asarray(truth.values) + 1e-7 * np.random.default_rng(0).standard_normal(147)
    found = StaticInversion(model, noise=1e-7, choice=1e-6).estimate(noisy)
    checked = validate(found, truth)
    assert checked.level == "distribution"
    assert checked.agrees
    sums = np.tile(np.eye(3), 49)
    partial = validate(
        found, ReferenceWrench([0.3, 0, -1.0], std=0.01, labels=("Fx", "Fy", "Fz"), C=sums, units=("N",) * 3)
    )
    assert partial.partial
    assert partial.agrees
    assert codes(partial.flags) == {"N701"}


@pytest.mark.parametrize(
    ("found", "truth", "words"),
    [
        (TRUTH[:-1], TRUTH, "different points"),
        (TRUTH, 0 * TRUTH, "zero everywhere"),
        (np.where(TRUTH == 0, np.nan, TRUTH), TRUTH, "NaN"),
        (np.zeros((4, 5)), np.ones((4, 5)), "no map"),
    ],
)
def test_maps_that_cannot_be_compared_are_refused(found: np.ndarray, truth: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        metrics.compare(found, truth)


def test_an_empty_estimate_has_numbers_and_no_nan() -> None:
    m = metrics.compare(0 * TRUTH, TRUTH, areas=AREAS, points=POINTS)
    assert (m.error, m.cosine, m.iou, m.peak_ratio, m.dtma, m.dtmb) == pytest.approx((1, 0, 0, 0, -1, 0))
    assert m.centroid_error is None
    assert m.radius_ratio is None
    assert "nan" not in m.table()


def test_forces_need_areas_and_patches_need_load() -> None:
    with pytest.raises(InputError, match="areas"):
        metrics.compare(TRUTH, TRUTH, quantity="forces")
    with pytest.raises(InputError, match="patch without load"):
        metrics.dtma(TRUTH, TRUTH, labels=np.where(np.arange(len(TRUTH)) == 0, 1, 0))
    with pytest.raises(InputError, match="share"):
        metrics.iou(TRUTH, TRUTH, theta=1.5)
