"""Layouts judged and chosen: against dense formulas, full enumeration, symmetry and scaling."""

import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loadid import InputError, design
from loadid.design import _layout as search
from structures import Channel, ForwardModel, MatrixModel, beams, loads, sensors


def dense(A):
    """Log det and posterior std over amplitude, by the formula with the precision matrix."""
    precision = np.eye(A.shape[1]) + np.einsum("ki,kj->ij", A, A)
    return np.linalg.slogdet(precision)[1], np.sqrt(np.diag(np.linalg.solve(precision, np.eye(len(precision)))))


def lorentz(m, n, t=0.1):
    x, z = np.linspace(0, 1, m), np.linspace(0.05, 0.95, n)
    return (t / np.pi) / (t**2 + (x[:, None] - z) ** 2) / n


def problems(count, seed=0):
    rng = np.random.default_rng(seed)
    for k in range(count):
        m, n = int(rng.integers(7, 12)), int(rng.integers(2, 7))
        H = lorentz(m, n) if k % 3 == 1 else rng.standard_normal((m, n))
        yield H * 10.0 ** rng.uniform(-1, 1, n) if k % 3 == 2 else H, int(rng.integers(1, m))


# -- judging -----------------------------------------------------------------------------------------------------------
class TestJudged:
    @pytest.mark.parametrize(("m", "n"), [(3, 8), (8, 8), (20, 6), (1, 1)])
    def test_numbers_against_the_dense_formula(self, m, n):
        rng = np.random.default_rng(m)
        H, noise, amplitude = rng.standard_normal((m, n)), rng.uniform(0.1, 2, m), rng.uniform(1, 9, n)
        (one,) = design.compare({"a": H}, noise=noise, amplitude=amplitude).layouts
        A = H / noise[:, None] * amplitude
        logdet, share = dense(A)
        assert one.logdet == pytest.approx(logdet)
        assert one.std == pytest.approx(share * amplitude)
        assert one.kappa == pytest.approx(np.linalg.cond(A))
        assert (one.rank, one.nullity) == (min(m, n), n - min(m, n))
        assert one.recoverable == np.sum(np.linalg.svd(A, compute_uv=False) > 1)
        assert one.mean_share == pytest.approx(np.exp(-logdet / 2 / n))
        assert one.worst == np.argmax(share)

    def test_correlated_noise_is_whitened(self):
        rng = np.random.default_rng(0)
        H, G = rng.standard_normal((6, 4)), rng.standard_normal((6, 6))
        R = G @ G.T + np.eye(6)
        rows = [4, 0, 2]
        found = design.compare({"a": rows}, candidates=H, noise=R, amplitude=2.0)["a"]
        sub = R[np.ix_(rows, rows)]
        precision = np.eye(4) / 4 + H[rows].T @ np.linalg.solve(sub, H[rows])
        assert found.std**2 == pytest.approx(np.diag(np.linalg.solve(precision, np.eye(4))))

    @given(st.integers(1, 9), st.integers(1, 6), st.integers(0, 10**6), st.floats(-4, 6))
    @settings(max_examples=30, deadline=None)
    def test_another_sensor_never_makes_it_worse(self, m, n, seed, power):
        rng = np.random.default_rng(seed)
        H = rng.standard_normal((m + 1, n)) * 10.0 ** rng.uniform(-2, 2, n)
        found = design.compare({"less": range(m), "more": range(m + 1)}, candidates=H, noise=1.0, amplitude=10.0**power)
        less, more = found.layouts
        assert np.all(more.std <= less.std * (1 + 1e-7) + 1e-14 * more.amplitude)
        assert more.logdet >= less.logdet - 1e-9
        assert more.recoverable >= less.recoverable

    def test_no_unit_matters(self):
        """Sensors in other units with their noise, loads in other units: the same shares, the same condition."""
        rng = np.random.default_rng(1)
        H, u, v = rng.standard_normal((7, 4)), 10.0 ** rng.uniform(-9, 9, 7), 1e6
        one = design.compare({"a": H}, noise=np.ones(7)).layouts[0]
        other = design.compare({"a": H * u[:, None] * v}, noise=u).layouts[0]
        assert other.share == pytest.approx(one.share, rel=1e-9)
        assert other.kappa == pytest.approx(one.kappa, rel=1e-9)
        assert other.std * v == pytest.approx(one.std, rel=1e-9)

    def test_loads_of_two_units_get_their_own_amplitude(self):
        columns = [Channel(label="f", quantity="force", unit="N"), Channel(label="p", quantity="pressure", unit="Pa")]
        model = MatrixModel(np.array([[1.0, 1e-9], [0.5, 2e-9]]), loads=columns)
        one = design.compare({"a": model}, snr=10).layouts[0]
        assert one.amplitude == pytest.approx([10, 5e9])


class TestCompare:
    H = lorentz(20, 10)

    def test_a_better_condition_by_lost_modes_is_said(self):
        found = design.compare({"all": range(20), "few": [3, 10, 16], "same": range(0, 20, 2)}, candidates=self.H)
        (flag,) = [f for f in found.flags if "few" in f.message]
        assert flag.code == "LID-W202"
        assert (flag.evidence.value, flag.evidence.threshold) == (7, 0)
        assert found["few"].kappa < found["all"].kappa
        assert "warning: few against all: kappa fell" in found.table()
        assert not [f for f in found.flags if f.message.startswith("same")]

    def test_ways_to_name_a_layout_agree(self):
        model = MatrixModel(self.H, sensors=[f"s{i}" for i in range(20)])
        found = design.compare({"a": ["s1", "s5"], "b": [1, 5], "c": np.array([1, -15])}, candidates=model)
        arrays = design.compare({"a": self.H[[1, 5]], "b": MatrixModel(self.H[[5, 1]])}, noise=1.0, amplitude=2.0)
        stated = design.compare({"a": [1, 5]}, candidates=self.H, noise=1.0, amplitude=2.0)
        assert len({x.logdet for x in found.layouts}) == 1
        assert {round(x.logdet, 9) for x in arrays.layouts} == {round(stated["a"].logdet, 9)}
        with pytest.raises(KeyError):
            found["none"]

    def test_best(self):
        found = design.compare({"few": [3, 10], "many": range(20)}, candidates=self.H)
        assert found.best().name == found.best("worst").name == "many"
        with pytest.raises(InputError, match="criterion"):
            found.best("A")

    def test_some_loads(self):
        some = design.compare({"a": range(20)}, ["u3", 7], candidates=self.H, noise=1.0, amplitude=1.0)["a"]
        assert some.loads == ("u3", "u7")
        assert some.std == pytest.approx(dense(self.H[:, [3, 7]])[1])

    def test_sensors_on_a_structure(self):
        beam = beams.cantilever(
            length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel, elements=10
        )
        forces = [loads.Point(at=x) for x in (0.35, 0.95)]
        sets = {
            "root": [sensors.StrainGauge(at=x, fibre=0.005, noise=1e-6) for x in (0.02, 0.05)],
            "apart": [sensors.StrainGauge(at=x, fibre=0.005, noise=1e-6) for x in (0.02, 0.5)],
        }
        found = design.compare(sets, forces, structure=beam, amplitude=10.0)
        model = ForwardModel(beam, sets["apart"], forces)
        assert found["apart"].std == pytest.approx(10 * dense(model.static() * 1e7)[1])
        assert found.best().name == "apart"
        assert found["apart"].at.ravel().tolist() == [0.02, 0.5]
        assert found.loads_at.ravel().tolist() == [0.35, 0.95]

    def test_refused(self):
        H, two = self.H, [Channel(label="a", quantity="displacement", unit="m"), Channel(label="b", unit="m/m")]
        for sets, given_, words in (
            ({}, {}, "no layouts"),
            ([1, 2], {}, "no layouts"),
            ({"a": []}, {"candidates": H}, "without sensors"),
            ({"a": ["none"]}, {"candidates": H}, "no such candidate"),
            ({"a": [1, 1]}, {"candidates": H}, "named twice"),
            ({"a": [20]}, {"candidates": H}, "no such candidate"),
            ({"a": [True]}, {"candidates": H}, "no such candidate"),
            ({"a": [1]}, {"candidates": np.full((3, 3), np.nan)}, "no model and no matrix"),
            ({"a": [1]}, {"candidates": np.ones(3)}, "no model and no matrix"),
            ({"a": 1j * H}, {}, "complex"),
            ({"a": H, "b": H[:, :3]}, {}, "same loads"),
            ({"a": 0 * H}, {}, "no load moves"),
            ({"a": H}, {"amplitude": 1.0}, "against a noise level"),
            ({"a": H}, {"amplitude": 1.0, "noise": 1.0, "snr": 3.0}, "say the same"),
            ({"a": H}, {"amplitude": -1.0, "noise": 1.0}, "no amplitude"),
            ({"a": H}, {"snr": 0}, "no signal-to-noise"),
            ({"a": H}, {"noise": -1.0}, "no noise level"),
            ({"a": H}, {"noise": np.ones(3)}, "no noise level"),
            ({"a": H}, {"noise": np.ones((20, 20))}, "no noise level"),
            ({"a": MatrixModel(H[:2], sensors=two)}, {}, "different units need their noise"),
            ({"a": [0]}, {"candidates": H, "at": np.ones(3)}, "places do not fit"),
        ):
            with pytest.raises(InputError, match=words):
                design.compare(sets, **given_)
        with pytest.raises(InputError, match="no such load"):
            design.compare({"a": H}, ["none"])


# -- choosing ----------------------------------------------------------------------------------------------------------
class TestSearch:
    @pytest.mark.parametrize("criterion", [search.D, 1.0, 8.0, search.WORST])
    def test_rank_one_updates_against_the_dense_formula(self, criterion):
        rng = np.random.default_rng(0)
        A = 30 * rng.standard_normal((12, 5)) * 10.0 ** rng.uniform(-2, 0, 5)
        state = search.RowSet(A, [0, 3])

        def score(rows):
            logdet, share = dense(A[rows])
            if criterion == search.D:
                return logdet
            return -np.log(np.linalg.norm(share**2, criterion))

        for row, sign in ((5, 1), (3, -1), (7, 1), (8, 1), (0, -1), (3, 1)):
            base = state.score(criterion) if criterion == search.D else 0.0
            after = sorted({*state.members, row} if sign > 0 else {*state.members} - {row})
            if sign > 0:
                assert base + state.gains(criterion)[row] == pytest.approx(score(after), rel=1e-8)
            state.change(row, sign)
            assert sorted(state.members) == after
            assert state.score(criterion) == pytest.approx(score(after), rel=1e-8)
            assert state.variance == pytest.approx(dense(A[after])[1] ** 2, rel=1e-8)
        rows = state.members
        inside, change = search.swaps(state, [7])
        assert set(inside) == set(rows) - {7}
        for i, out in enumerate(inside):
            for j in set(range(12)) - set(rows):
                swapped = [r for r in rows if r != out] + [j]
                assert state.logdet + change[i, j] == pytest.approx(dense(A[swapped])[0], rel=1e-8)
        if criterion != search.D:
            for out, gains in search.without(state, list(rows), criterion):
                for j in set(range(12)) - set(rows):
                    assert gains[j] == pytest.approx(score([r for r in rows if r != out] + [j]), rel=1e-7, abs=1e-9)

    def test_many_updates_do_not_drift(self):
        rng = np.random.default_rng(1)
        A = 1e4 * rng.standard_normal((40, 6))
        state = search.RowSet(A, list(range(10)))
        for _ in range(300):
            state.change(int(rng.choice(sorted(set(range(40)) - set(state.members)))), 1)
            state.change(int(rng.choice(state.members)), -1)
        assert state.logdet == pytest.approx(dense(A[state.members])[0], rel=1e-9)

    def test_log_det_by_exchange_against_every_set(self):
        efficiency = []
        for H, n in problems(40):
            found = design.place(H, n, snr=30, exhaustive=False)
            A = H * 30 / np.abs(H).max()
            best = max(dense(A[list(s)])[0] for s in itertools.combinations(range(len(A)), n))
            assert found.layout.logdet == pytest.approx(dense(A[list(found.chosen)])[0])
            efficiency.append(np.exp((found.layout.logdet - best) / (2 * H.shape[1])))
        assert min(efficiency) >= 0.98
        assert np.mean(np.array(efficiency) > 1 - 1e-9) >= 0.9

    def test_worst_std_by_exchange_against_every_set(self):
        ratio = []
        for H, n in problems(24, seed=1):
            exact = design.place(H, n, snr=30, criterion="worst", exhaustive=True)
            found = design.place(H, n, snr=30, criterion="worst", exhaustive=False)
            ratio.append(exact.layout.share.max() / found.layout.share.max())
        assert max(ratio) <= 1 + 1e-7
        assert np.mean(np.array(ratio) > 1 - 1e-7) >= 0.85
        assert min(ratio) >= 0.7

    @pytest.mark.parametrize("criterion", ["D", "worst"])
    def test_every_set_against_the_dense_formula(self, criterion):
        H, n = lorentz(9, 5), 4
        A = H * 30 / np.abs(H).max()
        scores = {
            s: dense(A[list(s)])[0] if criterion == "D" else -dense(A[list(s)])[1].max()
            for s in itertools.combinations(range(9), n)
        }
        found = design.place(H, n, snr=30, criterion=criterion)
        assert found.method == "all sets"
        assert scores[tuple(sorted(found.chosen))] == pytest.approx(max(scores.values()), rel=1e-9)

    @pytest.mark.parametrize("criterion", ["D", "worst"])
    @pytest.mark.parametrize("exhaustive", [False, True])
    def test_the_order_of_the_candidates_does_not_matter(self, criterion, exhaustive):
        rng = np.random.default_rng(2)
        for H in (rng.standard_normal((10, 4)), lorentz(10, 5)):  # without ties, and with mirror images
            sets = set()
            for seed in range(4):
                order = np.random.default_rng(seed).permutation(10)
                found = design.place(H[order], 4, criterion=criterion, exhaustive=exhaustive)
                sets.add(tuple(sorted(order[list(found.chosen)].tolist())))
            assert len(sets) == 1

    @pytest.mark.parametrize("criterion", ["D", "worst"])
    def test_units_do_not_matter(self, criterion):
        rng = np.random.default_rng(3)
        H, u = rng.standard_normal((14, 5)), 10.0 ** rng.uniform(-9, 9, 14)
        one = design.place(H, 6, noise=np.ones(14), criterion=criterion, exhaustive=False)
        other = design.place(1e7 * H * u[:, None], 6, noise=u, criterion=criterion, exhaustive=False)
        assert one.chosen == other.chosen
        assert other.layout.share == pytest.approx(one.layout.share)

    @pytest.mark.parametrize("exhaustive", [False, True])
    def test_mirror_images_are_reported(self, exhaustive):
        H = lorentz(13, 6)  # symmetric about the middle
        found = design.place(H, 3, exhaustive=exhaustive)
        mirror = tuple(f"y{12 - i}" for i in sorted(found.chosen, reverse=True))
        own = tuple(f"y{i}" for i in sorted(found.chosen))
        assert (mirror == own) != (mirror in found.ties)
        one = design.place(H[:, :4] + H[::-1, :4], 1, exhaustive=exhaustive)  # every place is as good as its image
        assert one.ties == ((f"y{12 - one.chosen[0]}",),)
        assert "ties: 1 other" in one.table()

    def test_twins_are_ties(self):
        H = np.vstack([np.eye(3), np.eye(3)[:1]])
        found = design.place(H, 3, exhaustive=False)
        assert len(found.ties) == 1
        assert design.place(np.random.default_rng(0).standard_normal((8, 3)), 4, exhaustive=False).ties == ()

    def test_sensors_to_keep(self):
        H = np.random.default_rng(4).standard_normal((12, 5))
        for exhaustive in (False, True):
            found = design.place(H, 5, keep=["y2", 7], exhaustive=exhaustive)
            assert {2, 7} <= set(found.chosen)
            best = max(
                dense(H[[2, 7, *s]] * 100 / np.abs(H).max())[0]
                for s in itertools.combinations(sorted(set(range(12)) - {2, 7}), 3)
            )
            assert found.layout.logdet == pytest.approx(best, rel=1e-6)
        assert set(design.place(H, 2, keep=[2, 7]).chosen) == {2, 7}

    def test_everything_is_an_upper_bound(self):
        found = design.place(lorentz(30, 8), 5)
        assert found.layout.logdet < found.everything.logdet
        assert [g[0] for g in found.gains] == list(found.sensors)
        steps = [g[1] for g in found.gains]
        assert steps == sorted(steps)
        assert steps[-1] == pytest.approx(found.layout.logdet)
        assert found.gains[-1][2] == pytest.approx(found.layout.share.max())

    def test_at_a_huge_signal(self):
        """1 - leverage is lost in rounding; the search still ends, with a set of full rank."""
        H = np.random.default_rng(5).standard_normal((15, 6))
        found = design.place(H, 6, snr=1e9, exhaustive=False)
        best = design.place(H, 6, snr=1e4, exhaustive=True)
        assert found.layout.rank == 6
        assert abs(np.linalg.det(H[list(found.chosen)])) > 0.9 * abs(np.linalg.det(H[list(best.chosen)]))

    def test_progress(self):
        for exhaustive in (False, True):
            said = []
            design.place(lorentz(40, 4), 3, exhaustive=exhaustive, progress=lambda f, text, s=said: s.append(f))
            assert said == sorted(said)
            assert said[-1] == 1
            assert len(said) > 3

    def test_refused(self):
        H = lorentz(10, 4)
        for n in (0, 11, 2.5, True, None):
            with pytest.raises(InputError, match="no such number"):
                design.place(H, n)
        with pytest.raises(InputError, match="no such number"):
            design.place(H, 1, keep=[1, 2])
        with pytest.raises(InputError, match="correlated noise"):
            design.place(H, 3, noise=np.eye(10) + 0.1)
        assert design.place(H, 3, noise=np.eye(10)).chosen == design.place(H, 3, noise=1.0).chosen
        with pytest.raises(InputError, match="criterion"):
            design.place(H, 3, criterion="A")


# -- words, pictures ---------------------------------------------------------------------------------------------------
def test_a_blind_layout():
    """A sensor that no load moves: rank 0, every std is its prior, and files hold no infinity."""
    H = np.vstack([np.zeros(3), np.ones(3)])
    blind = design.compare({"blind": [0], "one": [1]}, candidates=H)["blind"]
    assert (blind.rank, blind.nullity, blind.recoverable) == (0, 3, 0)
    assert blind.share == pytest.approx(np.ones(3))
    assert json.dumps(blind.to_dict(), allow_nan=False)


def test_results_are_plain_and_cannot_be_changed():
    placed = design.place(lorentz(10, 4), 3)
    compared = design.compare({"a": [1, 2], "b": [3, 4, 5]}, candidates=lorentz(10, 4))
    for found in (placed, compared):
        assert json.loads(json.dumps(found.to_dict(), allow_nan=False))
        assert str(found) == found.table()
        with pytest.raises(AttributeError):
            found.expected = ""
    with pytest.raises(ValueError, match="read-only"):
        placed.layout.std[0] = 1
    heads = compared.table().splitlines()[0]
    for word in ("condition", "rank", "nullity", "modes above noise", "worst std", "at load", "log det"):
        assert word in heads
    assert len({len(line) for line in compared.table().splitlines()[1:3]}) == 1


LINE = np.linspace(0, 1, 10)
GRID = np.stack(np.meshgrid(np.linspace(0, 1, 4), np.linspace(0, 0.5, 3)), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(
    ("at", "loads_at", "axes"),
    [
        (None, None, "load, in the order"),
        (LINE, np.linspace(0.1, 0.9, 4), "x [m]"),
        (np.column_stack([0 * LINE, LINE]), np.column_stack([np.zeros(4), np.arange(4.0)]), "y [m]"),
        (GRID[:10], GRID[:4] * 0.9, "x [m]"),
        (np.column_stack([GRID[:10, 0], 0 * LINE, GRID[:10, 1]]), np.column_stack([GRID[:4], GRID[:4, 1]]), "x [m]"),
    ],
)
def test_pictures(tmp_path, at, loads_at, axes):
    placed = design.place(lorentz(10, 4), 3, at=at, loads_at=loads_at)
    figure = placed.plot(path=tmp_path / "layout.png")
    assert (tmp_path / "layout.png").stat().st_size > 8000
    panel = figure.axes[0]
    assert panel.get_xlabel().startswith(axes)
    assert f"worst: {placed.layout.loads[placed.layout.worst]}" in panel.get_title(loc="left")
    marks = {line.get_label(): line.get_xydata() for line in panel.lines}
    if at is not None:
        assert len(marks["worst load"]) == 1
        assert len(marks["sensors"]) == 3


def test_one_way_to_say_what_the_sets_pick_from():
    with pytest.raises(InputError, match="two ways"):
        design.compare({"a": [0, 1]}, candidates=lorentz(10, 4), structure=object())


def test_a_panel_for_each_layout():
    sets = {str(k): [k, k + 1] for k in range(4)}
    figure = design.compare(sets, candidates=lorentz(10, 4), at=LINE, loads_at=LINE[:4]).plot()
    assert sum(a.get_visible() and bool(a.get_title(loc="left")) for a in figure.axes) == 4


def test_places_of_a_model():
    """DOFs by the coordinates of their nodes, points by themselves, patches by their middle."""
    beam = beams.cantilever(
        length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel, elements=10
    )
    node = beam.dofs[10].node
    rows = [sensors.Displacement(beam.dofs[10]), sensors.Displacement(at=0.33)]
    columns = [loads.Patch(x=(0.2, 0.4)), loads.Point(at=0.9)]
    found = design.place(ForwardModel(beam, rows, columns), 1)
    numbers = sorted({d.node for d in beam.dofs})
    assert found.candidates_at.ravel() == pytest.approx([beam.coordinates[numbers.index(node)][0], 0.33])
    assert found.loads_at.ravel() == pytest.approx([0.3, 0.9])
    assert found.outline.shape == beam.coordinates.shape


def test_a_model_of_hits_is_sent_where_hits_are_judged(tmp_path, monkeypatch, capsys):
    """FRFs have no static response, accelerometers see no static load: neither is told to take another family."""
    from loadid import calibrate, cli, datasets
    from loadid._commands import load_model

    made = datasets.hammer_test(tmp_path)
    monkeypatch.chdir(tmp_path)
    calibrate([str(f) for f in made.files[:3]], force="hammer", responses=["acc1", "acc2"]).save("frfs.h5")
    made.model.save("beam.h5")
    for name, said in (("frfs.h5", "of hits or FRFs"), ("beam.h5", "accelerometers and AC-coupled")):
        with pytest.raises(InputError, match=said) as refused:
            design.place(load_model(name), 1)
        assert "place_for_hits" in str(refused.value)
        assert "--pulse" in refused.value.command
        assert cli.main(["design", name, "-n", "1"]) == 0
        assert "would be found to" in capsys.readouterr().out
