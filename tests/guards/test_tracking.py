"""Guards of online tracking, on the benchmarks' matrices."""

from __future__ import annotations

import numpy as np

from loadid import LoadTracker
from loadid._guards.tracking import (
    believed,
    beyond_the_fit,
    biases,
    blind,
    contradicting,
    cures,
    drifting,
    faulty,
    kept_out,
    louder,
    moved_off,
    other_model,
    overconfident,
    refused,
    slow,
    spoilt,
    supposed,
    unbalanced,
    undetermined,
    unlike_the_fit,
    untuned,
)
from loadid._inverse.gaussian.observe import observability
from loadid.priors import Matern32
from loadid.settings import Noise
from structures import Flag, ForwardModel, chains, loads, sensors
from tests.tracked import Prior, bm2, building, d2, filter_model, judged, matern32, reference, walk

from .cases import Case
from .cases import refused as as_flag

STOREYS = chains.shear_building(masses=[1.0] * 10, stiffnesses=[2500.0] * 10, damping=0.01)


def observed(disp: tuple[int, ...], prior: Prior | None = None):
    case = bm2("mix", disp=disp, samples=20)
    prior = walk(100.0) if prior is None else prior
    return observability(filter_model(case, prior), case.setup.space(), [100.0])


def drift(disp: tuple[int, ...], allow: bool, prior: Prior | None = None) -> tuple[Flag, ...]:
    flag = drifting(observed(disp, prior))
    if not allow:
        return as_flag(lambda: refused(flag, allow))
    return tuple(f for f in (refused(flag, allow),) if f)


def cured() -> tuple[Flag, ...]:
    """The drift of accelerometers on a model that offers places."""
    accelerometers = [sensors.Accelerometer(f"{k}+X") for k in (3, 6, 10)]
    model = ForwardModel(STOREYS, accelerometers, [loads.Point("10+X")])
    found = observed(())
    flag = drifting(found, cures(model, found.lacking(), np.array([100.0])))
    return (flag,) if flag else ()


def noise_of_states(Qx: float) -> tuple[Flag, ...]:
    case = d2(Qx=Qx)
    return one(unbalanced(filter_model(case, walk(0.1)), np.sqrt(Qx), [f"mode {k}" for k in range(1, 9)]))


def one(flag: Flag | None) -> tuple[Flag, ...]:
    return (flag,) if flag else ()


def innovations(bias: float) -> tuple[Flag, ...]:
    z = np.random.default_rng(0).standard_normal((3000, 3))
    z[:, 1] += bias
    z[::7, 2] = np.nan
    return one(overconfident(1.0, z, ["a", "b", "c"]))


def begun(cut: int) -> tuple[Flag, ...]:
    """A record of a building under wind, from rest or cut from the middle."""
    case = bm2("matern", samples=1200)
    tracker = LoadTracker(case.setup.space(), prior=Matern32(100.0, 0.08), noise=Noise(case.noise))
    return tracker.fit(case.y[cut : cut + 600], case.dt).smooth(case.y[cut : cut + 600], case.dt).flags


CALM = np.random.default_rng(1).standard_normal((2000, 2))
CASES = [
    Case("N532", lambda: begun(600), lambda: begun(0), r"starts in motion.* = \d+.*\(threshold 7\)"),
    Case("E501", lambda: drift((), False), lambda: drift((10,), False), r"constant force.*0 of 1.*displacement"),
    Case("E501", lambda: drift((), True), lambda: drift((1,), True), r"singular value .*allow=.'LID-E501'", "kept"),
    Case("E501", cured, lambda: drift((), True, matern32(100.0, 0.08, 0.01)), r"sensor at 10\+X.*0\.4 m", "cure"),
    Case("W502", lambda: one(untuned(3.31, tuned=True)), lambda: one(untuned(1.06, tuned=True)), "3.31"),
    Case("W502", lambda: one(untuned(1.0, tuned=False)), lambda: one(untuned(1.0, tuned=True)), "sweep", "no sweep"),
    Case("W503", lambda: noise_of_states(1e-14), lambda: noise_of_states(1e-18), r"8\.18 times.*mode 8.*hide a bias"),
    Case("W504", lambda: innovations(0.2), lambda: innovations(0.0), r"channel b"),
    Case("W504", lambda: one(overconfident(1.42, CALM, ["a", "b"])),
         lambda: one(overconfident(1.0, CALM, ["a", "b"])), "1.42", "NIS"),
    Case("W519", lambda: one(supposed(observed((), matern32(100.0, 0.08, 0.01)))),
         lambda: one(supposed(observed((10,), matern32(100.0, 0.08, 0.01)))), "0 of 1.*prior"),
    Case("W521", lambda: one(kept_out(67, 3600, 4)), lambda: one(kept_out(3, 60, 0)), "67 of 3600.*gate=None"),
    Case("W521", lambda: one(kept_out(2, 3600, 1, 90, {"a3": 5, "d10": 87})),
         lambda: one(kept_out(2, 3600, 1, 3, {"d10": 5})), "believed 90.*87 of d10, 5 of a3", "set aside"),
    Case("W526", lambda: one(beyond_the_fit(455.0)), lambda: one(beyond_the_fit(30.0)), "455 times"),
    Case("W527", lambda: one(moved_off(np.array([0.3, -93.0]), ["a", "b"])),
         lambda: one(moved_off(np.array([0.3, -3.0]), ["a", "b"])), r"channel b \(-93\).*offset"),
    Case("W528", lambda: one(faulty([("a", None, "offset", 440), ("b", "c", "swapped", 900)])),
         lambda: one(faulty([])), r"a \(offset, sample 440\); b and c \(swapped"),
    Case("W529", lambda: one(unlike_the_fit(60, 1.4)), lambda: one(unlike_the_fit(0, 1.4)), "60 samples"),
    Case("W534", lambda: one(louder(4.7, 1.2)), lambda: one(louder(2.3, 2.0)), "4.7 times the power.*1.2 times"),
    Case("N531", lambda: one(blind(1500, 2000)), lambda: one(blind(900, 2000)), "1500 of 2000 samples"),
    Case("W530", lambda: one(contradicting([None, 0.23, 0.97], ["a", "b", "c"])),
         lambda: one(contradicting([None, 0.91, 0.97], ["a", "b", "c"])), "b 23%"),
    Case("W522", lambda: one(other_model("a" * 64, "b" * 64)), lambda: one(other_model("a" * 64, "a" * 64)),
         "certificate is not of this model"),
    Case("W523", lambda: one(undetermined(["length of load 1"])), lambda: one(undetermined([])), "length of load 1"),
    Case("W524", lambda: one(spoilt((0, 3), ["a", "b"])), lambda: one(spoilt((0, 0), ["a", "b"])), "3 of b"),
    Case("W525", lambda: one(believed(0.02)), lambda: one(believed(None)), "not data"),
    Case("W520", lambda: one(slow(20.0, 60.0)), lambda: one(slow(2.0, 60.0)), "20 s.*60 s"),
]  # fmt: skip


def test_innovations_of_a_rough_prior_raise_no_false_alarm():
    """Correlated as they are, by the random walk's prior, their mean is judged by pieces."""
    worst = []
    for seed in range(4):
        case = bm2("matern", seed, samples=3000)
        model = filter_model(case, walk(404.0))
        track = reference(model, case.y, settle=1e-9)
        assert 0.9 < judged(track, case).nis < 1.1
        worst.append(np.abs(biases(track.e[200:])).max())
    assert max(worst) < 4
    assert np.median(worst) < 3


def test_a_biased_accelerometer_is_flagged():
    """Away from the load by its own channel, beside it by the others: the load takes the bias up."""
    for sensor, shown in ((0, "a3"), (2, "d10")):
        case = bm2("mix", samples=3000)
        bias = 0.05 * case.y[:, sensor].std() * (np.arange(4) == sensor)
        track = reference(filter_model(case, walk(82.0)), case.y + bias, settle=1e-9)
        flag = overconfident(1.0, track.e[200:], ["a3", "a6", "a10", "d10"])
        assert flag is not None
        assert f"on channel {shown} " in flag.message


def test_the_cure_cures():
    """The sensor that is named makes the load seen; one further from the load shows less of it."""
    found = observed(())
    model = ForwardModel(STOREYS, [sensors.Accelerometer("3+X")], [loads.Point("10+X")])
    (cure,) = cures(model, found.lacking(), np.array([100.0]))
    node = int(cure.dof.split("+")[0])
    assert drifting(observed((node,))) is None
    static = building(disp=range(1, 11), acc=()).space().static()[:, 0] * 100
    assert abs(cure.moves - static.max()) < 1e-9
    assert node == 1 + int(np.argmax(static))


def test_loads_larger_than_those_of_the_fit_are_told_of():
    """Ten times as large, and not where they are as at the fit, nor for blocks of another length."""
    from tests.benchmarks.louder import tones
    from tests.benchmarks.noise_alone import DISP, DT, on

    model, std, rng = on(DISP), np.full(2, 1e-6), np.random.default_rng(7)
    quiet, loud = (model.predict(rms * tones(960, rng), DT) for rms in (2.0, 20.0))
    quiet, loud = (y + std * rng.standard_normal(y.shape) for y in (quiet, loud))
    tracker = LoadTracker(model, noise=Noise(std)).fit(quiet, DT)
    codes, most = [], []
    for rows, blocks in ((quiet, 1), (loud, 1), (loud, 37)):
        tracker.reset()
        for block in np.array_split(rows, blocks):
            tracker.run(block)
        codes.append("LID-W534" in {f.code for f in tracker.alarms})
        most.append(tracker.to_tree()["loudness"]["most"])
    assert most[1] == most[2]
    assert codes == [False, True, True]
