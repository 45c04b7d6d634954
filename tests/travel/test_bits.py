"""One object under several threads answers as one after another; the same input gives the same bits."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from tests.golden import problems as p

from .objects import DT, SHARED, bent, bits, padded, said

ROOT = Path(__file__).parents[2]
THREADS, RECORDS = 4, 4


def together(work: Callable[[int], Any], count: int = RECORDS) -> list[Any]:
    """Results of a function of 0, 1, ..., in four threads that start at once."""
    start = Barrier(THREADS)

    def one(k: int) -> Any:
        if k < THREADS:
            start.wait(60)
        return work(k)

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(one, range(count)))


def settings_of(family: Any) -> Any:
    """What a family was told, and holds in its own name."""
    return {name: bits(value) for name, value in vars(family).items() if not name.startswith("_")}


@pytest.mark.parametrize("name", SHARED)
def test_one_family_in_four_threads(name: str) -> None:
    """Fresh, so that everything that is kept is made while others look for it; its settings stay as they are."""
    shared = SHARED[name]
    expected = [shared.said(shared.estimate(shared.make(), k)) for k in range(RECORDS)]
    family = shared.make()
    settings = settings_of(family)
    found = together(lambda k: shared.said(shared.estimate(family, k)))
    assert [k for k in range(RECORDS) if found[k] != expected[k]] == []
    assert settings_of(family).keys() == settings.keys()
    assert [n for n, value in settings_of(family).items() if value != settings[n]] == []


def test_one_model_in_four_threads() -> None:
    """A fresh model is asked for everything at once: factor, modes, discretisation."""
    asked: list[Callable[[Any], Any]] = [
        lambda m: m.static(), lambda m: m.frf([3.0, 17.0]), lambda m: m.state_space(DT).A,
        lambda m: m.impulse_response(DT, 30), lambda m: m.predict(np.ones((20, 3)), DT), lambda m: m.fingerprint,
    ]  # fmt: skip
    expected = [bits(ask(bent())) for ask in asked]
    for _ in range(5):
        model = bent()
        assert together(lambda k, model=model: bits(asked[k](model)), len(asked)) == expected


def test_one_estimate_in_four_threads() -> None:
    """What an answer keeps is made when it is asked: by several at once, too."""
    shared = SHARED["Deconvolution, statespace"]
    expected = said(shared.estimate(shared.make(), 0))
    e = shared.estimate(shared.make(), 0)
    assert together(lambda k: said(e)) == [expected] * RECORDS


@pytest.mark.parametrize("law", [{"no_pull": True}, {"friction": 0.5}])
def test_a_pad_that_only_presses_in_four_threads(law: dict[str, Any]) -> None:
    """It starts from its last frame, whichever that was: the loads are the same to the accuracy of the solver."""
    sensor = padded(choice=p.LAM, contact=p.ContactLaw(**law))
    u = p.moved()[1]
    expected = [sensor.estimate(u * (1 + k / 10)).load for k in range(RECORDS)]
    found = together(lambda k: sensor.estimate(u * (1 + k / 10)).load)
    for a, b in zip(found, expected, strict=True):
        assert np.max(np.abs(a - b)) <= 1e-9 * np.max(np.abs(b))


# -- the same input, the same bits ------------------------------------------------------------------------------------
FIRST = """
import pickle, sys
from tests.travel.test_bits import first
sys.stdout.buffer.write(pickle.dumps({name: first(name) for name in sys.argv[1:]}))
"""
SAME = (
    "MultilayerPad, frozen", "Deconvolution, dense", "FieldDeconvolution", "Deconvolution, statespace",
    "SparseDeconvolution", "StaticInversion", "FrequencyInversion", "LocationSearch", "LoadTracker",
)  # fmt: skip
SPLIT = 2  # of them are asked on two threads: small matrices on waiting threads take long


def first(name: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """What a family says of its first record; load and std."""
    shared = SHARED[name]
    found = shared.estimate(shared.make(), 0)
    return shared.said(found), np.array(found.load), np.array(found.std)


def elsewhere(names: tuple[str, ...], threads: int) -> dict[str, Any]:
    """The same of some families in a new process, with so many threads for linear algebra."""
    env = {**os.environ, **{f"{name}_NUM_THREADS": str(threads) for name in ("OPENBLAS", "OMP", "MKL")}}
    done = subprocess.run([sys.executable, "-c", FIRST, *names], cwd=ROOT, env=env, capture_output=True, check=True)
    found: dict[str, Any] = pickle.loads(done.stdout)
    return found


def test_the_same_input_gives_the_same_bits_and_on_two_threads_the_same_digits() -> None:
    """In this process and in another one bit for bit; with two threads for linear algebra to 1e-12."""
    one = elsewhere(SAME, 1)
    for name in SAME:
        if os.environ.get("OPENBLAS_NUM_THREADS") == "1":
            assert one[name][0] == first(name)[0], name
    for name, found in elsewhere(SAME[:SPLIT], 2).items():
        for a, b in zip(one[name][1:], found[1:], strict=True):
            assert np.max(np.abs(a - b)) <= 1e-12 * np.max(np.abs(a)), name
