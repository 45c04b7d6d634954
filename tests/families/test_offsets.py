"""Constants of channels that no constant load moves: unknowns of the fit, against dense references and without them."""

from typing import Any

import numpy as np
import pytest

from loadid import Deconvolution, Lambda, Penalty
from loadid._families import offsets
from loadid._families.data import gather
from loadid._inverse.nuisances import free
from structures import ForwardModel, beams, damping, loads, sensors

from ..inverse.statespace.dense import operator

DT, SAMPLES = 2e-4, 240
PENALTIES = ("identity", "first_difference")


def model(*kinds: type, modes: int = 6, ratio: float = 0.01) -> ForwardModel:
    """A steel cantilever with sensors along it, struck near its tip."""
    beam = beams.cantilever(
        length=0.6,
        section=beams.Section.rectangle(width=0.04, height=0.01),
        material=beams.materials.steel,
        elements=20,
        damping=damping.Modal(ratio),
    )
    places = np.linspace(0.3, 0.6, len(kinds))
    gauges = [kinds[i](at=float(x), direction="Z", label=f"s{i}") for i, x in enumerate(places)]
    return ForwardModel(beam, gauges, [loads.Point(at=0.5, direction="Z")], modes=modes)


TWO = model(sensors.Accelerometer, sensors.Accelerometer)
MIXED = model(sensors.Accelerometer, sensors.Displacement, sensors.Accelerometer)


def recorded(given: ForwardModel, seed: int = 0, share: float = 0.01, start: int = 5, samples: int = SAMPLES) -> Any:
    """A blow that leaves no quiet part, its record, and the std of the noise."""
    load = np.zeros((samples, 1))
    load[start : start + 12, 0] = 50 * np.sin(np.pi * (np.arange(12) + 0.5) / 12)
    clean = given.state_space(DT).simulate(load)
    noise = share * clean.std(axis=0)
    return load, clean + noise * np.random.default_rng(seed).standard_normal(clean.shape), noise


def stacked(given: ForwardModel, y: Any, noise: Any, channels: Any, lam: float, penalty: str) -> Any:
    """Whitened [H C], data, rows of the penalty, and the least squares of all."""
    samples = len(y)
    H = operator(given.state_space(DT), samples).reshape(-1, samples)
    C = np.tile(np.eye(y.shape[1])[:, channels], (samples, 1))
    white = np.linalg.inv(np.linalg.cholesky(np.diag(noise**2) if noise.ndim == 1 else noise))
    A = np.einsum("st,ktn->ksn", white, np.hstack([H, C]).reshape(samples, y.shape[1], -1)).reshape(len(H), -1)
    data = (y @ white.T).reshape(-1)
    L = np.diff(np.eye(samples), n=PENALTIES.index(penalty), axis=0)
    stack = np.vstack([A, np.hstack([lam * L, np.zeros((len(L), len(channels)))])])
    return stack, np.r_[data, np.zeros(len(L))]


SHIFT = np.array([3.0, -1.2])  # times the noise


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("penalty", PENALTIES)
@pytest.mark.parametrize("path", ["statespace", "dense"])
def test_load_band_and_constants_are_those_of_dense_least_squares(path: str, penalty: str, correlated: bool) -> None:
    _, y, noise = recorded(TWO)
    level = np.outer(noise, noise) * np.array([[1.0, 0.4], [0.4, 1.0]]) if correlated else noise
    y = y + SHIFT * noise
    found = Deconvolution(TWO, noise=level, penalty=penalty, choice=Lambda(1e-3, path=path)).estimate(y, DT)
    stack, data = stacked(TWO, y, level, [0, 1], found.choice.lam * found.choice.scale, penalty)
    exact = np.linalg.lstsq(stack, data)[0]
    assert np.linalg.norm(found.load[:, 0] - exact[:-2]) < 1e-8 * np.linalg.norm(exact[:-2])
    std = np.linalg.norm(np.linalg.inv(np.linalg.qr(stack, mode="r")), axis=1)
    ratio = found.posterior.std[:, 0] / std[:-2]
    assert np.ptp(ratio) < 1e-8 * ratio.min()
    said = [line.split() for line in found.facts.offsets]
    assert [(line[0], line[-1]) for line in said] == [("s0:", "m/s^2"), ("s1:", "m/s^2")]
    assert [float(line[1]) for line in said] == pytest.approx(exact[-2:], rel=1e-3)
    level = [float(line[3]) for line in said]
    assert level[0] / level[1] == pytest.approx(std[-2] / std[-1], rel=0.05)  # two digits are printed
    assert level[0] == pytest.approx(std[-2] * found.facts.noise_level, rel=0.05)
    # what is left holds no constant
    assert np.all(np.abs(found.residual.mean(axis=0)) < 0.5 * noise)


@pytest.mark.parametrize("path", ["dense", "statespace", "toeplitz", "windows"])
@pytest.mark.parametrize("penalty", PENALTIES)
def test_what_is_left_of_other_data_is_exact(path: str, penalty: str) -> None:
    _, y, noise = recorded(TWO)
    family = Deconvolution(TWO, noise=noise, penalty=penalty, choice=Lambda(1e-2, path=path))
    posed = family._pose(gather(y, DT, TWO, None))
    other = np.random.default_rng(5).standard_normal(y.shape)
    stack, _ = stacked(TWO, y, noise, [], 1e-2 * float(posed.path.scale), penalty)
    white = posed.white(other)
    data = np.r_[white.reshape(-1), np.zeros(len(stack) - white.size)]
    left = (data - stack @ np.linalg.lstsq(stack, data)[0])[: white.size].reshape(white.shape)
    tolerance = 1e-3 if path == "windows" else 1e-7
    assert np.linalg.norm(posed.path.left_of(white, 1e-2) - left) < tolerance * np.linalg.norm(left)


def test_generalised_least_squares() -> None:
    """Against the inverse of the covariance; a column that K forgives is told apart from nothing."""
    rng = np.random.default_rng(2)
    A, C = rng.standard_normal((30, 30)), rng.standard_normal((2, 30))
    K = np.eye(30) + A @ A.T
    y = rng.multivariate_normal(np.zeros(30), K) + 5 * C[0]
    inverse = np.linalg.inv(K)
    found = free(C, C @ inverse, inverse @ y, float(y @ inverse @ y), 30, 1.0)
    known = C @ inverse @ C.T
    assert found.mean == pytest.approx(np.linalg.solve(known, C @ inverse @ y))
    noise2 = max((y @ inverse @ y - found.mean @ known @ found.mean) / 28, 1.0)
    assert found.covariance == pytest.approx(np.linalg.inv(known))
    assert found.noise2 == pytest.approx(noise2)
    assert found.chance() < 1e-3 < found.chance(100.0)
    assert free(C, 0 * C, inverse @ y, 1.0, 30, 1.0) is None


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("variance", ["constant", "auto"])
def test_the_answer_is_that_of_the_record_without_the_constant(stated: bool, variance: str) -> None:
    """Two constants, small and as large as the response: one load, to rounding, where lambda is given."""
    _, y, noise = recorded(MIXED)
    family = Deconvolution(MIXED, noise=noise if stated else None, penalty=Penalty("identity", variance=variance))
    clean = family.estimate(y, DT)
    answers = [family.estimate(y + off * y.std(axis=0) * [1, 0, -0.5], DT) for off in (0.1, 1.0)]
    for found in answers:
        assert np.linalg.norm(found.load - clean.load) < 0.2 * np.linalg.norm(clean.std)
        assert len(found.facts.offsets) == 2
        assert "LID-W206" in [f.code for f in found.flags]
    assert np.linalg.norm(answers[0].load - answers[1].load) < 0.02 * np.linalg.norm(clean.std)


def test_with_lambda_given_a_constant_changes_nothing() -> None:
    _, y, noise = recorded(MIXED)
    for path in ("statespace", "dense"):
        family = Deconvolution(MIXED, noise=noise, choice=Lambda(1e-3, path=path))
        one, two = (family.estimate(y + off * y.std(axis=0) * [1, 0, -0.5], DT) for off in (0.3, 2.0))
        assert np.linalg.norm(one.load - two.load) < 1e-6 * np.linalg.norm(one.load)
        assert np.linalg.norm(one.std - two.std) < 1e-6 * np.linalg.norm(one.std)


def test_a_displacement_keeps_its_constant() -> None:
    """A static load may have made it: it is the load's."""
    lasers = model(sensors.Displacement, sensors.Displacement)
    load, noise = np.zeros((300, 1)), recorded(lasers)[2]
    load[5:] = 30.0
    clean = lasers.state_space(DT).simulate(load)
    found = Deconvolution(lasers, noise=noise).estimate(clean + noise * np.random.default_rng(0).standard_normal(
        clean.shape), DT)  # fmt: skip
    assert "offsets" not in found.facts
    assert np.mean(found.load[150:]) == pytest.approx(30.0, rel=0.05)


def test_a_clean_record_is_answered_as_without_the_question(monkeypatch: pytest.MonkeyPatch) -> None:
    _, y, noise = recorded(TWO)
    asked = Deconvolution(TWO, noise=noise).estimate(y, DT)
    monkeypatch.setattr(offsets, "told", lambda *given: None)
    found = Deconvolution(TWO, noise=noise).estimate(y, DT)
    assert "offsets" not in asked.facts
    assert np.array_equal(asked.load, found.load)
    assert np.array_equal(asked.std, found.std)


def test_false_alarms_and_bands_over_seeds() -> None:
    """Loads of the prior: clean records keep their answer but by chance, constants and loads lie in their bands."""
    alarms, constants, off, samples = 0, [], [], 160
    H, noise = operator(TWO.state_space(DT), samples)[..., 0], np.array([40.0, 60.0])
    lam = 3e-3 * np.linalg.norm((H / noise[:, None]).reshape(-1, samples), 2)
    family = Deconvolution(TWO, noise=noise, choice=3e-3, penalty=Penalty("identity", variance="constant"))
    for seed in range(60):
        rng = np.random.default_rng(seed)
        load = rng.standard_normal(samples) / lam
        y = H @ load + noise * rng.standard_normal((samples, 2))
        alarms += "offsets" in family.estimate(y, DT).facts
        found = family.estimate(y + SHIFT * noise, DT)
        off.append((found.load[:, 0] - load) / found.std[:, 0])
        for line, true in zip(found.facts.offsets, SHIFT * noise, strict=True):
            constants.append((float(line.split()[1]) - true) / float(line.split()[3]))
    assert alarms <= 2
    assert 0.8 < np.sqrt(np.mean(np.square(constants))) < 1.2
    assert 0.9 < np.sqrt(np.mean(np.square(off))) < 1.05  # the noise level of a band is that stated, or above it


def test_a_record_that_starts_in_motion_is_said_to(monkeypatch: pytest.MonkeyPatch) -> None:
    _, y, noise = recorded(TWO, samples=600)
    cut = y[40:]
    found = Deconvolution(TWO, noise=noise).estimate(cut, DT)
    monkeypatch.setattr(offsets, "told", lambda *given: None)
    before = Deconvolution(TWO, noise=noise).estimate(cut, DT)
    assert "LID-W518" in [f.code for f in before.flags]
    assert [f.code for f in found.flags] == [f.code for f in before.flags]
    assert np.array_equal(found.load, before.load)


@pytest.mark.parametrize("periods", [0.5, 1.0])
def test_a_slow_load_is_no_offset(periods: float) -> None:
    """What accelerometers see of a load slower than all modes is little, and curved: it is answered, not refused."""
    t = np.arange(600)
    load = 40 * np.sin(2 * np.pi * periods * t / 600)[:, None]
    clean = TWO.state_space(DT).simulate(load)
    noise = 0.01 * clean.std(axis=0)
    y = clean + noise * np.random.default_rng(1).standard_normal(clean.shape)
    found = Deconvolution(TWO, noise=noise, penalty="second_difference").estimate(y, DT)
    inside = np.abs(found.load - load) < 3 * found.std
    assert np.mean(inside) > 0.9


@pytest.mark.parametrize("path", ["toeplitz", "dense"])
def test_a_path_without_states_takes_the_constant_off(path: str) -> None:
    """The same load as without it, to a part of its band; the flag says what the band does not hold."""
    _, y, noise = recorded(TWO)
    family = Deconvolution(TWO, noise=noise, choice=Lambda(3e-3, path=path), penalty="identity")
    clean, found = (family.estimate(y + off * noise, DT) for off in (0.0, SHIFT * 5))
    assert np.linalg.norm(found.load - clean.load) < 0.3 * np.linalg.norm(clean.std)
    (flag, *_) = [f for f in found.flags if f.code == "LID-W206"]
    assert ("does not hold" in flag.message) == (path == "toeplitz")
