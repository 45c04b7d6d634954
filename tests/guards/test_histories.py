"""Guards of histories, reached through deconvolution or a reader; false alarms; overriding."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from loadid import Deconvolution, Guards, Record, read
from loadid._commands.check import check
from loadid._spellings import folded
from loadid.settings import Noise
from loadid.validate import Coverage, held_out
from structures import (
    Channel,
    Flag,
    ForwardModel,
    ImpulseModel,
    InputError,
    MeasuredModel,
    beams,
    damping,
    loads,
    sensors,
)
from tests.data import measured
from tests.structures.impacts import hits

from .cases import Case, of, refused

DT = 1 / 1000
N = 100
COVERED = Coverage(0.95, 0.95, 50, "2026-01-01")


# -- what is inverted -------------------------------------------------------------------------------------------------
def impulse(rows=3, columns=1, decay=70.0) -> np.ndarray:
    """Impulse responses (N, rows, columns) of three modes, gone within the record."""
    t = np.arange(N) * DT
    h = np.zeros((N, rows, columns))
    for k, f in enumerate((40, 110, 260), 1):
        mode = np.exp(-decay * t) * np.cos(2 * np.pi * f * t)
        h += mode[:, None, None] * np.cos(k * np.arange(1, rows + 1))[:, None] * np.cos(2 * k * np.arange(columns))
    return h


def arrays(h: np.ndarray, units: Iterable[str] = (), **channel: float) -> ImpulseModel:
    """Model of impulse responses, of accelerometers unless told."""
    units = [*units] or ["m/s^2"] * h.shape[1]
    rows = [Channel(label=f"s{i}", unit=u, **channel) for i, u in enumerate(units)]
    columns = [Channel(label=f"p{j}", quantity="force", unit="N") for j in range(h.shape[2])]
    return ImpulseModel(h, DT, kind="held", sensors=rows, loads=columns)


def beam(at=0.9, zeta=0.15, modes=4, noise=None) -> ForwardModel:
    """Three strain gauges on a simply supported beam of 2 m, one force."""
    structure = beams.simply_supported(
        length=2.0,
        section=beams.Section.rectangle(0.05, 0.02),
        material=beams.materials.steel,
        elements=20,
        damping=damping.Modal(zeta),
    )
    gauges = [sensors.StrainGauge(at=x, fibre=0.01, label=f"s{x}", noise=noise) for x in (0.35, 0.9, 1.3)]
    return ForwardModel(structure, gauges, [loads.Point(at=at, direction="Z", label="p")], modes=modes)


def pulse(samples=N, columns=1) -> np.ndarray:
    k = np.arange(samples)[:, None] - 20 - 15 * np.arange(columns)
    return np.where((k >= 0) & (k <= 20), 100 * np.sin(np.pi * k / 20) ** 2, 0.0)


def noisy(y: np.ndarray, level=0.02, seed=0) -> np.ndarray:
    return y + level * rms(y) * np.random.default_rng(seed).standard_normal(y.shape)


def rms(y: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(y**2, axis=0))


def flags(model, y=None, **settings) -> tuple[Flag, ...]:
    """Flags of an estimate from noisy data of the model itself."""
    dt = settings.pop("dt", DT)
    if y is None:
        y = noisy(model.predict(pulse(columns=len(model.loads)), dt))
    if "noise" not in settings and not isinstance(model, MeasuredModel):
        settings |= {"noise": Noise(0.02 * rms(np.asarray(getattr(y, "values", y))), source="unloaded record")}
    return (
        Deconvolution(model, **folded(Deconvolution, settings)).estimate(y, None if isinstance(y, Record) else dt).flags
    )


# -- the guards -------------------------------------------------------------------------------------------------------
def verified() -> ImpulseModel:
    model = arrays(impulse())
    model.verify(pulse(), model.predict(pulse(), DT), DT)
    return model


def collinear(gain: float) -> ImpulseModel:
    """Two loads that only the second of two sensors tells apart, by `gain`."""
    h = np.repeat(impulse(2, 1), 2, axis=2)
    h[:, 1, 1] *= 1 + gain
    return arrays(h)


def clipped(share: float) -> Record:
    model = arrays(impulse())
    y = noisy(model.predict(pulse(), DT), 0.005)
    return Record(np.minimum(y, share * y.max(axis=0)), DT, model.sensors)


def oscillator(sign: int) -> MeasuredModel:
    f = np.arange(257) / 512 / DT
    s = 2j * np.pi * f
    H = s**2 / (s**2 + 0.1 * 2 * np.pi * 60 * s + (2 * np.pi * 60) ** 2)
    return MeasuredModel.from_frf(f, H if sign > 0 else H.conj(), kind="accelerance", sensors=["a"])


def imported(kind: str | None, unit: str = "m/s^2") -> MeasuredModel:
    good = oscillator(1)
    return MeasuredModel.from_frf(
        good.frequencies, good.H, kind=kind, sensors=[Channel(label="a", quantity="acceleration", unit=unit)]
    )


def cut_file(tmp: list, cut: int) -> tuple[Flag, ...]:
    """A text log whose last row is cut, read and inverted."""
    model = arrays(impulse())
    y = noisy(model.predict(pulse(), DT))
    rows = ["t,s0,s1,s2", *(",".join(f"{x:.6e}" for x in (k * DT, *row)) for k, row in enumerate(y))]
    path = tmp[0] / "log.csv"
    path.write_text("\n".join(rows)[: -cut or None])
    record = read(path, units={f"s{i}": "m/s^2" for i in range(3)})
    return (*flags(model, record), *record.flags)


def uneven_file(tmp: list, band: float) -> tuple[Flag, ...]:
    """A text log of uneven stamps with a response of some frequency (Hz), resampled and inverted."""
    rng = np.random.default_rng(0)
    t = np.cumsum(DT * (1 + 0.3 * rng.uniform(-1, 1, N + 20)))
    y = np.sin(2 * np.pi * band * t[:, None] + np.arange(3))
    rows = ["t,s0,s1,s2", *(",".join(f"{x:.9e}" for x in (a, *b)) for a, b in zip(t, y, strict=True))]
    path = tmp[0] / "uneven.csv"
    path.write_text("\n".join(rows) + "\n")
    record = read(path, fs=1 / DT, units={f"s{i}": "m/s^2" for i in range(3)}).window(0, N * DT)
    return (*flags(arrays(impulse()), record), *record.flags)


def smooth_kernel() -> ImpulseModel:
    """A response that begins slowly: the problem is ill-posed and the L-curve has its corner."""
    t = np.arange(N) * DT
    return arrays((np.sin(2 * np.pi * 30 * (t + DT)) * np.exp(-60 * t))[:, None, None])


def stated(factor: float, choice: str | None = None) -> tuple[Flag, ...]:
    """Flags with a noise level that is a factor too small."""
    y = smooth_kernel().predict(pulse(), DT)
    level = 0.02 * rms(y) / factor
    return flags(smooth_kernel(), noisy(y), noise=Noise(level, source="unloaded record"), choice=choice)


def trained(used: bool) -> tuple[Flag, ...]:
    records = [Record(t, DT, ["F", "a"]) for t in hits(3, noise=0.1)]
    model = MeasuredModel.from_hits(records[:2], force="F", responses=["a"])
    return flags(model, records[0 if used else 2])


def shared(labels: list[str]) -> tuple[Flag, ...]:
    model = arrays(impulse(4))
    record = Record(noisy(model.predict(pulse(), DT)), DT, model.sensors)
    estimate = Deconvolution(model, sensors=["s0", "s1"]).estimate(record)
    kept = [model.sensors[int(x[1])] for x in labels]
    rows = [int(x[1]) for x in labels]
    other = ImpulseModel(impulse(4)[:, rows], DT, kind="held", sensors=kept, loads=model.loads)
    return held_out(estimate, other, record).flags


def simulated(by: bool) -> tuple[Flag, ...]:
    model = arrays(impulse())
    y = noisy(model.predict(pulse(), DT))
    other = arrays(impulse(decay=80.0))
    return flags(model, Record(y, DT, model.sensors, simulated_by=(model if by else other).fingerprint))


def declared(highpass: tuple[float | None, ...]) -> ImpulseModel:
    model = arrays(impulse())
    rows = [replace(s, highpass=h) for s, h in zip(model.sensors, highpass, strict=True)]
    return ImpulseModel(impulse(), DT, kind="held", sensors=rows, loads=model.loads)


def gapped(share: float) -> np.ndarray:
    """A record of which the first channel has lost a share."""
    y = noisy(arrays(impulse()).predict(pulse(), DT))
    y[np.random.default_rng(1).permutation(N)[: int(share * N)], 0] = np.nan
    return y


def lost(start: int) -> np.ndarray:
    """A record of which all channels have lost ten samples."""
    y = noisy(arrays(impulse()).predict(pulse(), DT))
    y[start : start + 10] = np.nan
    return y


def moved(kind: type, **settings) -> ForwardModel:
    """Two sensors of motion on the beam."""
    seen = [kind(at=x, label=f"m{x}", **settings) for x in (0.4, 1.1)]
    return ForwardModel(BEAM, seen, [loads.Point(at=0.9, direction="Z", label="p")], modes=4)


def in_motion(start: int) -> tuple[Flag, ...]:
    """A record of a pulse at sample 20 that begins at `start`; noise level not known."""
    model = moved(sensors.Displacement)
    return flags(model, noisy(model.predict(pulse(220), DT))[start : start + N], noise=None)


def coupled(corner: float | None, known: bool) -> tuple[Flag, ...]:
    """A strain gauge recorded AC-coupled, whose model knows it or not, beside an accelerometer."""
    gauge = sensors.StrainGauge(at=0.9, fibre=0.01, label="s", highpass=corner if known else None)
    place = loads.Point(at=0.9, direction="Z", label="p")
    model = ForwardModel(BEAM, [gauge, sensors.Accelerometer(at=1.3, label="a")], [place], modes=4)
    rows = [replace(gauge, highpass=corner), model.sensors[1]]
    return flags(model, Record(noisy(model.predict(pulse(), DT)), DT, rows))


def brief(decay: float) -> tuple[Flag, ...]:
    """A record of 30 samples."""
    model = arrays(impulse(decay=decay)[:30])
    return flags(model, noisy(model.predict(pulse(30), DT)))


def twins(apart: float) -> ForwardModel:
    """Two loads at one place, or `apart` m apart, and three gauges."""
    other = beam()
    pair = [loads.Point(at=x, direction="Z", label=name) for x, name in ((0.9, "p"), (0.9 + apart, "q"))]
    return ForwardModel(other.structure, other.sensors, pair, modes=4)


UNIT, IDENTITY = np.zeros((N, 1, 1)), np.zeros((N, 1, 1))
UNIT[70:], IDENTITY[0] = 1.0, 1.0
TMP: list = []
BEAM = beam().structure
GAUGE = [sensors.StrainGauge(at=0.9, fibre=0.01, label="s")]

CASES = [
    Case(
        "E104",
        lambda: refused(lambda: ForwardModel(BEAM, GAUGE, [loads.Point("0+Z"), loads.Point("20+Z")])),
        lambda: refused(lambda: ForwardModel(BEAM, GAUGE, [loads.Point("2+Z"), loads.Point("5+Z")])),
        r"2 loads act on supported DOFs only.*0\+Z, 20\+Z",
    ),
    Case("W105", lambda: flags(beam(at=0.05)), lambda: flags(beam(at=0.9)), r"1 of 1 loads next to a support"),
    Case("W114", lambda: flags(arrays(impulse())), lambda: flags(verified()), r"certificates = 0 \(threshold 1\)"),
    Case(
        "W201",
        lambda: flags(arrays(impulse(1, 2))),
        lambda: flags(arrays(impulse(3, 2))),
        r"m = 100 data, n = 200 unknowns, rank r = 100, nullity 100",
    ),
    Case(
        "W201",
        lambda: flags(twins(1e-13)),
        lambda: flags(twins(0.4)),
        r"at no frequency can the sensors tell apart the loads p, q.*-> add a sensor that sees them",
        "loads that no line tells apart",
    ),
    Case(
        "W202",
        lambda: flags(collinear(1e-3), sensors=["s0"], noise=1.0),
        lambda: flags(arrays(impulse(3, 1)), sensors=["s0", "s1"], noise=1.0),
        r"kappa fell from [\d.e+]+ to [\d.]+ .* with s1; rank fell from 19\d to 9\d, nullity rose from \d to 10\d",
    ),
    Case(
        "W204",
        lambda: flags(arrays(impulse(), ["m", "m", "m/s^2"]), noise=None),
        lambda: flags(arrays(impulse(), ["m", "m", "m/s^2"])),
        r"2 kinds of sensor without noise levels.*units = m, m/s\^2",
    ),
    Case(
        "W204",
        lambda: flags(arrays(impulse(), ["m", "m", "1"]), noise=None),
        lambda: flags(arrays(impulse()), noise=None),
        r"2 kinds",
        "silent for one kind without noise levels",
    ),
    Case(
        "W205",
        lambda: flags(declared((50.0, 80.0, 60.0))),
        lambda: flags(declared((50.0, None, 60.0))),
        r"below 50 Hz.*= 10 \(threshold 50\)",
    ),
    Case(
        "W205",
        lambda: flags(declared((50.0, 50.0, 50.0))),
        lambda: flags(declared((5.0, 5.0, 5.0))),
        r"50 Hz",
        "silent for a record that does not reach the corner",
    ),
    Case(
        "W205",
        lambda: coupled(30.0, known=True),
        lambda: coupled(None, known=True),
        r"AC-coupled, or sees motion only: .* below 30 Hz",
        "beside accelerometers, which see no static load either",
    ),
    Case(
        "W205",
        lambda: coupled(0.5, known=False),
        lambda: coupled(0.5, known=True),
        r"taken by the model for sensors that see 0 Hz: s;.*highpass=0\.5",
        "a corner that the model does not know",
    ),
    Case(
        "W206",
        lambda: flags(arrays(impulse()), clipped(0.5)),
        lambda: flags(arrays(impulse()), clipped(1.0)),
        r"channel s\d: overload: clipped, 7 samples",
    ),
    Case("W207", lambda: flags(oscillator(-1)), lambda: flags(oscillator(1)), r"100% of its impulse response"),
    Case(
        "W208", lambda: refused(lambda: imported(None)), lambda: refused(lambda: imported("accelerance")), r"kind=None"
    ),
    Case(
        "W208",
        lambda: flags(imported("receptance")),
        lambda: flags(imported("accelerance")),
        r"unit of a = m/s\^2 \(threshold m\)",
        "unit against kind",
    ),
    Case(
        "W206",
        lambda: flags(arrays(impulse()), gapped(0.1), noise=1.0, choice=0.1),
        lambda: flags(arrays(impulse()), gapped(0.0), noise=1.0, choice=0.1),
        r"channel s0: 10 of 100 samples are missing.*left out of the fit",
        "a gap that the fit leaves out",
    ),
    Case("W209", lambda: cut_file(TMP, 8), lambda: cut_file(TMP, 0), r"truncated: 99 of 100 rows"),
    Case(
        "W220",
        lambda: uneven_file(TMP, 0.4 / DT),
        lambda: uneven_file(TMP, 0.02 / DT),
        r"resampled to .* over the std of the channel is s\d \d\.\d+",
    ),
    Case(
        "W210",
        lambda: flags(arrays(impulse()), gapped(0.6), noise=1.0, choice=0.1),
        lambda: flags(arrays(impulse()), gapped(0.4), noise=1.0, choice=0.1),
        r"more than half of the samples are missing: s0 \(60%\).*= 0\.6 \(threshold 0\.5\)",
    ),
    Case(
        "W224",
        lambda: flags(arrays(impulse()), lost(int(np.argmax(pulse()[:, 0])) - 4), noise=1.0, choice=0.1),
        lambda: flags(arrays(impulse()), lost(85), noise=1.0, choice=0.1),
        r"missing where the load acts: \d+% of what its response would have told are lost",
    ),
    Case("N303", lambda: flags(arrays(impulse(1, 2))), lambda: (), r"100 components in ker\(H\).*finer than \S+ s"),
    Case(
        "W401",
        lambda: flags(arrays(impulse()), choice="l_curve"),
        lambda: flags(smooth_kernel(), choice="l_curve"),
        r"lambda at the corner = [\d.e-]+",
    ),
    Case(
        "W402",
        lambda: flags(arrays(IDENTITY), choice="gcv"),
        lambda: flags(smooth_kernel(), choice="gcv"),
        r"relative lambda [\d.e-]+",
    ),
    Case(
        "W406",
        lambda: flags(arrays(impulse()), noise=[1.0, 1.0, 2.3]),
        lambda: flags(arrays(impulse()), noise=Noise([1.0, 1.0, 2.3], source="unloaded record")),
        r"half, once and twice of it: [\d.e-]+, [\d.e-]+, [\d.e-]+",
    ),
    Case(
        "W406",
        lambda: flags(arrays(impulse()), noise=[1.0, 1.0, 2.3]),
        lambda: flags(arrays(impulse()), noise=[1.0, 1.0, 2.3], choice="gcv"),
        r"guess of the user",
        "silent where the noise does not decide",
    ),
    Case(
        "W406",
        lambda: stated(30),
        lambda: stated(1),
        r"residual shows [123]\d[\d.]* times the stated noise level \(unloaded record\)",
        "a level that the data contradict",
    ),
    Case(
        "W407",
        lambda: stated(30, "discrepancy"),
        lambda: stated(1),
        r"gcv [\d.e-]+.*spread of the rules, decades = [\d.]+ \(threshold 1\)",
    ),
    Case(
        "W505",
        lambda: flags(arrays(impulse(decay=5.0))),
        lambda: flags(arrays(impulse(decay=70.0))),
        r"6\d\.\d% of the response is left",
    ),
    Case(
        "W505",
        lambda: flags(beam(zeta=0.01)),
        lambda: flags(beam(zeta=0.15), noisy(beam().predict(pulse(450), DT))),
        r"9\d\.\d% of the response",
        "from the slowest decay of a structure",
    ),
    Case(
        "W505",
        lambda: flags(beam(zeta=0.01), noisy(beam(zeta=0.01).predict(pulse(45), DT))),
        lambda: flags(beam(zeta=0.15), noisy(beam().predict(pulse(450), DT))),
        r"holds 0\.53 periods of the lowest mode \(11\.7\d Hz\).*record longer \(6\.2\d s instead of 0\.045 s\)",
        "a record of half a period",
    ),
    Case(
        "W505",
        lambda: brief(5.0),
        lambda: brief(300.0),
        r"8\d\.\d% of the response is left",
        "a record of 30 samples",
    ),
    Case(
        "E506",
        lambda: refused(lambda: flags(arrays(UNIT))),
        lambda: refused(lambda: flags(arrays(IDENTITY))),
        r"load p0.*\|h\(0\)\| is 0 of its maximum",
    ),
    Case(
        "W509",
        lambda: flags(beam(), dt=1 / 250),
        lambda: flags(beam(), dt=1 / 400),
        r"1 modes lie above the Nyquist frequency 125 Hz.*= 187\.\d \(threshold 125\)",
    ),
    Case(
        "W517",
        lambda: flags(moved(sensors.Accelerometer), penalty="first_difference"),
        lambda: flags(moved(sensors.Accelerometer)),
        r"no sensor \(m0\.4, m1\.1\) sees a constant part of p.*threshold 1e-08",
    ),
    Case(
        "W517",
        lambda: flags(moved(sensors.Displacement, highpass=2.0), penalty="second_difference"),
        lambda: flags(moved(sensors.Displacement), penalty="second_difference"),
        r"second_difference leaves it free",
        "AC-coupled",
    ),
    Case("W518", lambda: in_motion(60), lambda: in_motion(0), r"first sample holds \d+% .*\(threshold 5\)"),
    Case("W702", lambda: simulated(True), lambda: simulated(False), r"same model [0-9a-f]{12}"),
    Case(
        "W703",
        lambda: flags(arrays(impulse())),
        lambda: flags(arrays(impulse()), coverage=COVERED),
        r"coverage tests = 0 \(threshold 1\)",
    ),
    Case(
        "W703",
        lambda: flags(arrays(impulse()), coverage=replace(COVERED, share=0.7)),
        lambda: flags(arrays(impulse()), coverage=COVERED),
        r"held 70\.0%.*= 0\.7 \(threshold 0\.9\)",
        "a test that failed",
    ),
    Case("W704", lambda: trained(True), lambda: trained(False), r"1 shared.*shared = [0-9a-f]{16}", "a training hit"),
    Case("W704", lambda: shared(["s1", "s3"]), lambda: shared(["s2", "s3"]), r"shared = s1", "a validation channel"),
]


@pytest.fixture(autouse=True)
def folder(tmp_path):
    TMP[:] = [tmp_path]


# -- false alarms -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(3))
def test_a_clean_set_up_raises_the_note_alone(seed):
    """Strain gauges on a beam, white noise of known level, verified model, coverage tested."""
    y = beam().predict(pulse(450), DT)
    sigma = 0.03 * np.sqrt(np.mean(y**2))
    model = beam(noise=sigma)
    model.verify(pulse(450), y, DT, source="a known hit")
    record = Record(y + sigma * np.random.default_rng(seed).standard_normal(y.shape), DT, model.sensors)
    estimate = Deconvolution(model, allow=Guards(coverage=COVERED)).estimate(record)
    assert estimate.codes == {"N303"}
    assert "ker(H)" not in estimate.flags[0].message
    assert "cautions: none" in "".join(t.get_text() for t in estimate.plot().texts)
    assert check(record, model).flags == []


def test_a_measured_hit_raises_the_note_alone():
    """Four hammer hits make the model, the fifth is rebuilt: verified by the hits themselves, offsets as recorded."""
    tables = [np.load(measured("hammer_five_hits", f"measurements_{k}.npy"))[1:].T for k in range(1, 6)]
    model = MeasuredModel.from_hits(tables[:4], dt=1 / 25600, force=0, responses=[1])
    assert Deconvolution(model, allow=Guards(coverage=COVERED)).estimate(tables[4][:, 1:], 1 / 25600).codes == {"N303"}
    assert check(Record(tables[4][:, 1:], 1 / 25600, model.sensors), model).flags == []


def test_n303_states_the_width_and_the_lost_height():
    (flag,) = of("N303", flags(arrays(impulse())))
    assert re.search(
        r"nothing finer than [\d.]+ s is resolved; a single-sample peak is shown at \d+% of its", flag.message
    )
    assert flag.level == "note"


# -- overriding -------------------------------------------------------------------------------------------------------
def test_allowed_codes_travel_with_the_result(tmp_path):
    model = arrays(impulse())
    y = noisy(model.predict(pulse(), DT))
    estimate = Deconvolution(model, allow=["w407", "LID-E506"]).estimate(y, DT)
    assert estimate.allowed == ("LID-W407", "LID-E506")
    said = "LID-W407, LID-E506"
    assert said in estimate.summary()
    estimate.report(tmp_path / "page.html")
    assert said in (tmp_path / "page.html").read_text("utf-8")
    for kind in ("load", "response", "path"):
        assert said in estimate.plot(kind).get_suptitle().replace("\n", " ")
    plain = Deconvolution(model).estimate(y, DT)
    assert plain.allowed == ()
    assert "LID-E506" not in plain.summary()


def test_a_refusal_that_is_allowed():
    late = np.zeros((N, 1, 1))
    late[1:, 0, 0] = np.exp(-0.1 * np.arange(N - 1))
    assert len(Deconvolution(arrays(late)).estimate(np.ones(N), DT).load) == N - 1
    assert len(Deconvolution(arrays(late), allow=["e506"]).estimate(np.ones(N), DT).load) == N
    few = arrays(impulse(1, 2))
    y = noisy(few.predict(pulse(columns=2), DT))
    assert of("E306", refused(lambda: Deconvolution(few, penalty=None).estimate(y, DT)))
    assert "W201" in Deconvolution(few, penalty=None, allow=["E306"]).estimate(y, DT).codes


@pytest.mark.parametrize("codes", ["W407", ["407"], ["X407"], ["W4077"], [""]])
def test_no_code_to_allow(codes):
    with pytest.raises(InputError, match=r"list of codes|no such guard code"):
        Deconvolution(arrays(impulse()), allow=codes)
