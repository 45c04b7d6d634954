"""A tracker in C answers as the tracker does; compiled with every warning an error."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loadid import Ambient, InputError, LoadTracker, ModelErrors, Online
from loadid._families.tracking.tracker import Tracker
from loadid.priors import OU, Matern32, RandomWalk
from loadid.settings import Noise
from structures import StateSpace
from tests import tracked
from tests.compiled import CC, STRICT, Controller, build, needs_compiler

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "docs" / "examples" / "controller"
SETTLED, MISSING, OUT, EVENT, DOUBT, LOST, BELIEVED, BOUNDED = (1 << k for k in range(8))
CLOSE = 1e-9  # of the load, and of the std

Case = tuple[tracked.Tracked, Tracker]


def building(samples: int = 3000, **settings: object) -> Case:
    case = tracked.bm2("matern", 0, samples=samples)
    known = {"prior": Matern32(100.0, 0.08), "noise": Noise(case.noise, source="data sheet"), **settings}
    return case, LoadTracker(case.setup.space(), **known).fit(case.y[:2000], case.dt)


def far() -> Case:
    """The load at the top, all sensors at the foot: an event shows late, and the band is wider than the filter's."""
    case = tracked.bm2("step", 1, acc=(1, 2), disp=(3,), samples=2000)
    known = {"prior": Matern32(30.0, 0.5), "noise": Noise(case.noise, source="data sheet")}
    return case, LoadTracker(case.setup.space(), **known).fit(case.y, case.dt)


def beam(gate: float | None = 6.0) -> Case:
    """Ambient loads move structure and sensors: the two noises are correlated."""
    case = tracked.bm3(0, 4000)
    setup, j = case.setup, np.arange(1, 9)
    x = (np.array([25, 45, 80])[:, None] - 1) * 30.0 / 100
    around = (np.sqrt(2 / (50.0 * 30.0)) * np.sin(j * np.pi * x / 30.0)).T
    _, first, second = setup.held(around, case.dt)
    A, _, G, _ = setup.matrices()
    ambient = Ambient(StateSpace(A, first + second, G, setup.through(around), case.dt, "zoh"), 1.0)
    errors = ModelErrors(ambient=ambient, state_noise=1e-8)
    known = {"prior": OU(10.0, 1 / (2 * np.pi * 0.05)), "noise": Noise(1e-4, source="set")}
    return case, LoadTracker(setup.space(), model_error=errors, gate=gate, **known).fit(case.y, case.dt)


def drifting() -> Case:
    """Accelerometers alone: no gain settles."""
    case = tracked.bm2("mix", 0, disp=(), samples=1500)
    known = {"prior": RandomWalk(100.0), "noise": Noise(case.noise, source="data sheet"), "allow": ["LID-E501"]}
    return case, LoadTracker(case.setup.space(), **known).fit(case.y, case.dt)


def soiled(case: tracked.Tracked, seed: int, share: float = 0.05, spikes: float = 0.003) -> np.ndarray:
    """The record with NaN cells and spikes between a std of the noise and ten thousand of them."""
    rng, y = np.random.default_rng(seed), case.y.copy()
    std = np.sqrt(np.diag(case.noise)) if case.noise.ndim == 2 else np.broadcast_to(case.noise, y.shape[1])
    y[rng.random(y.shape) < share] = np.nan
    hit = rng.random(y.shape) < spikes
    size = rng.standard_normal(hit.sum()) * 10 ** rng.uniform(1, 5, hit.sum())
    y[hit] += size * np.broadcast_to(std, y.shape)[hit]
    return y


def alone(tracker: Tracker) -> Tracker:
    """The tracker without the watch over its sensors, which the C has not."""
    return Tracker(replace(tracker.fitted, usual=None), tracker.gate)


def compiled(tracker: Tracker, folder: Path, dtype: str = "double") -> Controller:
    source = folder / "roof.c"
    if not source.exists():
        assert tracker.to_c(source, "roof") == source
    return Controller(source, "roof", tracker.fitted.model.m, tracker.fitted.model.p, dtype)


def python(tracker: Tracker, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Its loads and std, within the bounds that stand in the tracker's watch."""
    load, std, _ = alone(tracker).run(y)
    most = np.inf if tracker._bounds() is None else tracker._bounds()
    wide = 1.0 if tracker.fitted.wider is None else tracker.fitted.wider
    return np.clip(load, -most, most), np.where(np.abs(load) > most, np.maximum(std, most * wide), std)


def agree(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray], within: float = CLOSE) -> None:
    """To a share of the load as it usually is, and of the std."""
    np.testing.assert_allclose(ours[0], theirs[0], rtol=0, atol=within * np.quantile(np.abs(theirs[0]), 0.9))
    np.testing.assert_allclose(ours[1], theirs[1], rtol=within)


@pytest.fixture(scope="module")
def roof() -> Case:
    return building(6000)


@needs_compiler
def test_c_and_python_agree_over_missing_cells_and_spikes(roof: Case, tmp_path: Path) -> None:
    """5 % of the cells missing; events, doubts, a gate that fails and wrong channels: `tests.benchmarks.controller` has
    100 000 samples."""
    case, tracker = roof
    y = soiled(case, 1)
    load, std, said = compiled(tracker, tmp_path).run(y)
    agree((load, std), python(tracker, y))
    for what in (MISSING, OUT, EVENT, DOUBT, BELIEVED):
        assert np.count_nonzero(said & what) > 3, what
    assert np.array_equal((said & MISSING) > 0, np.isnan(y).any(axis=1))
    single = compiled(tracker, tmp_path, "float").run(y)
    agree(single, (load, std), 2e-3)
    assert np.median(np.abs(single[0] - load)) < 1e-5 * np.abs(load).max()


@needs_compiler
def test_the_whole_tracker_answers_so_where_its_watch_finds_nothing(roof: Case, tmp_path: Path) -> None:
    case, tracker = roof
    y = case.y[:3000].copy()
    y[1000, 0] += 1e3 * case.noise[0]
    y[1500] = np.nan
    y[2000:2300, 1] = np.nan
    tracker.reset()
    load, std, said = compiled(tracker, tmp_path).run(y)
    agree((load, std), tracker.run(y)[:2])
    assert not tracker.faults
    assert np.count_nonzero(said & SETTLED) > 1500
    assert np.all(std[(said & SETTLED) > 0] == tracker.fitted.settled.std)
    tracker.reset()


@needs_compiler
@pytest.mark.parametrize(
    ("make", "spikes"),
    [(far, 0.003), (beam, 0.003), (lambda: beam(None), 0.0), (drifting, 0.003),
     (lambda: building(gate=None), 0.0)],
    ids=["far", "correlated", "correlated, no gate", "no settled gain", "no gate"],
)  # fmt: skip
def test_other_filters_agree_too(make, spikes: float, tmp_path: Path) -> None:
    case, tracker = make()
    y = soiled(case, 3, spikes=spikes)[:1000]
    y[400:420] = np.nan
    load, std, _ = compiled(tracker, tmp_path).run(y)
    agree((load, std), python(tracker, y))
    single = compiled(tracker, tmp_path, "float").run(y)
    after = slice(1, None)  # a start that may be anywhere leaves the first sample few digits
    agree([part[after] for part in single[:2]], (load[after], std[after]), 0.05)


@needs_compiler
def test_missing_channels_against_a_textbook_filter(tmp_path: Path) -> None:
    """Dense covariances, Joseph's form: load and std, whichever channels are there."""
    case, tracker = building(gate=None)
    y = soiled(case, 4, 0.3, 0.0)[:800]
    y[300:310] = np.nan
    dense = tracked.reference(tracker.fitted.model, y)
    load, std, said = compiled(tracker, tmp_path).run(y)
    assert not (said & SETTLED).any()
    agree((load, std), (dense.load, dense.std), 1e-6)
    assert std[309] > 1.5 * std[299]


@needs_compiler
def test_several_trackers_do_not_know_of_each_other(roof: Case, tmp_path: Path) -> None:
    case, tracker = roof
    y = soiled(case, 5)[:600]
    one, two = compiled(tracker, tmp_path), compiled(tracker, tmp_path)
    whole = one.run(y)
    one.reset()
    parts = []
    for k in range(0, 600, 50):
        parts.append(one.run(y[k : k + 50])[0])
        two.run(-y[k : k + 50])
    assert np.array_equal(np.vstack(parts), whole[0])


@needs_compiler
def test_samples_at_the_end_of_a_range_are_missing(tmp_path: Path) -> None:
    case, tracker = building(online=Online(limits={"a0": 5.0}))
    high = np.abs(case.y[:, 0]) >= 5.0
    assert high.any()
    load, std, said = compiled(tracker, tmp_path).run(case.y)
    assert np.array_equal((said & MISSING) > 0, high)
    agree((load, std), python(tracker, case.y))


@needs_compiler
def test_a_load_far_beyond_those_of_the_fit_is_held_with_as_wide_a_band(roof: Case, tmp_path: Path) -> None:
    case, tracker = roof
    load, most = np.zeros((600, 1)), 100 * tracker.fitted.most
    load[300:] = 5 * most
    found, std, said = compiled(tracker, tmp_path).run(case.y[:600] + case.setup.respond(load))
    held = (said & BOUNDED) > 0
    assert held[310:].all()
    assert not held[:300].any()
    np.testing.assert_allclose(found[held], np.broadcast_to(most, found[held].shape), rtol=1e-12)
    assert np.all(std[held] >= most * (1 - 1e-12))


@needs_compiler
def test_a_dead_channel_and_rates_agree_with_the_gains_of_their_rhythm(roof: Case, tmp_path: Path) -> None:
    case, tracker = roof
    y = case.y[:3000].copy()
    y[500:1500, 1] = np.nan
    y[1700:][np.arange(1300) % 3 > 0, 0] = np.nan
    load, std, _ = compiled(tracker, tmp_path).run(y)
    agree((load, std), python(tracker, y))


@needs_compiler
def test_the_object_needs_the_mathematics_alone_and_keeps_nothing(roof: Case, tmp_path: Path) -> None:
    """No heap, no input or output; and no variable that could be written to."""
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("no nm to list symbols with")
    source = roof[1].to_c(tmp_path / "t.c", "roof", dtype="float")
    made = build(source, "-O1", "-c", out=tmp_path / "t.o")
    said = subprocess.run([nm, str(made)], check=True, capture_output=True, text=True).stdout
    listed = [line.split() for line in said.splitlines()]
    asked = {words[-1].lstrip("_") for words in listed if words[-2] == "U"}
    assert asked <= {"memset", "memcpy", "memmove", "stack_chk_fail", "GLOBAL_OFFSET_TABLE_", "sqrtf", "logf", "expf"}
    assert {words[-1] for words in listed if words[-2] == "T"} == {"roof_reset", "roof_reset_moving", "roof_step"}
    assert not [words for words in listed if words[-2] in "bBdDcC"]


@needs_compiler
def test_the_example_of_cmake_builds_and_runs(roof: Case, tmp_path: Path) -> None:
    """In double, though it was written for single precision."""
    cmake = shutil.which("cmake")
    if cmake is None:
        pytest.skip("no cmake on this machine")
    case, tracker = roof
    source, y = tracker.to_c(tmp_path / "wind.c", name="wind", dtype="float"), soiled(case, 6)[:300]
    for words in (["-S", str(EXAMPLE), "-B", str(tmp_path / "b"), f"-DWIND={source}", "-DWIND_TYPE=DOUBLE"],
                  ["--build", str(tmp_path / "b")]):  # fmt: skip
        made = subprocess.run([cmake, *words], capture_output=True, text=True)
        assert made.returncode == 0, made.stdout + made.stderr
        assert "warning" not in made.stderr
    text = "\n".join(",".join(map(repr, row)) for row in y.tolist())
    answer = subprocess.run([str(tmp_path / "b" / "loads")], input=text, capture_output=True, text=True, check=True)
    found = np.array([line.split(",") for line in answer.stdout.splitlines()], float)
    agree((found[:, :1], found[:, 1:2]), python(tracker, y))


BOARD = """
#include <cmath>
#include <cstdio>
struct { void begin(long) {} template <class T> void print(T) {} template <class T> void println(T) {} } Serial;
static const int A0 = 14;
static unsigned long clock_;
unsigned long micros() { return clock_ += 100; }
void analogReadResolution(int) {}
int analogRead(int pin) { return 2048 + pin; }
"""


def test_the_sketch_for_a_board_builds(roof: Case, tmp_path: Path) -> None:
    """In C++, as a board's tools make it, with a board of ten lines."""
    cxx = next((path for name in ("c++", "g++", "clang++") if (path := shutil.which(name))), None)
    if cxx is None or CC is None:
        pytest.skip("no C++ compiler on this machine")
    source = roof[1].to_c(tmp_path / "wind.c", name="wind", dtype="float")
    build(source, "-c", out=tmp_path / "wind.o")
    sketch = (
        BOARD
        + (EXAMPLE / "controller.ino").read_text()
        + "int main() { setup(); for (int i = 0; i < 50; ++i) loop(); }"
    )
    (tmp_path / "sketch.cpp").write_text(sketch)
    made = subprocess.run(
        [cxx, "-std=c++11", "-Wall", "-Wextra", "-Werror", "-o", str(tmp_path / "sketch"), str(tmp_path / "sketch.cpp"),
         str(tmp_path / "wind.o"), "-lm"], capture_output=True, text=True,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    subprocess.run([str(tmp_path / "sketch")], check=True)


def test_the_files_say_what_goes_in_and_out_and_what_they_do_not(roof: Case, tmp_path: Path) -> None:
    tracker = roof[1]
    named = [
        replace(c, label=label) for c, label in zip(tracker.fitted.sensors, ("a3", "a6", "d10 */ µ", "x"), strict=True)
    ]
    other = Tracker(replace(tracker.fitted, sensors=tuple(named)), tracker.gate)
    for text in (path.read_text("ascii") for path in (other.to_c(tmp_path / "t.c"), tmp_path / "t.h")):
        head = text[: text.index("*/")]
        wanted = ("one sample every 0.01 s", "y[0]: a3, m/s^2", "y[2]: d10 * / ?", "load[0]: p0, N", "the watch")
        assert all(one in head for one in wanted)
        assert "@" not in text
        assert not re.search(r"\bLT_", text)
    assert '#include "t.h"' in (tmp_path / "t.c").read_text()


@pytest.mark.parametrize("name", ["2nd", "a b", "", "f();", "ä", "x" * 40, None])
def test_a_name_that_c_does_not_take_is_refused(roof: Case, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="identifier"):
        roof[1].to_c(tmp_path / "t.c", name)
    assert not list(tmp_path.iterdir())


def test_other_things_that_cannot_be(roof: Case, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        roof[1].to_c(tmp_path / "nowhere" / "t.c")
    for path in (tmp_path / "t.h", tmp_path / "t"):
        with pytest.raises(InputError, match="C file"):
            roof[1].to_c(path)
    for dtype in ("half", "FLOAT", None, 8):
        with pytest.raises(InputError, match="dtype"):
            roof[1].to_c(tmp_path / "t.c", dtype=dtype)


def test_the_flags_are_those_that_compilers_of_controllers_complain_with() -> None:
    assert {"-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-std=c99"} <= set(STRICT)


@needs_compiler
def test_a_start_in_motion_is_that_of_python(tmp_path: Path) -> None:
    """From a record cut in the middle of a longer one: the tracker finds such a start itself, the C is told of it."""
    case, tracker = building()
    cut = case.y[777:1200]
    controller = compiled(tracker, tmp_path)
    from_rest = controller.run(cut)
    controller.reset(moving=True)
    load, std, _ = controller.run(cut)
    tracker = alone(tracker)
    other = tracker.run(cut)
    assert tracker._start is not None
    assert tracker._start.wider == 1.0
    agree((load, std), other[:2])
    off = [float(np.abs(one - case.load[777:787])[:10].max()) for one in (load[:10], from_rest[0][:10])]
    assert off[0] < 0.7 * off[1]
