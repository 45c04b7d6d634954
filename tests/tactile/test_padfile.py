"""Sensor files: every value with its unit, every mistake with file, table and key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from structures.errors import InputError
from tactile import Pad, Tolerances, View
from tactile._pad import padfile

BODY = '[pad]\nsize = ["6 mm", "4 mm"]\nthickness = "2 mm"\nE = "0.147 MPa"\nnu = 0.3\npitch = "1 mm"\nlayers = 3\n'


def written(folder: Path, text: str) -> Path:
    path = folder / "pad.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_example_says_what_it_says(tmp_path: Path) -> None:
    found = padfile.read(written(tmp_path, padfile.EXAMPLE))
    pad = Pad.from_settings(found)
    assert pad.size == pytest.approx((0.024, 0.024), rel=1e-12)
    assert (pad.thickness, pad.E, pad.nu, pad.layers) == pytest.approx((3e-3, 147e3, 0.3223, 4), rel=1e-12)
    assert pad.points == 25 * 25
    view = View.camera(focal=640, centre=(320, 240), distance=25e-3, depth=3e-3, gamma=1.4, tilt=np.radians(12),
                       azimuth=np.radians(17))  # fmt: skip
    places = np.array([[0.0, 0.0, 0.0], [8e-3, -6e-3, -4e-4]])
    assert found.view is not None
    assert found.view.to_pixels(places) == pytest.approx(view.to_pixels(places), abs=1e-9)
    assert found.depth is not None
    assert (found.depth.pixel, found.depth.noise) == pytest.approx((1e-4, 1e-5), rel=1e-12)
    assert found.noise is None
    assert found.contact == {"no_pull": False}


@pytest.mark.parametrize(
    "body",
    [
        'size = ["0.6 cm", "4000 um"]\nthickness = "0.002 m"\nE = "147 kPa"\npitch = "1e-1 cm"\n',
        'length_unit = "mm"\nE_unit = "MPa"\nsize = [6, 4]\nthickness = 2\nE = 0.147\npitch = 1\n',
    ],
)
def test_units_do_not_matter(tmp_path: Path, body: str) -> None:
    first = Pad.from_toml(written(tmp_path, BODY))
    other = Pad.from_toml(written(tmp_path, f"[pad]\nnu = 0.3\nlayers = 3\n{body}"))
    assert other.nodes2d == pytest.approx(first.nodes2d, abs=1e-15)
    push = np.zeros((first.points, 3))
    push[first.points // 2, 2] = -0.1
    assert other.displacements(push) == pytest.approx(first.displacements(push), rel=1e-9)


def test_outlines(tmp_path: Path) -> None:
    whole = Pad.from_toml(written(tmp_path, BODY))
    for line in ('rounded = "1.5 mm"\n', 'polygon = [["-3 mm", "-2 mm"], ["3 mm", "-2 mm"], ["-3 mm", "2 mm"]]\n'):
        cut = Pad.from_toml(written(tmp_path, BODY + line))
        assert cut.surface.areas.sum() < whole.surface.areas.sum()


def test_a_view_from_a_matrix_or_from_points(tmp_path: Path) -> None:
    H = np.array([[20.0, 1.0, 160.0], [-0.5, 21.0, 120.0], [1e-3, 0.0, 1.0]])
    xy = np.array([[-3.0, -2.0], [3.0, -2.0], [3.0, 2.0], [-3.0, 2.0], [0.5, 0.25]])
    seen = np.column_stack([xy, np.ones(5)]) @ H.T
    px = seen[:, :2] / seen[:, 2:]
    rays = 'alpha = "40 deg"\ngamma = 1.4\nazimuth = "90 deg"\n'
    matrix = f'[camera]\nhomography = {H.tolist()}\nhomography_unit = "mm"\n{rays}'
    listed = [[f"{x} mm" for x in p] for p in xy]
    points = f"[camera]\npoints = {listed}\npixels = {px.tolist()}\n{rays}"
    for text in (matrix, points):
        view = padfile.read(written(tmp_path, BODY + text)).view
        assert view is not None
        assert view.to_pad(px) == pytest.approx(1e-3 * xy, abs=1e-9)
        beta = np.arcsin(np.sin(np.radians(40)) / 1.4)  # the ray climbs along +y by tan(beta) per unit of height
        moved = view.in_plane(px, -1e-4) - 1e-3 * xy
        assert moved == pytest.approx(np.tile([0.0, -1e-4 * np.tan(beta)], (5, 1)), abs=1e-10)


def test_a_lens_beside_a_matrix(tmp_path: Path) -> None:
    lens = '[camera.lens]\nat = ["0 mm", "1 mm"]\ndistance = "20 mm"\ndepth = "0 mm"\n'
    text = f'[camera]\nhomography = {np.diag([20.0, 20.0, 1.0]).tolist()}\nhomography_unit = "mm"\n{lens}'
    view = padfile.read(written(tmp_path, BODY + text)).view
    assert view is not None
    moved = view.in_plane([[0.0, 0.0]], -1e-4)  # a straight ray from (0, 1) mm at 20 mm: slope -1/20 along y
    assert moved == pytest.approx(np.array([[0.0, 1e-4 / 20]]), abs=1e-12)


def test_noise_in_px_or_in_a_length(tmp_path: Path) -> None:
    for said, expected in (("0.02 px", (0.02, "px")), ("5 um", (5e-6, "m"))):
        found = padfile.read(written(tmp_path, f'{BODY}[markers]\nnoise = "{said}"\nunit = "mm"\n'))
        assert found.noise is not None
        assert found.noise[1] == expected[1]
        assert found.noise[0] == pytest.approx(expected[0], rel=1e-12)
        assert found.unit == 1e-3


def test_how_well_the_pad_is_known(tmp_path: Path) -> None:
    assert padfile.read(written(tmp_path, BODY)).tolerances == Tolerances()
    stated = padfile.read(written(tmp_path, f"{BODY}[tolerances]\nE = 0.1\nnu = 0.03\n")).tolerances
    assert stated == Tolerances(E=0.1, nu=0.03)
    said = padfile.EXAMPLE.replace("# [tolerances]", "[tolerances]").replace("# E = 0.1", "E = 0.1")
    assert padfile.read(written(tmp_path, said)).tolerances == Tolerances(E=0.1)


def test_depth_of_the_other_sign_and_unit(tmp_path: Path) -> None:
    text = '[depth]\npixel = "0.5 mm"\nnoise = "10 um"\nunit = "um"\npressed = "positive"\ncentre = ["1 mm", "0 mm"]\n'
    kind = padfile.read(written(tmp_path, BODY + text)).depth
    assert kind is not None
    found = kind.map([[100, 200], [0, 50]])
    assert found.values == pytest.approx(-1e-6 * np.array([[100, 200], [0, 50]]), rel=1e-12)
    assert found.at([[1.25e-3, -0.25e-3]]) == pytest.approx([-2e-4], rel=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"2 mm"', "2", "[pad] thickness: a number without its unit"),
        ('"2 mm"', '"2"', "[pad] thickness: a number without its unit"),
        ('"2 mm"', '"2 kg"', "[pad] thickness: no unit of length"),
        ('"2 mm"', '"2 px"', "[pad] thickness: no unit of length"),
        ('"2 mm"', '"-2 mm"', "[pad] thickness: thickness must be positive"),
        ('"2 mm"', '"two mm"', "[pad] thickness: no number with a unit"),
        ("thickness", "thicknes", "[pad] thickness: a key is missing ... is it thicknes, misspelt"),
        ("layers", "layer", "[pad] layer: unknown key ... did you mean layers"),
        ('"0.147 MPa"', '"0.147 mm"', "[pad] E: no unit of modulus"),
        ("nu = 0.3", "nu = 0.5", "[pad]: ... Poisson"),
        ("nu = 0.3", 'nu = "0.3"', "[pad] nu: no number"),
        ('["6 mm", "4 mm"]', '["6 mm"]', "[pad] size: no list of 2 values"),
        ("layers = 3", "layers = 3.5", "[pad] layers: no whole number"),
        ("[pad]", "[pads]", "pads: unknown table ... did you mean pad"),
        ("[pad]", "pad = 3 #", "[pad] is no table"),
        ("layers = 3", "layers = 1\ncells = 1964\nnodes = 3698", "[pad]: these element and node counts ... (Euler's"),
        ("layers = 3", "layers = 1\ncells = 1964", "[pad] nodes: counts belong together"),
        ("nu = 0.3", "nu =", "the pad file cannot be read"),
        ("[pad]", "[contact]\nfriction = true\n[pad]", "[contact] friction: no number"),
        ("[pad]", "[contact]\nlam = 'best'\n[pad]", "[contact] lam: unknown word"),
        ("[pad]", "[camera]\ntilt = '3 deg'\n[pad]", "[camera]: the camera is not stated"),
        ("[pad]", "[markers]\nnoise = 0.02\n[pad]", "[markers] noise: a std needs its unit"),
        ("[pad]", "[tolerances]\nE = '10 %'\n[pad]", "[tolerances] E: no number"),
        ("[pad]", "[tolerances]\nnu = 0.6\n[pad]", "[tolerances]: Tolerances, nu: nu cannot be known to this"),
        ("[pad]", "[tolerances]\nthick = 0.1\n[pad]", "[tolerances] thick: unknown key ... did you mean thickness"),
        ("[pad]", "[depth]\npixel = '1 mm'\n[pad]", "[depth] noise: a key is missing"),
    ],
)
def test_a_mistake_names_file_table_and_key(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in BODY
    path = written(tmp_path, BODY.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        Pad.from_toml(path)
    for part in (str(path), *words.split(" ... ")):
        assert part in str(caught.value)


def test_no_file_and_no_pad(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no such file.*demo"):
        padfile.read(tmp_path / "none.toml")
    with pytest.raises(InputError, match=r"\[pad\] is missing"):
        padfile.read(written(tmp_path, "[contact]\n"))
