"""Facts of a result: attribute, dictionary and file say the same, and what another release wrote is kept."""

from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError, fields, replace

import pytest

from loadid import LoadEstimate
from loadid._results.facts import Facts
from loadid._results.location import LocationFacts
from loadid._results.summary import facts as listed

from .made import impact

OF_0_1 = {  # as a result file of release 0.1 holds them
    "path": "dense SVD", "m": 300, "n": 300, "rank": 299, "nullity": 1, "kappa": 1e5, "edf": None, "resolution": 2e-3,
    "resolution_unit": "s", "told_apart": 6, "held_out": ["a 1.00%", "b 2.00%"], "tuned_rate of load 1": 3.5,
    "count_gated": 2, "what nobody knows": [1, 2],
}  # fmt: skip


def test_a_dictionary_of_release_0_1_becomes_fields_and_comes_back_whole():
    known = Facts.of(OF_0_1)
    assert dict(known) == OF_0_1
    assert (known.m, known.kappa, known.distinguishable, known.held_out) == (300, 1e5, 6, ("a 1.00%", "b 2.00%"))
    assert (known.tuned, known.counts) == ({"rate of load 1": 3.5}, {"gated": 2})
    assert known.other == {"what nobody knows": [1, 2]}
    assert Facts.of(known) is known


def test_not_available_is_not_absent():
    known = Facts(edf=None, rank=3)
    assert known.stated == {"edf", "rank"}
    assert known.mu is None
    assert "mu" not in known
    assert known["edf"] is None
    assert dict(replace(known, gap=1e-7)) == {"rank": 3, "edf": None, "gap": 1e-7}
    assert dict(replace(known, rank=4)) == {"rank": 4, "edf": None}
    with pytest.raises(KeyError):
        known["mu"]


def test_facts_do_not_change():
    known = Facts(rank=3)
    with pytest.raises(FrozenInstanceError):
        known.rank = 4
    with pytest.raises(TypeError):
        known["rank"] = 4
    with pytest.raises(TypeError):
        Facts.of(OF_0_1).tuned["rate of load 1"] = 4.0


@pytest.mark.parametrize("known", [Facts.of(OF_0_1), LocationFacts(candidates=19, ratio=1.2, lam=1e-3)])
def test_they_are_pickled(known):
    again = pickle.loads(pickle.dumps(known))
    assert type(again) is type(known)
    assert dict(again) == dict(known)


def test_a_file_gives_them_back(tmp_path):
    e = impact(facts=OF_0_1, posterior=None)
    e.save(tmp_path / "out.h5")
    back = LoadEstimate.read(tmp_path / "out.h5")
    assert dict(back.facts) == OF_0_1
    assert back.facts.stated == e.facts.stated
    assert e.to_dict()["facts"] == OF_0_1


def test_a_summary_lists_them_with_their_titles():
    rows = dict(listed(impact(facts=OF_0_1)))
    assert rows["resolution width"] == "2 ms"
    assert rows["effective degrees of freedom"] == "not available"
    assert rows["told apart"] == "6"
    assert rows["tuned rate of load 1"] == "3.5"
    assert rows["what nobody knows"] == "1, 2"
    assert "noise source" not in dict(listed(impact(facts={"noise_source": "data sheet"})))


def test_every_fact_has_one_key():
    for kind in (Facts, LocationFacts):
        keys = list(kind.specs())
        assert len(keys) == len(set(keys)) == sum(bool(f.metadata) for f in fields(kind))
