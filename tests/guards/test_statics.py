"""Guards of static problems, reached through the static family, the solids and the validation."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import Absolute, Noise, NoiseSource, StaticInversion
from loadid import _guards as guards
from loadid._inverse.constrained.path import ConstrainedPath
from loadid._inverse.constrained.solver import ConstrainedSolution
from loadid._spellings import folded
from loadid.constraints import Bounds, NonNegative, Resultant
from loadid.paths import LinearProblem, SVDPath
from loadid.validate import Known, ReferenceWrench, validate
from structures import Channel, Flag, ForwardModel, MatrixModel, beams, loads, sensors, solids
from tests.inverse.test_choice import coloured, in_the_null_space

from .cases import Case, of, refused

QUIET = ["W114", "W703"]


def kernel(t=0.1, n=48, m=48) -> np.ndarray:
    """A compliant layer: pressure on n cells seen by m markers."""
    x, s = (np.arange(n) + 0.5) / n, (np.arange(m) + 0.5) / m
    return (t / np.pi) / (t**2 + (s[:, None] - x) ** 2) / n


def bump(n=48) -> np.ndarray:
    return np.exp(-((((np.arange(n) + 0.5) / n - 0.45) / 0.1) ** 2) / 2)


def flags(H=None, *, level=0.01, seed=0, constraints=(), noise=True, y=None, **settings) -> tuple[Flag, ...]:
    """Flags of an estimate of a bump."""
    H = kernel() if H is None else H
    clean = H @ bump(H.shape[1])
    sigma = level * float(np.sqrt(np.mean(clean**2)))
    y = clean + sigma * np.random.default_rng(seed).standard_normal(len(H)) if y is None else y
    if noise:
        settings = {"noise": sigma, "noise_source": "unloaded record", **settings}
    model = MatrixModel(H, sensors=[Channel(label=f"s{i}", quantity="displacement", unit="m") for i in range(len(H))])
    return StaticInversion(model, constraints=constraints, **folded(StaticInversion, settings)).estimate(y).flags


def pad(nu: float, allow=()) -> tuple[Flag, ...]:
    """Flags of a model on plain bricks."""
    block = solids.block(
        lengths=(0.02, 0.02, 0.004), elements=(2, 2, 1), material=beams.Material(E=1e5, rho=1000.0, nu=nu),
        element="standard", allow=allow,
    )  # fmt: skip
    node = len(block.coordinates) - 5
    return ForwardModel(block, [sensors.Displacement(f"{node}+Z")], [loads.Point(f"{node}+Z")]).flags


def per_frame(joint: bool) -> tuple[Flag, ...]:
    H = kernel()
    rng = np.random.default_rng(0)
    y = np.outer([1.0, 0.5, 2.0], H @ bump()) + 1e-3 * rng.standard_normal((3, 48))
    return StaticInversion(H, noise=Noise(1e-3, source="repeatability")).estimate(y, joint=joint).flags


def markers(interpolated: bool) -> tuple[Flag, ...]:
    """Readings of 40 places, interpolated from 10 markers or measured."""
    s = (np.arange(40) + 0.5) / 40
    W = np.array([np.interp(s, np.linspace(0, 1, 10), e) for e in np.eye(10)]).T
    if not interpolated:
        return flags(kernel(m=40))
    return flags(kernel(m=40), y=W @ (W.T @ kernel(m=40) @ bump()), interpolation=W, noise_source="repeatability")


def validated(*references) -> tuple[Flag, ...]:
    H = kernel()
    estimate = StaticInversion(H, noise=1e-3).estimate(H @ bump())
    return validate(estimate, *references).flags


def capped(steps: int) -> ConstrainedSolution:
    """A non-negative solution after at most some steps."""
    H = kernel()
    y = H @ bump() + 1e-2 * np.random.default_rng(1).standard_normal(48)
    path = ConstrainedPath(SVDPath(LinearProblem.whitened(H, y)), [NonNegative()])
    return path.prepare(1e-4).solve(y, cap=steps)


def whole(problem: LinearProblem, **settings) -> tuple[Flag, ...]:
    """Flags of an estimate from the operator and the data of a problem, noise level not known."""
    return StaticInversion(problem.H, **settings).estimate(problem.y).flags


TOTAL = np.ones((1, 48)) / 48
FORCE = ReferenceWrench([float(bump().mean())], std=0.01, C=TOTAL, labels=("F",))

CASES = [
    Case(
        "E102",
        lambda: refused(lambda: StaticInversion(np.diag([1.0, 2.0, 3.0]))),
        lambda: refused(lambda: StaticInversion(np.diag([1.0, 2.0, 3.0]) + 0.01)),
        r"none of its 6 off-diagonal entries.*among 3 loads",
    ),
    Case(
        "W106",
        lambda: guards.collect([guards.nodal_as_pressure("nodal", "Pa")]),
        lambda: guards.collect([guards.nodal_as_pressure("patches", "Pa"), guards.nodal_as_pressure("nodal", "N")]),
        r"nodal forces scale with element size.*= Pa \(threshold N\)",
    ),
    Case(
        "W107",
        lambda: flags(),
        lambda: flags(kernel(n=10)),
        r"n rose from 24 to 48; modes above noise stayed \d+",
    ),
    Case(
        "W107", lambda: flags(), lambda: flags(penalty="gradient"), r"stayed", "silent where a penalty ties neighbours"
    ),
    Case("W108", lambda: pad(0.47), lambda: pad(0.3), r"\d+ % too stiff at nu = 0\.47.*= 0\.47 \(threshold 0\.45\)"),
    Case("E109", lambda: refused(lambda: pad(0.495)), lambda: refused(lambda: pad(0.48)), r"% too stiff.*0\.495"),
    Case("E109", lambda: pad(0.495, ("E109",)), lambda: pad(0.3), r"allowed by the user", "allowed"),
    Case("W203", lambda: markers(True), lambda: markers(False), r"nominal m = 40, effective m = \d\.\d, rank .* 10"),
    Case(
        "W304",
        lambda: flags(penalty=None, allow=["E306"]),
        lambda: flags(),
        r"i\* = \d+ recoverable modes of 48; effective degrees of freedom 48",
    ),
    Case(
        "E306",
        lambda: refused(lambda: flags(kernel(m=20), penalty=None)),
        lambda: refused(lambda: flags(kernel(n=8), penalty=None)),
        r"rank \d+ of 48 unknowns from 20 sensors",
    ),
    Case(
        "E306",
        lambda: refused(lambda: flags(kernel() - kernel().mean(axis=1, keepdims=True), penalty="gradient")),
        lambda: refused(lambda: flags(penalty="gradient")),
        r"constant",
        "null spaces that meet",
    ),
    Case(
        "W307",
        lambda: flags(choice=Absolute(3.0)),
        lambda: flags(choice=0.03),
        r"lambda 3 is absolute \(relative [\d.e-]+\)",
    ),
    Case(
        "W308",
        lambda: flags(constraints=[Bounds(upper=0.0)]),
        lambda: flags(constraints=[NonNegative()]),
        r"raise the residual by [\d.]+ times the noise",
    ),
    Case(
        "E309",
        lambda: refused(lambda: flags(constraints=[NonNegative(), Resultant(TOTAL, [-1.0])])),
        lambda: refused(lambda: flags(constraints=[NonNegative(), Resultant(TOTAL, [1.0])])),
        r"-1",
    ),
    Case(
        "W310",
        lambda: flags(choice=5.0),
        lambda: flags(),
        r"[\d.]+ effective degrees of freedom are left of \d+",
    ),
    Case(
        "W403",
        lambda: whole(coloured(0).problem),
        lambda: whole(coloured(0, "white").problem),
        r"the noise is correlated: ",
    ),
    Case(
        "W404",
        lambda: flags(kernel(m=24), choice="dof_discrepancy"),
        lambda: flags(kernel(m=24), choice="dof_discrepancy", noise_source=NoiseSource("quiet", white=True)),
        r"noise modes that were tested = \d+ \(threshold 40\)",
    ),
    Case(
        "W405",
        lambda: flags(kernel(m=24), noise=False),
        lambda: flags(kernel(m=24)),
        r"not testable: 1\d noise modes",
    ),
    Case(
        "W411",
        lambda: whole(in_the_null_space()[0].problem, penalty="second_difference"),
        lambda: whole(in_the_null_space()[0].problem),
        r"null-space",
    ),
    Case("W409", lambda: per_frame(False), lambda: per_frame(True), r"3 frames, [\d.]+ decades"),
    Case(
        "W410",
        lambda: guards.collect([guards.stopped(capped(1), 1e-3, 48)]),
        lambda: guards.collect([guards.stopped(capped(200), 1e-3, 48)]),
        r"stopped after 1 steps.*residual is [\d.]+ times the noise level",
    ),
    Case("N701", lambda: validated(FORCE), lambda: validated(FORCE, Known(bump())), r"Necessary, not sufficient"),
]


def test_reactions_are_never_loads():
    """E104: a load at a support is refused, and reactions come from their own method."""
    beam = beams.cantilever(length=1.0, EI=10.0, mass_per_length=1.0, elements=4)
    assert of("E104", refused(lambda: ForwardModel(beam, [sensors.Displacement("4+Z")], [loads.Point("0+Z")])))
    model = ForwardModel(beam, [sensors.Displacement("4+Z")], [loads.Point("4+Z")])
    u = model.factor.solve(model.loads[0].column(beam)[beam.free] * 3.0)
    assert beam.reactions(u)[0] == pytest.approx(-3.0)


@pytest.mark.parametrize("codes", [["E102"], ["LID-e102"]])
def test_a_refusal_that_is_allowed_stays_as_a_flag(codes):
    found = StaticInversion(np.diag([1.0, 2.0]), noise=0.1, allow=codes).estimate([1.0, 2.0])
    assert "E102" in found.codes
