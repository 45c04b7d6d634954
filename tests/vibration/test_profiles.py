"""Specifications against published figures and closed forms; what does not fit is refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from loadid.vibration import Limit, Profile, Target
from structures.errors import InputError

from .. import lab

G = 9.80665


def test_a_published_random_specification_has_its_published_rms() -> None:
    """The screening spectrum of NAVMAT P-9492: +3 dB/octave to 80 Hz, .04 g^2/Hz to 350 Hz, -3 to 2 kHz: 6.06 g rms."""
    profile = Profile.from_slopes([20, 80, 350, 2000], [3, 0, -3], level=0.04, at=100, unit="g^2/Hz")
    assert profile.rms / G == pytest.approx(6.06, abs=0.01)
    assert profile.at([20.0, 160.0])[0] == pytest.approx(0.04 * G**2 * 10 ** (-0.6), rel=1e-9)
    assert profile.raised(-6).rms == pytest.approx(profile.rms * 10 ** (-0.3))


def test_the_rms_is_the_integral() -> None:
    profile = Profile([10, 40, 41, 300], [1e-3, 2e-2, 2e-2 * 40 / 41, 5e-4], "V^2/Hz")
    f = np.geomspace(10, 300, 400_001)
    assert profile.rms == pytest.approx(np.sqrt(np.trapezoid(profile.at(f), f)), rel=1e-6)


@pytest.mark.parametrize("spelled", ["g2/Hz", "g²/Hz", "g**2/Hz", "(g)^2/Hz", "g^2 / Hz"])
def test_a_density_is_one_however_it_is_spelled(spelled: str) -> None:
    own, plain = Profile([10, 20], [1, 2], spelled), Profile([10, 20], [1, 2], "g^2/Hz")
    assert own.density
    assert own.unit == plain.unit
    np.testing.assert_array_equal(own.levels, plain.levels)


def test_slopes_of_amplitudes_are_twice_as_flat_on_paper() -> None:
    sine = Profile.from_slopes([10, 20, 40], [6.0206, 0], level=1.0, at=20, unit="g")
    assert np.allclose(sine.levels / G, [0.5, 1, 1], rtol=1e-4)
    assert not sine.density


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Profile([20, 10], [1, 1], "g^2/Hz"), "ascending"),
        (lambda: Profile([10, 30, 20], [1, 1, 1], "g^2/Hz"), "20 Hz after 30 Hz"),
        (lambda: Profile([10, 20], [-30, -36], "g^2/Hz"), "-30 at 10 Hz.*dB"),
        (lambda: Profile([10, 20], [1, 1], "g/sqrt(Hz)"), r"density such as g\^2/Hz.*square"),
        (lambda: Profile([10, 20], [1, 1], "grms"), r"density such as g\^2/Hz"),
        (lambda: Profile([10, 20], [1, 1], "g/Hz"), r"density such as g\^2/Hz"),
        (lambda: Profile([0, 10], [1, 1], "g^2/Hz"), "no logarithm"),
        (lambda: Profile([10, 20], [1, 0], "g"), "no logarithm"),
        (lambda: Profile([10], [1], "g"), "no breakpoints"),
        (lambda: Profile([10, 20], [1, 1], "gg"), "unknown unit"),
        (lambda: Profile([10, 20], [1, np.nan], "g"), "no breakpoints"),
        (lambda: Profile([10, 20], [1, 1], "g").rms, "no rms"),
        (lambda: Profile([10, 20], [1, 1], "g").at([30.0]), "outside the breakpoints"),
        (lambda: Profile.from_slopes([10, 20], [1, 2], level=1, at=10, unit="g"), "do not fit"),
        (lambda: Profile.from_slopes([10, 20], [1], level=1, at=30, unit="g"), "outside the breakpoints"),
        (lambda: Limit("a"), "one number or profile"),
        (lambda: Limit("a", rms=1, density=2), "one number or profile"),
        (lambda: Limit("a", rms=-1), "positive"),
        (lambda: Limit("a", density=1.0, unit="g"), "other kind"),
        (lambda: Limit("a", density=Profile([1, 2], [1, 1], "g")), "other kind"),
        (lambda: Target([1.0, 2.0], [[1.0], [-1.0]], ["a"]), "none below 0"),
        (lambda: Target([1.0, 2.0], [[1.0, 1.0]], ["a"]), "do not fit"),
        (lambda: Target([1.0], [[1.0, 1.0]], ["a", "a"]), "doubled"),
        (lambda: Target([1.0], [[1.0]], ["a"], kind="swept"), "unknown kind"),
        (lambda: Target([1.0], [[1.0]], ["a"], phases=[[0.0]]), "phases belong"),
        (lambda: Target.of(lab.shaken(), {"a9": Profile([60, 900], [1, 1], "g^2/Hz")}), "no sensor 'a9'"),
        (lambda: Target.of(lab.shaken(), Profile([60, 900], [1, 1], "V^2/Hz")), "not that of the channel"),
        (lambda: Target.of(lab.shaken(), Profile([1, 2], [1, 1], "g")), "no line of the model"),
    ],
)
def test_what_is_no_specification_is_refused(make, says: str) -> None:
    with pytest.raises(InputError, match=says):
        make()


def test_a_target_takes_the_lines_of_the_model_inside_its_profiles() -> None:
    profile = Profile([100, 500], [0.01, 0.02], "g^2/Hz")
    target = Target.of(lab.shaken(), {"a1": profile, "a3": profile})
    f = lab.field().frequencies
    assert np.array_equal(target.frequencies, f[(f >= 100) & (f <= 500)])
    assert target.labels == ("a1", "a3")
    assert np.allclose(target.levels[:, 0], profile.at(target.frequencies))
