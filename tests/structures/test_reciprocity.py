"""W216: tables of FRFs with one fault, made by modal sums of a clamped beam of finite elements."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from loadid._commands.check import check, show
from structures import FrfModel, InputError, MeasuredModel
from structures._channels import Channel
from structures._flags import codes
from structures._testing import reciprocity

Array = np.ndarray[Any, Any]
LINES = np.linspace(8.0, 700.0, 400)
NODES = (5, 11, 17, 23)  # that have a sensor; the first three or fewer are struck
UNITS = {0: ("displacement", "m"), 1: ("velocity", "m/s"), 2: ("acceleration", "m/s^2")}


@cache
def modes(elements: int = 24) -> tuple[Array, Array]:
    """Natural frequencies (rad/s) and deflections (nodes, modes) of a steel strip of 1 m, one end clamped."""
    h, EI, mass = 1 / elements, 210e9 * 0.03 * 0.01**3 / 12, 7850 * 0.03 * 0.01
    k = EI / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                              [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]])  # fmt: skip
    m = mass * h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                                   [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]])  # fmt: skip
    K, M = (np.zeros((2 * elements + 2,) * 2) for _ in range(2))
    for e in range(elements):
        at = np.ix_(*(range(2 * e, 2 * e + 4),) * 2)
        K[at] += k
        M[at] += m
    lam, shapes = eigh(K[2:, 2:], M[2:, 2:])
    return np.sqrt(lam[:12]), np.vstack([np.zeros((1, 12)), shapes[::2, :12]])


def frf(struck: int = 3, order: int = 2, f: Array = LINES) -> Array:
    w, shape = modes()
    s = 2j * np.pi * f[:, None]
    q = 1 / (w**2 + s**2 + 0.02 * w * s)
    return np.einsum("ir,jr,kr->kij", shape[list(NODES)], shape[list(NODES[:struck])], q) * (s**order)[..., None]


def channels(struck: int = 3, order: int = 2) -> tuple[list[Channel], list[Channel]]:
    quantity, unit = UNITS[order]
    return ([Channel(label=f"{n}+Z", quantity=quantity, unit=unit) for n in NODES],
            [Channel(label=f"{n}+Z", quantity="force", unit="N") for n in NODES[:struck]])  # fmt: skip


def noisy(H: Array, seed: int, size: float = 0.05) -> Array:
    rng = np.random.default_rng(seed)
    return H * (1 + size * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2))


def told(H: Array, order: int = 2) -> reciprocity.FrfFault | None:
    return reciprocity.check(LINES, H, *channels(H.shape[2], order))


FAULTS = {
    "an entry in g": ((0, 1), 1 / 9.80665, "unit", ("5+Z",), ("11+Z",)),
    "an entry times 1.7": ((2, 0), 1.7, "gain", ("17+Z",), ("5+Z",)),
    "an entry of the wrong sign": ((1, 2), -1.0, "polarity", ("11+Z",), ("17+Z",)),
    "a sensor in g": ((1,), 1 / 9.80665, "unit", ("11+Z",), ()),
    "a sensor in mV": ((0,), 1000.0, "unit", ("5+Z",), ()),
    "a sensor of the wrong sign": ((2,), -1.0, "polarity", ("17+Z",), ()),
}


@pytest.mark.parametrize("name", list(FAULTS))
@pytest.mark.parametrize("order", [0, 1, 2])
def test_one_factor_is_named_and_corrected(name: str, order: int) -> None:
    at, factor, kind, sensors, loads = FAULTS[name]
    clean = noisy(frf(order=order), 3)
    H = clean.copy()
    H[(slice(None), *at)] *= factor
    fault = told(H, order)
    assert fault is not None
    assert (fault.kind, fault.sensors, fault.loads) == (kind, sensors, loads)
    assert fault.certain
    assert fault.factor == pytest.approx(factor, rel=0.03)
    assert fault.without <= 1
    names = [[c.label for c in some] for some in channels()]
    np.testing.assert_allclose(fault.corrected(H, *names), clean, rtol=0.03)


@pytest.mark.parametrize(("rows", "columns"), [((0, 1), ()), ((1, 3), ()), ((0, 2), (1,)), ((0,), (0, 1))])
def test_what_is_exchanged_is_named_and_put_back(rows: tuple[int, ...], columns: tuple[int, ...]) -> None:
    clean = noisy(frf(), 4)
    H = clean.copy()
    at = np.ix_(np.arange(len(H)), rows, columns or range(3))
    H[at] = np.flip(clean[at], axis=1 if len(rows) == 2 else 2)
    fault = told(H)
    assert fault is not None
    assert fault.kind == "exchanged"
    assert set(fault.sensors) == {f"{NODES[i]}+Z" for i in rows}
    assert set(fault.loads) == {f"{NODES[j]}+Z" for j in columns}
    names = [[c.label for c in some] for some in channels()]
    assert np.array_equal(fault.corrected(H, *names), clean)


def test_sound_tables_raise_nothing() -> None:
    """Noise of 5 % of the entry, of 5 % of the table, and gains that are 5 % wrong."""
    H, rng = frf(), np.random.default_rng(0)
    alarms = []
    for seed in range(70):
        level = 0.05 * np.sqrt(np.mean(np.abs(H) ** 2)) * (noisy(np.ones(H.shape), seed, 1.0) - 1)
        for table in (noisy(H, seed), H + level, H * (1 + 0.05 * rng.standard_normal(H.shape[1:]))):
            alarms.append(told(table) is not None)
    assert np.mean(alarms) <= 0.01


def test_two_places_tell_an_entry_and_leave_open_which_of_two_sensors() -> None:
    H = frf(struck=2)
    H[:, 0, 1] *= 1000
    fault = told(H)
    assert fault is not None
    assert fault.certain
    assert (fault.sensors, fault.loads) == (("5+Z",), ("11+Z",))
    H = frf(struck=2)
    H[:, 0] *= 1000
    fault = told(H)
    assert fault is not None
    assert not fault.certain
    assert "5+Z" in str(fault)
    assert "11+Z" in str(fault)


def test_an_entry_that_no_factor_mends() -> None:
    H = frf()
    rng = np.random.default_rng(1)
    H[:, 0, 2] = np.abs(H[:, 0, 2]).mean() * (rng.standard_normal(400) + 1j * rng.standard_normal(400))
    fault = told(H)
    assert fault is not None
    assert fault.kind == "other"
    assert not fault.correctable
    with pytest.raises(InputError, match="no correction"):
        fault.corrected(H, [], [])


def test_nothing_is_said_where_no_two_places_have_both() -> None:
    assert told(1e3 * frf(struck=1)) is None
    sensors, loads = channels()
    named = [Channel(label=f"a{i}", quantity=c.quantity, unit=c.unit) for i, c in enumerate(sensors)]
    assert reciprocity.check(LINES, 9.8 * frf(), named, loads) is None


@pytest.mark.parametrize("make", [FrfModel, MeasuredModel])
def test_a_model_says_so_and_is_corrected(make: type[FrfModel], tmp_path: Path) -> None:
    f = LINES if make is FrfModel else np.linspace(0, 700, 401)
    H = frf(f=f)
    names = [[c.label for c in some] for some in channels()]

    def model(table: Array) -> FrfModel:
        return make.from_frf(f, table, kind="accelerance", sensors=names[0], loads=names[1],
                             variance=1e-4 * np.abs(table) ** 2)  # fmt: skip

    sound = model(H)
    assert "W216" not in codes(sound.flags)
    assert sound.fault is None
    wrong = H.copy()
    wrong[:, 1] *= 9.80665
    given = model(wrong)
    (flag,) = (x for x in given.flags if x.code == "LID-W216")
    assert "11+Z reads 9.807 times what reciprocity says" in flag.message
    assert flag.evidence.value > flag.evidence.threshold
    again = given.corrected()
    assert "W216" not in codes(again.flags)
    np.testing.assert_allclose(again.H, sound.H, rtol=1e-9)
    np.testing.assert_allclose(again.variance, sound.variance, rtol=1e-6)
    with pytest.raises(InputError, match="no fault"):
        sound.corrected()
    given.save(tmp_path / "model.h5")
    found = check(model=tmp_path / "model.h5")
    assert "LID-W216" in {x.code for _, x in found.flags}
    assert "model.corrected()" in show(found)
    again.save(tmp_path / "model.h5")
    assert "W216" in check(model=tmp_path / "model.h5").silent


def test_tests_of_one_force_each_are_held_against_each_other_when_joined() -> None:
    H, (sensors, loads) = frf(), channels()
    H[:, 2, 1] *= -1
    parts = [FrfModel(LINES, H[:, :, [j]], sensors=sensors, loads=[loads[j]]) for j in range(3)]
    assert not any(p.flags for p in parts)
    assert codes(FrfModel.joined(parts).flags) == {"W216"}
