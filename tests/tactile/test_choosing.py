"""Lambda of a force map: neither a noise level that is too low nor correlated noise drives it to zero."""

from __future__ import annotations

import numpy as np
import pytest

from loadid._inverse.choice import PathCurve
from loadid.paths import Choice, RuleResult
from structures.errors import InputError
from tactile import Markers, MultilayerPad, Pad, Press
from tactile._sensors.posing import END, RULES, chosen

from .padtruth import consistent
from .rigs import NOISE, markers, motion, nodal, pad


def sensor(choice: str | None = None, noise: float = NOISE) -> MultilayerPad:
    return MultilayerPad(pad(), Markers(markers(), noise, "XYZ"), choice=choice, penalty="identity")


def error(s: MultilayerPad, y: np.ndarray) -> float:
    return float(np.linalg.norm(s.estimate(y).forces() - nodal()) / np.linalg.norm(nodal()))


def test_one_of_two_is_taken_and_kept() -> None:
    s, alone = sensor(), {}
    for rule in RULES:
        alone[rule] = sensor(rule).calibrate([motion(1), motion(2)]).lam
    found = s.calibrate([motion(1), motion(2)])
    assert found.lam == alone[found.rule]
    assert s.family.choice is None
    assert s.estimate(motion(1)).facts["lambda"] == found.lam


def asked(upre: float, gcv: float, met: float | None, *, rms: float, spent: float = 0.2) -> Choice:
    """What two rules and the discrepancy say of 1000 data of unit noise; rms residual and share spent of any fit."""
    lam = np.geomspace(1e-6, 1, 7)
    said = {"upre": upre, "gcv": gcv, "discrepancy": met, "robust_gcv": 0.02}
    sweep = PathCurve(lam, np.full(7, rms * np.sqrt(1000)), np.ones(7), np.full(7, 1000 * spent))
    return Choice(
        upre, 1.0, "upre", tuple(RuleResult(k, v, v == lam[0]) for k, v in said.items()), sigma=1.0, sweep=sweep
    )


def test_which_of_two_stands() -> None:
    assert chosen(asked(0.02, 0.005, 0.03, rms=1.0), 1000) == "upre"
    assert chosen(asked(0.02, 1.0, 0.03, rms=3.0), 1000) == "upre"  # the end of a range is no choice
    assert chosen(asked(0.02, 0.04, 0.03, rms=1.01), 1000) == "gcv"
    assert chosen(asked(0.02, 0.2, 0.03, rms=1.5), 1000) == "upre"  # its residual is no noise
    assert chosen(asked(0.02, 0.2, 0.03, rms=1.5, spent=0.9), 1000) == "discrepancy"  # where that level is open
    assert chosen(asked(1e-6, 0.04, 2e-4, rms=1.5, spent=0.9), 1000) == "gcv"  # far from any fit to that level
    assert chosen(asked(1e-9, 1e-5, 1e-3, rms=0.1, spent=0.9), 1000) == "robust_gcv"  # both follow everything
    assert chosen(asked(1e-5, 0.04, None, rms=10.0), 1000) == "gcv"
    assert chosen(asked(1e-5, 0.04, 1e-6, rms=10.0), 1000) == "gcv"  # the stated level is nowhere met


@pytest.fixture(scope="module")
def few() -> tuple[Pad, np.ndarray]:
    """A nearly incompressible pad of 20 x 16 x 4 mm with 120 markers."""
    here = Pad(size=(20e-3, 16e-3), thickness=4e-3, E=147e3, nu=0.47, elements=(15, 12), layers=4)
    x, y = np.meshgrid(np.linspace(-9e-3, 9e-3, 12), np.linspace(-7e-3, 7e-3, 10))
    return here, np.column_stack([x.ravel(), y.ravel()])


@pytest.mark.parametrize("noise", [(2e-6, 2e-6, 1e-5), (5e-6, 5e-6, 5e-6)])
def test_the_default_is_as_good_as_the_better_rule(few: tuple[Pad, np.ndarray], noise: tuple[float, ...]) -> None:
    """Truth: the kernels of the layer, exact, and the stated noise."""
    here, m = few
    made = {
        rule: MultilayerPad(here, Markers(m, np.array(noise), "XYZ"), choice=rule, penalty="identity")
        for rule in (None, "upre", "discrepancy")
    }
    rng, ratios = np.random.default_rng(5), []
    for force in (0.06, 0.15, 0.4, 1.0):
        turn, at = rng.uniform(0, 2 * np.pi), rng.uniform(-1, 1, 2) * (3e-3, 2e-3)
        shear = 0.3 * force * np.array([np.cos(turn), np.sin(turn)])
        press = Press(at=tuple(at), radius=rng.uniform(1.5e-3, 3.5e-3), force=force, shear=tuple(shear))
        y = press.displacement(here.layer, m) + np.array(noise) * rng.standard_normal((len(m), 3))
        truth, off = consistent(here, press, 8), {}
        for rule, s in made.items():
            s.calibrate([y])
            off[rule] = float(np.linalg.norm(s.estimate(y).forces() - truth) / np.linalg.norm(truth))
        ratios.append(off[None] / min(off["upre"], off["discrepancy"]))
    assert np.median(ratios) < 1.1
    assert max(ratios) < 1.5


def test_a_load_that_is_finer_than_the_mesh_is_not_smoothed_away() -> None:
    here = Pad(size=(20e-3, 20e-3), thickness=3e-3, E=147e3, nu=0.3223, elements=(20, 20), layers=2, allow=("W115",))
    line = np.linspace(-8.5e-3, 8.5e-3, 16)
    m = np.array([(x, y) for y in line for x in line])
    press = Press(at=(0.3e-3, -0.4e-3), radius=0.9e-3, shear=(0.25, 0.0))
    u = press.displacement(here.layer, m)
    y = u * (0.3e-3 / np.abs(u).max()) + NOISE * np.random.default_rng(1).standard_normal(u.shape)
    made = {
        r: MultilayerPad(here, Markers(m, NOISE, "XYZ"), choice=r, penalty="identity") for r in ("robust_gcv", None)
    }
    assert made["robust_gcv"].calibrate([y]).lam > END
    assert made[None].calibrate([y]).lam < END


def test_one_frame_is_chosen_alike() -> None:
    lams = [sensor(rule).estimate(motion(1)).choice.lam for rule in RULES]  # type: ignore[union-attr]
    found = sensor().estimate(motion(1))
    assert found.choice is not None
    assert found.choice.lam in lams


def test_a_noise_level_that_is_far_too_low_does_no_harm() -> None:
    y = motion(None) + 2e-5 * np.random.default_rng(0).standard_normal(motion().shape)
    told, low, trusting = sensor(noise=2e-5), sensor(noise=4e-7), sensor("discrepancy", noise=4e-7)
    assert error(low, y) < 1.5 * error(told, y)
    assert error(trusting, y) > 2 * error(told, y)  # which is what the second rule is for


def test_a_rule_of_the_user_is_asked_alone() -> None:
    found = sensor("gcv").estimate(motion(1))
    assert found.choice is not None
    assert found.choice.rule == "gcv"
    with pytest.raises(InputError):
        sensor("no rule").estimate(motion(1))
