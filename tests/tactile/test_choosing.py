"""Lambda of a force map: neither a noise level that is too low nor correlated noise drives it to zero."""

from __future__ import annotations

import numpy as np
import pytest

from structures.errors import InputError
from tactile.choosing import END, RULES, larger
from tactile.multilayer import MultilayerPad
from tactile.pad import Pad
from tactile.presses import Press

from .rigs import NOISE, markers, motion, nodal, pad


def sensor(choice: str | None = None, noise: float = NOISE) -> MultilayerPad:
    return MultilayerPad(pad(), markers(), noise=noise, axes="XYZ", choice=choice)


def error(s: MultilayerPad, y: np.ndarray) -> float:
    return float(np.linalg.norm(s.estimate(y).forces() - nodal()) / np.linalg.norm(nodal()))


def test_the_larger_of_two_is_taken_and_kept() -> None:
    s, alone = sensor(), {}
    for rule in RULES:
        alone[rule] = sensor(rule).calibrate([motion(1), motion(2)]).lam
    assert s.calibrate([motion(1), motion(2)]).lam == max(alone.values())
    assert s.family.choice is None
    assert s.estimate(motion(1)).facts["lambda"] == max(alone.values())


def test_the_end_of_a_range_is_no_choice() -> None:
    assert larger([0.02, 1.0]) == 0
    assert larger([1e-13, 0.011]) == 1
    assert larger([0.9, 1.0]) == 0


def test_a_load_that_is_finer_than_the_mesh_is_not_smoothed_away() -> None:
    here = Pad(size=(20e-3, 20e-3), thickness=3e-3, E=147e3, nu=0.3223, elements=(20, 20), layers=2, allow=("W115",))
    line = np.linspace(-8.5e-3, 8.5e-3, 16)
    m = np.array([(x, y) for y in line for x in line])
    press = Press(at=(0.3e-3, -0.4e-3), radius=0.9e-3, shear=(0.25, 0.0))
    u = press.displacement(here.layer, m)
    y = u * (0.3e-3 / np.abs(u).max()) + NOISE * np.random.default_rng(1).standard_normal(u.shape)
    made = {r: MultilayerPad(here, m, noise=NOISE, axes="XYZ", choice=r) for r in ("robust_gcv", None)}
    assert made["robust_gcv"].calibrate([y]).lam > END
    assert made[None].calibrate([y]).lam < END


def test_one_frame_is_chosen_alike() -> None:
    lams = [sensor(rule).estimate(motion(1)).choice.lam for rule in RULES]  # type: ignore[union-attr]
    found = sensor().estimate(motion(1))
    assert found.choice is not None
    assert found.choice.lam == max(lams)


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
