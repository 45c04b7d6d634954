"""Coverage of the stated bands against its nominal value; held-out channels against closed truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from loadid import Deconvolution, Noise, Record
from loadid._spellings import folded
from loadid.validate import Coverage, coverage, held_out
from structures import Channel, ImpulseModel, InputError, MatrixModel, MeasuredModel
from tests.structures.impacts import blow, hits

DT = 1 / 1000
N = 120
SIGMA = 0.3


def model(rows=("a", "b", "c"), loads=("p",), samples=N):
    """Impulse responses of decaying sines from one set of poles; every sensor has its own shape."""
    t = np.arange(samples) * DT
    h = np.zeros((samples, len(rows), len(loads)))
    for i, row in enumerate(rows):
        for j, load in enumerate(loads):
            for k, (f, decay) in enumerate(((40, 30), (110, 40), (260, 50))):
                shape = np.cos(ord(row) * (k + 1)) * np.cos(ord(load) * (k + 1))
                h[:, i, j] += shape * np.exp(-decay * t) * np.cos(2 * np.pi * f * t)
    sensors = [Channel(label=r, quantity="acceleration", unit="m/s^2") for r in rows]
    return ImpulseModel(
        h, DT, kind="held", sensors=sensors, loads=[Channel(label=x, quantity="force", unit="N") for x in loads]
    )


class TestCoverage:
    def family(self, **settings):
        """For loads of standard deviation 1: in whitened data the absolute lambda is 1."""
        m = model()
        scale = Deconvolution(m, choice=1.0, noise=SIGMA).estimate(np.ones((N, 3)), DT).choice.scale
        return Deconvolution(
            m, noise=Noise(SIGMA, source="covariance"), **folded(Deconvolution, {"choice": 1.0 / scale, **settings})
        )

    @pytest.mark.parametrize("level", [0.5, 0.95])
    def test_loads_from_the_prior(self, level):
        loads = list(np.random.default_rng(1).standard_normal((16, N)))
        found = coverage(self.family(), loads, DT, noise=SIGMA, draws=16, level=level)
        # the band also holds what regularisation hides of the estimate itself, so it is never too narrow
        assert level - 0.015 < found.share < level + 0.06
        assert (found.level, found.draws) == (level, 16)
        assert f"{level:.0%} band" in str(found)

    def test_fresh_noise_and_a_seed(self):
        loads = np.random.default_rng(1).standard_normal(N)
        shares = [coverage(self.family(), loads, DT, noise=SIGMA, draws=4, seed=s).share for s in (0, 0, 1)]
        assert shares[0] == shares[1] != shares[2]

    def test_understated_noise_is_found_in_the_residual(self):
        """Noise stated fifty times too small: the band follows the residual, and still covers."""
        loads = np.random.default_rng(1).standard_normal(N)
        lam = self.family().choice
        understated = Deconvolution(model(), noise=SIGMA / 50, choice=lam)
        assert coverage(understated, loads, DT, noise=SIGMA, draws=6).share > 0.93

    def test_another_truth(self):
        """Data made by a wrong-gain model are covered less than by the family's own."""
        loads = 20 * np.random.default_rng(1).standard_normal(N)
        h = model().impulse_response(DT, N)
        other = ImpulseModel(1.5 * h, DT, kind="held")
        shares = [coverage(self.family(), loads, DT, noise=SIGMA, draws=4, truth=t).share for t in (None, other)]
        assert shares[1] < shares[0] - 0.2

    def test_draws_go_through_the_loads_in_turn(self):
        said = []
        asked = [np.zeros(N), np.ones((N, 1)), np.full(N, 2.0)]

        class Family:
            model = model()

            def estimate(self, y, dt):
                said.append(float(np.linalg.norm(y - self.model.predict(asked[len(said) % 3], dt))))
                return self

            load, std = np.zeros((N, 1)), np.full((N, 1), 0.6)

        progress = []
        found = coverage(Family(), asked, DT, noise=1e-9, draws=6, progress=lambda f, text: progress.append(f))
        assert max(said) < 1e-6
        assert found.share == pytest.approx(2 / 3)  # the band of +-1.18 holds 0 and 1, and not 2
        assert progress == pytest.approx(np.arange(1, 7) / 6)

    def test_one_history_as_a_plain_list(self):
        loads = np.random.default_rng(1).standard_normal(N)
        found = [coverage(self.family(), g, DT, noise=SIGMA, draws=2).share for g in (loads, loads.tolist(), [loads])]
        assert found[0] == found[1] == found[2]

    @pytest.mark.parametrize(
        ("loads", "settings"),
        [
            (np.ones(N), {"draws": 0}),
            ([], {}),
            (np.ones(N), {"level": 1.0}),
            (np.ones(N), {"level": 0.0}),
            (np.ones((2, 2, 2)), {}),
            (3.0, {}),
            (np.full(N, np.nan), {}),
            (np.ones((N, 2)), {}),
        ],
    )
    def test_refused(self, loads, settings):
        with pytest.raises(InputError):
            coverage(self.family(), loads, DT, noise=SIGMA, **settings)

    def test_silences_w703_only_when_it_held(self):
        y = model().predict(blow(N), DT) + SIGMA * np.random.default_rng(0).standard_normal((N, 3))
        found = coverage(self.family(), blow(N), DT, noise=SIGMA, draws=3)
        assert "W703" in self.family().estimate(y, DT).codes
        assert "W703" not in self.family(coverage=replace(found, share=0.94)).estimate(y, DT).codes
        failed = self.family(coverage=Coverage(0.6, 0.95, 3, "")).estimate(y, DT)
        (flag,) = [f for f in failed.flags if f.code == "LID-W703"]
        assert "60.0%" in flag.message
        assert flag.evidence.value == 0.6
        assert "W703" in self.family(coverage=True).estimate(y, DT).codes


class TestStaticCoverage:
    """Readings y = H g + e with g from a Gaussian prior: the exact posterior covers as stated."""

    H = np.random.default_rng(0).standard_normal((5, 8))

    class Bayes:
        """Posterior mean and std for a prior of unit std, scaled by a factor."""

        def __init__(self, H, sigma, factor=1.0):
            self.model, self.factor = MatrixModel(H), factor
            stacked = np.vstack([H / sigma, np.eye(H.shape[1])])
            self.Q, self.R = np.linalg.qr(stacked)
            self.sigma = sigma

        def estimate(self, y):
            assert y.shape == (len(self.model.H),)
            rhs = np.r_[y / self.sigma, np.zeros(self.R.shape[1])]
            return SimpleNamespace(
                load=np.linalg.solve(self.R, self.Q.T @ rhs),
                std=self.factor * np.linalg.norm(np.linalg.solve(self.R, np.eye(len(self.R))), axis=1),
            )

    @pytest.mark.parametrize(("factor", "share"), [(1.0, 0.95), (0.5, 0.673)])
    def test_draws_from_the_prior(self, factor, share):
        found = coverage(self.Bayes(self.H, SIGMA, factor), lambda rng: rng.standard_normal(8), noise=SIGMA)
        assert found.draws == 2000
        assert found.share == pytest.approx(share, abs=0.01 if factor == 1 else 0.02)

    def test_correlated_noise(self):
        """The same errors, stated as a covariance and left out by whitening."""
        R = 0.2 * np.eye(5) + 0.1
        root = np.linalg.cholesky(R)
        family = self.Bayes(np.linalg.solve(root, self.H), 1.0)
        family.model = MatrixModel(self.H)
        whitened = family.estimate
        family.estimate = lambda y: whitened(np.linalg.solve(root, y))
        found = coverage(family, lambda rng: rng.standard_normal(8), noise=R, draws=1000)
        assert found.share == pytest.approx(0.95, abs=0.012)

    def test_arrays_go_in_turn_and_another_truth_counts(self):
        loads = np.random.default_rng(1).standard_normal((40, 8))
        own, table, other = (
            coverage(self.Bayes(self.H, SIGMA), g, noise=SIGMA, draws=40, truth=t).share
            for g, t in ((list(loads), None), (loads, None), (20 * loads, MatrixModel(1.5 * self.H)))
        )
        assert own == table > 0.9
        assert other < 0.3

    @pytest.mark.parametrize(
        ("loads", "settings"),
        [
            (np.ones(7), {}), (np.ones((2, 3, 8)), {}), (np.full(8, np.nan), {}), ([[1.0], [1.0, 2.0]], {}),
            (lambda rng: np.ones(3), {}), (np.ones(8), {"noise": -1.0}), (np.ones(8), {"noise": np.zeros((5, 5))}),
            (np.ones(8), {"noise": np.nan}),
        ],
    )  # fmt: skip
    def test_refused(self, loads, settings):
        with pytest.raises(InputError):
            coverage(self.Bayes(self.H, SIGMA), loads, **{"noise": SIGMA, "draws": 3, **settings})


class TestHeldOut:
    def made(self, noise=0.01, loads=("p",)):
        """Record of four sensors under a known blow, and its estimate from two of them."""
        g = np.column_stack([blow(N, at=20 + 30 * j) for j in range(len(loads))])
        whole = model(("a", "b", "c", "d"), loads)
        clean = whole.predict(g, DT)
        y = clean + noise * np.random.default_rng(0).standard_normal(clean.shape)
        log = Record(y, DT, whole.sensors)
        return g, log, Deconvolution(model(("a", "b"), loads)).estimate(log)

    def test_predicts_what_was_kept_out(self):
        _, log, estimate = self.made()
        out = held_out(estimate, model(("d", "c")), log)
        assert out.labels == ("d", "c")
        assert out.flags == ()
        h = model(("d", "c")).impulse_response(DT, N)[..., 0]
        expected = np.stack([np.convolve(estimate.load[:, 0], x)[:N] for x in h.T], axis=1)
        assert out.predicted == pytest.approx(expected, abs=1e-9)
        np.testing.assert_array_equal(out.measured, log.select(["d", "c"]).values)
        error = np.linalg.norm(out.predicted - out.measured, axis=0) / np.linalg.norm(out.measured, axis=0)
        assert out.error == pytest.approx(error)
        assert max(out.error) < 0.05

    def test_error_of_a_wrong_model_is_its_gain(self):
        _, log, estimate = self.made(1e-6)
        wrong = ImpulseModel(1.2 * model(("c",)).impulse_response(DT, N), DT, kind="held", sensors=["c"], loads=["p"])
        assert held_out(estimate, wrong, log).error[0] == pytest.approx(0.2, abs=0.01)

    def test_a_shared_channel(self):
        _, log, estimate = self.made()
        (flag,) = held_out(estimate, model(("b", "c")), log).flags
        assert flag.code == "LID-W704"
        assert flag.evidence.value == "b"
        assert "proves nothing" in flag.message

    def test_a_shared_channel_under_another_name(self):
        _, log, estimate = self.made()
        renamed = Record(log.values, DT, ["b", "a", "x", "y"])
        same = ImpulseModel(model(("b",)).impulse_response(DT, N), DT, kind="held", sensors=["x"], loads=["p"])
        assert held_out(estimate, same, renamed).flags == ()
        data = np.column_stack([log.values, log.values[:, 1]])
        copied = Record(data, DT, [*log.labels, "x"])
        assert [f.code for f in held_out(estimate, same, copied).flags] == ["LID-W704"]

    def test_loads_in_another_order(self):
        _, log, estimate = self.made(loads=("p", "q"))
        straight = held_out(estimate, model(("c",), ("p", "q")), log)
        assert held_out(estimate, model(("c",), ("q", "p")), log).predicted == pytest.approx(straight.predicted)
        assert straight.error[0] < 0.1

    def test_a_training_hit(self):
        """A hit that the validation model was made from, and one that the inverting model was made from."""
        tables = hits(3, 2, noise=0.1)
        records = [Record(t, DT, ["F", "a", "b"]) for t in tables]
        first = MeasuredModel.from_hits(records[:2], force="F", responses=["a"])
        second = MeasuredModel.from_hits(records[:2], force="F", responses=["b"])
        used, fresh = (Deconvolution(first).estimate(r) for r in (records[0], records[2]))
        assert "W704" in used.codes
        assert "W704" not in fresh.codes
        assert [f.code for f in held_out(used, second, records[0]).flags] == ["LID-W704"]
        out = held_out(fresh, second, records[2])
        assert out.flags == ()
        assert out.error[0] < 0.05

    def test_refused(self):
        _, log, estimate = self.made()
        c = model(("c",))
        for changed, words in (
            (Record(log.values[:, :2], DT, ["a", "b"]), "no channel"),
            (Record(log.values, 2 * DT, log.channels), "different steps"),
            (Record(np.where(np.arange(N)[:, None] == 9, np.nan, log.values), DT, log.channels), "NaN"),
            (Record(0 * log.values, DT, log.channels), "zero"),
            (Record(log.values, DT, [replace(x, quantity="displacement", unit="m") for x in log.channels]), "unit"),
        ):
            with pytest.raises(InputError, match=words):
                held_out(estimate, c, changed)
        with pytest.raises(InputError, match="time axis"):
            held_out(replace(estimate, axis=replace(estimate.axis, name="frequency")), c, log)


def test_measured_hit_held_out():
    """Force from one accelerometer, the other predicted as well as from the measured force: offsets taken off."""
    from tests.data import measured

    with np.load(measured("hammer_two_hits", "lvm_two_hits.npz")) as file:
        tables = [file[name] - file[name][-512:].mean(axis=0) for name in ("hit1", "hit2")]
    one, two = (Record(table, 1 / 1024, ["F", "m_1", "m_2"]) for table in tables)
    by_good, other = (MeasuredModel.from_hits([one], force="F", responses=[r]) for r in ("m_2", "m_1"))
    estimate = Deconvolution(by_good).estimate(two)
    out = held_out(estimate, other, two)
    assert out.flags == ()
    by_force = held_out(replace(estimate, load=tables[1][:, :1]), other, two)
    assert out.error[0] < 1.1 * by_force.error[0] < 0.1
    assert np.linalg.norm(estimate.load - tables[1][:, :1]) < 0.06 * np.linalg.norm(tables[1][:, 0])
