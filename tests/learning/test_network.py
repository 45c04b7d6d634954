"""Networks: numpy against torch, scipy and onnxruntime; training that repeats, stops, goes on and is refused."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from loadid._learning.network import architectures
from loadid._learning.network.graph import OPERATIONS, Graph
from loadid._learning.network.training import Pairs, Schedule, Trained, train
from structures.errors import InputError

from .networks import FILE, SHAPES, by_torch, drawn, values, weighed

SMALL = architectures.residual(3, 4, width=16, blocks=1)  # two means and two stds
QUICK = Schedule(epochs=6, batch=32, rate=5e-3)


def off(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference over the largest value."""
    return float(np.abs(a - b).max() / np.abs(b).max())


def pairs(n: int, seed: int) -> Pairs:
    """|x1| with noise of std .2, and noise alone of std .2 exp(x2 / 2)."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((n, 3))
    noise = rng.standard_normal((n, 2))
    return Pairs(x, np.stack([np.abs(x[:, 0]) + 0.2 * noise[:, 0], 0.2 * np.exp(x[:, 1] / 2) * noise[:, 1]], 1),
                 np.ones(n))  # fmt: skip


# -- without torch -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", SHAPES)
def test_numpy_makes_of_a_network_what_torch_made(name: str) -> None:
    with np.load(FILE) as kept:
        assert off(weighed(name)(values(name)), kept[name]) <= 1e-5


@pytest.mark.parametrize("wide", [1, 2])
@pytest.mark.parametrize("shape", [(2, 3, 9), (2, 3, 6, 8)])
def test_a_convolution_is_a_correlation(shape: tuple[int, ...], wide: int) -> None:
    rng = np.random.default_rng(0)
    taps = (3,) * (len(shape) - 2)
    x, weight, offset = rng.standard_normal(shape), rng.standard_normal((4, 3, *taps)), rng.standard_normal(4)
    found = OPERATIONS["convolve"](x, weight, offset, wide=wide)
    spread = np.zeros((4, 3, *(2 * wide + 1 for _ in taps)))
    spread[(..., *(slice(None, None, wide) for _ in taps))] = weight
    want = [[sum(ndimage.correlate(x[n, c], spread[o, c], mode="constant") for c in range(3)) + offset[o]
             for o in range(4)] for n in range(2)]  # fmt: skip
    assert off(found, np.array(want)) <= 1e-12


def test_weights_that_do_not_fit_are_refused() -> None:
    graph = weighed("unet")
    broken = {**graph.weights, "out.weight": np.zeros((2, 3, 3, 3))}
    with pytest.raises(InputError, match=r"out.weight.*do not fit"):
        Graph(graph.steps, broken)
    with pytest.raises(InputError, match="a step that no network has"):
        Graph.of([{**graph.described()[0], "kind": "system"}], {})
    again = Graph.of(graph.described(), graph.weights)
    assert again.steps == graph.steps
    assert again.count == sum(np.size(v) for v in graph.weights.values())


def test_training_without_torch_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match=r"no module torch.*loadid\[learn\]"):
        train(SMALL, pairs(8, 0), pairs(8, 1), QUICK, seed=0)


def test_a_started_network_corrects_nothing() -> None:
    graph = drawn("unet")
    assert not Graph(graph.steps, graph.started(0))(values("unet")).any()


# -- with torch --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", SHAPES)
def test_numpy_torch_and_onnxruntime_agree(name: str) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from loadid._learning.network.exchange import Runner, to_onnx

    graph, x = weighed(name), values(name)
    assert off(by_torch(graph, x), graph(x)) <= 1e-5
    assert off(Runner(to_onnx(graph, x.ndim - 2))(x), graph(x)) <= 1e-5


def test_mean_and_std_are_those_of_the_examples() -> None:
    pytest.importorskip("torch")
    done = train(SMALL, pairs(3000, 0), pairs(500, 1), Schedule(epochs=8, batch=32, rate=1e-2), seed=0)
    fresh = pairs(2000, 2)
    out = done.graph(fresh.inputs)
    wanted = np.stack([np.full(2000, 0.2), 0.2 * np.exp(fresh.inputs[:, 1] / 2)], 1)
    assert np.sqrt(np.mean((out[:, 0] - np.abs(fresh.inputs[:, 0])) ** 2)) < 0.08  # a line leaves .60
    assert np.median(np.abs(out[:, 2:] - np.log(wanted)), axis=0) == pytest.approx([0, 0], abs=0.1)


def test_training_repeats_and_goes_on_after_a_kill_to_the_same_bits(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    fit, held, kept = pairs(200, 0), pairs(60, 1), tmp_path / "training.h5"
    whole = train(SMALL, fit, held, QUICK, seed=3)
    assert np.array_equal(train(SMALL, fit, held, QUICK, seed=3).losses, whole.losses)
    assert not np.array_equal(train(SMALL, fit, held, QUICK, seed=4).losses, whole.losses)

    def killed(epoch: int, epochs: int) -> None:
        if epoch == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(SMALL, fit, held, QUICK, seed=3, progress=killed, checkpoint=kept)
    counted: list[int] = []
    with pytest.raises(InputError, match="a checkpoint of another training"):
        train(SMALL, fit, held, QUICK, seed=4, checkpoint=kept)
    later = train(SMALL, fit, held, QUICK, seed=3, checkpoint=kept, progress=lambda k, _: counted.append(k))
    assert counted == [4, 5, 6]
    assert np.array_equal(later.losses, whole.losses)
    assert all(np.array_equal(later.graph.weights[k], v) for k, v in whole.graph.weights.items())
    assert not kept.exists()


def summed(n: int, seed: int) -> Pairs:
    """Forty targets of much noise, the same in all of them: a tenth of it goes with what goes in."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((n, 3))
    shared = 0.1 * np.abs(x[:, :1])
    y = shared + rng.standard_normal((n, 40))
    return Pairs(x, y, np.ones(n), np.ones((1, 40)), np.full(n, 4.0))


def test_a_second_stage_brings_the_sums_and_goes_on_after_a_kill(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    graph, plan, kept = architectures.residual(3, 80, width=16, blocks=1), Schedule(5, 32, 5e-3), tmp_path / "c.h5"
    fit, held = summed(400, 0), summed(100, 1)
    whole = train(graph, fit, held, plan, seed=0)
    plain = train(graph, replace(fit, sums=None, whole=None), replace(held, sums=None, whole=None), plan, seed=0)
    assert np.array_equal(whole.losses[:5], plain.losses)
    assert len(whole.losses) == 5 + plan.of_sums.epochs
    assert whole.best >= 5

    def killed(epoch: int, epochs: int) -> None:
        if epoch == epochs == 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(graph, fit, held, plan, seed=0, progress=killed, checkpoint=kept)
    later = train(graph, fit, held, plan, seed=0, checkpoint=kept)
    assert np.array_equal(later.losses, whole.losses)

    def missed(done: Trained) -> float:
        fresh = summed(2000, 2)
        found, wanted = done.graph(fresh.inputs)[:, :40].sum(axis=1), 4 * np.abs(fresh.inputs[:, 0])
        return float(np.sqrt(np.mean((found - wanted) ** 2)))

    assert missed(whole) < 0.9 * missed(plain)


def test_a_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    kept = tmp_path / "training.h5"
    with pytest.raises(KeyboardInterrupt):
        train(SMALL, pairs(40, 0), pairs(10, 1), QUICK, seed=0, progress=_stop, checkpoint=kept)
    content = bytearray(kept.read_bytes())
    content[-9] ^= 1
    kept.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        train(SMALL, pairs(40, 0), pairs(10, 1), QUICK, seed=0, checkpoint=kept)


def test_training_stops_where_held_out_examples_gain_nothing() -> None:
    pytest.importorskip("torch")
    rng = np.random.default_rng(0)  # nothing to learn: the weights grow into the noise
    fit, held = (Pairs(rng.standard_normal((30, 3)), rng.standard_normal((30, 2)), np.ones(30)) for _ in range(2))
    done = train(SMALL, fit, held, Schedule(epochs=80, batch=8, rate=2e-2, patience=4), seed=0)
    assert len(done.losses) == done.best + 1 + 4 < 80
    assert done.losses[done.best, 1] == done.losses[:, 1].min()


def _stop(epoch: int, epochs: int) -> None:
    raise KeyboardInterrupt
