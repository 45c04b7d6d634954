"""Force maps: forces and tractions kept apart, wrenches about any point, contact, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loadid import LoadEstimate
from structures.errors import InputError
from tactile import ForceMap, GelSlim, Markers, Press
from tactile._results.forcemap import record

from .rigs import NO_PULL, NOISE, PRESS, markers, motion, nodal, pad, sensor


@pytest.fixture(scope="module")
def found() -> ForceMap:
    return sensor().estimate(motion(1))


def test_it_is_a_load_estimate(found: ForceMap) -> None:
    assert isinstance(found, LoadEstimate)
    assert found.load.shape == found.std.shape == (3 * pad().points,)
    assert set(found.units) == {"Pa"}


def test_it_is_printed_in_one_line(found: ForceMap) -> None:
    force = str(found.resultant())
    assert repr(found) == f"<ForceMap, {pad().points} nodes, {force}; {len(found.flags)} flags>"
    assert f"{pad().points} nodes, 2 frames" in repr(record([found, found]))
    assert "no surface" in repr(replace(found, geometry=None))


def test_forces_are_the_boundary_mass_times_tractions(found: ForceMap) -> None:
    assert np.allclose(found.forces(), pad().surface.forces(found.traction()), rtol=1e-12)
    assert np.allclose(found.forces().sum(axis=0), found.resultant().value, rtol=1e-10)


def test_nodal_forces_and_tractions_are_kept_apart() -> None:
    s = GelSlim(pad(), Markers(markers(), NOISE, "XYZ"))
    slim = s.estimate(motion(1))
    assert set(slim.units) == {"N"}
    assert np.allclose(pad().surface.forces(slim.traction()), slim.forces(), atol=1e-12)
    assert np.allclose(slim.forces().sum(axis=0), slim.resultant().value)


def test_the_torque_is_the_moment_of_the_forces(found: ForceMap) -> None:
    f, places = found.forces(), found.nodes
    for about in (None, (1e-3, -2e-3, 4e-3)):
        arms = places - np.array([0.0, 0.0, 3e-3] if about is None else about)
        assert np.allclose(found.torque(about).value, np.cross(arms, f).sum(axis=0), rtol=1e-8, atol=1e-12)


def test_the_std_of_a_torque_moves_with_its_point(found: ForceMap) -> None:
    s = sensor()
    rng, about = np.random.default_rng(0), (2e-3, 1e-3, 3e-3)
    drawn = [s.estimate(motion(1) + NOISE * rng.standard_normal((195, 3))).torque(about).value for _ in range(300)]
    noise = np.std(drawn, axis=0)
    assert np.all(found.torque(about).std > 0.9 * noise)  # noise is a part of it, the prior the rest


def test_contact_is_that_of_the_press(found: ForceMap) -> None:
    touch = sensor(contact=NO_PULL).estimate(motion(1)).contact()
    assert touch.radius == pytest.approx(PRESS.radius, rel=0.08)
    assert np.allclose(touch.centre, PRESS.at, atol=1e-4)
    assert touch.peak == pytest.approx(PRESS.peak, rel=0.1)
    inside = np.hypot(*(found.nodes[:, :2] - np.array(PRESS.at)).T) < 1.2e-3
    assert np.nanmedian(touch.slip[inside]) == pytest.approx(0.25, abs=0.05)
    assert np.all(np.isnan(touch.slip) == ~touch.mask)
    assert "mm" in str(touch)


def test_noise_alone_is_no_contact() -> None:
    quiet = sensor().estimate(NOISE * np.random.default_rng(5).standard_normal((195, 3))).contact()
    assert quiet.mask.sum() <= 0.05 * quiet.mask.size


TWO = (
    Press(at=(-4e-3, 0.5e-3), radius=1.6e-3, force=0.6, shear=(0.1, 0.0)),
    Press(at=(3.5e-3, -0.5e-3), radius=1.8e-3, force=0.3, shear=(0.0, -0.05)),
)


def two_fingers(seed: int) -> np.ndarray:
    """Motion of the markers under two presses, on the pad's own mesh, with noise."""
    here = pad()
    nodal = sum(here.surface.forces(press.traction(here.nodes2d)) for press in TWO)
    u = np.asarray(here.from_surface(markers()) @ here.displacements(nodal).ravel()).reshape(-1, 3)
    return u + NOISE * np.random.default_rng(seed).standard_normal(u.shape)


@pytest.mark.parametrize("choice", [0.01, "upre"])
def test_two_fingers_are_two_contacts_that_add_up(choice: float | str) -> None:
    s = sensor(choice)
    drawn = [s.estimate(two_fingers(seed)) for seed in range(10)]
    for one in drawn:
        found = one.contacts()
        assert len(found) == 2
        for contact, press in zip(found, TWO, strict=True):
            assert np.allclose(contact.centre, press.at, atol=3e-4)
            assert contact.area == pytest.approx(np.pi * press.radius**2, rel=0.5)
            force = here_force(press)
            assert np.all(np.abs(contact.force.value - force) < 4.5 * contact.force.std)
            assert np.all(contact.force.std < 0.05)
        assert np.allclose(sum(c.force.value for c in found), one.resultant().value, atol=1e-12)
        assert not np.any(found[0].mask & found[1].mask)
    scatter = np.std([[c.force.value for c in one.contacts()] for one in drawn], axis=0)
    stated = np.array([c.force.std for c in drawn[0].contacts()])
    assert np.all(scatter < 1.6 * stated)


def here_force(press: Press) -> np.ndarray:
    """Force (3,) of a press as the pad's own mesh has it."""
    return pad().surface.forces(press.traction(pad().nodes2d)).sum(axis=0)


def test_a_single_press_is_one_contact_with_the_resultant(found: ForceMap) -> None:
    (only,) = found.contacts()
    assert np.array_equal(only.force.value, found.resultant().value)
    assert np.array_equal(only.force.std, found.resultant().std)
    assert np.allclose(only.centre, found.contact().centre, atol=2e-4)


@pytest.mark.parametrize("kind", ["multilayer", "slim", "frozen"])
def test_noise_alone_has_no_contacts(kind: str) -> None:
    s = (
        GelSlim(pad(), Markers(markers(), NOISE, "XYZ"))
        if kind == "slim"
        else sensor(0.01 if kind == "frozen" else "upre")
    )
    rng = np.random.default_rng(7)
    assert not any(s.estimate(NOISE * rng.standard_normal((195, 3))).contacts() for _ in range(20))


def test_several_contacts_stand_in_the_numbers(tmp_path: Path) -> None:
    one = sensor().estimate(two_fingers(0))
    one.report(tmp_path / "two.html")
    assert "contact 2" in (tmp_path / "two.html").read_text("utf-8")
    with pytest.raises(InputError, match="one frame"):
        record([one, one]).contacts()


def test_files_give_the_same_map_back(found: ForceMap, tmp_path: Path) -> None:
    found.save(tmp_path / "map.h5")
    again = ForceMap.read(tmp_path / "map.h5")
    assert np.array_equal(again.forces(), found.forces())
    assert np.array_equal(again.resultant().std, found.resultant().std)
    assert again.provided == found.provided
    assert again.codes == found.codes
    slim = GelSlim(pad(), Markers(markers(), NOISE, "XYZ")).estimate(motion(1))
    slim.save(tmp_path / "slim.h5")
    assert np.allclose(ForceMap.read(tmp_path / "slim.h5").traction(), slim.traction())


def test_its_pictures_and_page_are_those_of_a_map(found: ForceMap, tmp_path: Path) -> None:
    figure = found.plot(path=tmp_path / "map.png")
    assert any("pressure" in ax.get_ylabel() for ax in figure.axes)
    found.report(tmp_path / "map.html")
    assert "peak pressure" in (tmp_path / "map.html").read_text("utf-8")
    assert (tmp_path / "map.png").stat().st_size > 10_000
    assert found.plot("load") is not figure


def test_another_result_is_no_force_map(tmp_path: Path) -> None:
    plain = LoadEstimate(load=np.ones(2), std=np.ones(2), labels=["a", "b"], units=["N", "N"])
    plain.save(tmp_path / "plain.h5")
    with pytest.raises(InputError, match="no force map"):
        ForceMap.read(tmp_path / "plain.h5")


def test_a_share_of_the_peak_is_a_share(found: ForceMap) -> None:
    with pytest.raises(InputError, match="share"):
        found.contact(1.5)


def test_vectors_speak(found: ForceMap) -> None:
    assert str(found.resultant()).endswith(") N")
    assert str(found.torque()).endswith(") N m")
    assert nodal().sum(axis=0)[2] == pytest.approx(-1.0, rel=0.05)
