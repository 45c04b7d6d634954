"""Masked arrays at every door: what a mask hides is missing, and never used."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import tactile
from loadid import (
    Deconvolution,
    FrequencyInversion,
    HarmonicInversion,
    LoadTracker,
    Record,
    SparseDeconvolution,
    Spectra,
    StaticInversion,
    compare_domains,
    constraints,
)
from loadid._families.field import harmonic_power, mean_power
from loadid._inverse.diagnosis import picard
from loadid._inverse.diagnosis import picard as decay
from loadid._quality import health
from loadid.sources import _correlation as correlation
from loadid.sources import _levels as bands
from loadid.sources import _levels as levels
from loadid.validate import _references as references
from structures import (
    CrossSpectra,
    FrfModel,
    ImpulseModel,
    MatrixModel,
    MeasuredModel,
    StateSpace,
    Structure,
    chains,
    cross_spectra,
    loads,
    sensors,
    units,
)
from structures import solids as meshes
from structures._elements.members import Material
from structures._flags import codes
from structures._system.damping import Modal
from structures.errors import InputError, plain, reals
from tactile import DepthMap, Markers, Wrench
from tactile.vision import read_motions
from tactile.vision._images import grey
from tests.loadid.test_cli import hit

WRONG = 999.0  # what the mask hides


def hidden(x: Any, at: int = 1) -> Any:
    """A masked array that hides a wrong value at a flat place."""
    values = np.array(x)
    mask = np.zeros(values.shape, bool)
    values.reshape(-1)[at], mask.reshape(-1)[at] = WRONG, True
    return np.ma.array(values, mask=mask)


rng = np.random.default_rng(0)
DT, N = 1e-3, 64
H22 = np.array([[2.0, 0.3], [0.4, 1.0], [0.1, 0.7]])
A, B, C, D = np.diag([0.9, 0.5]), np.ones((2, 1)), np.array([[1.0, -1.0]]), np.array([[0.5]])
SYSTEM = StateSpace(A, B, C, D, dt=DT)
DECAY = 0.5 ** np.arange(40)
IMPULSE = ImpulseModel(DECAY[:, None, None], DT, kind="held")
LINES = np.arange(1.0, 6.0)
FRF = rng.standard_normal((5, 3, 2)) + 1j * rng.standard_normal((5, 3, 2))
COHERENCE, POWERS = np.full((5, 3), 0.9), np.arange(20.0, 60.0)
TABLE = FrfModel.from_frf(LINES, FRF, kind="receptance")
STATIC = MatrixModel(H22)
Y = rng.standard_normal((N, 1))
K = np.array([[2.0, -1.0], [-1.0, 2.0]])
CHAIN = chains.chain(masses=[1.0, 1.0], springs=[1e3, 1e3])
SPECTRUM = np.einsum("l,ij->lij", LINES, np.eye(2)).astype(complex)
NODES = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
CELLS = np.array([[0, 1, 3, 2, 4, 5, 7, 6]])
FORCES = np.array([(x, y) for x in range(3) for y in range(3)], float) * 1e-3
MARKERS = np.array([(x, y, -1) for x in range(4) for y in range(3)], float) * 1e-3
HIT = hit(1)
GEL = Material(1e5, 1000.0, 0.3)

# name: (a call, an array that it takes); each of them refuses a number that is not there
REFUSING: dict[str, tuple[Callable[[Any], Any], Any]] = {
    "MatrixModel": (MatrixModel, H22),
    "ImpulseModel": (lambda x: ImpulseModel(x, DT, kind="held"), DECAY[:, None, None]),
    "StateSpace": (lambda x: StateSpace(x, B, C, D, dt=DT), A),
    "StateSpace.simulate": (lambda x: SYSTEM.simulate(x), np.ones((9, 1))),
    "lines": (lambda x: SYSTEM.frf(x), LINES),
    "lines of an FRF": (lambda x: TABLE.frf(x), LINES),
    "FrfModel": (lambda x: FrfModel.from_frf(LINES, x, kind="receptance"), FRF),
    "FrfModel, lines": (lambda x: FrfModel.from_frf(x, FRF, kind="receptance"), LINES),
    "FrfModel, variance": (lambda x: FrfModel.from_frf(LINES, FRF, kind="receptance", variance=x), np.abs(FRF)),
    "FrfModel, coherence": (lambda x: FrfModel.from_frf(LINES, FRF, kind="receptance", coherence=x), COHERENCE),
    "mask of lines": (lambda x: CrossSpectra(LINES, SPECTRUM, ["a", "b"], 9).lines(x), np.arange(5) > 1),
    "MeasuredModel": (lambda x: MeasuredModel.from_frf(LINES, x, kind="receptance"), FRF),
    "variance": (lambda x: MeasuredModel.from_frf(LINES, FRF, kind="receptance", variance=x), np.abs(FRF)),
    "hits": (lambda x: MeasuredModel.from_hits([x], dt=DT, force=0, responses=[1]), HIT),
    "CrossSpectra": (lambda x: CrossSpectra(LINES, x, ["a", "b"], 9), SPECTRUM),
    "cross_spectra": (lambda x: cross_spectra([x], dt=DT, segment=32), HIT),
    "Spectra": (lambda x: Spectra(LINES, x, ["a"]), np.ones((5, 1))),
    "Spectra, lines": (lambda x: Spectra(x, np.ones((5, 1)), ["a"]), LINES),
    "Structure, K": (lambda x: Structure(x, np.eye(2), dofs=["1+X", "2+X"]), K),
    "Structure, coordinates": (lambda x: Structure(K, np.eye(2), dofs=["1+X", "2+X"], coordinates=x), [0.0, 1.0]),
    "chain": (lambda x: chains.chain(masses=x, springs=[1e3, 1e3]), [1.0, 1.0]),
    "Modal": (lambda x: Modal(x), [0.01, 0.02]),
    "mesh": (lambda x: meshes.mesh(x, CELLS, material=GEL), NODES),
    "mesh, cells": (lambda x: meshes.mesh(NODES, x, material=GEL), CELLS),
    "MovingPoint": (lambda x: loads.MovingPoint(x), np.arange(5.0)),
    "Displacement, at": (lambda x: sensors.Displacement(at=x, direction="+Z"), (0.1, 0.2)),
    "verify": (lambda x: STATIC.verify(x, H22 @ [1.0, 2.0]), [1.0, 2.0]),
    "static reading": (lambda x: StaticInversion(STATIC, noise=0.1).estimate(x), H22 @ [1.0, 2.0]),
    "frames": (lambda x: StaticInversion(STATIC, noise=0.1, choice=0.1).estimate(x), np.ones((4, 3))),
    "noise": (lambda x: StaticInversion(STATIC, noise=x).estimate(H22 @ [1.0, 2.0]), [0.1, 0.1, 0.2]),
    "penalty": (lambda x: StaticInversion(STATIC, noise=0.1, penalty=x).estimate(H22 @ [1.0, 2.0]), np.eye(2)),
    "amplitudes": (lambda x: HarmonicInversion(TABLE, 2.0, choice=0.1).estimate(x), np.ones(3, complex)),
    "initial": (lambda x: Deconvolution(SYSTEM, initial=x, choice=0.1).estimate(Y, DT), [0.0, 0.0]),
    "dictionary": (lambda x: SparseDeconvolution(IMPULSE, dictionary=x, noise=0.1).estimate(Y, DT), np.eye(N)),
    "compare_domains": (lambda x: compare_domains(IMPULSE, x, DT), Y),
    "NonNegative": (lambda x: constraints.NonNegative(loads=x), np.array([True, False, True])),
    "Support": (lambda x: constraints.Support(loads=x), np.array([0, 1])),
    "Bounds": (lambda x: constraints.Bounds(upper=x), [1.0, 2.0]),
    "Resultant": (lambda x: constraints.Resultant(x, 1.0), [[1.0, 1.0]]),
    "FrictionCone": (lambda x: constraints.FrictionCone(0.5, x), np.array([[0, 1, 2]])),
    "functional": (lambda x: StaticInversion(STATIC, noise=0.1).estimate(H22 @ [1.0, 2.0]).functional(x), [1.0, 1.0]),
    "reference": (lambda x: references.numbers(x, "the reference"), [1.0, 2.0]),
    "mac": (lambda x: correlation.mac(x), np.array([[1.0, 0.2], [0.3, 1.0]])),
    "decibels": (lambda x: levels.decibels(x, np.ones(3)), np.ones(3)),
    "running_rms": (lambda x: levels.running_rms(x, DT, 0.01), np.ones(50)),
    "band_power": (lambda x: bands.band_power(POWERS, x, bands.bands_of(POWERS), density=True), np.ones(40)),
    "harmonic_power": (lambda x: harmonic_power(x, np.ones(3)), np.ones(3)),
    "mean_power": (lambda x: mean_power(x, np.ones(50), DT, 0.01), np.ones(50)),
    "decay": (lambda x: decay.decay(x), np.exp(-np.arange(12.0))),
    "plateau": (lambda x: picard.plateau(x), np.exp(-np.arange(12.0))),
    "image": (grey, np.arange(4096).reshape(64, 64) % 251),
    "markers": (lambda x: Markers(x, 1e-6), MARKERS[:, :2]),
    "wrench": (Wrench, [0.0, 0.0, -1.0]),
    "GelForce": (
        lambda x: tactile.GelForce(tactile.HalfSpace(1e5, 0.45), FORCES, Markers(x, 1e-6, "XYZ")), MARKERS
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSING)
def test_what_is_masked_is_refused(name):
    call, array = REFUSING[name]
    call(array)  # it is right as it stands
    call(np.ma.array(array))
    call(np.ma.array(array, mask=np.zeros(np.shape(array), bool)))
    with pytest.raises(InputError):
        call(hidden(array))


@pytest.mark.parametrize("name", REFUSING)
@pytest.mark.parametrize("bad", [[[1.0], [1.0, 2.0]], "x", [["a"]]], ids=["rows of different lengths", "text", "texts"])
def test_what_is_no_array_of_numbers_is_refused(name, bad):
    with pytest.raises(InputError):
        REFUSING[name][0](bad)


def test_a_masked_sample_of_a_record_is_missing():
    values = np.cos(np.arange(40.0))[:, None] * [1.0, 2.0]
    record = Record(hidden(values, at=9), DT, ["a", "b"])
    assert np.argwhere(np.isnan(record.values)).tolist() == [[4, 1]]
    assert [f.evidence.name for f in record.health()] == ["missing"]
    assert [f.evidence.name for f in health(record)] == ["missing"]
    assert Record([hidden([1.0, 2.0]), [3.0, 4.0]], DT).values.tolist()[0][0] == 1.0
    assert np.isnan(Record([hidden([1.0, 2.0]), [3.0, 4.0]], DT).values[0, 1])
    for whole in (np.ma.array(values), np.ma.array(values, mask=np.zeros_like(values, bool))):
        np.testing.assert_array_equal(Record(whole, DT).values, values)
        assert type(Record(whole, DT).values) is np.ndarray


def test_families_take_a_masked_sample_as_missing():
    y = Y.copy()
    y[20] = np.nan
    missing = np.ma.array(np.where(np.isnan(y), WRONG, y), mask=np.isnan(y))
    family = Deconvolution(SYSTEM, noise=0.1, choice=0.1)
    found, known = family.estimate(missing, DT), family.estimate(y, DT)
    np.testing.assert_array_equal(found.load, known.load)
    assert codes(found.flags) == codes(known.flags)
    assert codes(found.flags) & {"W206", "W210"}
    with pytest.raises(InputError):
        FrequencyInversion(IMPULSE, noise=0.1).estimate(missing, DT)


def test_a_tracker_takes_a_masked_sample_as_missing():
    record = Record(rng.standard_normal((200, 1)), DT, SYSTEM.sensors)
    one, other = (LoadTracker(SYSTEM, noise=0.1, prior="random_walk").fit(record) for _ in range(2))
    for k in range(20):
        sample = np.array([np.nan if k == 10 else 1.0])
        for x, y in zip(
            one.step(sample), other.step(np.ma.array([WRONG if k == 10 else 1.0], mask=k == 10)), strict=True
        ):
            np.testing.assert_array_equal(x, y)


def test_what_is_masked_in_a_tactile_reading_is_lost():
    depth = DepthMap(hidden(np.zeros((6, 6)), at=8), 1e-3, 1e-6)
    assert np.argwhere(np.isnan(depth.values)).tolist() == [[1, 2]]
    places = rng.standard_normal((3, 5, 2))
    motions = read_motions(hidden(places, at=14))
    assert np.isnan(motions.places[1, 2]).all()
    assert np.isfinite(motions.places).sum() == places.size - 2
    sensor = tactile.GelForce(tactile.HalfSpace(1e5, 0.45), FORCES, tactile.Markers(MARKERS, 1e-6, "XYZ"), choice=0.1)
    moved = 1e-5 * rng.standard_normal((len(MARKERS), 3))
    lost = moved.copy()
    lost[0, 1] = np.nan
    np.testing.assert_array_equal(sensor.estimate(hidden(moved)).load, sensor.estimate(lost).load)


def test_masks_become_gaps_and_nothing_else_changes():
    for x in (3.0, "text", [1, 2], np.arange(3), None, [[1.0], [1.0, 2.0]]):
        assert plain(x) is x
    assert plain(np.ma.array([1, 2])).dtype.kind == "i"
    np.testing.assert_array_equal(plain(hidden(np.arange(3))), [0, np.nan, 2])
    np.testing.assert_array_equal(plain([1.0, np.ma.masked, 3.0]), [1, np.nan, 3])
    np.testing.assert_array_equal(plain((hidden([1.0, 2.0]), [3.0, 4.0])), [[1, np.nan], [3, 4]])
    np.testing.assert_array_equal(reals([hidden([1.0, 2.0]), [3.0, 4.0]], where="x"), [[1, np.nan], [3, 4]])
    assert np.isnan(plain(hidden(np.ones(3, complex)))[1])
    np.testing.assert_array_equal(units.to_si(hidden([1.0, 2.0]), "mm"), [1e-3, np.nan])
