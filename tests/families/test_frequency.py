"""Loads on lines: units, kinds, coverage with and without errors of the FRF, harmonics, cross spectra, transients."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from loadid import Deconvolution, FrequencyInversion, Penalty, Record, Spectra
from loadid._spellings import folded
from loadid.settings import Noise, Signal
from structures import (
    CrossSpectra,
    ForwardModel,
    FrfModel,
    InputError,
    NotIdentifiable,
    beams,
    cross_spectra,
    damping,
    loads,
    sensors,
)

from ..linecases import BAND95, Case, case, model, normals

RULES = ["gcv", "robust_gcv", "modified_gcv", "upre", "predicted_error", "quasi_optimality", "evidence", "l_curve",
         "discrepancy", "dof_discrepancy", None, 0, 1e-2]  # fmt: skip
ROUNDED = {"l_curve": 1e-6, "discrepancy": 1e-8, "dof_discrepancy": 1e-7}  # flat optima and shallow crossings


def spectra(c: Case, known=True, **more):
    return Spectra(c.f, c.Y, noise=c.sigma if known else None, noise_source="test", **more)


def estimate(c: Case, known=True, *, stated=True, **settings):
    variance = c.variance if stated else None
    return FrequencyInversion(model(c.f, c.H, variance), **folded(FrequencyInversion, settings)).estimate(
        spectra(c, known)
    )


def exactly(c: Case, known=True, **settings):
    """With an FRF that is said to be exact."""
    given = folded(FrequencyInversion, settings)
    return FrequencyInversion(model(c.f, c.H), **given, noise=Noise(frf=0.0)).estimate(spectra(c, known))


def off(found, expected):
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


# -- against dense problems -------------------------------------------------------------------------------------------
def test_least_squares_with_its_std():
    c = case(30, 6, 3)
    e = exactly(c, choice=0)
    for k in range(30):
        assert e.load[k] == pytest.approx(np.linalg.lstsq(c.H[k], c.Y[k], rcond=None)[0], rel=1e-8)
        R = np.linalg.qr(c.H[k], mode="r")
        root = np.linalg.solve(R, np.eye(3))
        assert e.std[k] == pytest.approx(c.sigma * np.linalg.norm(root, axis=1), rel=1e-8)
    assert e.spectrum.naive == pytest.approx(e.load, rel=1e-9)
    assert e.spectrum.naive_std == pytest.approx(e.std, rel=1e-9)
    assert e.residual == pytest.approx(c.Y - np.einsum("ksl,kl->ks", c.H, e.load), abs=1e-9 * np.abs(c.Y).max())


@pytest.mark.parametrize("over", ["line", "band"])
def test_a_given_lambda_is_ridge_regression(over):
    c, size, lam = case(12, 6, 3), np.array([1.0, 10.0, 0.1]), 0.03
    e = exactly(c, choice=lam, over=over, size=size)
    tops = np.array([np.linalg.svd(c.H[k] * size, compute_uv=False)[0] for k in range(12)])
    for k in range(12):
        x = lam * (tops.max() if over == "band" else tops[k])
        rows = np.vstack([c.H[k] * size, x * np.eye(3)])
        z = np.linalg.lstsq(rows, np.concatenate([c.Y[k], np.zeros(3)]), rcond=None)[0]
        assert e.load[k] == pytest.approx(size * z, rel=1e-8)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_truncation_keeps_that_many_singular_values(count):
    c = case(12, 6, 3)
    e = exactly(c, method="tsvd", count=count, size=[1, 1, 1])
    for k in range(12):
        U, s, Vh = np.linalg.svd(c.H[k], full_matrices=False)
        kept = Vh[:count].conj().T @ ((U[:, :count].conj().T @ c.Y[k]) / s[:count])
        assert e.load[k] == pytest.approx(kept, rel=1e-8)


def test_noise_of_each_line_and_sensor_weighs_the_data():
    c = case(30, 6, 3)
    level = c.sigma * np.random.default_rng(0).uniform(0.2, 5, (30, 6))
    e = FrequencyInversion(model(c.f, c.H), choice=0, noise=Noise(frf=0.0)).estimate(Spectra(c.f, c.Y, noise=level))
    for k in range(30):
        w = 1 / level[k]
        assert e.load[k] == pytest.approx(np.linalg.lstsq(c.H[k] * w[:, None], c.Y[k] * w, rcond=None)[0], rel=1e-8)


# -- units ------------------------------------------------------------------------------------------------------------
CHOICES = [(m, c, o) for m in ("tikhonov", "tsvd") for c in RULES for o in ("neighbours", "line", "band")
           if not (m == "tsvd" and c in ("l_curve", "quasi_optimality", "evidence"))]  # fmt: skip


@pytest.mark.parametrize(("method", "choice", "over"), CHOICES)
def test_no_unit_changes_the_loads(method, choice, over):
    """Model and data times 1e-9 and 1e9, a load in another unit, sensors in another order, conjugates, other kinds."""
    c = case(40, 6, 3, error=0.02, seed=3)
    settings = {"method": method, "choice": choice, "over": over}
    needs_level = choice in ("upre", "discrepancy", "dof_discrepancy")
    limit = ROUNDED.get(choice, 1e-10)
    unit, order, w = np.array([1.0, 1e3, 1e-2]), np.array([3, 1, 5, 0, 2, 4]), 2 * np.pi * c.f[:, None, None]
    for stated, known in ((False, True), (True, needs_level)):
        if stated and choice == 0:
            continue  # calibrated lines need not determine the loads

        def ask(size, turn=slice(None), conjugate=False, stated=stated, known=known):
            """FRF times `size`, which the data follow but for what differs between the loads."""
            response = np.broadcast_to(size, c.H.shape)[:, :, 0]
            H, Y, noise = c.H * size, c.Y * response, c.sigma * np.abs(response)
            H, Y = (H.conj(), Y.conj()) if conjugate else (H, Y)
            v = (c.variance * np.abs(size) ** 2)[:, turn] if stated else None
            data = Spectra(c.f, Y[:, turn], noise=noise[:, turn] if known else None)
            return FrequencyInversion(model(c.f, H[:, turn], v), **folded(FrequencyInversion, settings)).estimate(data)

        base = ask(np.ones(3))
        small, large = ask(1e-9 * np.ones(3), order), ask(1e9 * np.ones(3), conjugate=True)
        changed = ask(1 / unit)
        for found in (small.load, large.load.conj(), changed.load / unit):
            assert off(found, base.load) < limit
        for found in (small.std, large.std, changed.std / unit):
            assert off(found, base.std) < limit
        assert np.array_equal(small.trust(), base.trust())
        if known:
            mobility = ask(1 / (1j * w) * np.ones(3))
            assert off(mobility.load, base.load) < limit
            assert off(mobility.std, base.std) < limit


def test_a_range_of_twelve_decades_over_the_lines():
    c = case(100, 6, 3)
    size = 10.0 ** np.linspace(-6, 6, 100)
    data = Spectra(c.f, c.Y * size[:, None], noise=np.tile(c.sigma * size[:, None], (1, 6)))
    e = FrequencyInversion(model(c.f, c.H * size[:, None, None])).estimate(data)
    assert off(e.load, estimate(c).load) < 1e-10


# -- coverage ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("error", [0.0, 0.02, 0.10])
@pytest.mark.parametrize("kind", ["random", "harmonic", "flat"])
def test_the_band_covers_the_truth(kind, error, known):
    """The 95 % band over all lines; of a flat spectrum, whose phases repeat, over those that are trusted."""
    inside = []
    for seed in range(3):
        truth = normals(np.random.default_rng(seed), 600, 3)
        if kind == "harmonic":
            truth[200] *= 30
        if kind == "flat":
            truth = truth[:1] / np.abs(truth[:1]) * np.ones((600, 1))
        c = case(600, 8, 3, seed=seed, truth=truth, error=error)
        e = estimate(c, known) if error else exactly(c, known)
        where = e.trust() if kind == "flat" else np.ones((600, 3), bool)
        inside.append(c.inside(e)[where])
    assert 0.925 < np.mean(np.concatenate(inside)) < 0.975


def test_noise_alone_understates_what_errors_of_the_frf_do():
    """As many loads as sensors: the data cannot show by themselves that the lines do not fit."""
    covered = {}
    for stated in (True, False):
        found = []
        for seed in range(3):
            c = case(600, 3, 3, seed=seed, error=0.05, noise=0.003)
            found.append(c.inside(estimate(c) if stated else exactly(c)).mean())
        covered[stated] = np.mean(found)
    assert covered[True] > 0.925
    assert covered[False] < 0.5


def test_calibration_undoes_the_attenuation(monkeypatch):
    """Of two close loads under large errors of the FRF: without it the band does not cover."""
    from loadid._families.posing import fitting

    def covered():
        found = []
        for seed in range(4):
            c = case(400, 8, 3, seed=seed, error=0.1)
            found.append(c.inside(estimate(c)).mean())
        return np.mean(found)

    with_it = covered()
    monkeypatch.setattr(fitting, "calibrated", lambda lines, size: (lines, lambda second: np.ones(len(second))))
    assert 0.925 < with_it < 0.98
    assert covered() < with_it - 0.01


def test_std_of_each_line_is_the_scatter_over_draws():
    c = case(60, 6, 2, noise=0.05)
    rng = np.random.default_rng(9)
    clean = np.einsum("ksl,kl->ks", c.H, c.truth)
    errors, stated = [], []
    for _ in range(60):
        Y = clean + c.sigma * normals(rng, *clean.shape)
        e = FrequencyInversion(model(c.f, c.H), noise=Noise(frf=0.0)).estimate(Spectra(c.f, Y, noise=c.sigma))
        errors.append(np.abs(e.spectrum.naive - c.truth) ** 2)
        stated.append(e.spectrum.naive_std**2)
    ratio = np.sqrt(np.mean(stated, axis=0) / np.mean(errors, axis=0))
    assert np.median(ratio) == pytest.approx(1, abs=0.05)
    assert np.quantile(ratio, [0.05, 0.95]) == pytest.approx([1, 1], abs=0.25)


# -- loads of all sorts -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("background", [0.0, 0.03])
def test_harmonics_in_silence_are_not_shrunk(background, known):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = background * normals(rng, 300, 2)
        tones = [50, 150, 250]
        truth[tones, 0] = 10
        loud = case(300, 6, 2, seed=seed, truth=truth, noise=0)
        quiet = 0.02 * np.sqrt(np.mean(np.abs(loud.Y[tones]) ** 2, axis=1)).min()
        c = case(300, 6, 2, seed=seed, truth=truth, quiet=quiet)
        e = estimate(c, known)
        assert np.abs(e.load[tones, 0]) == pytest.approx([10, 10, 10], rel=0.15)
        assert np.all(np.abs(e.load[tones, 0] - 10) < 4 * e.std[tones, 0])
        assert np.all(e.spectrum.expected[tones, 0] > 3)


@pytest.mark.parametrize("known", [True, False])
def test_harmonics_under_errors_of_the_frf(known):
    worst = []
    for seed in range(4):
        truth = normals(np.random.default_rng(seed), 400, 3)
        truth[133] *= 10**1.5
        c = case(400, 8, 3, seed=seed, truth=truth, error=0.02)
        e = estimate(c, known)
        worst.append(np.max(np.abs(e.load - truth)[133] / e.std[133]))
    assert np.max(worst) < 4


def test_a_silent_load_vanishes_and_is_not_trusted():
    truth = normals(np.random.default_rng(2), 400, 3)
    truth[:, 2] = 0
    c = case(400, 8, 3, truth=truth)
    e = estimate(c, known=False)
    plain = estimate(c, known=False, choice=0)
    assert np.linalg.norm(e.load[:, 2]) < 0.2 * np.linalg.norm(plain.load[:, 2])
    assert not e.trust()[:, 2].any()
    assert c.inside(e)[:, 2].mean() > 0.95


def test_more_loads_than_sensors():
    c = case(200, 2, 3)
    for known in (True, False):
        e = estimate(c, known)
        assert "W201" in e.codes
        assert not e.trust().any()
        assert 0.9 < c.inside(e).mean() <= 1
    with pytest.raises(NotIdentifiable, match="do not determine"):
        estimate(c, choice=0)


# -- sensors ----------------------------------------------------------------------------------------------------------
def test_held_out_sensors_keep_their_columns_and_their_noise():
    c = case(100, 6, 3)
    level = c.sigma * np.arange(1, 7)
    Y = np.einsum("ksl,kl->ks", c.H, c.truth) + level * normals(np.random.default_rng(3), 100, 6)
    m, names = model(c.f, c.H), [f"s{i}" for i in range(6)]
    base = FrequencyInversion(m, sensors=[0, 2, 3, 4, 5], noise=level[[0, 2, 3, 4, 5]]).estimate(Spectra(c.f, Y))
    turned = {"values": Y[:, ::-1], "channels": names[::-1]}
    for e in (
        FrequencyInversion(m, validation=["s1"], noise=level).estimate(Spectra(c.f, Y)),
        FrequencyInversion(m, validation=[1]).estimate(Spectra(c.f, Y, noise=level)),
        FrequencyInversion(m, validation=["s1"]).estimate(Spectra(c.f, noise=level[::-1], **turned)),
        FrequencyInversion(m, validation=["s1"]).estimate(Spectra(c.f, noise=np.tile(level[::-1], (100, 1)), **turned)),
        FrequencyInversion(m, sensors=[0, 2, 3, 4, 5]).estimate(Spectra(c.f, noise=level[::-1], **turned)),
    ):
        assert e.load == pytest.approx(base.load, rel=1e-10)
        assert e.std == pytest.approx(base.std, rel=1e-10)
        if "held_out" in e.facts:
            made = np.einsum("kl,kl->k", c.H[:, 1], e.load)
            error = np.linalg.norm(Y[:, 1] - made) / np.linalg.norm(Y[:, 1])
            assert e.facts["held_out"] == [f"s1 {error:.2%}"]
    assert error < 0.5


# -- cross spectra ----------------------------------------------------------------------------------------------------
MIX = np.array([[2, 0, 0], [1 + 1j, 1, 0], [0, 0.5j, 0.5]])
POWER = MIX @ MIX.conj().T


def averaged(c: Case, averages: int, rng, mix=MIX):
    """Cross spectra of `averages` independent draws of loads with the spectrum ``mix mix^H``."""
    g = normals(rng, len(c.f), averages, 3) @ mix.T
    y = np.einsum("ksl,knl->kns", c.H, g) + c.sigma * normals(rng, len(c.f), averages, c.H.shape[1])
    S = np.einsum("kni,knj->kij", y, y.conj()) / averages
    return CrossSpectra(frequencies=c.f, matrix=(S + S.conj().swapaxes(1, 2)) / 2, averages=float(averages),
                        channels=model(c.f, c.H).sensors, window="hann", bandwidth=1.0)  # fmt: skip


@pytest.mark.parametrize(("averages", "known"), [(10, True), (100, False), (1000, True)])
def test_cross_spectra_of_correlated_loads(averages, known):
    """Bias, phase between the loads, and the std against the scatter over draws; where nothing is told, no less."""
    c, rng = case(150, 6, 3), np.random.default_rng(7)
    family = FrequencyInversion(model(c.f, c.H), noise=Noise(c.sigma if known else None, frf=0.0))
    found = [family.estimate(averaged(c, averages, rng)) for _ in range(8)]
    load, std, cross = (np.array(v) for v in zip(*((e.load, e.std, e.spectrum.cross) for e in found), strict=True))
    truth = np.diag(POWER).real
    trust = found[0].trust()
    ratio = np.sqrt(np.mean(std**2, axis=0) / np.mean((load - truth) ** 2, axis=0))
    for j in range(3):
        assert np.mean(load[:, trust[:, j], j]) == pytest.approx(truth[j], rel=0.03)
        assert np.median(ratio[trust[:, j], j]) == pytest.approx(1.03, abs=0.12)
        lost = ~trust[:, j]
        assert np.mean(std[:, lost, j] ** 2) > 0.6 * np.mean((load[:, lost, j] - truth[j]) ** 2)
    told = trust.all(axis=1)
    assert np.mean(cross[:, told], axis=(0, 1)) == pytest.approx(POWER, abs=0.1)
    assert found[0].units == ("(N)^2/Hz",) * 3
    S = found[0].spectrum.cross
    assert pytest.approx(S.conj().swapaxes(1, 2), abs=1e-12 * np.abs(S).max()) == S
    assert np.all(np.linalg.eigvalsh(S)[:, 0] > -1e-9 * np.abs(S).max())


def test_cross_spectra_keep_the_power_of_what_a_line_does_not_tell():
    """Of loads that do not know of each other: nothing is shrunk, on lines that are trusted or not."""
    c, size = case(150, 6, 3), np.array([2.0, 1.0, 0.5])
    e = FrequencyInversion(model(c.f, c.H)).estimate(averaged(c, 200, np.random.default_rng(3), np.diag(size)))
    low = c.f < 60
    assert not e.trust()[low].all()
    assert np.mean(e.load, axis=0) == pytest.approx(size**2, rel=0.1)
    share = np.mean(e.load[low], axis=0) / size**2
    assert np.all((share > 0.7) & (share < 2))


def test_cross_spectra_that_no_response_has_are_refused():
    c = case(20, 6, 3)
    good = averaged(c, 20, np.random.default_rng(0))
    S = np.array(good.matrix)
    ring = np.eye(6) - 0.9 * (np.eye(6, k=1) + np.eye(6, k=-1))  # coherences below one, yet a negative eigenvalue
    size = np.sqrt(np.einsum("kss->ks", S).real)
    bad = CrossSpectra(frequencies=c.f, matrix=size[:, :, None] * size[:, None, :] * ring, channels=good.channels,
                       averages=20.0)  # fmt: skip
    with pytest.raises(InputError, match="negative eigenvalue"):
        FrequencyInversion(model(c.f, c.H)).estimate(bad)


# -- records ----------------------------------------------------------------------------------------------------------
DT = 1e-3


@pytest.fixture(scope="module")
def beam():
    structure = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=20,
        damping=damping.Modal(0.03),
    )  # fmt: skip
    seen = [sensors.Accelerometer(at=x, direction="Z", label=f"s{i}") for i, x in enumerate([0.3, 0.5, 0.8, 1.1, 1.5])]
    pushed = [loads.Point(at=x, direction="Z", label=f"p{i}") for i, x in enumerate([0.65, 1.25])]
    return ForwardModel(structure, seen, pushed, modes=5)


def answered(beam, g, sigma, seed=0):
    """Noisy response (samples, sensors) to loads (samples, loads)."""
    from scipy.signal import fftconvolve

    h = beam.impulse_response(DT, min(len(g), 4000))
    y = sum(fftconvolve(h[:, :, j], g[:, j, None], axes=0)[: len(g)] for j in range(2))
    return y + sigma * np.random.default_rng(seed).standard_normal(y.shape)


def hits(samples):
    g, pulse = np.zeros((samples, 2)), np.sin(np.pi * np.arange(11) / 10)
    g[300:311, 0], g[500:511, 1] = 100 * pulse, -60 * pulse
    return g


def test_a_transient_is_found_as_in_the_time_domain(beam):
    g = hits(2500)
    y = answered(beam, g, 0.3)
    e = FrequencyInversion(beam, signal="transient", noise=0.3).estimate(y, DT)
    time = Deconvolution(beam, penalty=Penalty(variance="constant"), noise=0.3).estimate(y, DT)
    assert e.axis.name == "time"
    assert e.units == ("N", "N")
    for j in range(2):
        error, other = (np.linalg.norm(f.load[:, j] - g[:, j]) for f in (e, time))
        assert error < 1.1 * other
        assert error < 0.3 * np.linalg.norm(g[:, j])
        assert np.mean(np.abs(e.load[:, j] - g[:, j]) < 1.96 * e.std[:, j]) > 0.9
    assert "W508" not in e.codes


def test_peak_and_impulse_of_a_hit_are_within_their_std(beam):
    """What the lowest lines do not tell is missing at the pulse, not evenly over the record."""
    g, far = hits(2500), []
    clean = answered(beam, g, 0.0)
    for seed in range(8):
        y = clean + 0.3 * np.random.default_rng(seed).standard_normal(clean.shape)
        e = FrequencyInversion(beam, signal="transient", noise=0.3).estimate(y, DT)
        for j, (peak, window) in enumerate(zip(e.peaks, ((0.285, 0.333), (0.485, 0.533)), strict=True)):
            impulse = e.functional("impulse", load=j, window=window)
            far += [(peak.value - g[peak.index, j]) / peak.std, (impulse.value - g[:, j].sum() * DT) / impulse.std]
            quiet = e.std[1500:, j]
            assert np.all(quiet < 0.5 * peak.std)  # and not smeared over what follows
    assert np.sqrt(np.mean(np.square(far))) < 1.6
    assert np.max(np.abs(far)) < 3


def test_records_become_cross_spectra(beam):
    """The spectrum that the loads had in the same segments; two halves are as good; a held-out sensor is predicted."""
    L, segment = np.array([[3, 0], [1, 2.0]]), 4000
    g = np.random.default_rng(1).standard_normal((44_000, 2)) @ L.T
    y = answered(beam, g, 0.05)[4000:]
    f = np.fft.rfftfreq(segment, DT)
    sampled = np.fft.rfft(beam.impulse_response(DT, segment), axis=0)[1:]
    table = FrfModel(f[1:], sampled, sensors=beam.sensors, loads=beam.loads)
    settings = {"signal": Signal("stationary", segment=segment), "noise": 0.05, "band": (20.0, 400.0)}
    e = FrequencyInversion(table, validation=["s3"], **settings).estimate(y, DT)
    truth = cross_spectra(g[4000:], DT, segment=segment).lines((f >= 20) & (f <= 400)).matrix
    trust = e.trust()
    for j in range(2):
        assert trust[:, j].mean() > 0.2
        assert e.load[trust[:, j], j] == pytest.approx(truth[trust[:, j], j, j].real, rel=0.3)
        assert np.mean(e.load[trust[:, j], j]) == pytest.approx(np.mean(truth[trust[:, j], j, j].real), rel=0.02)
    both = trust.all(axis=1)
    assert np.mean(e.spectrum.cross[both, 1, 0]) == pytest.approx(np.mean(truth[both, 1, 0]), rel=0.05)
    assert float(e.facts["held_out"][0].split()[1].rstrip("%")) < 15
    halves = [Record(part, DT, beam.sensors) for part in (y[:20_000], y[20_000:])]
    twice = FrequencyInversion(table, **settings).estimate(halves)
    whole = FrequencyInversion(table, **settings).estimate(y, DT)
    assert twice.facts["averages"] == pytest.approx(whole.facts["averages"], rel=0.15)
    assert np.mean(twice.load[trust] / whole.load[trust]) == pytest.approx(1, abs=0.05)
    averaged = cross_spectra(y, DT, channels=beam.sensors, segment=segment)
    own = FrequencyInversion(table, band=(20, 400), noise=0.05 * np.sqrt(2 * DT)).estimate(averaged)
    assert own.load == pytest.approx(whole.load, rel=1e-9)


# -- edges ------------------------------------------------------------------------------------------------------------
SIZES = [(2, 6, 3), (12, 2, 3), (1, 1, 1)]


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_every_combination_answers_or_says_why_not(size):
    lines, seen, pushed = size
    for (method, choice, over), known in itertools.product(CHOICES, (True, False)):
        c = case(lines, seen, pushed)
        if choice == 0 and seen < pushed:
            continue  # refused, see above
        try:
            e = estimate(c, known, method=method, choice=choice, over=over, neighbours=500)
        except InputError as why:
            silent = not known and choice in ("upre", "discrepancy", "dof_discrepancy")
            if silent or over == "band":
                continue  # no level, or no optimum on so few lines
            raise AssertionError((method, choice, over, known)) from why
        assert e.load.shape == e.std.shape == (lines, pushed)
        assert np.all(np.isfinite(e.spectrum.std))


DEAD = {"one line": lambda H: H * (np.arange(40) != 7)[:, None, None],
        "one load": lambda H: H * [1, 0, 1],
        "alike": lambda H: H[:, :, [0, 1, 0]],
        "one sensor": lambda H: H * (np.arange(6) != 2)[:, None]}  # fmt: skip


@pytest.mark.parametrize("name", DEAD)
@pytest.mark.parametrize("choice", [None, "gcv", "discrepancy", 1e-2])
def test_lines_that_lose_rank_are_flagged_and_finite(name, choice):
    c = case(40, 6, 3)
    H = DEAD[name](c.H)
    Y = np.einsum("ksl,kl->ks", H, c.truth) + c.sigma * normals(np.random.default_rng(0), 40, 6)
    e = FrequencyInversion(model(c.f, H), choice=choice).estimate(Spectra(c.f, Y, noise=c.sigma))
    lost = {"one line": (7, slice(None)), "one load": (slice(None), 1), "alike": (slice(None), [0, 2])}.get(name)
    if lost is not None:
        assert not e.trust()[lost].any()
        assert "W507" in e.codes
        assert np.all(np.isinf(e.spectrum.naive_std[lost]))
    assert np.all(e.std < 1e6)


def test_variance_of_some_entries_alone():
    c = case(200, 6, 3, error=0.05)
    some = np.where(np.random.default_rng(0).random(c.H.shape) < 0.5, c.variance, 0.0)
    for variance in (some, 1e-30 * c.variance, np.zeros_like(some)):
        e = FrequencyInversion(model(c.f, c.H, variance)).estimate(spectra(c))
        assert np.all(np.isfinite(e.load))
    plain = FrequencyInversion(model(c.f, c.H)).estimate(spectra(c))
    assert e.load == pytest.approx(plain.load, rel=1e-12)
    with pytest.raises(NotIdentifiable, match="larger than the FRF"):
        FrequencyInversion(model(c.f, c.H, 1e4 * np.abs(c.H) ** 2)).estimate(spectra(c))


def test_silence():
    c = case(40, 6, 3)
    e = FrequencyInversion(model(c.f, c.H)).estimate(Spectra(c.f, 0 * c.Y, noise=c.sigma))
    assert not np.any(e.load)
    assert not e.trust().any()
    with pytest.raises(InputError, match="zero throughout"):
        FrequencyInversion(model(c.f, c.H)).estimate(Spectra(c.f, 0 * c.Y))


BAD = [
    ({"method": "pinv"}, "method"), ({"over": "all"}, "over"), ({"neighbours": -1}, "neighbours"),
    ({"neighbours": 2.5}, "neighbours"), ({"count": 2}, "count"), ({"method": "tsvd", "count": 0}, "count"),
    ({"choice": "guess"}, "choice"), ({"choice": -1.0}, "choice"), ({"choice": np.nan}, "choice"),
    ({"choice": True}, "choice"), ({"level": 0}, "level"), ({"size": [1, 2, 3]}, "size"),
    ({"choice": "gcv", "size": [1, 2]}, "size"), ({"choice": "gcv", "size": [1, 0, 2]}, "size"),
    ({"band": (500.0, 600.0)}, "band"), ({"band": (100.0, 50.0)}, "band"), ({"band": "low"}, "band"),
    ({"band": (1.0,)}, "band"), ({"noise": 0.0}, "noise"), ({"noise": np.ones(4)}, "noise"),
    ({"noise": "loud"}, "noise"), ({"validation": ["s9"]}, "sensor"), ({"validation": range(6)}, "validation"),
    ({"sensors": ["s0", "s1"], "validation": ["s1"]}, "validation"),
]  # fmt: skip


@pytest.mark.parametrize(("settings", "where"), BAD, ids=str)
def test_settings_that_do_not_fit(settings, where):
    c = case(20, 6, 3)
    with pytest.raises(InputError, match=where):
        FrequencyInversion(model(c.f, c.H), **folded(FrequencyInversion, settings)).estimate(spectra(c))


def test_data_that_do_not_fit(beam):
    c = case(20, 6, 3)
    family = FrequencyInversion(model(c.f, c.H))
    names = [f"s{i}" for i in range(5)]
    for data, words in (
        (Spectra(c.f + 0.01, c.Y), "no line of the table"),
        (Spectra(c.f, c.Y[:, :5]), "no channel for a sensor"),
        (Spectra(c.f, c.Y[:, :5], channels=names), "s5"),
        (c.Y, "Spectra"),
        ("spectra", "Spectra"),
    ):
        with pytest.raises(InputError, match=words):
            family.estimate(data)
    e = family.estimate(Spectra(c.f[::2], c.Y[::2]))  # some of the lines will do
    assert len(e.load) == 10
    with pytest.raises(InputError, match="transient"):
        FrequencyInversion(beam).estimate(np.ones((100, 5)), DT)
    with pytest.raises(InputError, match="averaged"):
        FrequencyInversion(beam, signal="transient").estimate([Record(np.ones((100, 5)), DT, beam.sensors)])
    with pytest.raises(InputError, match="lines of the table"):
        FrequencyInversion(family.model, signal="transient").estimate(np.ones((100, 6)), DT)


@pytest.mark.parametrize(
    ("frequencies", "values", "more", "words"),
    [
        ([1, 2], np.ones((3, 2)), {}, "do not fit"),
        ([1, 2, 3], np.ones((2, 3)), {}, "transpose"),
        ([2, 1], np.ones((2, 2)), {}, "ascending"),
        ([1, 1], np.ones((2, 2)), {}, "ascending"),
        ([-1, 1], np.ones((2, 2)), {}, "negative"),
        (["a", "b"], np.ones((2, 2)), {}, "frequency lines"),
        ([1, 2], [[1, np.nan], [1, 1]], {}, "NaN"),
        ([1, 2], [["a", "b"], ["c", "d"]], {}, "no numbers"),
        ([1, 2], np.ones((2, 2)), {"noise": 0}, "found: 0"),
        ([1, 2], np.ones((2, 2)), {"noise": "x"}, "real number"),
        ([1, 2], np.ones((2, 2)), {"noise": [1, 2, 3]}, "noise"),
        ([1, 2], np.ones((2, 2)), {"channels": ["a", "a"]}, "different names"),
    ],
)
def test_spectra_that_are_none(frequencies, values, more, words):
    with pytest.raises(InputError, match=words):
        Spectra(frequencies, values, **more)


def test_accelerance_at_zero_hertz_tells_nothing():
    c = case(40, 6, 3)
    f, H = c.f - c.f[0], c.H * (c.f > c.f[0])[:, None, None]
    e = FrequencyInversion(FrfModel(f, H, sensors=model(c.f, H).sensors, loads=model(c.f, H).loads)).estimate(
        Spectra(f, c.Y * (f > 0)[:, None] + c.sigma * (f == 0)[:, None], noise=c.sigma)
    )
    assert not e.trust()[0].any()
    assert e.spectrum.bands(0)[0][0] == 0.0


def test_a_conjugate_frf_is_flagged_in_the_estimate():
    f = np.linspace(1, 200, 400)
    w, own = 2 * np.pi * f, 2 * np.pi * 60
    H = -(w**2) / (own**2 - w**2 + 2j * 0.02 * own * w)
    for value, flagged in ((H, False), (H.conj(), True)):
        m = FrfModel.from_frf(f, value, kind="accelerance", sensors=["a"], loads=["p"])
        e = FrequencyInversion(m).estimate(Spectra(f, 3 * value[:, None], noise=0.01))
        assert ("W207" in e.codes) is flagged


def test_levels_of_trust_are_nested():
    c = case(200, 6, 3)
    e = estimate(c)
    low, high = e.trust(0.05), e.trust(0.5)
    assert np.all(high[low])
    assert low.sum() < e.trust().sum() < high.sum()
    error = np.abs(e.spectrum.naive - c.truth) / e.spectrum.expected
    assert np.mean(error[e.trust()] < BAND95 * 0.1) > 0.95
