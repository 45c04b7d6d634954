"""What a map says of loads that its examples did not tell apart, and of examples of another model."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import LearnedMap, load_map
from loadid.generate import Examples, HistoryDeclaration, LoadRange, ModelRange, ReadingRange, TrainingSet, histories
from structures import InputError, MatrixModel

from .made import NOISE, chain, plate, presses, static_set


def learned(tie):
    """Of twelve sensors and ten loads, one of which is tied to another or at rest; loads to seven figures."""
    rng = np.random.default_rng(3)
    model = MatrixModel(rng.standard_normal((12, 10)))
    g = rng.standard_normal((400, 10)).astype(np.float32)
    g[:, 9] = np.float32(tie) * g[:, 8]
    y = g @ model.static().T + NOISE * rng.standard_normal((400, 12))
    training = TrainingSet.of(Examples.measured(y, g, noise=NOISE), sensors=model.sensors, loads=model.loads)
    return LearnedMap(model).fit(training), y, [c.label for c in model.loads]


@pytest.mark.parametrize(("tie", "words"), [(0.3, "acting only together, in 9 directions of 10: {8}, {9}"),
                                            (0.0, "never varying there, and answered by their mean: {9}")])  # fmt: skip
def test_loads_that_were_never_told_apart_are_named(tie, words, tmp_path):
    fitted, y, labels = learned(tie)
    (flag,) = (f for f in fitted.estimate(y[0]).flags if f.code == "LID-W616")
    assert words.format(*labels) in str(flag)
    assert fitted.facts["rank"] == 9
    model = fitted.model
    fitted.save(tmp_path / "map.h5")
    again = load_map(tmp_path / "map.h5", model=model)
    assert str(flag) in map(str, again.estimate(y[0]).flags)


def test_loads_that_were_told_apart_raise_no_flag():
    y, _ = presses(1, 3)
    fitted = LearnedMap(plate()[0]).fit(static_set())
    assert "W616" not in fitted.estimate(y[0]).codes


def test_ties_in_seven_figures_are_refused_as_any():
    """Of four loads, one is a third of another to seven figures."""
    y, g = presses(400, 0)
    g = g.astype(np.float32)
    g[:, 1] = np.float32(1 / 3) * g[:, 0]
    with pytest.raises(InputError, match="does not span the loads"):
        LearnedMap(plate()[0]).fit(static_set().of(Examples.measured(y, g, noise=NOISE), sensors=plate()[0].sensors,
                                                   loads=plate()[0].loads))  # fmt: skip


def test_a_set_drawn_for_another_model_is_refused(tmp_path):
    declared = HistoryDeclaration([LoadRange("random", level=(1, 5), frequency=(1, 20))], dt=1 / 100, samples=64,
                                  model=ModelRange(stiffness=(0.95, 1.05)),
                                  sensors=ReadingRange(relative=(0.01, 0.01)))  # fmt: skip
    made = histories(chain(), declared, tmp_path / "set", draws=100, seed=0, workers=1)
    again = TrainingSet.open(tmp_path / "set")
    assert made.model == again.model == chain().fingerprint
    assert LearnedMap(chain()).fit(again).facts["draws"] == 100
    with pytest.raises(InputError, match="drawn for another model"):
        LearnedMap(chain(1.1)).fit(again)
