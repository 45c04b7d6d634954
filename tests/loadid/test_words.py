"""Words that must not claim too much: shares, overridden refusals, what the data cannot tell, known loads."""

import json
import logging

import numpy as np
import pytest

from loadid import cli
from loadid._results.report import page
from loadid._results.summary import against, allowed, cannot_tell, comparison, share
from loadid.codes import GUARDS, known_codes
from loadid.paths import Choice
from structures import Flag
from structures._flags import Evidence
from structures.errors import InputError
from tests.loadid.made import half_sine, impact


@pytest.mark.parametrize(
    ("part", "text"), [(1.0, "100 %"), (0.9997, "99.97 %"), (0.99999, "99.99 %"), (0.95, "95.0 %"), (0.0, "0.0 %")]
)
def test_nearly_all_is_not_all(part, text):
    assert share(part) == text


def test_the_coverage_around_the_peak_stands_beside_that_of_the_record():
    t, truth = half_sine()
    e = impact(seed=3)
    wrong = truth.copy()
    wrong[np.argmax(truth)] += 500  # one sample of the pulse is far outside the band
    found = against(e, wrong)
    near = (t >= found["window"][0]) & (t <= found["window"][1])
    inside = np.abs(e.load[:, 0] - wrong) <= 1.959964 * e.std[:, 0]
    assert found["coverage_95"] == pytest.approx(inside.mean())
    assert found["coverage_95_peak"] == pytest.approx(inside[near].mean())
    assert found["coverage_95_peak"] < found["coverage_95"]
    assert "around the peak" in comparison(found)
    assert "around the peak" not in comparison(found | {"window": None})
    assert "caution: do not read the band as 95 %" in comparison(found | {"coverage_95_peak": 0.82})
    assert "caution" not in comparison(found | {"coverage_95_peak": 0.93})


def test_the_report_holds_the_comparison_with_the_known_load():
    e = impact(choice=None, response=None, residual=None)
    truth = half_sine()[1]
    text = " ".join(page(e, truth=truth).split())
    assert comparison(against(e, truth)) in text
    assert "against the known load" not in page(e)


def test_allowed_is_not_overridden():
    idle = impact(allowed=["W407", "E306"])
    assert allowed(idle) == "allowed: LID-W407, LID-E306"
    free = {"facts": {"rank": 10, "n": 400}, "choice": Choice(lam=0.0, scale=1.0, rule="given")}
    assert allowed(impact(allowed=["E306"], **free)) == "overridden refusals: LID-E306"
    full = free | {"facts": {"rank": 400, "n": 400}}
    assert allowed(impact(allowed=["E306"], **full)) == "allowed: LID-E306"
    flag = Flag("E506", Evidence("|h(0)|", 0.0), "no diagonal", "shift")
    assert allowed(impact(allowed=["E506"], flags=[flag])) == "overridden refusals: LID-E506"


def test_codes_are_those_of_the_package():
    assert known_codes(["w407", "LID-E306"]) == ("LID-W407", "LID-E306")
    with pytest.raises(InputError, match=r"no such guard code.*W999.*E306"):
        known_codes(["W999"])
    assert "E306" in GUARDS


def test_what_the_data_cannot_tell_is_a_sentence():
    nothing = cannot_tell(impact(facts={"nullity": 0, "resolution": 2e-4, "resolution_unit": "s", "peak_bias": 0.4}))
    assert "nullity 0" in nothing
    assert "200 µs" in nothing
    assert "60%" in nothing
    assert cannot_tell(impact(facts={"nullity": 7, "n": 400})).startswith("7 of 400 components")
    assert cannot_tell(impact(facts={})) == ""


def test_names_in_a_file_give_a_terminal_no_orders(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text(
        "time [s],a\x1b]0;owned\x9b31m\u202ename [g]\n" + "".join(f"{k / 10},{k}\n" for k in range(9)), "utf-8"
    )
    for given in ([], ["--json"]):
        assert cli.main(["info", str(path), *given]) == 0
        out = capsys.readouterr().out
        assert "\\u001b" in out
        assert not set(out) & set("\x1b\x9b\u202e")
        if given:
            assert json.loads(out)["records"][0]["channels"][0]["label"] == "a\x1b]0;owned\x9b31m\u202ename"


def test_errors_and_logs_give_a_terminal_no_orders(tmp_path, capsys):
    bad = "a\x1b]0;owned\x9b31m\u202ename"
    path = tmp_path / "log.csv"
    path.write_text(f"time [s],{bad} [furlong],{bad}2 [g]\n" + "".join(f"{k / 10},{k},1\n" for k in range(9)), "utf-8")
    for given in ([], ["--json"]):
        for words in (["check", str(path)], ["info", f"{bad}.csv"], ["info", f"--{bad}"]):
            assert cli.main([*words, *given]) in (2, 3)
            told = capsys.readouterr().err
            assert "\\u001b" in told
            assert not set(told) & set("\x1b\x9b\u202e")
            if given:
                assert "\x1b" in json.dumps(json.loads(told), ensure_ascii=False).replace("\\u001b", "\x1b")
    with cli._Log("warning", as_json=False, hushed=False):
        logging.getLogger("loadid").warning("channel %s", bad)
    told = capsys.readouterr().err
    assert "\\u001b" in told
    assert "\x1b" not in told
