"""What is recommended: by evidence where a model carries processes, with the declared class where that says nothing."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import Record, recommend
from loadid._families import recommend as advice
from loadid._families.posing import PosingSettings
from loadid._families.posing.sparsity import pose
from loadid._families.recommend import of_sparse
from loadid.settings import Lambda, Noise, Penalty
from structures import ImpulseModel, InputError, StateSpace
from tests.tracked import Tracked, bm2

SAID = "data sheet"


@cache
def case(kind: str = "matern") -> Tracked:
    return bm2(kind, 0, samples=400)


@cache
def space(rows: tuple[int, ...] = (0, 1, 2, 3)) -> StateSpace:
    plain = case().setup.space()
    return StateSpace(
        plain.A, plain.B, plain.C[list(rows)], plain.D[list(rows)], plain.dt, plain.hold,
        sensors=[plain.sensors[i] for i in rows], loads=plain.loads,
    )  # fmt: skip


@cache
def plainly() -> advice.Recommendation:
    return recommend(space(), case().y, case().dt, noise=case().noise)


def test_a_process_is_recognised_and_run():
    """The load is a Matern-3/2 process; the recommendation runs it, and states the prior in words."""
    c, found = case(), plainly()
    assert found.prior == "matern32"
    assert found.evidence["matern32"] == 0
    assert found.evidence["matern52"] > 10
    assert "Matern-3/2" in found.reason
    estimate = found.estimate(c.y, c.dt)
    off = estimate.load[:, 0] - c.load[:, 0]
    assert np.linalg.norm(off) < 0.03 * np.linalg.norm(c.load)
    assert np.mean(np.abs(off) < 1.96 * estimate.std[:, 0]) > 0.9
    assert "Matern-3/2" in estimate.provenance["prior"]


@pytest.mark.parametrize(("load_class", "fits"), [(None, 6), ("impact", 12)])
def test_progress_has_even_steps_and_says_what_is_to_come(load_class, fits):
    c, heard = case(), list[tuple[float, str]]()
    recommend(space(), c.y, c.dt, noise=Noise(c.noise, source=SAID), load_class=load_class,
              progress=lambda fraction, text: heard.append((fraction, text)))  # fmt: skip
    shares = [fraction for fraction, _ in heard]
    assert shares[0] == 0
    assert shares[-1] == 1
    assert shares[:-1] == pytest.approx(np.arange(len(shares) - 1) / fits)
    assert len(shares) in (fits, fits + 1)  # heights of spikes are asked where spikes are the best
    for k, (_, text) in enumerate(heard[1:-1], 2):
        assert f"(fit {k} of {fits}, about " in text
        assert text.endswith(" s to go)")


def test_a_record_of_some_sensors_and_in_any_unit():
    """The same prior, the same load; channels found by their labels."""
    c = case()
    labels = [s.label for s in space().sensors]
    some = recommend(space(), c.y, c.dt, noise=Noise(c.noise[[3, 1]], source=SAID), sensors=[labels[3], labels[1]])
    record = Record(c.y[:, [1, 3]], c.dt, [space().sensors[i] for i in (1, 3)])
    one, two = some.estimate(c.y, c.dt), some.estimate(record)
    assert np.array_equal(one.load, two.load)
    plain = space()
    small = StateSpace(plain.A, plain.B, 1e-6 * plain.C, 1e-6 * plain.D, plain.dt, plain.hold,
                       sensors=plain.sensors, loads=plain.loads)  # fmt: skip
    other = recommend(small, 1e-6 * c.y, c.dt, noise=Noise(1e-6 * c.noise, source=SAID))
    assert other.prior == plainly().prior
    assert other.evidence == pytest.approx(plainly().evidence, abs=0.1)


def test_a_declared_class_decides_where_the_record_does_not():
    near = {"matern32": 3.0, "random_walk": 0.0, "spikes": 900.0}
    assert advice._chosen(near, None) == "random_walk"
    assert advice._chosen(near, "slow") == "random_walk"
    assert advice._chosen(near, "harmonic") == "matern32"
    assert advice._chosen(near, "impact") == "matern32"
    assert advice._chosen({**near, "matern32": 50.0}, "harmonic") == "random_walk"
    c = case()
    assert {"spikes", "pulses"} & set(plainly().evidence) == set()
    asked = recommend(space(), c.y, c.dt, noise=Noise(c.noise, source=SAID), load_class="impact")
    assert {"spikes", "pulses"} <= set(asked.evidence)
    assert asked.prior == "matern32"
    told = advice._Asked(space(), {}, advice._Seen(3.0, 5.0, 1.0), "harmonic")
    assert "although the load was declared as harmonic" in told.process({"ou": 0.0, "matern52": 99.0}, {}).reason
    with pytest.raises(InputError, match="load_class"):
        recommend(space(), c.y, c.dt, noise=Noise(c.noise, source=SAID), load_class="hammer")


@pytest.mark.parametrize("known", [True, False])
def test_waveforms_and_processes_are_judged_in_one_unit(known):
    """No waveform at all against the density of a record of noise alone, computed by hand."""
    c = case()
    rng, sd = np.random.default_rng(0), c.noise
    y = sd * rng.standard_normal(c.y.shape)
    from loadid._families.data import gather
    from loadid._inverse.rules import information
    from loadid._inverse.sparse.path import log_supports

    noise = sd if known else None
    asked = PosingSettings(Noise(noise, source="data sheet" if known else None), Lambda(), Penalty(), ())
    problem = pose(space(), gather(y, c.dt, space(), None), asked)
    misfit, supports = float(np.sum(problem.y**2)), log_supports(len(y), 0)
    score = float(information(misfit, 0, supports, problem.data, problem.noise.sigma))
    level = problem.noise.level if known else problem.noise.level * np.sqrt(np.mean(problem.y**2))
    density = np.sum(np.log(2 * np.pi * level**2) + (problem.values / level) ** 2)
    assert of_sparse(score, problem, problem.samples) == pytest.approx(density, rel=1e-9)


def test_a_model_that_carries_no_process():
    """An impulse response has no states: Tikhonov and waveforms are left, and run."""
    c = case()
    h = space().impulse_response(c.dt, 300, "zoh")
    model = ImpulseModel(h, c.dt, kind="held")
    found = recommend(model, c.y[:300], c.dt, noise=Noise(c.noise, source=SAID))
    assert found.prior == "tikhonov"
    assert found.evidence == {}
    assert found.estimate(c.y[:300], c.dt).load.shape == (300, 1)
    with pytest.raises(InputError, match="without a model"):
        advice.Recommendation("tikhonov", "", "", True, 3.0, 5.0, None, {}).estimate(c.y)
