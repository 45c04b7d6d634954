"""The case studies, pinned: the figures that the README and the reports quote."""

import numpy as np
import pytest

from case_studies import contact_inversion, hammer_log, impact_plate, wing_gauges
from loadid import Absolute, StaticInversion

from .data import measured


@pytest.fixture(scope="module")
def hits():
    measured("hammer_five_hits", "measurements_1.npy")
    return hammer_log.five_hits()


@pytest.fixture(scope="module")
def both():
    measured("hammer_two_hits", "long_single_header_multi_ch.lvm")
    return hammer_log.two_hits()


@pytest.fixture(scope="module")
def rows():
    return impact_plate.table(0.01, seeds=20)


class TestFiveHits:
    def test_whole_record(self, hits):
        errors = [h.error() for h in hits]
        assert np.mean(errors) <= 0.035
        assert max(errors) <= 0.044
        assert all(h.estimate.facts["variance"] == "local" for h in hits)

    def test_first_samples(self, hits):
        assert max(h.error(slice(80)) for h in hits) <= 0.015

    def test_peak(self, hits):
        assert max(abs(h.peak_error) for h in hits) <= 0.01

    def test_band(self, hits):
        assert np.mean([h.covered for h in hits]) >= 0.90
        std = [h.estimate.std[h.peak, 0] / h.estimate.load[h.peak, 0] for h in hits]
        assert max(std) <= 0.025  # the hits themselves scatter by 1.0 to 1.5 %

    def test_verified_by_the_hits_themselves(self, hits):
        assert all("W114" not in h.estimate.codes for h in hits)
        assert "each predicted from the others" in hits[0].estimate.verified


class TestOtherPriors:
    def test_few_short_pulses_come_close_on_a_hit(self, hits):
        others = hammer_log.under_other_priors((1,), signs=False)
        ((few, _),) = others
        assert few.error() <= 0.05
        assert few.error() < 1.3 * hits[0].error()
        assert few.error(slice(80)) <= 0.03
        assert few.estimate.facts["gap"] <= 1e-6
        assert "few B-splines" in hammer_log.priors(hits[:1], others)


class TestTwoHits:
    def test_both_sensors(self, both):
        assert max(hit.error(hit.around()) for hit in both) <= 0.02
        assert max(hit.error(offset=hit.offset) for hit in both) <= 0.08
        assert all(hit.covered >= 0.8 for hit in both)

    def test_the_poor_sensor_does_not_hurt(self, both):
        """Both sensors are as good as the good one alone, within a tenth."""
        alone = hammer_log.two_hits(("m_2",))
        total = [sum(h.error(h.around()) for h in hits) for hits in (both, alone)]
        assert total[0] <= 1.1 * total[1]
        poor = hammer_log.two_hits(("m_1",))
        assert min(h.error(h.around()) for h in poor) > 0.1

    def test_weights_are_stated(self, both):
        assert "roughness" in both[0].estimate.choice.sigma_source

    def test_picture(self, both, tmp_path):
        measured("hammer_five_hits", "measurements_1.npy")
        hammer_log.picture(tmp_path / "x.png", both, both)
        assert (tmp_path / "x.png").stat().st_size > 10_000


class TestImpactPlate:
    def test_default_is_near_the_best_lambda(self, rows):
        assert max(r.ratio["default"] for r in rows) <= 1.20

    def test_the_best_lambda_is_that_of_the_published_set_up(self, rows):
        """Oracle errors of a dense reference calculation of the same set-up."""
        assert [r.best for r in rows] == pytest.approx([0.191, 0.233, 0.070, 0.092, 0.067, 0.128], rel=0.05)

    def test_strain_beats_displacement(self, rows):
        displacement, strain = rows[:2], rows[2:4]
        assert min(r.best for r in displacement) > 2 * max(r.best for r in strain)

    def test_rules_disagree_for_displacement_and_not_their_loads(self, rows):
        """Decades apart where lambda hardly changes the load: the default is near the best, and nothing is raised."""
        assert all(r.spread > 1 and r.flagged < 0.2 and r.ratio["default"] < 1.3 for r in rows[:2])

    def test_no_choice_of_lambda_is_no_solution(self):
        """The unregularised solution is worthless."""
        plate, g = impact_plate.model("displacement", 0.0), impact_plate.force()
        y = plate.predict(g, impact_plate.DT)
        y = y + 0.01 * np.linalg.norm(y) / np.sqrt(len(y)) * np.random.default_rng(0).standard_normal(y.shape)
        from loadid import Deconvolution, NotIdentifiable

        with pytest.raises(NotIdentifiable):
            Deconvolution(plate, penalty=None).estimate(y, dt=impact_plate.DT)

    def test_picture(self, tmp_path):
        impact_plate.picture(tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 10_000


# -- contact on a compliant surface -----------------------------------------------------------------------------------
def ridge(H: np.ndarray, y: np.ndarray, lam: float) -> np.ndarray:
    """Standard-form Tikhonov with an absolute lambda, written out: independent of the package."""
    augmented = np.vstack([H, lam * np.eye(H.shape[1])])
    return np.linalg.lstsq(augmented, np.r_[y, np.zeros(H.shape[1])], rcond=None)[0]


@pytest.fixture(scope="module")
def contact():
    return contact_inversion.table(0.1, "bumps", "every node", seeds=3)


class TestContactText:
    """The worked example of the theory: 48 nodes, Lorentzian kernel, two bumps."""

    x = contact_inversion.nodes()
    p = contact_inversion.bumps(x)

    def kernel(self, t):
        return contact_inversion.kernel(t, self.x, self.x)

    def test_singular_values(self):
        s = np.linalg.svd(self.kernel(0.1), compute_uv=False)
        assert s[0] == pytest.approx(0.81, abs=0.005)
        assert s[-1] == pytest.approx(6.0e-7, rel=0.01)
        assert s[0] / s[-1] == pytest.approx(1.4e6, rel=0.03)

    def test_two_clean_peaks_without_noise_in_a_thick_layer(self):
        H = self.kernel(0.3)
        family = StaticInversion(H, choice=Absolute(1e-6), noise=1.0)
        load = family.estimate(H @ self.p).load
        np.testing.assert_allclose(load, ridge(H, H @ self.p, 1e-6), atol=1e-6)
        assert load[:24].max() == pytest.approx(0.84, abs=0.06)
        assert load[24:].max() == pytest.approx(0.84, abs=0.06)
        assert load[23:25].max() < 0.2

    def test_past_any_functional(self):
        H = self.kernel(0.3)
        load = StaticInversion(H, choice=Absolute(1.0), noise=1.0).estimate(H @ self.p).load
        resultant, pressure = contact_inversion.errors(load, self.p)
        assert resultant == pytest.approx(0.70, abs=0.03)
        assert pressure == pytest.approx(0.30, abs=0.03)

    def test_occlusion_hurts_while_the_condition_number_falls(self):
        H = self.kernel(0.1)
        keep = np.abs(self.x - 0.5) > 0.2
        seen, hidden = [], []
        for seed in range(20):
            y = H @ self.p
            y = y + 0.01 * np.sqrt(np.mean(y**2)) * np.random.default_rng(seed).standard_normal(48)
            for rows, errors in ((np.full(48, True), seen), (keep, hidden)):
                load = StaticInversion(H[rows], choice=Absolute(1e-3), noise=1.0).estimate(y[rows]).load
                errors.append(contact_inversion.errors(load, self.p)[0])
        assert 5 <= np.median(hidden) / np.median(seen) <= 30
        s, t = (np.linalg.svd(A, compute_uv=False) for A in (H, H[keep]))
        assert t[0] / t[-1] < s[0] / s[-1]
        family = StaticInversion(H, sensors=[int(i) for i in np.flatnonzero(keep)], choice=1e-3, noise=1.0)
        assert "W202" in family.estimate((H @ self.p)[keep]).codes

    def test_constraints_sharpen_the_map(self, contact):
        rows = {r.method: r for r in contact}
        assert rows["least squares"].map > 10  # worthless
        plain = rows["Tikhonov, L = I"]
        assert plain.map < 0.12
        assert plain.resultant < 0.02
        assert rows["L = I, p >= 0"].map < plain.map
        assert rows["first difference, p >= 0, force plate"].map < plain.map
        assert rows["L = I, resultant"].resultant < 1e-9
        assert all(r.resultant < r.map for name, r in rows.items() if name != "least squares")

    def test_picture(self, contact, tmp_path):
        contact_inversion.figure(contact, contact_inversion.truth(contact_inversion.bumps), tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 10_000


# -- lift of a wing ---------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def wing():
    return {r.method: r for r in wing_gauges.table(5)}


class TestWing:
    def test_resultants_are_right_long_before_the_distribution(self, wing):
        for name in ("24 patches, gradient", "24 patches, Laplacian", "polynomials to degree 4"):
            row = wing[name]
            assert row.moment < 0.01
            assert row.shear < 0.05
            assert 2 * row.shear < row.distribution < 0.20

    def test_the_band_holds_the_distribution_under_a_smoothness_prior(self, wing):
        assert all(wing[f"24 patches, {x}"].covered > 0.85 for x in ("gradient", "Laplacian"))

    def test_the_model_error_is_seen(self, wing):
        """The stiffened bay that the model does not know shows itself above the noise of the gauges."""
        assert "W406" in wing["24 patches, gradient"].estimate.codes

    def test_both_levels_are_reached_and_said(self, wing):
        row = wing["24 patches, gradient"]
        assert row.validation.level == "distribution"
        assert not row.validation.partial
        assert "level: distribution" in row.estimate.summary(details=True)
        assert len(row.validation.table().splitlines()) == 3

    def test_picture(self, wing, tmp_path):
        wing_gauges.figure(list(wing.values()), tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 10_000
