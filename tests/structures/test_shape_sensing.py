"""Inverse finite elements against closed forms: plates of both theories, beams, frames; and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from structures import ForwardModel, InputError, beams, frames, loads, plates, sensors
from structures.shape_sensing import InverseFEM, QuadPlate

THICK = 5e-3
MATERIAL = plates.Material(E=70e9, rho=2700, nu=0.33)
MODES = np.arange(1, 60, 2)
PLACES = [(x, y) for x in np.linspace(0.1, 0.9, 5) for y in np.linspace(0.1, 0.9, 5)]


def supported(at, order=(0, 0)):
    """Deflection (D = q = a = 1) of a simply supported square under uniform pressure, or a derivative: Navier."""
    M, N = np.meshgrid(MODES, MODES, indexing="ij")
    A = 16 / (np.pi**6 * M * N * (M**2 + N**2) ** 2) * (M * np.pi) ** order[0] * (N * np.pi) ** order[1]
    along = [
        np.array([np.sin, np.cos, lambda t: -np.sin(t)][k](np.pi * v * MODES)) for k, v in zip(order, at, strict=True)
    ]
    return float(along[0] @ A @ along[1])


def gauges(count, angles=(0.0, np.pi / 2), faces=(1,), **more):
    """One station in the middle of each of count x count cells."""
    p = (np.arange(count) + 0.5) / count
    return [
        sensors.StrainGauge(at=(x, y), fibre=f * THICK / 2, angle=t, label=f"{x:.3f} {y:.3f} {t:.1f} {f}", **more)
        for y in p
        for x in p
        for t in angles
        for f in faces
    ]


def reading(gauge):
    """Strain of the Navier solution."""
    c, s = np.cos(gauge.angle), np.sin(gauge.angle)
    bent = c * c * supported(gauge.at, (2, 0)) + s * s * supported(gauge.at, (0, 2))
    return -gauge.fibre * (bent + 2 * c * s * supported(gauge.at, (1, 1)))


def wrong(model, placed):
    """Largest error of the deflection over its largest value."""
    inverse = InverseFEM(model, placed)
    found = inverse.estimate([reading(g) for g in placed])
    w = [inverse.row(sensors.Displacement(at=at)) @ found.values for at in PLACES]
    true = np.array([supported(at) for at in PLACES])
    return float(np.abs(w - true).max() / true.max())


def mesh(theory, count):
    if theory == "hermite":
        return plates.plate(lengths=(1, 1), thickness=THICK, material=MATERIAL, elements=count)
    return QuadPlate.rectangle((1, 1), (count, count), THICK, theory=theory)


@pytest.mark.parametrize(("theory", "order"), [("hermite", 1.2), ("kirchhoff", 1.7), ("mindlin", 1.7)])
def test_a_simply_supported_plate_under_pressure(theory, order):
    """One station an element: 1 % with 12 x 12 stations, and the error falls with the square of the size or so."""
    coarse, fine = (wrong(mesh(theory, count), gauges(count)) for count in (4, 12))
    assert fine <= 0.0125 if theory == "kirchhoff" else fine <= 0.01
    assert fine < 0.01 or np.log(coarse / fine) / np.log(3) >= order


def test_gauges_coarser_than_the_mesh():
    """Elements without a gauge continue those that have one."""
    assert wrong(mesh("hermite", 10), gauges(5)) < 0.05


def test_distorted_elements_of_constant_curvature():
    """Patch test: the corners moved, a field of constant curvature comes back, of both theories."""
    rng = np.random.default_rng(0)
    for theory in ("kirchhoff", "mindlin"):
        regular = QuadPlate.rectangle((1, 1), (4, 4), THICK)
        inner = np.all((regular.nodes > 0) & (regular.nodes < 1), axis=1)
        nodes = regular.nodes + 0.05 * inner[:, None] * rng.uniform(-1, 1, regular.nodes.shape)
        held = [f"{k}{axis}" for k in (0,) for axis in ("+Z", "-RY", "+RX")]
        plate = QuadPlate(nodes, regular.cells, THICK, theory=theory, supports=held)
        placed = gauges(4, angles=(0.0, np.pi / 2, np.pi / 4))
        k = np.array([2.0, -1.0, 0.5])  # w_xx, w_yy, w_xy
        ways = [np.array([np.cos(g.angle) ** 2, np.sin(g.angle) ** 2, np.sin(2 * g.angle)]) for g in placed]
        found = InverseFEM(plate, placed, weight=1e-9).estimate([-THICK / 2 * way @ k for way in ways])
        x, y = nodes.T
        exact = k[0] * x**2 / 2 + k[1] * y**2 / 2 + k[2] * x * y
        w = found.values.reshape(-1, 3)[:, 0]
        # a deflection of eight nodes is not complete on distorted elements: shear spoils it a little
        assert np.abs(w - exact).max() < (1e-6 if theory == "kirchhoff" else 2e-3) * np.abs(exact).max(), theory


def test_gauges_on_both_faces_tell_stretch_from_bending():
    """A plate that bends and stretches at once: both come back."""
    plate = QuadPlate.rectangle((1, 1), (6, 6), THICK, membrane=True)
    placed = gauges(6, angles=(0.0, np.pi / 2, np.pi / 4), faces=(1, -1))
    stretch = [1e-3 * np.cos(g.angle) ** 2 - 3e-4 * np.sin(g.angle) ** 2 for g in placed]
    inverse = InverseFEM(plate, placed, weight=1e-7)
    found = inverse.estimate([reading(g) + e for g, e in zip(placed, stretch, strict=True)]).values.reshape(-1, 5)
    x, y = plate.nodes.T
    assert found[:, 3] == pytest.approx(1e-3 * x, abs=1e-8)
    assert found[:, 4] == pytest.approx(-3e-4 * y, abs=1e-8)
    middle = np.argmin(np.hypot(x - 0.5, y - 0.5))
    assert found[middle, 0] == pytest.approx(supported((0.5, 0.5)), rel=0.05)


def test_a_clamped_plate():
    """Readings of a mesh four times as fine under uniform pressure; the centre after Timoshenko, 0.00126532 q a^4/D."""
    fine = plates.plate(lengths=(1, 1), thickness=THICK, material=MATERIAL, elements=36, edges="CCCC")
    placed = gauges(12)
    model = ForwardModel(fine, [*placed, sensors.Displacement(at=(0.5, 0.5))], [loads.Patch(x=(0, 1), y=(0, 1))])
    *strains, centre = model.static()[:, 0]
    rigidity = MATERIAL.E * THICK**3 / 12 / (1 - MATERIAL.nu**2)
    assert centre * rigidity == pytest.approx(0.00126532, rel=1e-4)
    coarse = plates.plate(lengths=(1, 1), thickness=THICK, material=MATERIAL, elements=12, edges="CCCC")
    inverse = InverseFEM(coarse, placed)
    w = inverse.row(sensors.Displacement(at=(0.5, 0.5))) @ inverse.estimate(strains).values
    assert w == pytest.approx(centre, rel=0.011)


def test_a_clamped_plate_converges():
    """One station an element, strains of a mesh of 32: second order, and 1 % from 16 x 16 stations on."""
    fine = plates.plate(lengths=(1, 1), thickness=THICK, material=MATERIAL, elements=32, edges="CCCC")
    errors = []
    for count in (8, 16):
        placed = gauges(count)
        model = ForwardModel(fine, [*placed, sensors.Displacement(at=(0.5, 0.5))], [loads.Patch(x=(0, 1), y=(0, 1))])
        *strains, centre = model.static()[:, 0]
        inverse = InverseFEM(plates.plate(lengths=(1, 1), thickness=THICK, material=MATERIAL, elements=count,
                                          edges="CCCC"), placed)  # fmt: skip
        w = inverse.row(sensors.Displacement(at=(0.5, 0.5))) @ inverse.estimate(strains).values
        errors.append(abs(w / centre - 1))
    assert errors[1] < 0.01
    assert np.log2(errors[0] / errors[1]) > 1.7


@pytest.mark.parametrize(
    ("ends", "deflection", "curvature"),
    [
        (("clamped", "free"), lambda x: x**2 * (x**2 - 4 * x + 6) / 24, lambda x: (1 - x) ** 2 / 2),
        (("pinned", "pinned"), lambda x: x * (1 - 2 * x**2 + x**3) / 24, lambda x: -x * (1 - x) / 2),
        (("clamped", "clamped"), lambda x: x**2 * (1 - x) ** 2 / 24, lambda x: (6 * x**2 - 6 * x + 1) / 12),
    ],
)
def test_beams_under_uniform_load(ends, deflection, curvature):
    """Six gauges, closed forms: 1 % and second order."""
    errors = []
    for count in (6, 12):
        beam = beams.beam(
            length=1.0,
            section=beams.Section.rectangle(0.05, 0.01),
            material=beams.materials.steel,
            elements=count,
            left=ends[0],
            right=ends[1],
        )
        at = (np.arange(count) + 0.5) / count
        inverse = InverseFEM(beam, [sensors.StrainGauge(at=x, fibre=5e-3) for x in at])
        found = inverse.estimate(-5e-3 * curvature(at))
        x = np.linspace(0, 1, 21)
        w = np.array([inverse.row(sensors.Displacement(at=v)) for v in x]) @ found.values
        errors.append(np.abs(w - deflection(x)).max() / np.abs(deflection(x)).max())
    assert errors[1] < 0.01
    assert errors[0] < 0.03
    assert errors[1] < errors[0] / 3


def test_a_plane_and_a_space_frame():
    """Gauges of a forward model under a tip force: the tip comes back."""
    for space in (False, True):
        joints = [(0, 0, 0), (0, 0, 2.0), (1.5, 0, 2.0)] if space else [(0, 0), (0, 2.0), (1.5, 2.0)]
        portal = frames.frame(
            joints,
            [frames.Member(0, 1, elements=6), frames.Member(1, 2, elements=6)],
            section=frames.Section.rectangle(0.04, 0.06),
            material=beams.materials.steel,
            supports={0: "clamped"},
        )
        fibres = [(0.02, 0.03), (-0.02, 0.03), (0.02, -0.03)] if space else [0.03, -0.03]
        at = [frames.At(m, s) for m, length in ((0, 2.0), (1, 1.5)) for s in length * (np.arange(6) + 0.5) / 6]
        placed = [sensors.StrainGauge(at=a, fibre=f, label=f"{a} {f}") for a in at for f in fibres]
        tip = [sensors.Displacement(f"2{axis}") for axis in ("+X", "+Z")]
        model = ForwardModel(portal, [*placed, *tip], [loads.Point("2-Z")])
        *strains, x, z = model.static()[:, 0]
        inverse = InverseFEM(portal, placed)
        found = inverse.estimate(strains)
        assert [inverse.row(s) @ found.values for s in tip] == pytest.approx([x, z], rel=0.01)


def test_the_covariance_is_that_of_repeated_noise():
    plate, placed = mesh("hermite", 4), gauges(4)
    inverse = InverseFEM(plate, placed, noise=1e-6)
    draws = inverse.estimate(1e-6 * np.random.default_rng(0).standard_normal((4000, len(placed))))
    row = inverse.row(sensors.Displacement(at=(0.5, 0.5)))
    assert np.std(draws.values @ row) == pytest.approx(np.sqrt(draws.covariance(row[None])[0, 0]), rel=0.05)
    assert draws.std.max() == pytest.approx(np.std(draws.values, axis=0).max(), rel=0.06)


def test_it_is_the_dense_least_squares():
    """Against numpy's own on a small plate: sparse rotations and dense singular values agree."""
    plate, placed = mesh("mindlin", 3), gauges(3)
    inverse = InverseFEM(plate, placed)
    elements = plate.sampled()
    A = np.vstack(
        [inverse.rows, 1e-3 * (elements.bends @ elements.strains).toarray(), 1e-5 * elements.strains.toarray()]
    )
    rhs = np.vstack([np.eye(len(placed)), np.zeros((len(A) - len(placed), len(placed)))])
    dense = np.linalg.lstsq(A[:, plate.free], rhs, rcond=None)[0]
    assert np.abs(inverse.gain[plate.free] - dense).max() < 1e-8 * np.abs(dense).max()


def test_what_is_refused():
    plate = QuadPlate.rectangle((1, 1), (3, 3), THICK)
    with pytest.raises(InputError, match="lies outside the plate") as refused:
        InverseFEM(plate, [sensors.StrainGauge(at=(1.4, 0.5), fibre=THICK / 2)])
    assert "x 0 to 1" in str(refused.value)
    with pytest.raises(InputError, match="no gauges"):
        InverseFEM(plate, [])
    with pytest.raises(InputError, match="negative area"):
        QuadPlate(plate.nodes, plate.cells[:, ::-1], THICK)
    with pytest.raises(InputError, match="unknown supports"):
        QuadPlate(plate.nodes, plate.cells, THICK, supports=["99+Z"])
    with pytest.raises(InputError, match="leave a motion open"):
        InverseFEM(QuadPlate(plate.nodes, plate.cells, THICK), gauges(3))
    with pytest.raises(InputError, match="do not fit the gauges"):
        InverseFEM(plate, gauges(3)).estimate(np.zeros(4))
    with pytest.raises(InputError, match="NaN"):
        InverseFEM(plate, gauges(3)).estimate(np.full(18, np.nan))
    with pytest.raises(InputError, match="noise"):
        InverseFEM(plate, gauges(3)).estimate(np.zeros(18)).covariance(np.eye(48))
    with pytest.raises(InputError, match="strains between the nodes"):
        InverseFEM("a plate", gauges(3))
