"""What the pages of the lab state, against NumPy's own algebra and the figures of the text that they come from."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from loadid._lab import facts, lcurve
from loadid._lab.cards import answer, table
from loadid._lab.pages import pages
from loadid._lab.server import Lab
from loadid._lab.surface import METHODS, PROFILES

from .client import called

N = 48
X = (np.arange(N) + 0.5) / N
BASE = {"t": 0.1, "spacing": 0.25, "profile": "fingertips", "every": 1, "occluded": False, "eta": 0.01, "seed": 0,
        "method": "identity", "lam": 0.01}  # fmt: skip


def kernel(t: float) -> Any:
    return np.array([[t / (t * t + (a - b) ** 2) / (np.pi * N) for b in X] for a in X])


def two(spacing: float = 0.25) -> Any:
    return np.exp(-(((X - 0.5 + spacing / 2) / 0.03) ** 2) / 2) + np.exp(-(((X - 0.5 - spacing / 2) / 0.03) ** 2) / 2)


def tikhonov(H: Any, y: Any, lam: float, L: Any = None) -> Any:
    """By least squares of the stacked problem."""
    L = np.eye(N) if L is None else L
    return np.linalg.lstsq(np.vstack([H, lam * L]), np.concatenate([y, np.zeros(len(L))]), rcond=None)[0]


@pytest.fixture(scope="module")
def lab() -> Iterator[Lab]:
    with Lab(pages()) as server:
        yield server


def pictured(lab: Lab, **change: Any) -> Any:
    return called(lab, "contact/picture", **BASE | change)


# -- contact inversion: the picture, by another route ----------------------------------------------------------------
@pytest.mark.parametrize(("method", "L"), [
    ("identity", None), ("gradient", np.diff(np.eye(N), axis=0)), ("laplacian", np.diff(np.eye(N), 2, axis=0)),
])  # fmt: skip
@pytest.mark.parametrize(("t", "every"), [(0.1, 1), (0.2, 3)])
def test_tikhonov_is_that_of_the_stacked_problem(lab: Lab, method: str, L: Any, t: float, every: int) -> None:
    found = pictured(lab, method=method, t=t, every=every)
    H, y = kernel(t)[::every], np.array(found["readings"])
    load = tikhonov(H, y, 0.01, L)
    assert np.abs(found["load"] - load).max() < 1e-4 * np.abs(load).max()  # the readings have six digits
    stack = np.vstack([H, 0.01 * (np.eye(N) if L is None else L)])
    A = H @ np.linalg.solve(stack.T @ stack, H.T)
    assert found["edf"] == pytest.approx(np.trace(A), rel=1e-5)
    std = found["sigma"] * np.sqrt(np.diag(np.linalg.inv(stack.T @ stack)))
    assert np.allclose(np.array(found["high"]) - found["load"], 1.96 * std, rtol=1e-4)
    s = np.linalg.svd(H, compute_uv=False)
    assert (found["measurements"], found["rank"], found["nullity"]) == (len(H), len(H), N - len(H))
    assert found["kappa"] == pytest.approx(s[0] / s[-1], rel=1e-4)


def test_the_other_methods_are_what_they_say(lab: Lab) -> None:
    H, sigma = kernel(0.1), pictured(lab)["sigma"]
    y = np.array(pictured(lab)["readings"])
    U, s, Vt = np.linalg.svd(H)
    k = int(np.sum(s >= 0.01))
    cut = Vt[:k].T @ (U[:, :k].T @ y / s[:k])
    assert np.allclose(pictured(lab, method="tsvd")["load"], cut, atol=1e-3)
    positive = np.array(pictured(lab, method="nonnegative")["load"])
    slope = H.T @ (H @ positive - y) + 1e-4 * positive  # Karush, Kuhn and Tucker
    assert positive.min() >= 0
    assert np.abs(slope[positive > 1e-6]).max() < 1e-5
    assert slope.min() > -1e-5
    held = np.array(pictured(lab, method="support")["load"])
    assert np.flatnonzero(held).tolist() == [i for i in range(15, 33) if held[i] > 0]
    assert pictured(lab, method="resultant")["resultant"] < 1e-10
    assert pictured(lab, method="naive", t=0.05, eta=0.0)["map"] < 1e-9
    sparse = np.array(pictured(lab, method="l1", lam=0.05)["load"])
    mu = 0.05 * np.abs(H.T @ y).max()
    slope = H.T @ (y - H @ sparse)
    assert np.abs(slope).max() < mu * (1 + 1e-3)
    assert np.allclose(slope[sparse != 0], mu * np.sign(sparse[sparse != 0]), rtol=1e-2)
    assert sigma == pytest.approx(0.01 * (H @ two()).max(), rel=1e-5)


def test_the_two_errors_are_as_the_page_defines_them(lab: Lab) -> None:
    for profile in PROFILES:
        found = pictured(lab, profile=profile)
        load, true = np.array(found["load"]), np.array(found["truth"])
        assert found["resultant"] == pytest.approx(abs(load.sum() - true.sum()) / true.sum(), abs=1e-5)
        assert found["map"] == pytest.approx(np.sqrt(np.mean((load - true) ** 2)) / true.max(), rel=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_answers_at_every_end_of_its_ranges(lab: Lab, method: str) -> None:
    for change in ({"t": 0.02}, {"t": 0.4, "every": 4, "occluded": True, "spacing": 0.6}, {"eta": 0.0, "lam": 1e-8},
                   {"eta": 0.2, "lam": 1.0, "profile": "point", "every": 3, "occluded": True}):  # fmt: skip
        found = pictured(lab, method=method, **change)
        assert np.isfinite(found["load"]).all()
        assert found["rank"] + found["nullity"] == N


def test_rules_are_asked_of_the_data_and_not_of_the_method(lab: Lab) -> None:
    asked = {k: v for k, v in BASE.items() if k != "lam"}
    free = called(lab, "contact/rules", **asked)
    assert free == called(lab, "contact/rules", **asked | {"method": "nonnegative"})
    told = {r["rule"]: r["lam"] for r in free["rules"]}
    y = np.array(pictured(lab)["readings"])
    U, s, _ = np.linalg.svd(kernel(0.1))
    lams = np.geomspace(1e-4, 0.5, 2000)
    left = lams**2 / (s[:, None] ** 2 + lams**2)
    gcv = ((left * (U.T @ y)[:, None]) ** 2).sum(axis=0) / left.sum(axis=0) ** 2
    assert told["gcv"] == pytest.approx(lams[gcv.argmin()], rel=0.01)
    assert free["verdict"] in ("determined", "usable", "rules disagree", "not determined")


# -- try this ----------------------------------------------------------------------------------------------------------
def test_1_exact_data_come_back_and_prove_nothing(lab: Lab) -> None:
    found = called(lab, "contact/tried", which=1)
    assert "proves nothing" in found["outcome"]
    assert pictured(lab, **found["steps"][0]["settings"])["map"] < 1e-9
    assert facts.exact()["error"] < 1e-9


def test_2_noise_blows_the_naive_inverse_up(lab: Lab) -> None:
    found = called(lab, "contact/tried", which=2)
    stated = int(re.search(r"largest value is (\d+) times", found["outcome"])[1])  # type: ignore[index]
    assert stated == pytest.approx(2.0e3, rel=0.15)
    H, peak, rng = kernel(0.1), two().max(), np.random.default_rng(5)
    y = (H @ two())[:, None] + 0.01 * (H @ two()).max() * rng.standard_normal((N, 400))
    assert stated == pytest.approx(np.median(np.abs(np.linalg.solve(H, y)).max(axis=0)) / peak, rel=0.15)
    naive, tamed = (pictured(lab, **step["settings"]) for step in found["steps"])
    assert naive["largest"] > 500
    assert tamed["largest"] < 1


def test_3_a_thick_layer_leaves_fewer_decades_that_separate(lab: Lab) -> None:
    found = called(lab, "contact/tried", which=3)
    decades = [float(d) for d in re.search(r"grows: ([\d., ]+) decades", found["outcome"])[1].split(",")]  # type: ignore[index]
    assert decades == pytest.approx([2.1, 2.0, 1.6, 1.3, 1.0, 0.5], abs=0.11)
    assert "84 % of the true height" in found["outcome"]
    last = pictured(lab, **found["steps"][-1]["settings"])
    load = np.array(last["load"])
    peaks = [i for i in range(1, N - 1) if load[i] > max(load[i - 1], load[i + 1], 0.5 * load.max())]
    assert len(peaks) == 2
    assert last["peak"] == pytest.approx(0.84, abs=0.006)
    H, true = kernel(0.3), two()
    assert last["peak"] == pytest.approx(tikhonov(H, H @ true, 1e-6).max() / true.max(), rel=1e-3)


def test_4_markers_lost_under_the_contact(lab: Lab) -> None:
    found = called(lab, "contact/tried", which=4)
    assert "rank falls from 48 to 30" in found["outcome"]
    assert "nullity rises from 0 to 18" in found["outcome"]
    assert "falls from 1.36e6 to 4.3e5" in found["outcome"]
    assert facts.seen()["resultant"] == pytest.approx(0.006, abs=0.001)
    assert facts.hidden()["resultant"] == pytest.approx(0.10, abs=0.01)
    lost = pictured(lab, **found["steps"][0]["settings"])
    assert (lost["measurements"], lost["rank"], lost["nullity"]) == (30, 30, 18)
    assert lost["kappa"] == pytest.approx(4.3e5, rel=0.01)
    assert pictured(lab, **found["steps"][1]["settings"])["kappa"] == pytest.approx(1.36e6, rel=0.01)


def test_5_a_right_resultant_and_a_wrong_map(lab: Lab) -> None:
    found = called(lab, "contact/tried", which=5)
    assert "71.5 % against 32.4 %" in found["outcome"]
    *moderate, top = (pictured(lab, **step["settings"]) for step in found["steps"])
    for one in moderate:
        assert one["resultant"] < 0.1 * one["map"]
    assert (top["resultant"], top["map"]) == pytest.approx((0.715, 0.324), abs=5e-4)


# -- L-curve and GCV ---------------------------------------------------------------------------------------------------
def test_the_problem_is_the_one_of_the_text(lab: Lab) -> None:
    found = called(lab, "lcurve/curves", seed=0, correlated=False)
    assert len(found["lam"]) == 150
    assert (found["lam"][0], found["lam"][-1]) == (1e-6, 1)
    assert found["singular"] == pytest.approx([0.8146, 5.97e-7], rel=1e-4)
    assert found["singular"][0] / found["singular"][1] == pytest.approx(1.36e6, rel=5e-3)


@pytest.mark.parametrize("correlated", [False, True])
def test_curves_and_reconstruction_by_another_route(lab: Lab, correlated: bool) -> None:
    found = called(lab, "lcurve/curves", seed=3, correlated=correlated)
    H, y = kernel(0.1), lcurve.readings(3, correlated)
    U, s, Vt = np.linalg.svd(H)
    beta, errors, gcv = U.T @ y, [], []
    for k, lam in enumerate(np.geomspace(1e-6, 1, 150)):
        f = s**2 / (s**2 + lam**2)
        load = Vt.T @ (f / s * beta)
        assert found["residual"][k] == pytest.approx(np.linalg.norm((1 - f) * beta), rel=1e-3)
        assert found["norm"][k] == pytest.approx(np.linalg.norm(load), rel=1e-3)
        gcv.append(np.sum(((1 - f) * beta) ** 2) / np.sum(1 - f) ** 2)
        errors.append(np.sqrt(np.mean((load - two()) ** 2)) / two().max())
    assert found["oracle"] == pytest.approx(np.geomspace(1e-6, 1, 150)[np.argmin(errors)], rel=1e-4)
    assert found["best"] == pytest.approx(min(errors), rel=1e-3)
    for name, curve in (("gcv", np.log(gcv)), ("error", np.log(errors))):
        assert np.allclose(found[name], (curve - curve.min()) / np.ptp(curve), atol=1e-3)
    gcv_rule = next(r for r in found["rules"] if r["rule"] == "gcv")
    now = called(lab, "lcurve/at", seed=3, correlated=correlated, lam=gcv_rule["lam"])
    assert now["map"] == pytest.approx(gcv_rule["error"], rel=1e-3)
    assert np.allclose(now["load"], tikhonov(H, y, gcv_rule["lam"]), atol=1e-4 * now["largest"])


def test_medians_of_white_noise(lab: Lab) -> None:
    rows = {r["rule"]: r for r in called(lab, "lcurve/histogram", correlated=False)["rows"]}
    assert all(sum(row["counts"]) == 200 for row in rows.values())
    for rule, lam in (("l_curve", 6.7e-3), ("gcv", 8.1e-3), ("oracle", 8.8e-3)):
        assert rows[rule]["lam"] == pytest.approx(lam, rel=0.12), rule
    assert rows["l_curve"]["ratio"] == pytest.approx(1.06, abs=0.03)
    assert rows["gcv"]["ratio"] == pytest.approx(1.05, abs=0.03)


def test_medians_of_correlated_noise(lab: Lab) -> None:
    rows = {r["rule"]: r for r in called(lab, "lcurve/histogram", correlated=True)["rows"]}
    assert rows["gcv"]["lam"] == pytest.approx(1e-6)
    assert rows["gcv"]["ratio"] == pytest.approx(10.8, rel=0.15)
    assert rows["discrepancy"]["ratio"] == pytest.approx(1.5, abs=0.06)
    drawn = np.array([lcurve.noise(seed, True) for seed in range(400)])
    assert np.mean(drawn**2, axis=1) == pytest.approx(np.ones(400))
    shared = np.corrcoef(drawn[:, 20], drawn[:, 23])[0, 1]
    assert shared == pytest.approx(np.exp(-((3 / 1.5) ** 2) / 4), abs=0.1)


# -- cards -------------------------------------------------------------------------------------------------------------
STATED = {  # what the numbers of the cards are to two digits or so; a change here is a change of the package
    "exact": {}, "blown": {"naive": 2025, "tikhonov": 0.878, "map": 0.0862},
    "separable": {"0.05": 2.10, "0.15": 1.68, "0.30": 0.60, "height": 0.836},
    "seen": {"resultant": 0.00543, "rank": 48, "nullity": 0, "kappa": 1.364e6},
    "hidden": {"resultant": 0.106, "rank": 30, "nullity": 18, "kappa": 4.271e5},
    "partial": {"R0.03": 0.00111, "M0.03": 0.108, "R0.1": 0.0112, "M0.1": 0.177, "R1": 0.715, "M1": 0.324},
    "sizes": {"first": 0.8146, "last": 5.97e-7, "kappa": 1.364e6, "squared": 1.862e12},
    "thickness": {"modes0.05": 31, "modes0.10": 16, "modes0.30": 6, "kappa0.05": 834, "kappa0.10": 1.364e6},
    "stiffness": {"gain": 2.0}, "filters": {"equal": 0.5, "over": 0.990, "under": 0.0099, "edf": 15.24},
    "shortcut": {"noise": 1102}, "margin": {"half": 47.6, "once": 1.25, "twice": 1.62},
    "white": {"oracle": 9.7e-3, "gcv": 7.96e-3, "x_gcv": 1.05, "discrepancy": 0.0281, "x_discrepancy": 1.24,
              "x_robust_gcv": 1.05, "x_l_curve": 1.08},
    "smooth": {"oracle": 6.4e-3, "gcv": 1e-6, "x_gcv": 9.9, "x_discrepancy": 1.49, "robust_gcv": 1e-6,
               "l_curve": 4.5e-4, "x_l_curve": 2.32},
    "priors": {"point_l1": 0.0038, "point_nonnegative": 0.0051, "point_identity": 0.110, "punch_l1": 0.480,
               "punch_identity": 0.117, "punch_nonnegative": 0.0873},
}  # fmt: skip


@pytest.mark.parametrize("name", facts.FACTS)
def test_a_number_that_a_card_states_does_not_drift(name: str) -> None:
    found = facts.FACTS[name]()
    assert {key: found[key] for key in STATED[name]} == pytest.approx(STATED[name], rel=0.03)


def test_every_fact_of_a_text_is_pinned() -> None:
    texts = [card["question"] + card["answer"] for card in table()["cards"].values()]
    named = {(m[1], m[2]) for text in texts for m in re.finditer(r"\{(\w+)\[([\w.]+)\][^}]*\}", text)}
    free = {("exact", "error")}  # rounding: below 1e-9, as the first of the things to try
    assert named - free <= {(name, key) for name, keys in STATED.items() for key in keys}


def test_numbers_on_cards_are_those_of_numpy() -> None:
    H, true = kernel(0.1), two()
    s = np.linalg.svd(H, compute_uv=False)
    assert facts.sizes()["kappa"] == pytest.approx(s[0] / s[-1], rel=1e-6)
    assert facts.filters()["edf"] == pytest.approx(np.sum(s**2 / (s**2 + 1e-4)), rel=1e-6)
    noise = 0.01 * (H @ true).max() * np.linalg.norm(np.linalg.inv(H)) / np.sqrt(N) / true.max()
    assert facts.shortcut()["noise"] == pytest.approx(noise, rel=1e-6)
    assert facts.thickness()["modes0.05"] == np.sum(np.linalg.svd(kernel(0.05), compute_uv=False) > 0.01 * 0.8978623832)


def test_the_deck_is_whole() -> None:
    deck = table()
    assert len(deck["cards"]) >= 40
    assert {card["topic"] for card in deck["cards"].values()} == set(deck["topics"])
    assert len({card["question"] for card in deck["cards"].values()}) == len(deck["cards"])
    for key, card in deck["cards"].items():
        assert set(card) == {"key", "topic", "question", "answer"}
        told = answer(key)["answer"]
        assert "{" not in told
        assert 20 < len(told) < 700, key
