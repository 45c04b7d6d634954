"""The band of a load in a window behind measured FRFs, held against hits on a beam that is not the model's own."""

import numpy as np
import pytest

from loadid import Deconvolution, Record, datasets, read
from loadid._commands.compare import compare
from loadid._inverse.problem import LinearProblem
from loadid._inverse.support import SupportedPath
from structures import MeasuredModel

WINDOW = (0.019, 0.025)


@pytest.mark.parametrize("seed", [520, 530])
def test_the_band_holds_errors_of_the_hits_where_the_load_acts(seed: int, tmp_path) -> None:
    """What pulses leave above the Nyquist frequency is an error of the FRFs that lies in the pulse, not in the record.

    The band without it, and without the gains of the sensors, is 6 standard deviations short.
    """
    hit = datasets.hammer_test(tmp_path, seed=seed)
    model = MeasuredModel.from_hits([read(f) for f in hit.files[:3]], force="hammer", responses=["acc1", "acc2"],
                                    gate=0.004)  # fmt: skip
    record, truth = read(hit.files[3]), hit.load[:, 0]
    inside = slice(round(WINDOW[0] / record.dt) + 1, round(WINDOW[1] / record.dt))
    peak = int(np.argmax(truth))
    for more in ({}, {"penalty": "first_difference"}, {"sensors": ["acc1"]}):
        found = Deconvolution(model, support=WINDOW, **more).estimate(record)
        away = np.abs(found.load[:, 0] - truth)
        assert np.mean(away[inside] < 1.96 * found.std[inside, 0]) >= 0.9
        assert away[peak] < 1.96 * found.std[peak, 0] < 0.05 * truth[peak]
        assert found.std[inside, 0].min() < 0.01 * truth[peak]
        assert found.facts["window_level"] > 2
    louder = Record(1.02 * record.values, record.dt, record.channels)  # gains drift between a test and its use
    found = Deconvolution(model, support=WINDOW).estimate(louder)
    assert 2 < np.abs(found.load[peak, 0] - truth[peak]) < 1.96 * found.std[peak, 0]


def test_a_comparison_says_how_far_each_family_is_and_what_a_rule_lacks_in_words(tmp_path) -> None:
    hit, said = datasets.hammer_test(tmp_path), []
    model = MeasuredModel.from_hits([read(f) for f in hit.files[:3]], force="hammer", responses=["acc1", "acc2"],
                                    gate=0.004)  # fmt: skip
    found = compare(hit.files[3], model, families=["deconvolution", "first difference"],
                    progress=lambda fraction, text: said.append((fraction, text)))  # fmt: skip
    fractions = [fraction for fraction, _ in said]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert {"deconvolution: choosing lambda", "first difference: held out, choosing lambda"} <= {t for _, t in said}
    assert "ebic needs a load of few pulses" in str(found)


def test_the_level_where_a_load_acts_is_that_of_its_residual() -> None:
    rng = np.random.default_rng(7)
    samples, inside = 400, np.zeros((400, 1), bool)
    inside[100:140] = True
    H = rng.standard_normal((samples, 2, 40)) * np.exp(-np.abs(np.arange(samples) - 120) / 20)[:, None, None]
    levels = {1.0: [], 5.0: []}
    for factor, found in levels.items():
        for _ in range(20):
            noise = rng.standard_normal((samples, 2))
            noise[inside[:, 0]] *= factor
            y = np.einsum("tsn,n->ts", H, rng.standard_normal(40)) + noise
            path = SupportedPath(LinearProblem.whitened(H, y, None, None, (40, 1)), inside)
            found.append(path.level_within(1e-6, 1.0))
    assert levels[1.0] == [1.0] * 20
    assert np.mean(levels[5.0]) == pytest.approx(5.0, rel=0.15)
