"""One's own data: the numbers of the command, any lambda, bad files, and an estimate that explores itself."""

from __future__ import annotations

import json
import math
import re
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loadid
from loadid import Deconvolution, InputError, SparseDeconvolution, datasets
from loadid._lab import explore as exploring
from loadid._lab.own import LARGEST_LOG, page_of
from loadid._lab.server import Lab
from loadid._lab.shown import BINS, Shown, curve, shortened
from loadid.cli import main

from .client import asked, posted, sent

PLAIN = {"family": "auto", "response": "", "noise": "", "more": ""}
NO_WORDS = {"fs": "", "columns": "", "record": "", "units": ""}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A log and its model, the static readings of a wing and theirs."""
    folder = tmp_path_factory.mktemp("own")
    hit = datasets.impact(folder)
    hit.model.save(folder / "beam.h5")
    wing = datasets.wing_strains()
    wing.model.save(folder / "wing.h5")
    rows = zip(wing.record.labels, wing.record.values[0], strict=True)
    (folder / "strains.csv").write_text("\n".join(f"{label},{value:.9g}" for label, value in rows))
    return {"log": folder / "log.csv", "model": folder / "beam.h5", "wing": folder / "wing.h5",
            "strains": folder / "strains.csv"}  # fmt: skip


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    """A lab whose temporary folder is seen."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    with Lab([page_of()]) as found:
        yield found
    assert not list((tmp_path / "temporary").iterdir())


@pytest.fixture(scope="module")
def estimate(files: dict[str, Path]) -> loadid.LoadEstimate:
    return Deconvolution(datasets.impact().model).estimate(datasets.impact().record)


def command(files: dict[str, Path], out: Path, *words: str, log: str = "log", model: str = "model") -> dict[str, Any]:
    """What the command writes as JSON, and the file that it writes."""
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()) as said:
        given = ["identify", str(files[log]), "--model", str(files[model]), "-o", str(out), *words, "--json"]
        assert main(given) == 0
    found: dict[str, Any] = json.loads(said.getvalue())
    return found


def same(page: dict[str, Any], said: dict[str, Any]) -> None:
    """The numbers and words of the page are those of the command, to the last digit."""
    assert page["peaks"] == said["peaks"]
    assert page["grade"] == said["grade"]["said"]
    assert page["verdict"] == said["choice"]["verdict"]
    assert page["edf"] == said["facts"]["edf"]
    told = {(f["code"], f["level"], f["message"]) for f in page["flags"]}
    assert told == {(f["code"].removeprefix("LID-"), f["level"], f["message"]) for f in said["flags"]}


def opened(lab: Lab, files: dict[str, Path], log: str = "log", model: str = "model") -> None:
    assert sent(lab, "own/model", files[model])[0] == 200
    assert sent(lab, "own/log", files[log], **NO_WORDS)[0] == 200


# -- the numbers of the command ---------------------------------------------------------------------------------------
def test_the_page_has_the_numbers_of_the_command(lab: Lab, files: dict[str, Path], tmp_path: Path) -> None:
    opened(lab, files)
    status, found = asked(lab, "own/identify", **PLAIN)
    assert status == 200
    said = command(files, tmp_path / "load.h5")
    same(found, said)
    assert found["lam"] == said["choice"]["lam"]
    shown = asked(lab, "own/picture", of=found["of"], lam=0.0, load=0)[1]
    assert shown["peak"]["value"] == pytest.approx(said["peaks"][0]["value"], rel=1e-7)
    status, kept = asked(lab, "own/save", of=found["of"], lam=0.0)
    (tmp_path / "page.h5").write_bytes(kept)
    np.testing.assert_array_equal(loadid.load(tmp_path / "page.h5").load, loadid.load(tmp_path / "load.h5").load)


def test_at_another_lambda_they_are_those_of_the_command_with_this_lambda(
    lab: Lab, files: dict[str, Path], tmp_path: Path
) -> None:
    opened(lab, files)
    of = asked(lab, "own/identify", **PLAIN)[1]["of"]
    status, found = asked(lab, "own/at", of=of, lam=3e-4)
    assert status == 200
    said = command(files, tmp_path / "load.h5", "--choice", "3e-4")
    assert found["edf"] == pytest.approx(said["facts"]["edf"], rel=1e-6)
    assert found["peaks"][0]["value"] == pytest.approx(said["peaks"][0]["value"], rel=1e-9)
    assert found["peaks"][0]["std"] == pytest.approx(said["peaks"][0]["std"], rel=1e-4)
    assert found["verdict"] == said["choice"]["verdict"]
    assert {f["code"] for f in found["flags"]} == {f["code"].removeprefix("LID-") for f in said["flags"]}
    quick = asked(lab, "own/picture", of=of, lam=3e-4, load=0)[1]
    assert quick["peak"]["value"] == pytest.approx(found["peaks"][0]["value"], rel=1e-7)
    assert quick["peak"]["std"] == pytest.approx(found["peaks"][0]["std"], rel=1e-7)
    axis = asked(lab, "own/found")[1]["x"]  # sent once
    assert "x" not in quick
    assert len(axis) == len(quick["y"])
    (tmp_path / "page.h5").write_bytes(asked(lab, "own/save", of=of, lam=3e-4)[1])
    own, other = loadid.load(tmp_path / "page.h5"), loadid.load(tmp_path / "load.h5")
    assert own.choice is not None
    assert own.choice.lam == 3e-4
    assert own.axis is not None
    np.testing.assert_allclose(axis, own.axis.values, rtol=1e-5)
    np.testing.assert_allclose(own.load, other.load, atol=1e-9 * np.abs(other.load).max())


def test_static_readings_with_settings_of_the_command(lab: Lab, files: dict[str, Path], tmp_path: Path) -> None:
    opened(lab, files, "strains", "wing")
    words = "--penalty gradient --nonnegative"
    status, found = asked(lab, "own/identify", **{**PLAIN, "family": "static", "more": words, "noise": "1e-6"})
    assert status == 200
    said = command(files, tmp_path / "load.h5", "--family", "static", "--noise", "1e-6", *words.split(), log="strains",
                   model="wing")  # fmt: skip
    same(found, said)
    assert found["single"]
    status, shown = asked(lab, "own/picture", of=found["of"], lam=found["lam"] * 2, load=0)
    assert status == 200
    assert len(shown["y"]) == len(found["loads"])


def test_a_unit_that_the_command_would_ask_for_is_asked_for(lab: Lab, files: dict[str, Path], tmp_path: Path) -> None:
    plain = tmp_path / "plain.csv"
    text = files["log"].read_text().splitlines()
    plain.write_text("\n".join(["time,12+Z", *[line for line in text if re.match(r"[-\d.]+[,;]", line)]]))
    assert sent(lab, "own/model", files["model"])[0] == 200
    status, found = sent(lab, "own/log", plain, **NO_WORDS)
    assert status == 400
    assert "unit" in found["error"]
    status, found = sent(lab, "own/log", plain, **{**NO_WORDS, "units": "12+Z=m/s^2"})
    assert status == 200
    assert found["log"]["channels"][0]["unit"] == "m/s^2"
    assert sent(lab, "own/log", plain, **{**NO_WORDS, "units": "12+Z"})[0] == 400
    assert sent(lab, "own/log", plain, **{**NO_WORDS, "fs": "-3", "units": "12+Z=g"})[0] == 400


def test_the_log_shows_its_channels_and_their_health(lab: Lab, files: dict[str, Path]) -> None:
    opened(lab, files)
    log = asked(lab, "own/state")[1]["log"]
    record = loadid.read(files["log"])
    assert log["samples"] == len(record.values)
    assert log["channels"][0]["rms"] == pytest.approx(np.sqrt(np.mean(record.values**2)))
    np.testing.assert_allclose(log["curves"][0]["y"], record.values[:, 0], rtol=1e-4, atol=1e-3)


def test_a_long_curve_keeps_its_extremes() -> None:
    y = np.random.default_rng(0).standard_normal(20_011)
    y[7], y[19_000] = 40.0, -50.0
    found = curve(np.arange(20_011.0), y, y - 1, y + 1)
    assert len(found["y"]) <= 2 * BINS
    assert (found["y"].max(), found["y"].min()) == (40.0, -50.0)
    assert (found["high"].max(), found["low"].min()) == (41.0, -51.0)
    assert np.all(found["low"] <= found["y"])
    assert np.all(found["high"] >= found["y"])
    assert np.all(np.diff(found["x"]) > 0)


def test_shortened_numbers_are_those_that_a_text_has() -> None:
    values = np.concatenate([np.random.default_rng(0).standard_normal(300) * 10.0 ** np.arange(-150, 150), [0.0, 7.0]])
    assert shortened(values, 5).tolist() == pytest.approx([float(f"{v:.5g}") for v in values], rel=1e-13)
    odd = shortened(np.array([np.nan, np.inf, -np.inf, 5e-324]), 3)
    assert np.isnan(odd[0])
    assert odd[1:3].tolist() == [np.inf, -np.inf]


# -- bad input --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "a" * 300 + ".h5", "", "nul\x00.h5", "/dev/null", "..", "%00", "☃.csv"]
)
def test_absurd_names_lead_nowhere(lab: Lab, name: str) -> None:
    status, found = sent(lab, "own/model", b"no model at all", name)
    assert status == 400
    assert len(found["error"]) < 2000
    assert "Traceback" not in found["error"]
    assert tempfile.gettempdir() not in found["error"]
    assert asked(lab, "own/state")[0] == 200


def test_damaged_models_are_refused_in_a_sentence(lab: Lab, files: dict[str, Path]) -> None:
    whole, rng = files["model"].read_bytes(), np.random.default_rng(3)
    cut = [whole[: int(k)] for k in rng.integers(0, len(whole), 6)]
    turned = []
    for _ in range(6):
        data = bytearray(whole)
        at = int(rng.integers(0, len(data) - 64))
        data[at : at + 64] = rng.bytes(64)
        turned.append(bytes(data))
    for data in [b"", *cut, *turned]:
        status, found = sent(lab, "own/model", data, "model.h5")
        assert status in (200, 400)  # a byte between the blocks is nobody's
        if status == 400:
            assert "Traceback" not in found["error"]
    assert sent(lab, "own/model", files["model"])[0] == 200


@pytest.mark.parametrize(
    "data", [b"", b"\x00" * 5000, b"a,b\n1,2\n", b"\x89HDF\r\n\x1a\n" + b"\xff" * 900, b"PK\x03\x04" + b"0" * 99]
)
def test_damaged_logs_are_refused_in_a_sentence(lab: Lab, files: dict[str, Path], data: bytes) -> None:
    assert sent(lab, "own/model", files["model"])[0] == 200
    for name in ("log.csv", "log.h5", "log.mat", "log.npz", "log.xyz"):
        status, found = sent(lab, "own/log", data, name, **NO_WORDS)
        assert status == 400, name
        assert "Traceback" not in found["error"]
    assert asked(lab, "own/state")[1]["log"] is None


def test_odd_values_are_refused_in_a_sentence(lab: Lab, files: dict[str, Path]) -> None:
    opened(lab, files)
    of = asked(lab, "own/identify", **PLAIN)[1]["of"]
    right: dict[str, dict[str, Any]] = {
        "own/picture": {"of": of, "lam": 0.01, "load": 0},
        "own/ahead": {"of": of, "lams": [0.01, 0.02], "load": 0},
        "own/at": {"of": of, "lam": 0.01},
        "own/save": {"of": of, "lam": 0.01},
        "own/found": {},
    }
    for path, given in right.items():
        assert asked(lab, path, **given)[0] == 200
        for name in given:
            for odd in (math.nan, -1, "0.01", None, True, [], {}, 1e300, "\x00"):
                status, found = asked(lab, path, **{**given, name: odd})
                assert status == 400, (path, name, odd)
                assert "Traceback" not in found["error"]
        assert asked(lab, path, **given, more=1)[0] == 400
    assert asked(lab, "own/at", of=of, lam=0.0)[0] == 400
    for name in PLAIN:
        for odd in ("\x1b[2J", "a" * 2000, None, 7, "--" * 40, "; rm -rf /", "$(id)", "☃"):
            status, found = asked(lab, "own/identify", **{**PLAIN, name: odd})
            assert status in (400, 422), (name, odd)
            assert "Traceback" not in found["error"]
    assert asked(lab, "own/picture", of=of, lam=0.0, load=0)[0] == 200  # the estimate is still there


def test_a_window_does_not_get_the_picture_of_the_load_of_another_one(lab: Lab, files: dict[str, Path]) -> None:
    opened(lab, files)
    first, second = (asked(lab, "own/identify", **{**PLAIN, "noise": noise})[1]["of"] for noise in ("0.1", "0.2"))
    assert asked(lab, "own/picture", of=second, lam=0.01, load=0)[0] == 200
    for path, more in (("picture", {"lam": 0.01, "load": 0}), ("at", {"lam": 0.01}), ("save", {"lam": 0.0})):
        status, found = asked(lab, f"own/{path}", of=first, **more)
        assert status == 400
        assert "in another window" in found["error"]


def test_what_is_too_large_is_not_read(lab: Lab) -> None:
    told = {"Content-Type": "application/octet-stream", "X-Lab-File": "x.csv", "X-Lab-Parameters": "%7B%7D"}
    status, found = posted(lab, "/own/log", b"", {**told, "Content-Length": str(LARGEST_LOG + 1)})
    assert status == 413
    assert str(LARGEST_LOG) in found["error"]


def test_a_log_needs_a_model_and_a_load_needs_both(lab: Lab, files: dict[str, Path]) -> None:
    assert "model" in sent(lab, "own/log", files["log"], **NO_WORDS)[1]["error"]
    assert asked(lab, "own/identify", **PLAIN)[0] == 400
    assert asked(lab, "own/found")[0] == 400
    assert asked(lab, "own/picture", of=0, lam=0.1, load=0)[0] == 400


@pytest.mark.parametrize(
    "more", ["--report page.html", "-o x.h5", "--job x.toml", "--nonsense", "--noise", "'", "--choice x", "x.csv"]
)
def test_words_that_are_no_settings_are_refused(lab: Lab, files: dict[str, Path], more: str) -> None:
    opened(lab, files)
    status, found = asked(lab, "own/identify", **{**PLAIN, "more": more})
    assert status == 400
    assert "Traceback" not in found["error"]
    assert not Path("page.html").exists()


def test_a_setting_that_the_family_refuses_says_so(lab: Lab, files: dict[str, Path]) -> None:
    opened(lab, files)
    assert asked(lab, "own/identify", **{**PLAIN, "family": "harmonic"})[0] == 400
    assert "12+Y" in asked(lab, "own/identify", **{**PLAIN, "response": "12+Y"})[1]["error"]
    assert asked(lab, "own/identify", **{**PLAIN, "family": "location"})[0] == 400


# -- an estimate that explores itself ---------------------------------------------------------------------------------
def test_an_estimate_explores_itself(estimate: loadid.LoadEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: shown.append(address) or True)
    with estimate.explore() as found:
        assert shown == [found.address]
        assert found.address in repr(found)
        lab = found._lab
        assert asked(lab, "own/state")[1] == {"model": None, "log": None, "found": True, "given": True}
        assert asked(lab, "own/found")[1]["peaks"][0]["value"] == estimate.peaks[0].value
        assert asked(lab, "own/at", of=0, lam=0.01)[1]["peaks"][0]["value"] == estimate.at(0.01).peaks[0].value
        assert asked(lab, "own/identify", **PLAIN)[0] == 404  # nothing can be sent to it
        assert sent(lab, "own/model", b"x")[0] == 404
        page = found._repr_html_()
        assert page.count(found.address) == 2
        assert "<iframe" in page
    found.close()
    assert "closed" in repr(found)
    assert "closed" in found._repr_html_()


def test_in_a_notebook_no_browser_is_opened(estimate: loadid.LoadEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: shown.append(address) or True)
    monkeypatch.setattr(exploring, "in_notebook", lambda: True)
    estimate.explore().close()
    estimate.explore(browser=False).close()
    assert not shown
    estimate.explore(browser=True).close()
    assert len(shown) == 1
    monkeypatch.undo()
    assert not exploring.in_notebook()
    with estimate.explore(browser=False) as first, pytest.raises(InputError, match="port"):
        estimate.explore(browser=False, port=int(first.address.split(":")[2].split("/")[0]))


def test_what_an_estimate_does_not_hold_is_said_and_nothing_fails(
    estimate: loadid.LoadEstimate, tmp_path: Path
) -> None:
    estimate.save(tmp_path / "load.h5")
    hit = datasets.impact()
    sparse = SparseDeconvolution(hit.model, choice=0.05).estimate(
        replace(hit.record, values=hit.record.values[:200].copy())
    )
    for other in (loadid.load(tmp_path / "load.h5"), sparse):
        desk = Shown(other)
        found = desk.found()
        assert found["lacks"]
        assert found["range"] is None
        assert found["picard"] is None
        assert desk.picture(0.0, 0)["peak"]["value"] == pytest.approx(other.peaks[0].value, rel=1e-7)
        with pytest.raises(InputError, match="no problem"):
            desk.at(0.1)
    assert Shown(loadid.load(tmp_path / "load.h5")).found()["sweep"] is not None  # a file has its L-curve


def test_the_command_opens_a_log_and_a_model(
    files: dict[str, Path], monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    def run(lab: Lab) -> None:
        lab.start()
        try:
            assert asked(lab, "own/state")[1]["log"]["samples"] == 400
        finally:
            lab.http.shutdown()

    monkeypatch.setattr(Lab, "run", run)
    assert main(["lab", str(files["log"]), str(files["model"]), "--no-browser"]) == 0
    assert "/own?token=" in capsys.readouterr().out
    assert main(["lab", str(files["log"]), "--no-browser"]) == 2
    assert main(["lab", str(files["model"]), str(files["log"]), "--no-browser"]) == 3
