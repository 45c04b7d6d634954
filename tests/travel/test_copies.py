"""Every kind of object that users hold goes through pickle, deepcopy and a new process, and answers bit for bit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

import loadid
import structures
import tactile
from structures._readonly import ReadOnly
from tests.golden import problems as p

from .objects import KINDS, histories, said, tracker_of

WAIT = 120  # s, until a process that hangs is no more waited for


def answered(name: str, blob: bytes) -> Any:
    """In another process: what an object of a kind says when it arrives."""
    return KINDS[name].ask(pickle.loads(blob))


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as workers:
        yield workers


@pytest.mark.parametrize("name", KINDS)
def test_it_answers_as_before_wherever_it_goes(name: str, pool: ProcessPoolExecutor) -> None:
    """Before it was asked, and after: then what it keeps travels along, or is made again.

    One of each kind, whose name has no comma, is asked in a new process then.
    """
    kind = KINDS[name]
    own = kind.make()
    fresh = copy.deepcopy(pickle.loads(pickle.dumps(own)))
    assert type(fresh) is type(own)
    assert kind.ask(own) == kind.ask(fresh)
    blob = pickle.dumps(own)
    used = copy.deepcopy(pickle.loads(blob))
    elsewhere = None if "," in name else pool.submit(answered, name, blob)
    second = kind.ask(own)
    assert (kind.ask(used) if elsewhere is None else elsewhere.result(WAIT)) == second


def test_no_public_class_is_forgotten() -> None:
    """Classes that `loadid`, `structures` and `tactile` list: each is among the kinds, or is no object that is kept."""
    errors = {"InputError", "NotIdentifiable"}
    parts = {  # of what stands there
        "Absolute", "Ambient", "NoiseSource", "Certificate", "Channel", "Flag", "Model", "CrossSpectra", "Sparsity",
        "ContactLaw", "Cylinder", "DepthMap", "Extent", "Hertz", "View", "LoadEstimate", "ForceMap",
    }  # fmt: skip
    slow = ("answer/", "tracker/", "family/StaticInversion, ")
    made = {type(kind.make()).__name__ for name, kind in KINDS.items() if not name.startswith(slow)}
    named = {name: getattr(package, name) for package in (loadid, structures, tactile) for name in package.__all__}
    classes = {name for name, value in named.items() if isinstance(value, type)}
    assert classes - made - errors - parts == set()
    for name in parts & named.keys():
        pickle.loads(pickle.dumps(named[name]))


def test_read_only_arrays_stay_so() -> None:
    """An immutable object is one where it arrives, too."""
    for name in ("model/matrix", "model/FRF", "basis/hats on a beam", "record", "structure", "setting/Noise"):
        own = KINDS[name].make()
        for other in (pickle.loads(pickle.dumps(own)), copy.deepcopy(own), copy.copy(own)):
            arrays = {key: x for key, x in vars(own).items() if isinstance(x, np.ndarray) and not x.flags.writeable}
            assert arrays, name
            for key in arrays:
                assert not vars(other)[key].flags.writeable, (name, key)
    assert issubclass(structures.Model, ReadOnly)


def test_a_callback_stays_in_its_process() -> None:
    heard: list[float] = []
    family = histories(progress=lambda fraction, text: heard.append(fraction))
    expected = said(family.estimate(p.pushed()[0], p.DT))
    told = len(heard)
    assert told > 0
    assert said(pickle.loads(pickle.dumps(family)).estimate(p.pushed()[0], p.DT)) == expected
    assert len(heard) == told
    copy.deepcopy(family).estimate(p.pushed()[0], p.DT)
    assert len(heard) == 2 * told


def test_a_tracker_goes_on_under_another_model_after_its_travel() -> None:
    """What a file of a tracker does not hold: the model of the structure, through which a state is carried over."""
    own = tracker_of(50, prior=p.WALK)
    other = pickle.loads(pickle.dumps(own))
    for tracker in (own, other):
        tracker.update_model(p.housed().perturbed("stiffness", 1.05))
    a, b = (tracker.track(p.service()[50:], p.DT) for tracker in (own, other))
    assert a.load.tobytes() == b.load.tobytes()
    assert a.std.tobytes() == b.std.tobytes()
