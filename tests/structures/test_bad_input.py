"""What a newcomer types by mistake is refused in words: what, where, what was found, what is expected, what to do."""

import ast
import inspect
from pathlib import Path

import numpy as np
import pytest

from structures import ForwardModel, ImpulseModel, InputError, StateSpace, Structure, beams, chains, damping, plates
from structures._system.loads import MovingPoint, Patch, Point
from structures._system.sensors import Displacement, StrainGauge

FLAT = beams.Section.rectangle(0.04, 0.008)
steel = beams.materials.steel
BEAM = {"length": 1.2, "section": FLAT, "material": steel, "elements": 6}
PLATE = {"lengths": (1.0, 0.8), "thickness": 4e-3, "material": steel, "elements": (3, 3)}
FACTORIES = (beams.cantilever, beams.simply_supported, beams.clamped, beams.free)


def beam(**changed):
    return lambda: beams.cantilever(**{**BEAM, **changed})


def plate(**changed):
    return lambda: plates.plate(**{**PLATE, **changed})


def chain(**changed):
    return lambda: chains.chain(**{"masses": [1.0, 2.0], "springs": 5.0, **changed})


def model(structure, **settings):
    return lambda: ForwardModel(structure, [Displacement("1+Z")], [Point("2+Z")], **settings)


WRONG = {
    "length none": (beam(length=None), "length must be positive"),
    "length array": (beam(length=np.array([1.0, 2.0])), "length must be positive"),
    "length text": (beam(length="1.2"), "length must be positive"),
    "length nan": (beam(length=np.nan), "length must be positive"),
    "length bool": (beam(length=True), "length must be positive"),
    "origin text": (beam(origin="a"), "origin must be one finite number"),
    "origin nan": (beam(origin=np.nan), "origin must be one finite number.*found: nan"),
    "section text": (beam(section="rect"), "no section.*Section.rectangle"),
    "material text": (beam(material="steel"), "no material.*materials.steel"),
    "EI text": (beam(section=None, material=None, EI="1", mass_per_length=1.0), "EI must be positive"),
    "EI array": (beam(section=None, material=None, EI=[1.0], mass_per_length=1.0), "EI must be positive"),
    "tension text": (beam(tension="a"), "tension must be one finite number"),
    "tension none": (beam(tension=None), "tension must be one finite number"),
    "tension raises": (beam(tension=lambda x: 1 / 0), "tension is no function of x.*ZeroDivisionError"),
    "tension arguments": (beam(tension=lambda: 1.0), "tension is no function of x"),
    "tension text value": (beam(tension=lambda x: "a"), "tension is no function of x"),
    "tension nan": (beam(tension=lambda x: np.nan), "tension is no function of x"),
    "elements huge": (beam(elements=10**9), "no number of elements.*from 1 to 100000"),
    "elements float": (beam(elements=4.5), "no number of elements"),
    "elements zero": (beam(elements=0), "no number of elements"),
    "ends unhashable": (lambda: beams.beam(left=["pinned"], right="free", **BEAM), "unknown end"),
    "damping text": (beam(damping="2%"), r"no damping.*damping.Modal\(0.02\)"),
    "damping nan": (beam(damping=np.nan), "no damping"),
    "damping in percent": (beam(damping=2.0), "0.02 for 2 %"),
    "Modal text": (lambda: damping.Modal("2%"), "no damping ratio"),
    "Modal number as text": (lambda: damping.Modal("0.02"), "no damping ratio"),
    "Modal table": (lambda: damping.Modal([[0.02]]), "no damping ratio"),
    "Rayleigh text": (lambda: damping.Rayleigh("a"), "alpha must not be negative"),
    "Rayleigh ratios": (lambda: damping.Rayleigh.from_ratios("a", 0.01, 2, 0.02), "f1 must be one finite number"),
    "Section text": (lambda: beams.Section.rectangle("40 mm", 0.008), "width must be positive"),
    "Material text": (lambda: beams.Material(E="210 GPa", rho=7850), "E must be positive"),
    "Material nu": (lambda: beams.Material(E=210e9, rho=7850, nu=None), "Poisson"),
    "section deeper than long": (beam(section=beams.Section.rectangle(0.04, 0.8)), "too deep.*check the units"),
    "plate lengths number": (plate(lengths=1.0), "lengths must be two finite numbers"),
    "plate lengths three": (plate(lengths=(1, 2, 3)), "lengths must be two finite numbers"),
    "plate lengths text": (plate(lengths="ab"), "lengths must be two finite numbers"),
    "plate lengths negative": (plate(lengths=(1.0, -1.0)), "length must be positive"),
    "plate prestress": (plate(prestress=5.0), "prestress must be two finite numbers"),
    "plate origin": (plate(origin=1.0), "origin must be two finite numbers"),
    "plate origin nan": (plate(origin=(np.nan, 0)), r"origin must be two finite numbers.*found: \(nan, 0\)"),
    "plate material": (plate(material=None), "no material"),
    "plate thickness": (plate(thickness="4 mm"), "thickness must be positive"),
    "plate too thick": (plate(thickness=0.3), "too thick"),
    "plate elements text": (plate(elements="4"), "no number of elements"),
    "plate elements three": (plate(elements=(4, 4, 4)), "one or two integers"),
    "plate elements huge": (plate(elements=(1000, 1000)), "too many elements"),
    "plate edges": (plate(edges=None), "unknown edges"),
    "chain masses text": (chain(masses="ab"), "masses are no numbers"),
    "chain masses numeral": (chain(masses="12"), "masses are no numbers"),
    "chain masses none": (chain(masses=None), "masses"),
    "chain springs text": (chain(springs="k"), "springs are no numbers"),
    "chain ragged": (chain(masses=[[1.0], [1.0, 2.0]]), "masses are no numbers"),
    "oscillator": (lambda: chains.oscillator(mass="m", stiffness=1.0), "masses are no numbers"),
    "model of nothing": (model(None), "no structure.*Structure.from_matrices"),
    "model of a matrix": (model(np.eye(3)), "no structure"),
    "model band": (model(beams.cantilever(**BEAM), band="wide"), "band must be positive"),
    "impulse step": (lambda: ImpulseModel(np.ones(4), "a", kind="held"), "step must be positive.*found: 'a'"),
    "state space step": (lambda: StateSpace(0.5, 1, 1, 0, None), "step must be positive"),
    "patch span": (lambda: Patch(x=5.0), "no span"),
    "patch text": (lambda: Patch(x="ab"), "no span"),
    "moving": (lambda: MovingPoint("path"), "no path"),
    "fibre text": (lambda: StrainGauge(at=0.1, fibre="c"), "fibre"),
    "gauge length": (lambda: StrainGauge(at=0.1, fibre=1e-3, length="3 mm"), "gauge length"),
    "gauge angle": (lambda: StrainGauge(at=0.1, fibre=1e-3, angle="x"), "angle"),
    "mass text": (lambda: beams.cantilever(**BEAM).with_mass("3+Z", "1 kg"), "mass must be positive"),
    "factor text": (lambda: beams.cantilever(**BEAM).scaled("mass", "2"), "factor must be positive"),
    "parameter list": (lambda: beams.cantilever(**BEAM).scaled(["mass"], 2.0), "no such parameter"),
    "matrices none": (lambda: Structure.from_matrices(None), "matrix K"),
    "places text": (lambda: Structure.from_matrices(np.eye(2), coordinates=["a", "b"]), "coordinates"),
}


@pytest.mark.parametrize("name", WRONG)
def test_refused_in_words(name):
    make, words = WRONG[name]
    with pytest.raises(InputError, match=words) as error:
        make()
    assert error.value.where
    assert error.value.found is not None
    assert error.value.expected is not None
    assert error.value.hint


@pytest.mark.parametrize("build", FACTORIES)
def test_settled_ends(build):
    """The four beams take what beam() takes, ends apart; help() shows it, and an end is refused by name."""
    kept = [name for name in inspect.signature(beams.beam).parameters if name not in ("left", "right")]
    assert list(inspect.signature(build).parameters) == kept
    with pytest.raises(InputError, match=rf"the ends of beams.{build.__name__} are settled.*left='pinned'"):
        build(left="pinned", **BEAM)
    with pytest.raises(TypeError, match="unexpected keyword"):
        build(colour="red", **BEAM)


@pytest.mark.parametrize("ratio", [0.02, np.float64(0.02), np.array(0.02)])
def test_a_number_is_the_damping_ratio_of_every_mode(ratio):
    for s in (beam(damping=ratio)(), plate(damping=ratio)(), chain(damping=ratio)(), beam()().with_damping(ratio)):
        assert s.damping == damping.Modal(0.02)
    assert Structure.from_matrices(np.eye(2), np.eye(2), damping=0.02).damping == damping.Modal(0.02)


def test_one_number_of_elements_serves_both_sides():
    assert plate(elements=4)().digest == plate(elements=(4, 4))().digest


@pytest.mark.parametrize("times", [1.0, -1.0, 1.2])
def test_a_gauge_on_the_surface_is_read(times):
    StrainGauge(at=0.1, fibre=times * FLAT.c).row(beam()())
    StrainGauge(at=(0.1, 0.2), fibre=times * 2e-3).row(plate()())


@pytest.mark.parametrize("times", [2.0, -2.0])
def test_a_gauge_outside_the_section_is_refused(times):
    """The full height instead of half of it is the usual slip."""
    for s, at, outer in ((beam()(), 0.1, FLAT.c), (plate()(), (0.1, 0.2), 2e-3)):
        with pytest.raises(InputError, match="outside the section"):
            StrainGauge(at=at, fibre=times * outer).row(s)
    bare = beams.cantilever(length=1.2, EI=1.0, mass_per_length=1.0)
    StrainGauge(at=0.1, fibre=times * FLAT.c).row(bare)  # no section is known


def test_stocky_but_possible():
    beam(section=beams.Section.rectangle(0.04, 0.5))()
    plate(thickness=0.25)()


ROOMS = (
    "_model", "_channels", "errors", "units", "_system/structure", "_system/checks", "_system/damping",
    "_system/factor", "_system/fields", "_system/sensors", "_system/loads", "_elements/members", "_elements/beams",
    "_elements/chains", "_elements/plates", "_models/reduction", "_models/discretise", "_models/forward",
    "_models/statespace", "_models/arrays",
)  # fmt: skip


@pytest.mark.parametrize("room", ROOMS)
def test_every_refusal_says_where_found_expected_and_what_to_do(room):
    source = Path(beams.__file__).parents[1] / f"{room}.py"
    for call in ast.walk(ast.parse(source.read_text())):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "InputError":
            stated = {word.arg for word in call.keywords}
            assert {"where", "found", "expected", "hint"} <= stated, f"{source.name}, line {call.lineno}"
