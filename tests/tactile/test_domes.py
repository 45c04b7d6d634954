"""Domed gels and gels held in a rim: equilibrium, reactions, refinement, the flat limit, normals, a sensor on one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from structures._elements import solids
from structures._elements.members import Material
from structures.errors import InputError
from tactile import ContactLaw, Markers, MultilayerPad, Pad, Wrench
from tactile._pad.padfile import read

from .domes import GEL, HEIGHT, PLINTH, RADIUS, DomePress, calibration, dome, markers, motion

PRESS = DomePress(at=(1e-3, -0.5e-3), radius=2.5e-3, force=1.0, shear=0.2)
NOISE = 2e-6


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


# -- the body ---------------------------------------------------------------------------------------------------------
def test_the_surface_is_the_cap() -> None:
    here = dome()
    R = (RADIUS**2 + (HEIGHT - PLINTH) ** 2) / (2 * (HEIGHT - PLINTH))
    x, y, z = here.surface.coordinates.T
    assert np.abs(x**2 + y**2 + (z - HEIGHT + R) ** 2 - R**2).max() < 1e-12
    assert here.surface.area == pytest.approx(2 * np.pi * R * (HEIGHT - PLINTH), rel=0.015)
    sphere = (here.surface.coordinates - [0.0, 0.0, HEIGHT - R]) / R
    off = np.linalg.norm(here.surface.normals - sphere, axis=1)
    assert off[~here.edge].max() < 0.02
    assert off.max() < 0.05
    assert here.top == (0.0, 0.0, HEIGHT)


def test_forces_are_those_that_moved_it_and_the_base_carries_them() -> None:
    here = dome(1e-3, 4)
    f = PRESS.forces(here)
    U = here.displacements(f)
    assert relative(here.forces(U), f) < 1e-10
    assert relative(here.stiffness @ U.ravel(), f.ravel()) < 1e-9
    held = here.reactions(f)
    assert np.allclose(held.sum(axis=0), -f.sum(axis=0), atol=1e-12)
    arms = here.structure.coordinates[: len(held)] - np.array(here.top)
    assert np.allclose(np.cross(arms, held).sum(axis=0), -here.resultant(f)[3:], atol=1e-13)


def test_refinement_settles() -> None:
    """Depth of the apex under a smooth pressure along the normals: every finer mesh lies nearer to the finest."""
    deep = []
    for pitch, layers in ((2e-3, 2), (4e-3 / 3, 3), (1e-3, 4), (0.5e-3, 6)):
        here = dome(pitch, layers, allow=("W115",))
        t = -5e3 * here.surface.normals * np.exp(-np.sum(here.nodes2d**2, axis=1) / 3e-3**2)[:, None]
        apex = int(np.argmin(np.sum(here.nodes2d**2, axis=1)))
        deep.append(float(here.displacements(here.surface.forces(t))[apex, 2]))
    print(deep)
    off = np.abs(np.array(deep[:-1]) / deep[-1] - 1)
    assert np.all(np.diff(off) < 0)
    assert off[-1] < 0.03


def test_a_cap_without_a_rise_is_the_flat_pad() -> None:
    size = {"size": (12e-3, 12e-3), "thickness": 3e-3, "pitch": 1e-3, "layers": 3, **GEL}
    flat, curved = Pad(**size), Pad(**size, curvature=100.0)
    press = DomePress(radius=2.5e-3)
    a, b = (here.displacements(press.forces(here)) for here in (flat, curved))
    assert relative(b, a) < 1e-4
    assert np.ptp(curved.surface.coordinates[:, 2]) < 1e-6


def test_a_steep_dome_is_loaded_to_its_rim() -> None:
    here = Pad.dome(6e-3, 4.4e-3, plinth=1e-3, pitch=0.75e-3, **GEL)
    assert len(here.surface.nodes) * (here.layers + 1) == len(here.structure.coordinates)
    assert here.surface.normals[here.edge, 2].max() < 0.75


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"radius": 8e-3, "height": 4e-3, "plinth": 4e-3}, "no spherical cap"),
        ({"radius": 2e-3, "height": 8e-3, "plinth": 1e-3}, "no spherical cap"),
        ({"radius": 8e-3, "height": 4e-3, "plinth": 0.0}, "plinth"),
        ({"radius": 8e-3, "height": 4e-3, "plinth": 1e-6}, "comes down to its base"),
    ],
)
def test_caps_that_are_none(given: dict, what: str) -> None:
    with pytest.raises(InputError, match=what):
        Pad.dome(**given, **GEL)
    with pytest.raises(InputError, match="comes down"):
        Pad(size=(20e-3, 20e-3), thickness=3e-3, curvature=12e-3, pitch=1e-3, **GEL)


def test_a_pad_file_has_domes_and_rims(tmp_path) -> None:
    file = tmp_path / "pad.toml"
    common = 'E = "0.147 MPa"\nnu = 0.45\npitch = "1 mm"\nlayers = 4\n'
    file.write_text(f'[pad]\nshape = "dome"\nradius = "8 mm"\nheight = "4 mm"\nplinth = "1.5 mm"\n{common}')
    here, wanted = Pad.from_toml(file), dome(1e-3, 4)
    assert np.array_equal(here.surface.coordinates, wanted.surface.coordinates)
    file.write_text(
        f'[pad]\nsize = ["16 mm", "12 mm"]\nthickness = "4 mm"\ncurvature = "40 mm"\nrim = "bonded"\n{common}'
    )
    here = Pad.from_toml(file)
    assert here.rim == "bonded"
    assert here.curvature == 0.04
    file.write_text(f'[pad]\nshape = "dome"\nradius = "8 mm"\nheight = "4 mm"\nplinth = "5 mm"\n{common}')
    with pytest.raises(InputError, match=r"pad\.toml"):
        read(file)


# -- held in a rim ----------------------------------------------------------------------------------------------------
def whole_rim(nx: int, layers: int) -> float:
    """Depth at the middle of a gel whose sides are held over all of their height, under a pressure in its middle."""
    material = Material(E=GEL["E"], rho=1000.0, nu=GEL["nu"])
    lengths, cells = (12e-3, 12e-3, 4e-3), (nx, nx, layers)
    block = solids.block(lengths=lengths, elements=cells, material=material, element="bbar",
                         origin=(-6e-3, -6e-3, 0.0), fixed=("bottom", "left", "right", "front", "back"))  # fmt: skip
    top = block.field.surface("top")
    f = np.zeros((block.n // 3, 3))
    f[top.nodes] = top.forces(pressure(top.coordinates))
    u = block.expand(np.asarray(solve(block, f.ravel()))).reshape(-1, 3)
    return float(u[top.nodes[np.argmin(np.sum(top.coordinates[:, :2] ** 2, axis=1))], 2])


def solve(block, f: np.ndarray) -> np.ndarray:
    from scipy.sparse.linalg import spsolve

    return spsolve(block.K_free.tocsc(), f[block.free])


def pressure(places: np.ndarray) -> np.ndarray:
    """A smooth pressure (Pa) as tractions."""
    return np.array([0.0, 0.0, -5e3]) * np.exp(-np.sum(places[:, :2] ** 2, axis=1) / 3e-3**2)[:, None]


def test_a_bonded_rim_holds_and_carries() -> None:
    size = {"size": (12e-3, 12e-3), "thickness": 4e-3, "pitch": 1e-3, "layers": 4, **GEL}
    free, held = Pad(**size), Pad(**size, rim="bonded")
    f = held.surface.forces(pressure(held.surface.coordinates))
    a, b = free.displacements(f), held.displacements(f)
    assert relative(held.forces(b), f) < 1e-10
    assert np.allclose(held.reactions(f).sum(axis=0), -f.sum(axis=0), atol=1e-12)
    assert b[:, 2].min() > a[:, 2].min()  # stiffer
    assert np.abs(b[held.edge]).max() < 0.7 * np.abs(a[free.edge]).max()  # the topmost layer is a free lip
    wide = {**size, "size": (40e-3, 40e-3), "pitch": 1.25e-3}
    a, b = (
        p.displacements(p.surface.forces(pressure(p.surface.coordinates)))
        for p in (Pad(**wide), Pad(**wide, rim="bonded"))
    )
    assert relative(b, a) < 0.05  # a rim far away says little
    with pytest.raises(InputError, match="rim"):
        Pad(**size, rim="glued")


def test_a_bonded_rim_goes_to_that_of_sides_held_to_the_top() -> None:
    truth = whole_rim(24, 8)
    found = []
    for pitch, layers in ((1.5e-3, 3), (0.75e-3, 6)):
        here = Pad(size=(12e-3, 12e-3), thickness=4e-3, pitch=pitch, layers=layers, rim="bonded", **GEL)
        u = here.displacements(here.surface.forces(pressure(here.surface.coordinates)))
        found.append(float(u[np.argmin(np.sum(here.nodes2d**2, axis=1)), 2]))
    print(found, truth)
    assert abs(found[1] - truth) < abs(found[0] - truth)
    assert found[1] == pytest.approx(truth, rel=0.04)


# -- a sensor on a dome -----------------------------------------------------------------------------------------------
def estimated(pad: Pad, press: DomePress, seed: int = 0):
    """Map of the motion of markers on the true dome, read with a model."""
    at = markers()
    u = motion(at, press) + NOISE * np.random.default_rng(seed).standard_normal((len(at), 3))
    return MultilayerPad(pad, Markers(at, NOISE, "XYZ"), penalty="identity").estimate(u)


def on_nodes(pad: Pad, press: DomePress) -> np.ndarray:
    """True tractions at the nodes of a model."""
    here = dome()
    return np.nan_to_num(LinearNDInterpolator(here.nodes2d, press.tractions(here))(pad.nodes2d))


def cosine(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sum(a * b) / np.linalg.norm(a) / np.linalg.norm(b))


@pytest.mark.parametrize("press", [PRESS, *calibration(2)])
def test_a_dome_is_read_by_its_own_shape(press: DomePress) -> None:
    model = dome(1e-3, 4)
    found = estimated(model, press)
    force, truth = found.resultant(), press.resultant(dome())
    assert cosine(found.traction(), on_nodes(model, press)) > 0.985
    assert np.allclose(force.value, truth, atol=0.05 * abs(truth[2]))
    assert np.all(np.abs(force.value - truth) < 4 * force.std)


def test_a_dome_read_as_a_flat_pad_has_a_good_map_and_a_wrong_force() -> None:
    """What a user sees who models a dome by its mean thickness: nothing in the band, the map looks right."""
    flat = Pad(size=(16e-3, 16e-3), thickness=3e-3, pitch=1e-3, layers=4, **GEL)
    found = estimated(flat, PRESS)
    force, truth = found.resultant(), PRESS.resultant(dome())
    error = abs(force.value[2] - truth[2])
    print(f"Fz {force.value[2]:.3f} for {truth[2]:.3f}, {error / force.std[2]:.1f} stds")
    assert cosine(found.traction(), on_nodes(flat, PRESS)) > 0.96
    assert error > 0.4 * abs(truth[2])
    assert error > 4 * force.std[2]


def test_pressure_is_that_along_the_normal() -> None:
    """A frictionless press on the slope of a dome: no shear, whatever X and Y say."""
    side = DomePress(at=(3.5e-3, 0.0), radius=2e-3)
    model = dome(0.7e-3, 5)
    found = estimated(model, side)
    touch = found.contact()
    tilt = np.tan(np.arcsin(3.5e-3 / 14.05e-3))
    t = found.traction()
    along_z = np.hypot(t[:, 0], t[:, 1]) / -t[:, 2]
    inside = np.hypot(*(found.nodes[:, :2] - side.at).T) < 1.2e-3
    assert np.median(along_z[inside]) == pytest.approx(tilt, rel=0.15)
    assert np.median(touch.slip[inside]) < 0.08
    truth = on_nodes(model, side)
    peak = np.sqrt(np.sum(truth**2, axis=1)).max()
    assert touch.peak == pytest.approx(peak, rel=0.15)
    assert found.normals is not None
    assert np.allclose(np.linalg.norm(found.normals, axis=1), 1.0)
    flat = estimated(Pad(size=(16e-3, 16e-3), thickness=3e-3, pitch=2e-3, layers=4, **GEL), side)
    assert flat.normals is None
    assert np.array_equal(flat.pressure(), -flat.traction()[:, 2])


def test_constraints_hold_along_the_local_normal() -> None:
    """A frictionless press on a slope of .25, on a coarse mesh: no pull, and a friction of .15, along its normals."""
    model, slope = dome(1.2e-3, 4), DomePress(at=(3.5e-3, 0.0), radius=2e-3, force=0.4)
    at, truth = markers(), on_nodes(dome(1.2e-3, 4), slope)
    u = motion(at, slope) + NOISE * np.random.default_rng(1).standard_normal((len(at), 3))
    settings = {"friction": ({"penalty": "identity", "choice": 0.02}, {"choice": 0.01}), "no pull": ({"choice": 0.01},)}
    for law, given in settings.items():
        contact = ContactLaw(friction=0.15) if law == "friction" else ContactLaw(no_pull=True)
        for each in given:
            found = MultilayerPad(model, Markers(at, NOISE, "XYZ"), contact=contact, **each).estimate(u)
            pressure, t = found.pressure(), found.traction()
            assert pressure.min() > -1e-6 * pressure.max()
            if law == "friction":
                shear = np.linalg.norm(t + pressure[:, None] * found.normals, axis=1)
                assert np.all(shear <= 0.15 * pressure + 1e-6 * pressure.max())
            print(law, relative(t, truth), found.resultant().value, slope.resultant(dome()))
            assert relative(t, truth) < 0.29  # with Z for the normal, or a mesh that is taken to be exact, more
            assert np.allclose(found.resultant().value, slope.resultant(dome()), atol=0.03)


def test_a_wrench_on_a_slope_is_what_its_normals_carry() -> None:
    model = dome(2e-3, 3)
    press = ContactLaw(friction=0.3)
    sensor = MultilayerPad(model, Markers(markers(2e-3), NOISE, "XYZ"), contact=press, choice=0.05, penalty="identity")
    u = motion(markers(2e-3), DomePress(at=(4e-3, 0.0), radius=2e-3, force=0.4))
    found = sensor.estimate(u, wrench=Wrench([-0.16, 0.0, -0.4])).resultant()  # .4 to Z, a tenth to the normal there
    assert np.allclose(found.value, (-0.16, 0.0, -0.4), atol=1e-4)
    with pytest.raises(InputError, match="cannot carry"):
        sensor.estimate(u, wrench=Wrench([-0.5, 0.0, -0.2]))
