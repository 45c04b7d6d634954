"""Lambda of a force map: neither a noise level that is too low nor correlated noise drives it to zero."""

from __future__ import annotations

import numpy as np
import pytest

from structures.errors import InputError
from tactile.choosing import RULES
from tactile.multilayer import MultilayerPad

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
