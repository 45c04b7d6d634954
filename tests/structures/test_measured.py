"""Measured models against loops, closed forms, Monte Carlo and measured records."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from structures import Channel, FrfModel, InputError, MeasuredModel, TrainingRecords
from structures.errors import digests
from tests.data import measured

from .impacts import DT, blow, hits, record, response, transfer


def model(tables, **settings):
    return MeasuredModel.from_hits(tables, **{"dt": DT, "force": 0, "responses": [1], **settings})


@dataclass
class Log:
    """What a record needs to be: values and a step."""

    values: np.ndarray
    dt: float = DT
    channels: tuple = ("F", "a", "b")
    name: str = ""


class TestH1:
    def test_against_a_loop_over_lines(self):
        """Cross over auto spectrum, line by line, from the sums of the definition."""
        tables = hits(3, sensors=2, noise=1.0, samples=128)
        m = model(tables, responses=[1, 2])
        padded = 2 * (len(m.frequencies) - 1)
        t = np.arange(128)
        for k in range(0, len(m.frequencies), 7):
            wave = np.exp(-2j * np.pi * k * t / padded)
            assert m.frequencies[k] == pytest.approx(k / padded / DT)
            for i in (1, 2):
                Sff = Sfy = Syy = 0
                for table in tables:
                    F, Y = wave @ table[:, 0], wave @ table[:, i]
                    Sff, Sfy, Syy = Sff + abs(F) ** 2, Sfy + F.conj() * Y, Syy + abs(Y) ** 2
                assert m.H[k, i - 1, 0] == pytest.approx(Sfy / Sff, rel=1e-10)
                assert m.coherence[k, i - 1] == pytest.approx(abs(Sfy) ** 2 / Sff / Syy, rel=1e-10)

    @pytest.mark.parametrize("count", [1, 3])
    def test_noise_free_hits_give_the_response_itself(self, count):
        m = model(hits(count, sensors=3), responses=[1, 2, 3])
        h = response(1024, sensors=3)
        assert np.abs(m.impulse_response(DT, 400)[..., 0] - h[:400]).max() < 1e-10
        exact = transfer(m.frequencies, sensors=3)
        assert np.abs(m.H[..., 0] - exact).max() < 1e-6 * np.abs(exact).max()

    def test_a_constant_offset_of_one_hit_is_not_hidden(self):
        """What one hit more than a line needs does not explain is residual power."""
        tables = hits(3)
        tables[1][:, 1] += 5.0
        m = model(tables)
        assert m.noise_power[0, 0] > 1e3 * m.noise_power[300, 0]

    def test_one_hit_tells_no_error(self):
        m = model(hits(1))
        assert m.variance is m.noise_power is m.coherence is m.certificate is None
        assert m.frf_variance(m.frequencies) is m.noise_spectrum(m.frequencies) is None
        assert "1 record)" in repr(m)


@pytest.fixture(scope="module")
def many():
    """Models of 300 tests of three hits with noise of standard deviation 0.7 and 1.4 on two sensors."""
    clean, rng = hits(3, sensors=2, samples=512), np.random.default_rng(0)
    noisy = [[t + 0.7 * rng.standard_normal(t.shape) * [0, 1, 2] for t in clean] for _ in range(300)]
    return [model(tables, responses=[1, 2]) for tables in noisy]


class TestErrors:
    """What the model says of its own errors, against what they are over many simulated tests."""

    def test_variance(self, many):
        exact = model(hits(3, sensors=2, samples=512), responses=[1, 2]).H
        seen = np.mean([np.abs(m.H - exact) ** 2 for m in many], axis=0)
        ratio = np.mean([m.variance for m in many], axis=0) / seen
        assert np.median(ratio, axis=0) == pytest.approx(1, abs=0.1)
        assert ratio.reshape(-1) == pytest.approx(1, abs=0.45)  # each line: 300 draws of an exponential variable

    def test_noise_power(self, many):
        power = np.mean([m.noise_power for m in many], axis=0)
        assert power / [0.49, 4 * 0.49] == pytest.approx(1, abs=0.1)

    def test_coherence(self, many):
        for m in many[:20]:
            assert np.all((m.coherence >= 0) & (m.coherence <= 1))

    def test_coherence_of_known_noise(self):
        """gamma^2 = |H F|^2 / (|H F|^2 + S_nn), from many hits of one kind."""
        rng, h, sigma = np.random.default_rng(1), response(), 2.0
        m = model([record(blow(512), h, sigma, rng) for _ in range(400)])
        force = np.abs(np.fft.rfft(blow(512), 2 * (len(m.frequencies) - 1)))
        signal = np.abs(m.H[:, 0, 0] * force) ** 2
        expected = signal / (signal + 512 * sigma**2)
        assert expected.min() < 0.3
        assert expected.max() > 0.95
        assert m.coherence[:, 0] == pytest.approx(expected, abs=0.13)
        assert np.mean(m.coherence[:, 0] - expected) == pytest.approx(0, abs=0.01)

    def test_coherence_without_noise_is_one(self):
        m = model(hits(3))
        assert m.coherence == pytest.approx(1, abs=1e-10)
        assert np.all(m.noise_power > 0)

    def test_leave_one_out_certificate(self):
        """Each hit predicted from the model of the others, over all hits."""
        tables = hits(4, sensors=2, noise=1.5)
        found = model(tables, responses=[1, 2]).certificate
        predicted, true = [], []
        for i, table in enumerate(tables):
            others = model([t for j, t in enumerate(tables) if j != i], responses=[1, 2])
            padded = 2 * (len(others.frequencies) - 1)
            force = np.fft.rfft(table[:, 0], padded)
            predicted.append(np.fft.irfft(others.H[..., 0] * force[:, None], padded, axis=0)[: len(table)])
            true.append(table[:, 1:])
        p, y = np.concatenate(predicted), np.concatenate(true)
        assert found.error == pytest.approx(np.linalg.norm(p - y, axis=0) / np.linalg.norm(y, axis=0))
        assert found.gain == pytest.approx(np.sum(p * y, axis=0) / np.sum(p**2, axis=0))
        assert "4 hits" in found.source
        assert found.sensors == ("channel 1", "channel 2")

    def test_certificate_of_a_wrong_hit(self):
        """A hit at another place is seen in the certificate."""
        tables = hits(3, noise=0.1)
        tables[2][:, 1] *= 1.3
        assert model(hits(3, noise=0.1)).certificate.error[0] < 0.01
        assert model(tables).certificate.error[0] > 0.1


class TestRecords:
    def test_unequal_lengths(self):
        """Decayed records of different length are the same as padded by hand; digests are those of the records."""
        tables = hits(3)
        short = [tables[0][:600], tables[1], tables[2][:800]]
        m = model(short)
        assert np.abs(m.H - model(tables).H).max() < 1e-9 * np.abs(m.H).max()
        assert m.samples == 1024
        assert m.training == {digests(t[:, 1:])[0] for t in short}

    def test_objects_with_values_and_a_step(self):
        tables = hits(2, sensors=2)
        plain = model(tables, responses=[1, 2])
        for named in ({"force": "F", "responses": ["a", "b"]}, {"force": 0, "responses": [-2, 2]}):
            m = MeasuredModel.from_hits([Log(t) for t in tables], **named)
            np.testing.assert_array_equal(m.H, plain.H)
            assert [c.label for c in (*m.loads, *m.sensors)] == ["F", "a", "b"]
        one = MeasuredModel.from_hits([Log(t) for t in tables], force="F", responses="b")
        np.testing.assert_array_equal(one.H, plain.H[:, 1:])
        swapped = MeasuredModel.from_hits([Log(t) for t in tables], force="F", responses=["b", "a"])
        np.testing.assert_array_equal(swapped.H, plain.H[:, ::-1])

    @pytest.mark.parametrize(
        ("logs", "settings", "words"),
        [
            ([], {}, "no records"),
            ([Log(hits(1)[0], dt=None, channels=())], {"force": 0, "responses": [1]}, "step.*not known"),
            ([Log(hits(1, 2)[0]), Log(hits(1, 2)[0], dt=2 * DT)], {}, "different steps"),
            ([Log(hits(1, 2)[0])], {"dt": 2 * DT}, "own step"),
            ([Log(hits(1, 2)[0], dt=-1.0)], {}, "not positive"),
            ([Log(hits(1, 2)[0], dt=np.nan)], {}, "not positive"),
            ([Log(hits(1, 2)[0])], {"force": "G"}, r"no such channel.*'G'.*\['F', 'a', 'b'\]"),
            ([Log(hits(1, 2)[0])], {"responses": ["c"]}, "no such channel"),
            ([Log(hits(1, 2)[0])], {"responses": [3]}, "no such channel"),
            ([Log(hits(1, 2)[0])], {"responses": [-4]}, "no such channel"),
            ([Log(hits(1, 2)[0])], {"responses": []}, "no responses"),
            ([Log(hits(1, 2)[0])], {"responses": ["a", "F"]}, "named twice"),
            ([Log(hits(1, 2)[0])], {"responses": ["a", 1]}, "named twice"),
            ([Log(np.zeros(100))], {}, "table"),
            ([Log(np.zeros((0, 3)))], {}, "table"),
            ([Log(hits(1, 2)[0], channels=("F", "a"))], {}, "do not fit"),
            (
                [Log(hits(1, 2)[0], channels=("F", Channel(label="a", unit=u), "b")) for u in ("m", "m/s^2")],
                {},
                "different units",
            ),
        ],
    )
    def test_refused(self, logs, settings, words):
        with pytest.raises(InputError, match=words):
            MeasuredModel.from_hits(logs, **{"force": "F", "responses": ["a"], **settings})

    def test_digests_know_the_training(self):
        tables = [*hits(2), record(blow() + blow(at=300), response())]
        m = model(tables)
        assert [h.used for h in m.hits] == [True, True, False]
        assert m.training == {digests(t[:, 1:])[0] for t in tables[:2]}
        assert digests(tables[0][:, 1:] + 1e-12)[0] not in m.training


class TestLines:
    def test_own_grid(self):
        m = model(hits(2))
        np.testing.assert_array_equal(m.frf(m.frequencies), m.H)

    @pytest.mark.parametrize("padded", [900, 4096, 5000])
    def test_another_uniform_grid(self, padded):
        m, f = model(hits(2)), np.fft.rfftfreq(padded, DT)
        exact = transfer(f)
        assert np.abs(m.frf(f)[..., 0] - exact).max() < 1e-6 * np.abs(exact).max()

    def test_single_frequencies(self):
        """Off the grid, linear interpolation on a fine grid: within 1 % of the peak, and exact on its lines."""
        m, f = model(hits(2)), np.array([0.0, 7.3, 59.9, 60.04, 171.3, 433.1, 500.0])
        exact = transfer(f)
        assert np.abs(m.frf(f)[..., 0] - exact).max() < 1e-3 * np.abs(exact).max()
        assert m.frf(60.0).shape == (1, 1, 1)

    @pytest.mark.parametrize("f", [-1.0, 501.0, np.nan, np.inf])
    def test_outside_the_measured_range(self, f):
        with pytest.raises(InputError, match=r"measured range.*0 to 500 Hz"):
            model(hits(1)).frf([10.0, f])

    def test_variance_and_noise_between_lines(self):
        m = model(hits(3, noise=1.0))
        middle = 0.5 * (m.frequencies[1:] + m.frequencies[:-1])
        assert m.frf_variance(middle) == pytest.approx(0.5 * (m.variance[1:] + m.variance[:-1]))
        assert m.noise_spectrum(middle) == pytest.approx(0.5 * (m.noise_power[1:] + m.noise_power[:-1]))

    @pytest.mark.parametrize("samples", [1, 100, 1024, 3000])
    def test_impulse_response(self, samples):
        h = model(hits(2)).impulse_response(DT, samples)[:, 0, 0]
        assert h == pytest.approx(np.pad(response()[:, 0], (0, 2600))[:samples], abs=1e-10)
        with pytest.raises(InputError, match="different steps"):
            model(hits(2)).impulse_response(1.01 * DT, samples)

    def test_predicts_a_hit(self):
        m, (table,) = model(hits(3)), hits(1, samples=700)
        assert m.predict(table[:, 0], DT) == pytest.approx(table[:, 1:], abs=1e-8)
        assert m.verify(table[:, 0], table[:, 1], DT).error[0] < 1e-9


def analytic(kind="accelerance", first=0):
    """FRF (lines,) of one oscillator, and its lines."""
    f = np.arange(first, 513) * (0.5 / DT / 512)
    w, w0 = 2 * np.pi * f, 2 * np.pi * 60
    receptance = 1 / (w0**2 - w**2 + 2j * 0.05 * w0 * w)
    return f, receptance * (1j * w) ** {"receptance": 0, "mobility": 1, "accelerance": 2}[kind]


class TestImported:
    @pytest.mark.parametrize("kind", ["accelerance", "mobility", "receptance"])
    def test_kind_names_quantity_and_unit(self, kind):
        f, H = analytic(kind)
        m = MeasuredModel.from_frf(f, H, kind=kind, sensors=["a"], loads=["hammer"])
        quantity, unit = {
            "accelerance": ("acceleration", "m/s^2"),
            "mobility": ("velocity", "m/s"),
            "receptance": ("displacement", "m"),
        }[kind]
        assert (m.sensors[0].label, m.sensors[0].quantity, m.sensors[0].unit) == ("a", quantity, unit)
        assert (m.loads[0].label, m.loads[0].unit) == ("hammer", "N")
        assert m.flags == ()
        assert m.dt == pytest.approx(DT)
        assert "imported FRF" in repr(m)

    @pytest.mark.parametrize("kind", [None, "", "inertance", 2])
    def test_kind_is_never_guessed(self, kind):
        with pytest.raises(InputError, match="receptance, mobility or accelerance") as caught:
            MeasuredModel.from_frf(*analytic(), kind=kind)
        assert caught.value.code == "LID-W208"
        with pytest.raises(InputError, match="W208"):
            MeasuredModel.from_frf(*analytic(), kind="mobility").as_kind(kind)

    @pytest.mark.parametrize("shape", [(), (2,), (2, 3)])
    def test_shapes(self, shape):
        f, H = analytic()
        H = H.reshape(-1, *(1 for _ in shape)) * np.ones(shape)
        m = MeasuredModel.from_frf(f, H, kind="accelerance", variance=np.abs(H) ** 2)
        assert m.H.shape == m.variance.shape == (513, *(*shape, 1, 1)[:2])

    def test_missing_first_line(self):
        for kind in ("accelerance", "mobility", "receptance"):
            f, H = analytic(kind, first=1)
            m = MeasuredModel.from_frf(f, H, kind=kind, variance=np.ones(512))
            assert m.frequencies[0] == 0
            assert m.variance.shape == m.H.shape == (513, 1, 1)
            assert m.H[0, 0, 0] == (H[0].real if kind == "receptance" else 0)
            np.testing.assert_array_equal(m.H[1:, 0, 0], H)

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda f, H: (f[2:], H[2:]), "uniformly from 0"),
            (lambda f, H: (f**1.01, H), "uniformly from 0"),
            (lambda f, H: (f[::-1], H), "uniformly from 0"),
            (lambda f, H: (f[:2], H[:2]), "uniformly from 0"),
            (lambda f, H: (f, H[:-1]), "do not fit"),
            (lambda f, H: (f, H.reshape(-1, 1, 1, 1)), "do not fit"),
            (lambda f, H: (f, np.where(f == f[7], np.nan, H)), "NaN.*1 of 513"),
            (lambda f, H: (np.where(f == f[7], np.nan, f), H), "NaN"),
            (lambda f, H: (f, np.empty((513, 0))), "do not fit"),
        ],
    )
    def test_refused(self, change, words):
        with pytest.raises(InputError, match=words):
            MeasuredModel.from_frf(*change(*analytic()), kind="accelerance")

    @pytest.mark.parametrize(
        ("extra", "words"),
        [
            ({"variance": np.ones(7)}, "variance: lines, channels and table do not fit"),
            ({"variance": -np.ones(513)}, "negative"),
            ({"variance": np.full(513, np.inf)}, "NaN or inf"),
            ({"sensors": ["a", "b"]}, "do not fit"),
        ],
    )
    def test_extras_are_checked(self, extra, words):
        with pytest.raises(InputError, match=words):
            MeasuredModel.from_frf(*analytic(), kind="accelerance", **extra)
        f, H = analytic()
        with pytest.raises(InputError, match="not unique"):
            MeasuredModel.from_frf(f, np.stack([H, H], 1), kind="accelerance", sensors=["a", "a"])

    def test_unit_against_kind(self):
        acceleration = Channel(label="a", quantity="acceleration", unit="m/s^2")
        (flag,) = MeasuredModel.from_frf(*analytic(), kind="receptance", sensors=[acceleration]).flags
        assert flag.code == "LID-W208"
        assert "m/s^2" in flag.message
        assert MeasuredModel.from_frf(*analytic(), kind="accelerance", sensors=[acceleration]).flags == ()
        arbitrary = MeasuredModel.from_frf(*analytic(), kind="receptance", sensors=[Channel(label="a")])
        assert arbitrary.flags == ()
        assert arbitrary.sensors[0].quantity == "displacement"


class TestKinds:
    @pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
    @pytest.mark.parametrize("other", ["receptance", "mobility", "accelerance"])
    def test_against_the_closed_form_and_back(self, kind, other):
        m = MeasuredModel.from_frf(*analytic(kind), kind=kind, variance=np.abs(analytic(kind)[1]) ** 2)
        turned = m.as_kind(other)
        exact = analytic(other)[1]
        assert turned.H[1:, 0, 0] == pytest.approx(exact[1:], rel=1e-12)
        assert turned.H[0, 0, 0] == (exact[0] if kind == other else 0)
        assert turned.variance[1:, 0, 0] == pytest.approx(np.abs(exact[1:]) ** 2, rel=1e-12)
        assert turned.sensors[0].unit == {"receptance": "m", "mobility": "m/s", "accelerance": "m/s^2"}[other]
        back = turned.as_kind(kind)
        assert back.H[1:] == pytest.approx(m.H[1:], rel=1e-12)
        assert back.sensors == m.sensors

    def test_hits_keep_their_errors(self):
        """Variance and residual power follow the FRF; at 0 Hz nothing is known, and it says so."""
        logs = [
            Log(t, channels=("F", Channel(label="a", quantity="acceleration", unit="m/s^2"))) for t in hits(3, 1, 0.5)
        ]
        m = MeasuredModel.from_hits(logs, force=0, responses=[1])
        turned = m.as_kind("receptance")
        w = 2 * np.pi * m.frequencies[1:, None]
        assert turned.noise_power[1:] == pytest.approx(m.noise_power[1:] / w**4)
        assert turned.variance[1:, :, 0] == pytest.approx(m.variance[1:, :, 0] / w**4)
        assert turned.noise_power[0] > 0.1 * turned.noise_power[1]
        assert turned.H[0] == 0
        assert turned.training == m.training
        assert turned.certificate.gain == m.certificate.gain
        assert "receptance" in turned.certificate.source

    def test_other_quantities_and_arbitrary_units_stay(self):
        f, H = analytic("receptance")
        strain = Channel(label="e", quantity="strain", unit="1")
        plain = Channel(label="u")
        m = MeasuredModel(
            f, np.stack([H, H], 1)[..., None], sensors=[strain, replace(plain, quantity="displacement")], loads=[plain]
        )
        turned = m.as_kind("accelerance")
        np.testing.assert_array_equal(turned.H[:, 0], m.H[:, 0])
        assert turned.H[5, 1] == pytest.approx(-((2 * np.pi * f[5]) ** 2) * H[5])
        assert [s.unit for s in turned.sensors] == ["1", "arbitrary"]

    @pytest.mark.parametrize("kind", ["mobility", "receptance"])
    def test_the_load_does_not_depend_on_the_kind(self, kind):
        """The same accelerations, the same structure, its FRF imported as one kind or another."""
        from loadid import Deconvolution, Penalty

        still = Penalty("identity", variance="constant")  # variances are learned in steps, which make rounding larger
        f, H = analytic("accelerance")
        # zero at the Nyquist frequency too: a sampled response is real there
        H = H * np.hanning(2 * len(f) - 1)[len(f) - 1 :]
        imported = analytic(kind)[1] * np.hanning(2 * len(f) - 1)[len(f) - 1 :]
        h = np.fft.irfft(H)[:512]
        y = np.convolve(blow(512), h)[:512] + 1e-3 * np.random.default_rng(0).standard_normal(512)
        loads = []
        for given, name in ((H, "accelerance"), (imported, kind)):
            m = MeasuredModel.from_frf(f, given, kind=name).as_kind("accelerance")
            loads.append(Deconvolution(m, penalty=still).estimate(y, dt=DT).load)
        assert np.abs(loads[0] - loads[1]).max() < 1e-9 * np.abs(loads[0]).max()

    def test_a_converted_model_of_hits_inverts(self):
        """Accelerances from hits, the record measured as displacement: the blow comes back."""
        from loadid import Deconvolution, Record

        channels = ("F", Channel(label="a", quantity="acceleration", unit="m/s^2"))
        logs = [
            Log(np.column_stack([t[:, 0], np.convolve(t[:, 1], [1, -2, 1])[1:-1] / DT**2]), channels=channels)
            for t in hits(3)
        ]
        rng = np.random.default_rng(0)
        for log in logs:
            log.values[:, 1] += 1e-3 * np.abs(log.values[:, 1]).max() * rng.standard_normal(len(log.values))
        m = MeasuredModel.from_hits(logs, force=0, responses=[1]).as_kind("receptance")
        force = blow(at=200, height=80.0)
        y = record(force, response())[:, 1]
        estimate = Deconvolution(m).estimate(Record(y, DT, m.sensors))
        assert int(np.argmax(np.abs(estimate.load))) == 201
        assert np.linalg.norm(estimate.load[:, 0] - force) < 0.5 * np.linalg.norm(force)


class TestCausality:
    @pytest.mark.parametrize("kind", ["accelerance", "mobility", "receptance"])
    def test_conjugated(self, kind):
        f, H = analytic(kind)
        (flag,) = MeasuredModel.from_frf(f, H.conj(), kind=kind).flags
        assert flag.code == "LID-W207"
        assert flag.evidence.value > 0.9
        assert "conjugate" in flag.advice
        assert MeasuredModel.from_frf(f, H, kind=kind).flags == ()

    def test_one_small_sensor_of_many(self):
        f, H = analytic()
        table = np.stack([H, 1e-6 * H.conj(), H], axis=1)
        (flag,) = MeasuredModel.from_frf(f, table, kind="accelerance").flags
        assert "sensor 2 / load 1" in flag.message

    def test_a_shifted_record(self):
        """Response that leads the force by more than a filter rings."""
        f, H = analytic()
        early = H * np.exp(2j * np.pi * f * DT * 40)
        assert [x.code for x in MeasuredModel.from_frf(f, early, kind="accelerance").flags] == ["LID-W207"]

    def test_silent_on_hits(self):
        assert model(hits(3, 2, noise=1.0), responses=[1, 2]).flags == ()
        reversed_ = [t[::-1] for t in hits(3)]
        assert [x.code for x in model(reversed_).flags] == ["LID-W207"]

    def test_silent_on_measured_hits(self):
        tables = [np.load(measured("hammer_five_hits", f"measurements_{k}.npy"))[1:].T for k in (1, 2)]
        five = model(tables, dt=1 / 25600)
        with np.load(measured("hammer_two_hits", "lvm_two_hits.npz")) as file:
            two = model([file["hit1"], file["hit2"]], dt=1 / 1024, responses=[1, 2])
        assert five.flags == two.flags == ()
        assert all(h.used for h in (*five.hits, *two.hits))
        conjugated = MeasuredModel.from_frf(five.frequencies, five.H.conj(), kind="accelerance")
        assert conjugated.flags[0].evidence.value > 0.999


class TestFiles:
    @pytest.fixture
    def saved(self, tmp_path):
        tables = [*hits(3, 2, noise=0.5), record(blow() + blow(at=300), response(sensors=2))]
        channels = (
            Channel(label="F", quantity="force", unit="N"),
            Channel(label="a", quantity="acceleration", unit="m/s^2", noise=0.1, highpass=0.5),
            Channel(label="b"),
        )
        m = MeasuredModel.from_hits([Log(t, channels=channels, name="é") for t in tables], force=0, responses=[1, 2])
        m.save(tmp_path / "model.h5")
        return m, tmp_path / "model.h5"

    def test_bit_identical(self, saved):
        m, path = saved
        read = MeasuredModel.load(path)
        for name in ("frequencies", "H", "variance", "noise_power", "coherence"):
            before, after = getattr(m, name), getattr(read, name)
            assert (before.dtype, before.tobytes()) == (after.dtype, after.tobytes())
        for name in ("hits", "certificate", "flags", "sensors", "loads", "samples", "training", "fingerprint", "dt"):
            assert getattr(read, name) == getattr(m, name)
        assert [h.used for h in read.hits] == [True, True, True, False]

    def test_flags_and_missing_parts(self, tmp_path):
        wrong = Channel(label="a", quantity="acceleration", unit="m/s^2")
        f, H = analytic()
        m = MeasuredModel.from_frf(f, H.conj(), kind="receptance", sensors=[wrong])
        m.save(tmp_path / "model.h5")
        read = MeasuredModel.load(tmp_path / "model.h5")
        assert [x.code for x in read.flags] == ["LID-W208", "LID-W207"]
        assert read.flags == m.flags
        assert read.variance is read.certificate is None
        assert read.hits == ()

    def test_damaged(self, saved):
        _, path = saved
        data = path.read_bytes()
        for at in np.linspace(0, len(data) - 1, 40).astype(int):
            path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
            with pytest.raises(InputError):
                MeasuredModel.load(path)
        path.write_bytes(data[: len(data) // 2])
        with pytest.raises(InputError):
            MeasuredModel.load(path)

    def test_another_kind_of_file(self, tmp_path):
        from structures.files import _storage as storage

        storage.write(tmp_path / "x.h5", {"load": np.ones(3)}, "estimate")
        with pytest.raises(InputError, match="estimate"):
            MeasuredModel.load(tmp_path / "x.h5")
        with pytest.raises(InputError):
            MeasuredModel.load(tmp_path / "missing.h5")


def test_perturbed():
    m = model(hits(3, noise=0.5))
    louder = m.perturbed("gain", 1.1)
    np.testing.assert_allclose(louder.H, 1.1 * m.H, rtol=1e-12)
    assert louder.variance == pytest.approx(1.21 * m.variance)
    np.testing.assert_array_equal(louder.noise_power, m.noise_power)
    assert louder.certificate is None
    assert louder.training == m.training
    with pytest.raises(InputError, match="no such parameter"):
        m.perturbed("stiffness", 1.1)


def test_fingerprint_changes_with_content():
    tables = hits(3, noise=0.5)
    m = model(tables)
    label = replace(m.sensors[0], label="x")
    unit = replace(m.sensors[0], unit="m")
    records = TrainingRecords(m.hits, m.samples, m.noise_power)
    parts = {n: getattr(m, n) for n in ("frequencies", "H", "sensors", "loads", "variance")} | {"records": records}
    others = [
        {"frequencies": m.frequencies * 2},
        {"H": m.H * (1 + 1e-15)},
        {"sensors": [label]},
        {"sensors": [unit]},
        {"variance": 2 * m.variance},
        {"variance": None},
        {"records": replace(records, noise_power=2 * m.noise_power)},
    ]
    seen = {MeasuredModel(**{**parts, **change}).fingerprint for change in ({}, *others)}
    assert len(seen) == 1 + len(others)
    assert model(tables).fingerprint == m.fingerprint == MeasuredModel(**parts).fingerprint


def test_the_same_record_twice_is_one_hit():
    """Repeated records would look like perfect coherence and a perfect certificate."""
    rng = np.random.default_rng(0)
    t = np.arange(400)
    record = np.column_stack(
        [np.exp(-(((t - 40) / 3) ** 2)), np.exp(-t / 30) * np.cos(t / 5) + 0.01 * rng.standard_normal(400)]
    )
    model = MeasuredModel.from_hits([record, record.copy()], dt=1e-3, force=0, responses=[1])
    assert [h.used for h in model.hits] == [True, False]
    assert "same record" in model.hits[1].reason
    assert model.certificate is None
    assert model.noise_power is None


@pytest.mark.parametrize(
    ("force", "response", "words"),
    [("acceleration", "acceleration", "no unit of a force"), ("force", "force", "swapped")],
)
def test_units_that_cannot_be_what_they_say(force, response, words):
    units = {"force": "N", "acceleration": "m/s^2"}

    class Table:
        values, dt, name = np.random.default_rng(0).standard_normal((100, 2)), 1e-3, "log"
        channels = (
            Channel(label="f", quantity=force, unit=units[force]),
            Channel(label="a", quantity=response, unit=units[response]),
        )

    with pytest.raises(InputError, match=words):
        MeasuredModel.from_hits([Table()], force="f", responses=["a"])


def test_a_symmetric_pulse_may_have_a_zero():
    """A pulse with a zero at one line is no error: nothing is known there."""
    force = np.zeros(256)
    force[20:30] = np.hanning(10)
    response = np.convolve(force, 0.9 ** np.arange(200) * np.cos(np.arange(200)))[:256]
    model = MeasuredModel.from_hits([np.column_stack([force, response])], dt=1e-3, force=0, responses=[1])
    assert np.all(np.isfinite(model.H))


def test_noise_on_unexcited_lines_is_not_taken_for_a_wrong_sign():
    """W207 looks at the response, not at the noise that fills all times alike."""
    rng = np.random.default_rng(1)
    h = np.exp(-np.arange(2000) / 50) * np.sin(np.arange(2000) / 7)
    noisy = h + 0.05 * rng.standard_normal(2000)
    assert not MeasuredModel.from_frf(np.fft.rfftfreq(2000, 1e-3), np.fft.rfft(noisy), kind="accelerance").flags
    turned = MeasuredModel.from_frf(np.fft.rfftfreq(2000, 1e-3), np.fft.rfft(noisy).conj(), kind="accelerance")
    assert [f.code for f in turned.flags] == ["LID-W207"]


def test_the_spelling_of_0_1_goes_on_working():
    m = model(hits(3, noise=0.5))
    old = {n: getattr(m, n) for n in ("variance", "coherence", "noise_power", "hits", "samples")}
    with pytest.warns(DeprecationWarning, match=r"MeasuredModel\(noise_power=, hits=, samples=\) is now records="):
        again = MeasuredModel(m.frequencies, m.H, sensors=m.sensors, loads=m.loads, **old)
    assert (again.fingerprint, again.hits, again.samples) == (m.fingerprint, m.hits, m.samples)
    with pytest.raises(TypeError, match="no argument 'hit'"):
        MeasuredModel(m.frequencies, m.H, sensors=m.sensors, loads=m.loads, hit=())


def test_it_is_a_table_of_frfs():
    """What every table of FRFs has: some lines no more, as they would not run from 0 Hz to the Nyquist frequency."""
    m = model(hits(3, noise=0.5))
    assert isinstance(m, FrfModel)
    assert np.all(m.has_lines([0.3, 60.1]))
    assert m.judged() is m
    whole = m.at(m.frequencies)
    assert (whole.fingerprint, whole.certificate) == (m.fingerprint, None)
    with pytest.raises(InputError, match="uniformly from 0"):
        m.at(m.frequencies[1:])
    with pytest.raises(TypeError, match="no argument 'interpolate'"):
        MeasuredModel.from_frf(m.frequencies, m.H, kind="mobility", interpolate=True)
