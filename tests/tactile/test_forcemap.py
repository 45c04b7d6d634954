"""Force maps: forces and tractions kept apart, wrenches about any point, contact, files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loadid import LoadEstimate
from structures.errors import InputError
from tactile import ForceMap, GelSlim, Markers

from .rigs import NO_PULL, NOISE, PRESS, markers, motion, nodal, pad, sensor


@pytest.fixture(scope="module")
def found() -> ForceMap:
    return sensor().estimate(motion(1))


def test_it_is_a_load_estimate(found: ForceMap) -> None:
    assert isinstance(found, LoadEstimate)
    assert found.load.shape == found.std.shape == (3 * pad().points,)
    assert set(found.units) == {"Pa"}


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
