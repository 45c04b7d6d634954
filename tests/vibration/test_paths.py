"""Transfer path analysis against the closed form of the blocked forces, and on sensors that were kept out."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import Record, Spectra
from loadid.vibration import VirtualPoint, transfer_paths
from loadid.vibration._paths import at_points
from structures import CrossSpectra
from structures._models import mapped as virtual
from structures.errors import InputError, NotIdentifiable

from .. import mounted
from ..linecases import BAND95

UP = (0.0, 0.0, 1.0)
MOTIONS = ("Z", "RX", "RY")


def foot(sensors: bool = True) -> VirtualPoint:
    around = {n: (p, UP) for n, p in mounted.AROUND.items()} if sensors else {}
    return VirtualPoint("foot", {n: (p, UP) for n, p in mounted.HITS.items()}, around, motions=MOTIONS)


def spectra(case: mounted.Mounted) -> Spectra:
    noise = {"noise": case.noise, "noise_source": "covariance"} if case.noise else {}
    return Spectra(case.model.frequencies, case.operation, case.model.sensors, **noise)


def test_blocked_forces_are_those_of_the_closed_form() -> None:
    """Without noise to rounding: the assembly is solved with its mesh, the truth by the springs of the source alone."""
    case = mounted.made(noise=0.0)
    found = transfer_paths(case.model, spectra(case), points=[foot()], validation=mounted.KEPT, choice=0)
    size = np.linalg.norm(case.blocked, axis=0)
    assert np.all(np.linalg.norm(found.estimate.load[:, :3] - case.blocked, axis=0) < 1e-6 * size)
    assert found.estimate.labels == ("foot+Z", "foot+RX", "foot+RY", "beside")
    assert found.estimate.units == ("N", "N*m", "N*m", "N")


def test_with_noise_they_lie_in_their_band_and_the_kept_sensors_are_met() -> None:
    case = mounted.made()
    found = transfer_paths(case.model, spectra(case), points=[foot()], validation=mounted.KEPT)
    off = np.abs(found.estimate.load[:, :3] - case.blocked)
    assert np.mean(off <= BAND95 * found.estimate.std[:, :3]) > 0.9
    assert np.all(np.asarray(found.held_out.comparison.correlation) > 0.999)
    assert max(found.held_out.comparison.error) < 0.04
    assert found.flags == ()
    assert found.estimate.grade.letter in "AB"


def test_the_ranking_is_that_of_the_truth_within_its_band() -> None:
    case, clean = mounted.made(), mounted.made(noise=0.0)
    found = transfer_paths(case.model, spectra(case), points=[foot()], validation=mounted.KEPT)
    T = foot().columns()
    rows = [list(mounted.SEEN).index(k) for k in mounted.KEPT]
    power = np.sum(np.abs(clean.model.H[:, rows, :4] @ T * case.blocked[:, None]) ** 2, axis=0)
    true = power / power.sum(axis=1, keepdims=True)
    for i, name in enumerate(mounted.KEPT):
        for label, share, std in found.ranking(name):
            if label != "beside":
                assert abs(share - true[i, found.estimate.labels.index(label)]) < 4 * std + 1e-4, label
    assert [label for label, _, _ in found.ranking()][:2] == ["foot+Z", "foot+RY"]


def test_contact_points_without_a_virtual_point_stay_as_they_are() -> None:
    case = mounted.made()
    found = transfer_paths(case.model, spectra(case), receivers=["k1"])
    assert found.estimate.labels == (*mounted.HITS, "beside")
    assert np.array_equal(at_points(case.model, []).T, np.eye(5))
    assert np.array_equal(at_points(case.model, [foot()]).T[:, 3], [0, 0, 0, 0, 1])
    assert found.held_out is None
    assert "nothing tells" in found.summary()


def test_cross_spectra_are_taken_too() -> None:
    case = mounted.made()
    S = case.operation[:, :, None] * case.operation[:, None, :].conj()
    operation = CrossSpectra(case.model.frequencies, S, channels=case.model.sensors, averages=50)
    found = transfer_paths(case.model, operation, points=[foot()], validation=["k1"], receivers=["k2"])
    truth = np.abs(case.blocked[:, 0]) ** 2
    assert abs(np.sum(found.estimate.load[:, 0]) / np.sum(truth) - 1) < 0.1
    assert found.contributions.sensors[0].label == "k2"
    assert found.ranking("k2")[0][2] > 0


def test_an_interface_that_bends_is_said() -> None:
    bent, stiff = mounted.made(bent=1.0), mounted.made()
    found = transfer_paths(bent.model, spectra(bent), points=[foot()], validation=["k1"])
    assert [f.code for f in found.flags if f.code == "LID-W119"]
    assert np.median(found.rigid["foot"]) < 0.9
    assert not transfer_paths(stiff.model, spectra(stiff), points=[foot()], validation=["k1"]).flags
    assert not transfer_paths(bent.model, spectra(bent), points=[foot(sensors=False)], validation=["k1"]).rigid


@pytest.mark.parametrize("seed", [0, 21])
def test_hits_that_stand_elsewhere_are_said(seed: int) -> None:
    """Two millimetres, at which the bands of the moments hold a quarter of their lines."""
    case, right = mounted.made(seed=seed), foot()
    places = {n: ((x + (2e-3 if n in ("h1", "h3") else -2e-3), y + 2e-3, z), u)
              for n, ((x, y, z), u) in right.loads.items()}  # fmt: skip
    wrong = VirtualPoint("foot", places, right.sensors, motions=MOTIONS)
    found = transfer_paths(case.model, spectra(case), points=[wrong], validation=["k1"])
    (flag,) = (f for f in found.flags if f.code == "LID-W119")
    assert flag.evidence.value > 10
    assert right.contradiction(case.model, case.model.frequencies) == pytest.approx(1.0, abs=0.15)
    bare = mounted.made(noise=0.0).model
    assert right.contradiction(bare, bare.frequencies) is None


def test_the_rigid_share_is_that_of_a_projection() -> None:
    rng = np.random.default_rng(0)
    places, ways = rng.standard_normal((9, 3)), np.tile(np.eye(3), (3, 1))
    R = virtual.rigid(places, ways)
    x = R @ rng.standard_normal(6) + 0j
    null = np.linalg.svd(R)[0][:, 6]
    mixed = x + 0.5 * np.linalg.norm(x) * null
    share = virtual.rigid_share(np.stack([x, mixed]), places, ways)
    assert np.allclose(share, [1.0, 0.8])
    with pytest.raises(InputError, match="more than 6"):
        virtual.rigid_share(np.ones((1, 6)), places[:6], ways[:6])


def test_a_point_of_hits_along_one_axis_has_its_three_motions() -> None:
    T = virtual.loads_of(list(mounted.HITS.values()), [UP] * 4, motions=MOTIONS)
    moments = np.cross(list(mounted.HITS.values()), [UP] * 4)
    assert np.allclose(T.sum(axis=0), [1, 0, 0])
    assert np.allclose(moments.T @ T, [[0, 1, 0], [0, 0, 1], [0, 0, 0]])
    with pytest.raises(NotIdentifiable, match="RX"):
        virtual.loads_of([(0, 0, 0), (0.1, 0, 0)], [UP] * 2, motions=MOTIONS)
    with pytest.raises(InputError, match="in this order"):
        virtual.loads_of(list(mounted.HITS.values()), [UP] * 4, motions=("RX", "Z"))


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({}, "no receiver"),
        ({"validation": ["k9"]}, "no sensor 'k9'"),
        ({"validation": ["k1"], "points": [foot(), foot()]}, "one virtual point"),
        ({"validation": ["k1"], "points": [VirtualPoint("foot", {"h9": ((0, 0, 0), UP)}, motions=("Z",))]}, "'h9'"),
        ({"validation": ["k1"], "operation": Record(np.ones((9, 2)), 0.1)}, "over frequency"),
    ],
)
def test_what_does_not_fit_is_refused(settings: dict, says: str) -> None:
    case = mounted.made()
    operation = settings.pop("operation", spectra(case))
    with pytest.raises(InputError, match=says):
        transfer_paths(case.model, operation, **settings)


def test_the_picture_is_drawn(tmp_path) -> None:
    case = mounted.made()
    transfer_paths(case.model, spectra(case), points=[foot()], validation=mounted.KEPT).plot(path=tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 20_000
