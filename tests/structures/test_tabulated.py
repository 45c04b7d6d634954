"""FRFs on any lines: what they give, what they refuse, and what becomes of them in another kind."""

from dataclasses import replace

import numpy as np
import pytest

from structures import Channel, ForwardModel, FrfModel, InputError, MeasuredModel, chains, loads, sensors
from structures._flags import codes

F = np.array([20.0, 21.0, 22.5, 40.0, 100.0])
H = np.random.default_rng(0).standard_normal((5, 3, 2)) + 1j * np.random.default_rng(1).standard_normal((5, 3, 2))
CLEAN = {"LID-N207"}  # five lines do not tell whether an FRF is causal


def table(**settings):
    return FrfModel.from_frf(
        **{"frequencies": F, "H": H, "kind": "accelerance", "variance": np.abs(H) ** 2, **settings}
    )


class TestLines:
    def test_own_lines_in_any_order(self):
        m = table()
        np.testing.assert_array_equal(m.frf(F), H)
        np.testing.assert_array_equal(m.frf([100.0, 20.0, 20.0]), H[[4, 0, 0]])
        np.testing.assert_array_equal(m.frf(40.0), H[[3]])
        np.testing.assert_array_equal(m.frf_variance([21.0]), np.abs(H[[1]]) ** 2)
        np.testing.assert_array_equal(m.frf(F * (1 + 1e-9)), H)
        assert table(variance=None).frf_variance(F) is None

    @pytest.mark.parametrize(
        ("asked", "words"),
        [
            ([20.0, 20.5], "20.5 Hz.*the nearest is 2"),
            ([20.0 + 2e-6], "20.000002.*the nearest is 20 Hz"),
            ([1e5], "nearest is 100"),
            ([0.0, 3.0], "0 Hz and 1 others"),
            ([-20.0], "frequencies"),
            ([np.nan], "NaN"),
        ],
    )
    def test_other_lines_are_refused(self, asked, words):
        with pytest.raises(InputError, match=words):
            table().frf(asked)

    def test_a_single_line(self):
        m = table(frequencies=[50.0], H=H[:1], variance=None)
        np.testing.assert_array_equal(m.frf([50.0]), H[:1])
        with pytest.raises(InputError, match="nearest is 50"):
            m.frf([50.1])
        assert "50 Hz)" in repr(m)

    def test_interpolated_on_request(self):
        m = table(interpolate=True)
        assert "LID-W211" in {f.code for f in m.flags}
        assert m.frf([20.25, 40.0])[0] == pytest.approx(0.75 * H[0] + 0.25 * H[1])
        np.testing.assert_array_equal(m.frf([40.0, 100.0]), H[[3, 4]])
        assert m.frf_variance([70.0])[0] == pytest.approx((np.abs(H[3]) ** 2 + np.abs(H[4]) ** 2) / 2)
        assert sum(f.code == "LID-W211" for f in m.at(F < 50).as_kind("mobility").flags) == 1
        for outside in (19.9, 100.1):
            with pytest.raises(InputError, match="outside"):
                m.frf([outside])

    def test_some_lines(self):
        m = table(coherence=np.full((5, 3), 0.9))
        for part in (m.at(F > 30), m.at([40.0, 100.0])):
            np.testing.assert_array_equal(part.frf([40.0, 100.0]), H[3:])
            assert part.variance.shape == (2, 3, 2)
            assert part.coherence.shape == (2, 3)
            assert part.sensors == m.sensors
        for bad, words in ((F > 300, "no lines"), ((F > 30)[:3], "mask"), ([40.0, 50.0], "no line of the table")):
            with pytest.raises(InputError, match=words):
                m.at(bad)


class TestContract:
    @pytest.mark.parametrize(
        ("ask", "name", "way"),
        [
            (lambda m: m.static(), "StaticInversion", "MatrixModel"),
            (lambda m: m.impulse_response(1e-3, 4), "Deconvolution", "MeasuredModel"),
            (lambda m: m.state_space(1e-3), "LoadTracker", "ForwardModel"),
        ],
    )
    def test_refused_by_name_with_a_way_out(self, ask, name, way):
        with pytest.raises(InputError, match=rf"{name} cannot run on it.*FrequencyInversion; .*{way}"):
            ask(table())

    def test_table_of_another_model(self):
        chain = chains.chain(masses=[1.0, 2.0], springs=[1e4, 2e4], dashpots=3.0)
        model = ForwardModel(chain, [sensors.Accelerometer("1+X"), sensors.Displacement("2+X")], [loads.Point("2+X")])
        lines = np.linspace(1, 40, 30)
        m = FrfModel.of(model, lines)
        np.testing.assert_array_equal(m.frf(lines), model.frf(lines))
        assert (m.sensors, m.loads, m.flags) == (tuple(model.sensors), tuple(model.loads), model.flags)
        with pytest.raises(InputError, match="StaticInversion"):
            FrfModel.of(MeasuredModel.from_frf(np.arange(9.0), np.ones(9), kind="mobility"), [1.0]).static()

    def test_joined(self):
        """Two hammer points, one model: the same as measured at once."""
        a, b = (table(H=H[..., [j]], variance=np.abs(H[..., [j]]) ** 2, loads=[name]) for j, name in enumerate("ab"))
        both = FrfModel.joined([a, b])
        np.testing.assert_array_equal(both.H, H)
        np.testing.assert_array_equal(both.variance, np.abs(H) ** 2)
        assert [c.label for c in both.loads] == ["a", "b"]
        assert both.flags == a.flags
        assert FrfModel.joined([a, table(H=H[..., [1]], variance=None, loads=["b"])]).variance is None
        for wrong, words in (
            ([], "no models"),
            ([a, a], "labels of loads"),
            ([a, b.at(F > 30)], "different lines"),
            ([a, table(H=H[..., [1]], variance=None, loads=["b"], sensors="xyz")], "different sensors"),
        ):
            with pytest.raises(InputError, match=words):
                FrfModel.joined(wrong)

    def test_gain(self):
        louder = table().perturbed("gain", 1.1)
        np.testing.assert_allclose(louder.H, 1.1 * H, rtol=1e-12)
        assert louder.variance == pytest.approx(1.21 * np.abs(H) ** 2)
        with pytest.raises(InputError, match="no such parameter"):
            table().perturbed("E", 1.1)

    def test_fingerprint_changes_with_content(self):
        m = table()
        others = [
            table(frequencies=2 * F),
            table(H=H * (1 + 1e-15)),
            table(variance=None),
            table(variance=np.ones(H.shape)),
            table(kind="mobility"),
            table(loads=["a", "b"]),
            m.perturbed("gain", 2.0),
        ]
        assert len({x.fingerprint for x in (m, *others)}) == 1 + len(others)
        assert table().fingerprint == m.fingerprint

    def test_arrays_cannot_be_changed(self):
        m = table()
        for array in (m.frequencies, m.H, m.variance):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0

    def test_more_loads_than_sensors(self):
        assert table(H=H[:, :1], variance=None).frf(F).shape == (5, 1, 2)


class TestFiles:
    def test_bit_identical(self, tmp_path):
        chain = chains.chain(masses=[1.0], springs=[1e4], dashpots=3.0)
        model = ForwardModel(chain, [sensors.Accelerometer("1+X")], [loads.Point("1+X")])
        model.verify(np.ones(40), model.predict(np.ones(40), 1e-3), 1e-3)
        for m in (table(interpolate=True, coherence=np.full((5, 3), 0.5)), FrfModel.of(model, F)):
            m.save(tmp_path / "m.h5")
            read = FrfModel.load(tmp_path / "m.h5")
            for name in ("flags", "certificate", "fingerprint", "interpolate"):
                assert getattr(read, name) == getattr(m, name)
            assert [(c.label, c.unit) for c in read.sensors] == [(c.label, c.unit) for c in m.sensors]
            np.testing.assert_array_equal(read.H, m.H)
            assert (read.coherence is None) == (m.coherence is None)

    def test_another_kind_of_file(self, tmp_path):
        MeasuredModel.from_frf(np.arange(9.0), np.ones(9), kind="mobility").save(tmp_path / "m.h5")
        with pytest.raises(InputError, match="table of FRFs"):
            FrfModel.load(tmp_path / "m.h5")


class TestBadInput:
    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"frequencies": F[::-1]}, "do not ascend.*100 Hz before 40"),
            ({"frequencies": F[[0, 0, 1, 2, 3]]}, "do not ascend"),
            ({"frequencies": [], "H": H[:0], "variance": None}, "no lines"),
            ({"frequencies": -F}, "frequencies"),
            ({"frequencies": F[:4]}, r"do not fit.*shape \(5, 3, 2\).*\(4, 3, 2\)"),
            ({"frequencies": ["a"] * 5}, "not a real array"),
            ({"H": np.where(np.abs(H) > 2, np.nan, H)}, "NaN"),
            ({"H": np.full(H.shape, "x")}, "no numbers"),
            ({"H": 0 * H}, "no load moves"),
            ({"H": H[:, :0], "variance": None}, "do not fit"),
            ({"variance": -np.abs(H)}, "negative"),
            ({"variance": H}, "complex"),
            ({"variance": np.abs(H[:2])}, "do not fit"),
            ({"coherence": np.full((5, 3), 1.1)}, "coherence outside 0 to 1"),
            ({"coherence": np.full((5, 2), 0.1)}, "do not fit"),
            ({"sensors": ["a", "a", "b"]}, "not unique"),
            ({"loads": ["a"]}, "do not fit"),
            ({"kind": None}, "W208"),
            ({"kind": "inertance"}, "W208"),
        ],
    )
    def test_refused(self, change, words):
        with pytest.raises(InputError, match=words):
            table(**change)

    def test_unit_against_kind(self):
        plain = [Channel(label=x, quantity="acceleration", unit="m/s^2") for x in "abc"]
        assert "LID-W208" in {f.code for f in table(kind="receptance", sensors=plain).flags}
        assert {f.code for f in table(sensors=plain).flags} == CLEAN


class TestKinds:
    @pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
    @pytest.mark.parametrize("other", ["receptance", "mobility", "accelerance"])
    def test_powers_of_omega_and_back(self, kind, other):
        m = table(kind=kind, coherence=np.full((5, 3), 0.5))
        turned = m.as_kind(other)
        steps = ["receptance", "mobility", "accelerance"]
        power = steps.index(other) - steps.index(kind)
        omega = 2 * np.pi * F[:, None, None]
        np.testing.assert_allclose(turned.H, H * (1j * omega) ** power, rtol=1e-12)
        assert turned.variance == pytest.approx(np.abs(H) ** 2 * omega ** (2 * power), rel=1e-12)
        np.testing.assert_array_equal(turned.coherence, m.coherence)
        assert turned.sensors[0].unit == {"receptance": "m", "mobility": "m/s", "accelerance": "m/s^2"}[other]
        np.testing.assert_allclose(turned.as_kind(kind).H, H, rtol=1e-12)

    def test_the_line_at_0_hz(self):
        """Differentiated it is zero; integrated it is lost, and both are said."""
        f, flat = np.array([0.0, 1.0, 2.0]), np.ones((3, 1, 1))
        up = table(frequencies=f, H=flat, variance=flat, kind="receptance").as_kind("mobility")
        assert up.H[0] == 0
        assert codes(up.flags) == {"N207"}
        down = table(frequencies=f, H=flat, variance=flat, kind="mobility").as_kind("receptance")
        assert down.H[0] == 0
        assert down.variance[0] == down.variance[1] > 0
        (lost,) = (x for x in down.flags if x.code == "LID-W211")
        assert "0 Hz" in lost.message
        assert down.as_kind("mobility").as_kind("receptance").flags == down.flags

    def test_strain_stays(self):
        strain = Channel(label="e", quantity="strain", unit="1")
        m = FrfModel(F, H[:, :1], sensors=[strain], loads=table().loads)
        np.testing.assert_array_equal(m.as_kind("accelerance").H, m.H)

    def test_unknown(self):
        with pytest.raises(InputError, match="W208"):
            table().as_kind("velocity")


def test_scale_of_units_changes_nothing_but_the_scale():
    m, small = table(), table(H=1e-6 * H, variance=1e-12 * np.abs(H) ** 2)
    np.testing.assert_allclose(small.as_kind("receptance").H, 1e-6 * m.as_kind("receptance").H, rtol=1e-12)
    assert {f.code for f in small.flags} == {f.code for f in m.flags}


def test_channels_keep_what_they_know():
    noisy = [replace(c, noise=0.1) for c in table().sensors]
    assert table(sensors=noisy).at([20.0]).noise == pytest.approx([0.1] * 3)
