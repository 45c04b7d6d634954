"""Text is for people: changing any of it changes no number, no flag, no verdict and no exit code."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable
from importlib.metadata import EntryPoint, EntryPoints
from typing import Any

import numpy as np
import pytest

from loadid import (
    Deconvolution,
    FrequencyInversion,
    LoadTracker,
    Noise,
    NoiseSource,
    NotIdentifiable,
    Record,
    SparseDeconvolution,
    Spectra,
    StaticInversion,
    calibrate,
    cli,
)
from loadid._families.tracking.fit import pack, unpack
from loadid._inverse.problem import KINDS, WRITTEN
from loadid._results import archive
from loadid.constraints import Resultant
from loadid.paths import Refusal, RuleResult
from loadid.priors import Matern32
from loadid.validate import ReferenceWrench, held_out, validate
from structures import Channel, Flag, FrfModel, ImpulseModel, MatrixModel
from structures._advice import Advice, Option, Spelling, from_plain, on_command_line, to_plain
from structures._flags import Evidence
from structures.errors import InputError
from tests.loadid.test_cli import RATE, hit
from tests.loadid.test_track_fit import DT, made

TEXTS = (
    "a guess, not from any data sheet; white, as the covariance of the residual of an unloaded record",
    "residual power and roughness: not known ±σ 雑音 \n'{}%s",
    "",
)
RNG = np.random.default_rng


# -- problems with flags ----------------------------------------------------------------------------------------------
def static(source: Any, **settings: Any) -> Any:
    x = (np.arange(16) + 0.5) / 16
    H = 0.1 / np.pi / (0.01 + (x[:, None] - x) ** 2) / 16
    clean = H @ np.exp(-(((x - 0.45) / 0.1) ** 2) / 2)
    sigma = 0.01 * float(np.sqrt(np.mean(clean**2)))
    model = MatrixModel(H, sensors=[Channel(label=f"s{i}", quantity="displacement", unit="m") for i in range(16)])
    family = StaticInversion(model, noise=Noise(sigma, source=source), **settings)
    return family.estimate(clean + sigma * RNG(0).standard_normal(16))


def impulse() -> tuple[ImpulseModel, np.ndarray, np.ndarray]:
    t = np.arange(64) * 1e-3
    h = np.exp(-30 * t) * np.sin(2 * np.pi * 40 * t + 0.4)
    load = np.where((t > 0.01) & (t < 0.02), np.sin(np.pi * (t - 0.01) / 0.01), 0.0)
    y = np.convolve(load, h)[:64, None]
    sigma = np.array([0.02 * float(np.sqrt(np.mean(y**2)))])
    return ImpulseModel(h[:, None, None], 1e-3, kind="held"), y + sigma * RNG(1).standard_normal(y.shape), sigma


def deconvolution(source: Any) -> Any:
    model, y, sigma = impulse()
    return Deconvolution(model, noise=Noise(sigma / 4, source=source)).estimate(y, 1e-3)  # a level that is too low


def sparse(source: Any) -> Any:
    model, y, sigma = impulse()
    return SparseDeconvolution(model, noise=Noise(sigma, source=source)).estimate(y, 1e-3)


def frequency(source: Any) -> Any:
    rng, f = RNG(2), np.linspace(5, 100, 96)
    H = rng.standard_normal((96, 5, 2)) + 1j * rng.standard_normal((96, 5, 2))
    Y = np.einsum("ksl,l->ks", H, [3.0, 1.0]) + 0.1 * (rng.standard_normal((96, 5)) + 1j * rng.standard_normal((96, 5)))
    model = FrfModel(f, H, sensors=[Channel(label=x) for x in "abcde"], loads=[Channel(label=x) for x in "pq"])
    return FrequencyInversion(model).estimate(Spectra(f, Y, noise=0.02, noise_source=source))


def tracker(source: Any) -> Any:
    model = made()
    y = model.predict(np.convolve(RNG(3).standard_normal(300), np.hanning(40))[:300, None], DT)
    sigma = 0.02 * y.std(axis=0)
    family = LoadTracker(model, prior=Matern32(5.0, 0.1), noise=Noise(sigma / 3, source=source), allow=["LID-E501"])
    return family.estimate(y + sigma * RNG(4).standard_normal(y.shape), DT)


PROBLEMS: dict[str, Callable[[Any], Any]] = {
    "static": lambda source: static(source, choice="discrepancy"),
    "static, dof": lambda source: static(source, choice="dof_discrepancy"),
    "deconvolution": deconvolution,
    "sparse": sparse,
    "frequency": frequency,
    "tracker": tracker,
}


def decided(e: Any) -> dict[str, Any]:
    """All of an estimate that is no text for people."""
    c = e.choice
    return {
        "codes": sorted(f.code for f in e.flags),
        "evidence": [f.evidence.value for f in e.flags if not isinstance(f.evidence.value, str)],
        "load": e.load.tolist(),
        "std": e.std.tolist(),
        "choice": c and (c.lam, c.rule, c.verdict, c.spread, c.source.kind, c.source.white, c.shown),
        "rules": c and [(r.rule, r.lam, r.edge, r.free) for r in c.rules],
    }


@pytest.mark.parametrize(
    ("name", "kind"), [*((name, "stated") for name in PROBLEMS), ("static", "quiet"), ("deconvolution", "residual")]
)
def test_the_text_of_a_source_decides_nothing(name: str, kind: str) -> None:
    expected = decided(PROBLEMS[name](kind))
    for text in TEXTS[: 1 if name in ("sparse", "tracker") else 3]:
        assert decided(PROBLEMS[name](NoiseSource(kind, text))) == expected, text


def test_words_of_a_free_text_silence_no_flag() -> None:
    assert "W406" in static("a guess, not from any data sheet", choice="discrepancy").codes
    assert "W404" in static("white paper of the vendor", choice="dof_discrepancy").codes


def test_kinds_silence_flags() -> None:
    for kind, silent in (("datasheet", True), ("stated", False)):
        assert ("W406" not in static(kind, choice="discrepancy").codes) is silent
    assert "W404" in static(NoiseSource("quiet", "white"), choice="dof_discrepancy").codes
    assert "W404" not in static(NoiseSource("quiet", white=True), choice="dof_discrepancy").codes


# -- what is given as a source ----------------------------------------------------------------------------------------
def test_a_source_is_a_kind_a_pair_or_a_text() -> None:
    for kind in KINDS:
        assert NoiseSource.of(kind) == NoiseSource(kind)
        assert NoiseSource.of((kind, "text")) == NoiseSource(kind, "text")
    assert NoiseSource.of("my bench") == NoiseSource("stated", "my bench")
    assert NoiseSource.of("data sheet").kind == "datasheet"
    assert NoiseSource.of("unloaded record").kind == "quiet"
    assert NoiseSource.of("covariance").kind == "repeatability"
    assert (NoiseSource.of(None), NoiseSource.of("")) == (None, None)
    assert all(str(source) == text and NoiseSource.of(text) == source for text, source in WRITTEN.items())
    for wrong in (3, ("bogus", "text"), ("quiet", 3), ("quiet",), {"kind": "quiet"}):
        with pytest.raises(InputError, match="no source of a noise level"):
            NoiseSource.of(wrong)
    with pytest.raises(InputError, match="no source"):
        Deconvolution(impulse()[0], noise=Noise(source=("bogus", "text")))


def test_files_keep_the_kind_and_those_of_release_0_1_are_read(tmp_path: Any) -> None:
    e = static(NoiseSource("quiet", "bench of Tuesday", white=True), choice="discrepancy")
    e.save(tmp_path / "e.h5")
    back = type(e).read(tmp_path / "e.h5")
    assert back.choice.source == e.choice.source
    tree = archive.to_tree(e)
    assert tree["choice"]["sigma_source"] == "bench of Tuesday"
    assert tree["facts"]["noise_kind"] == "quiet"
    for text, kind in (("data sheet", "datasheet"), ("bench of Tuesday", "stated"), ("not known", "unknown")):
        old = archive.to_tree(e)
        del old["choice"]["source"]
        old["choice"] |= {"sigma_source": text, "rules": [{k: v for k, v in vars(r).items() if k != "free"}
                                                          for r in e.choice.rules]}  # fmt: skip
        old["choice"]["sweep"] = old["choice"]["sweep"] and vars(e.choice.sweep)
        found = archive.arguments({**old, "posterior": None})["choice"].source
        assert (found.kind, found.text) == (kind, text)


# -- advice -----------------------------------------------------------------------------------------------------------
def test_advice_has_both_spellings() -> None:
    advice = Advice("start with ", Option("initial", "unknown"), " or ", Spelling("allow=['E501']", "--allow E501"))
    assert advice == "start with initial='unknown' or allow=['E501']"
    assert advice.command == "start with --initial unknown or --allow E501"
    assert Option("allow_drift").command == "--allow-drift"
    assert (Option("dt", flag="fs").python, Option("dt", flag="fs").command) == ("dt=", "--fs")
    for again in (copy.deepcopy(advice), pickle.loads(pickle.dumps(advice)), Advice(advice),
                  from_plain(json.loads(json.dumps(to_plain(advice))))):  # fmt: skip
        assert (again, again.command) == (advice, advice.command)
    assert Advice("so: ", advice).command == f"so: {advice.command}"
    flag = Flag("W406", Evidence("a", 1.0), "found", advice)
    assert flag.command.endswith(advice.command)
    assert Flag.from_dict(json.loads(json.dumps(flag.to_dict()))).command == flag.command
    assert unpack(pack([flag, flag]))[1].command == flag.command
    error = InputError("wrong", where="here", hint=advice)
    assert str(error) == f"here: wrong; what to do: {advice}"
    assert error.command == f"here: wrong; what to do: {advice.command}"
    refused = NotIdentifiable("no", advice=advice, code="LID-E306")
    assert refused.command == f"[LID-E306] no; what to do: {advice.command}"
    assert on_command_line("plain") == "plain"


# -- all texts scrambled ----------------------------------------------------------------------------------------------
def scrambled(text: Any) -> Any:
    """Another text; the same for the same."""
    if isinstance(text, Advice):
        return Advice(Spelling(scrambled(str(text)), scrambled(text.command)))
    return text if not isinstance(text, str) or not text else f"data sheet, white, static {text[::-1]} Resultant"


@pytest.fixture
def other_words(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Scrambles every message, advice, hint, note and source from now on."""

    def constructor(kind: type, *names: str) -> None:
        plain = kind.__init__  # type: ignore[misc]
        positional = [*plain.__code__.co_varnames[1 : plain.__code__.co_argcount]]

        def init(self: Any, *given: Any, **more: Any) -> None:
            for name, value in zip(positional, given, strict=False):
                more[name] = value
            for name in names:
                if isinstance(more.get(name), str):
                    more[name] = scrambled(more[name])
                elif isinstance(more.get(name), list | tuple):
                    more[name] = [scrambled(text) for text in more[name]]
            plain(self, **more)

        monkeypatch.setattr(kind, "__init__", init)

    def start() -> None:
        constructor(Flag, "message", "advice")
        constructor(InputError, "what", "found", "expected", "hint")
        constructor(NotIdentifiable, "what", "advice")
        constructor(RuleResult, "note")
        constructor(NoiseSource, "text")
        constructor(Record, "notes")
        monkeypatch.setattr(Refusal, "__str__", lambda self: scrambled("refused"))

    return start


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_words_of_the_package_decide_nothing(name: str, other_words: Callable[[], None]) -> None:
    expected = decided(PROBLEMS[name]("stated"))
    other_words()
    found = PROBLEMS[name]("stated")
    assert all("data sheet, white" in flag.message for flag in found.flags)
    assert decided(found) == expected


def test_the_words_of_a_result_decide_no_validation(other_words: Callable[[], None]) -> None:
    expected = checked()
    other_words()
    assert checked() == expected


def checked() -> list[str]:
    """What validations say: of a resultant that was a constraint, of sensors that were kept out."""
    total = float(np.sum(static(None).load))
    e = static("quiet", constraints=[Resultant(np.ones((1, 16)), [total], labels=["F"])], choice=0.01)
    x = (np.arange(4) + 0.5) / 4
    H = 0.1 / np.pi / (0.01 + (x[:, None] - (np.arange(16) + 0.5) / 16) ** 2) / 16
    model = MatrixModel(H, sensors=[Channel(label=f"k{i}", quantity="displacement", unit="m") for i in range(4)])
    kept = held_out(e, model, H @ e.load)
    codes = sorted(f.code for f in validate(e, ReferenceWrench([total], C=np.ones((1, 16)), labels=["F"])).flags)
    assert "LID-W704" in codes
    return [*codes, *(f.code for f in kept.flags), kept.measured.tolist()]


def test_the_words_of_the_package_give_no_exit_code(
    other_words: Callable[[], None], tmp_path: Any, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    group = EntryPoints(
        EntryPoint(n, f"loadid._commands.{n}:command", cli.GROUP) for n in ("info", "check", "identify")
    )
    monkeypatch.setattr(cli, "entry_points", lambda group_=None, group=None, found=group: found)
    monkeypatch.chdir(tmp_path)
    for k in range(2):
        table = np.column_stack([np.arange(1024) / RATE, hit(k, samples=1024)])
        np.savetxt(f"hit{k}.csv", table, delimiter=",", header="time [s],F [N],a1 [m/s^2],a2 [m/s^2]", comments="")
    np.save("bare.npy", hit(0))
    calibrate(["hit0.csv"], force="F", responses=["a1", "a2"]).save("model.h5")
    runs = (
        "identify hit1.csv --model model.h5 -o r.h5",
        "info r.h5",
        "identify hit1.csv --model model.h5 -o r.h5 --fs 1000",
        "identify hit1.csv --model model.h5 -o r.h5 --choice bogus",
        "identify hit1.csv --model model.h5 -o r.h5 --penalty none",
        "identify bare.npy --model model.h5 -o r.h5",
        "info bare.npy",
        "check hit0.csv",
        "info nothing.csv",
    )

    def codes() -> list[int]:
        found = [cli.main(words.split()) for words in runs]
        capsys.readouterr()
        return found

    expected = codes()
    assert {0, 3} <= set(expected)
    other_words()
    assert codes() == expected
