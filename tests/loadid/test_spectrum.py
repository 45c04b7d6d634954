"""An estimate over lines: band, trust, peaks, words, pictures, report, and the way to a file and back."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from matplotlib.figure import Figure

from loadid import FrequencyInversion, Noise, Spectra, load
from loadid._results.functionals import LoadSpectrum, in_words
from structures import CrossSpectra, FrfModel, InputError
from tests import frfplate
from tests.linecases import case, model, normals
from tests.loadid.made import impact


@pytest.fixture(scope="module")
def beam():
    """One force, four antiresonances."""
    c = frfplate.beam(13)
    m = FrfModel.of(frfplate.beam_model(13), c.frequencies)
    data = Spectra(c.frequencies, c.Y, noise=c.sigma, noise_source="covariance")
    return c, FrequencyInversion(m, noise=Noise(frf=0.0)).estimate(data)


@pytest.fixture(scope="module")
def three():
    c = case(200, 6, 3)
    return c, FrequencyInversion(model(c.f, c.H), validation=["s2"]).estimate(Spectra(c.f, c.Y, noise=c.sigma))


@pytest.fixture(scope="module")
def cross():
    c = case(100, 6, 3)
    y = np.einsum("ksl,knl->kns", c.H, normals(np.random.default_rng(0), 100, 20, 3))
    y += c.sigma * normals(np.random.default_rng(1), 100, 20, 6)
    S = np.einsum("kni,knj->kij", y, y.conj()) / 20
    m = model(c.f, c.H)
    spectra = CrossSpectra(frequencies=c.f, matrix=(S + S.conj().swapaxes(1, 2)) / 2, averages=20.0, channels=m.sensors)
    return FrequencyInversion(m).estimate(spectra)


def words(figure: Figure) -> str:
    from matplotlib.text import Text

    return "\n".join(t.get_text() for t in figure.findobj(Text))


# -- numbers ----------------------------------------------------------------------------------------------------------
def test_band_of_a_modulus_holds_that_share_of_a_circular_error(three):
    """Draws of the error that is stated: the band of the modulus covers at least its level, and not all."""
    _, e = three
    k, j = np.argwhere(e.trust())[0]
    drawn = np.abs(e.load[k, j] + e.std[k, j] * normals(np.random.default_rng(0), 20_000))
    for level in (0.5, 0.9, 0.95):
        lower, upper = (side[k, j] for side in e.band(level))
        assert level <= np.mean((drawn >= lower) & (drawn <= upper)) < 1
        radius = (upper - lower) / 2
        disc = np.abs(e.std[k, j] * normals(np.random.default_rng(1), 20_000)) <= radius
        assert np.mean(disc) == pytest.approx(level, abs=0.012)
    assert np.all(e.band()[0] >= 0)


def test_peak_is_that_of_a_line_that_is_believed(beam, three):
    c, e = beam
    (peak,) = e.peaks
    assert e.trust()[peak.index, 0]
    assert peak.value == pytest.approx(10, rel=0.25)
    assert np.abs(e.load).max() > 1.5 * peak.value  # at an antiresonance, where it tells nothing
    assert peak.at == c.frequencies[peak.index]
    silent = case(60, 6, 2, truth=np.zeros((60, 2)), quiet=1.0)
    nothing = FrequencyInversion(model(silent.f, silent.H)).estimate(Spectra(silent.f, silent.Y, noise=1.0))
    assert not nothing.trust().any()
    assert [p.value for p in nothing.peaks] == pytest.approx(np.abs(nothing.load).max(axis=0))
    assert len(three[1].peaks) == 3


def test_trust_is_the_predicted_error(beam):
    _, e = beam
    s = e.spectrum
    assert np.array_equal(e.trust(0.2), s.naive_std <= 0.2 * s.expected)
    assert np.array_equal(e.trust(), e.trust(0.1))
    assert s.naive_std[:, 0] == pytest.approx(s.noise / s.gain[:, 0])
    for level in (0, -0.1, True, "much", np.nan):
        with pytest.raises(InputError, match="level of trust"):
            e.trust(level)
    with pytest.raises(InputError, match="no frequency lines"):
        impact().trust()


def test_bands_are_the_stretches_that_are_not_believed(beam):
    c, e = beam
    bands = e.spectrum.bands(0)
    inside = np.zeros(len(c.frequencies), bool)
    for first, last in bands:
        inside |= (c.frequencies >= first) & (c.frequencies <= last)
    assert np.array_equal(inside, ~e.trust()[:, 0])
    for zero in (16.50, 75.50, 127.50):
        assert any(first <= zero <= last for first, last in bands)
        assert np.min(np.abs(np.unique(e.spectrum.zeros) - zero)) < 0.3
    assert bands[0][0] == 1.0  # accelerance vanishes with the frequency
    assert in_words(((1.0, 4.25), (16.5, 16.5))) == "1 to 4.25 Hz, 16.5 Hz"
    assert in_words(tuple((float(i), i + 0.5) for i in range(9))).endswith("and 5 more")
    assert in_words(()) == ""


def test_complex_amplitudes_have_no_functional(three):
    with pytest.raises(InputError, match="transient"):
        three[1].functional("mean")


def test_a_spectrum_does_not_change(three):
    s = three[1].spectrum
    for name in ("load", "gain", "naive", "expected"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(s, name)[0, 0] = 1
    with pytest.raises(AttributeError):
        s.level = 1.0


# -- files ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("which", ["beam", "three", "cross"])
def test_an_estimate_comes_back_from_its_file(which, request, tmp_path):
    made = request.getfixturevalue(which)
    e = made if which == "cross" else made[1]
    e.save(tmp_path / "e.h5")
    for again in (load(tmp_path / "e.h5"), pickle.loads(pickle.dumps(e))):
        assert np.array_equal(again.load, e.load)
        assert np.array_equal(again.trust(0.07), e.trust(0.07))
        for name, value in e.spectrum.to_dict().items():
            other = getattr(again.spectrum, name)
            assert (other is None) if value is None else np.array_equal(other, value), name
        assert again.summary(details=True) == e.summary(details=True)
        assert again.codes == e.codes
    json.dumps(e.to_dict(), allow_nan=False)
    short = e.to_dict(arrays=False)
    assert "spectrum" not in short or not short["spectrum"]
    assert len(json.dumps(short)) < 20_000


def test_spectrum_of_a_tree_is_the_same(three):
    s = three[1].spectrum
    again = LoadSpectrum.from_dict(s.to_dict())
    assert np.array_equal(again.trust(), s.trust())
    assert again.cross is None


# -- words and pictures -----------------------------------------------------------------------------------------------
def test_summary_says_what_every_user_must_know(beam, three, cross):
    text = beam[1].summary(details=True)
    for word in ("frequency inversion", "N at", "W507", "antiresonances", "share of the lines", "evidence"):
        assert word in text
    assert "kept out s2" in three[1].summary(details=True)
    assert "(N)^2/Hz" in cross.summary(details=True)
    assert "averages 20" in cross.summary(details=True)


def test_picture_leaves_out_what_is_not_trusted(beam):
    c, e = beam
    figure = e.plot(truth=c.truth)
    top, below = figure.axes
    lines = {line.get_label(): np.asarray(line.get_ydata(), float) for line in top.get_lines()}
    shown = lines["estimate, trusted lines"]
    trusted = e.trust()[:, 0]
    assert np.all(np.isnan(shown[~trusted]))
    assert shown[trusted] == pytest.approx(np.abs(e.load[trusted, 0]))
    assert lines["least squares"] == pytest.approx(np.abs(e.spectrum.naive[:, 0]))
    assert lines["least squares"].max() > 30  # the blow-up stands beside it
    assert lines["truth"] == pytest.approx(np.full(797, 10.0))
    labels = [b.get_label() for b in top.collections]
    assert "predicted error above 10%" in labels
    assert "95% band" in labels
    assert below.get_lines()[0].get_ydata() == pytest.approx(e.spectrum.predicted[:, 0])
    assert below.get_xlabel() == "frequency [Hz]"
    assert "forward model not verified" in words(figure)


@pytest.mark.parametrize("kind", ["load", "lines", "response"])
def test_every_picture_of_every_kind_of_data(kind, three, cross, tmp_path):
    for e in (three[1], cross) if kind == "load" else (cross,):
        e.plot(kind, path=tmp_path / "p.png")
        assert (tmp_path / "p.png").stat().st_size > 5000
    with pytest.raises(InputError, match="no frequency lines"):
        impact().plot("lines")


def test_picture_of_one_line(tmp_path):
    c = case(1, 4, 2)
    e = FrequencyInversion(model(c.f, c.H)).estimate(Spectra(c.f, c.Y, noise=c.sigma))
    for kind in ("load", "lines"):
        e.plot(kind, path=tmp_path / "p.png")


def test_report_lists_the_bands(beam, tmp_path):
    _, e = beam
    e.report(tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text("utf-8")
    assert "What every line can tell" in page
    assert in_words(e.spectrum.bands(0)) in page
    assert "W507" in page
    assert page.count("<script") == 1  # its own, held in test_report.py
    assert "What every line can tell" not in impact()._repr_html_()
