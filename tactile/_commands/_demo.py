"""A demonstration of force maps that needs no file: simulated, photographed, rebuilt, and compared with the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid._commands import require_outputs
from structures.errors import InputError
from structures.files._storage import replace

from .._arrays import Array
from .._closed.presses import Press, press_and_slide
from .._pad import padfile
from .._pad.pad import Pad
from ..metrics._measures import cosine as cosine_of
from ..vision._images import Scene, grid, installed
from ._chain import Reconstruction, data, reconstruct, write_all
from ._chain import text as in_words

FORCE, SHEAR, RADIUS, TRAVEL = 0.25, 0.08, 3e-3, 1e-3  # N, N, m, m: strains stay below 10 %
UNLOADED, LOADED = 6, 12  # frames
ROWS, COLUMNS, PITCH, DOT = 20, 26, 0.9e-3, 0.22e-3  # markers; m
BLUR, GREY = 1.0, 2.0  # px, grey levels


@dataclass(frozen=True)
class Demonstration:
    """What the demonstration found, and what was true.

    `rows` are name, estimate and truth of what was compared, in the strongest frame; `numbers` as ratios and errors.
    """

    reconstruction: Reconstruction
    rows: list[tuple[str, str, str]]
    numbers: dict[str, float]
    written: list[str]

    @property
    def data(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {**data(self.reconstruction), "against_truth": self.numbers, "written": self.written}


def presses() -> list[Press]:
    """The loaded frames: a press that grows, then shear while it slides."""
    return press_and_slide(force=FORCE, shear=(SHEAR, 0.0), radius=RADIUS, travel=(TRAVEL, 0.0), frames=LOADED)


def demo(
    folder: str | Path = "tactile-demo", *, seed: int = 0, progress: Callable[[float, str], None] | None = None
) -> Demonstration:
    """Simulate, rebuild and compare; leave images, depth maps, pad file, map, picture, report and video in a folder.

    The truth comes from the kernels of the bonded layer, the maps from the images and from depth maps with noise (of
    `seed`): the inversion knows neither the presses nor their shape.
    """
    tell = progress or (lambda fraction, text: None)
    files = _files(Path(folder))
    require_outputs({name: path for name, path in files.items() if name != "frames"})
    truth = presses()
    simulate(files["frames"], files["depth"], files["pad"], truth, seed, lambda f, text: tell(0.3 * f, text))
    found = reconstruct(
        files["frames"], files["pad"], depth=files["depth"], unloaded=str(UNLOADED),
        progress=lambda f, text: tell(0.3 + 0.5 * f, text),
    )  # fmt: skip
    tractions, wrenches = known(truth, found.pad)
    rows, numbers = compared(found, truth[found.strongest - UNLOADED])
    written = write_all(
        found, files["map"], report=files["report"], plot=files["plot"], video=files["video"], truth=tractions,
        wrenches=wrenches, compared=rows, progress=lambda f, text: tell(0.8 + 0.2 * f, text),
    )  # fmt: skip
    return Demonstration(found, rows, numbers, [*written, *(str(files[n]) for n in ("pad", "frames", "depth"))])


def _files(folder: Path) -> dict[str, Path]:
    """Where everything goes; the video is a GIF where OpenCV is not installed."""
    frames = folder / "frames"
    try:
        frames.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("the folder cannot be made", where=str(folder), found=error.strerror or error) from error
    names = {"pad": "pad.toml", "depth": "depth.npy", "map": "map.h5", "plot": "map.png", "report": "map.html"}
    names["video"] = "map.mp4" if installed() else "map.gif"
    return {"frames": frames, **{key: folder / name for key, name in names.items()}}


# -- simulation -------------------------------------------------------------------------------------------------------
def simulate(
    frames: Path, depth: Path, pad_file: Path, truth: list[Press], seed: int, tell: Callable[[float, str], None]
) -> None:
    """Write the pad file, images and depth maps of the unloaded and the loaded pad."""
    replace(pad_file, padfile.EXAMPLE.encode())
    settings = padfile.read(pad_file)
    pad = Pad.from_settings(settings)
    noise = np.random.default_rng(seed)
    for old in frames.glob("frame*.png"):  # those of a demonstration that was longer
        old.unlink()
    maps = []
    shown: list[Press | None] = [*[None] * UNLOADED, *truth]
    for k, press in enumerate(shown):
        replace(frames / f"frame{k + 1:03d}.png", _photograph(settings, pad, press, noise))
        maps.append(_depth(settings, pad, press, noise))
        tell((k + 1) / len(shown), f"photographing frame {k + 1}")
    replace(depth, _npy(np.array(maps, np.float32)))


def markers() -> Array:
    """Places of the dots at rest (N, 2) in m."""
    return grid(ROWS, COLUMNS, PITCH)


def _photograph(settings: padfile.SensorFile, pad: Pad, press: Press | None, noise: np.random.Generator) -> bytes:
    """PNG file of a frame."""
    from PIL import Image

    rest = markers()
    u = np.zeros((len(rest), 3)) if press is None else press.displacement(pad.layer, rest)
    scene = Scene(radius=DOT, blur=BLUR, noise=GREY)
    assert settings.view is not None
    image = scene.photograph(settings.view, np.column_stack([rest + u[:, :2], u[:, 2]]), seed=noise, exact=False)
    buffer = BytesIO()
    Image.fromarray(image).save(buffer, format="PNG", compress_level=3)
    return buffer.getvalue()


def _depth(settings: padfile.SensorFile, pad: Pad, press: Press | None, noise: np.random.Generator) -> Array:
    """Numbers of a depth map of the whole pad, with the noise that the pad file states."""
    kind = settings.depth
    assert kind is not None
    counts = [round(side / kind.pixel) for side in pad.size]
    x, y = ((np.arange(n) - (n - 1) / 2) * kind.pixel for n in counts)
    motion = np.zeros((len(y), len(x)))
    if press is not None:
        places = np.array(np.meshgrid(x, y)).reshape(2, -1).T
        motion = press.displacement(pad.layer, places)[:, 2].reshape(motion.shape)
    return (motion + kind.noise * noise.standard_normal(motion.shape)) / kind.factor


def _npy(array: NDArray[Any]) -> bytes:
    buffer = BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


# -- comparison -------------------------------------------------------------------------------------------------------
def known(truth: list[Press], pad: Pad) -> tuple[Array, Array]:
    """Tractions (frames, P, 3) in Pa and wrenches (frames, 6) of all frames, the unloaded ones first."""
    nodes = pad.nodes2d
    tractions = [np.zeros((len(nodes), 3))] * UNLOADED + [press.traction(nodes) for press in truth]
    wrenches = [np.zeros(6)] * UNLOADED + [press.resultant() for press in truth]
    return np.array(tractions), np.array(wrenches)


def compared(found: Reconstruction, press: Press) -> tuple[list[tuple[str, str, str]], dict[str, float]]:
    """Resultant, peak, radius and shape of the strongest frame against the press behind it."""
    one = found.map.frame(found.strongest)
    resultant, contact, vector = one.resultant(), one.contact(), np.array(press.vector)
    error = float(np.linalg.norm(resultant.value - vector) / np.linalg.norm(vector))
    cosine = cosine_of(one.traction(), press.traction(found.pad.nodes2d), one.areas)
    true = ", ".join(f"{x + 0.0:.4g}" for x in vector)
    rows = [
        ("force on the pad", f"{resultant}", f"({true}) N: error {error:.1%}"),
        ("peak pressure", f"{1e-3 * contact.peak:.3g} kPa", f"{1e-3 * press.peak:.3g} kPa"),
        ("contact radius", f"{1e3 * contact.radius:.3g} mm", f"{1e3 * press.radius:.3g} mm"),
        ("cosine of the field", f"{cosine:.4f}", "1"),
    ]
    numbers = {
        "resultant_error": error,
        "peak_ratio": contact.peak / press.peak,
        "radius_ratio": contact.radius / press.radius,
        "cosine": cosine,
    }
    return rows, numbers


def text(done: Demonstration) -> str:
    """The whole story as lines."""
    folder = Path(done.written[0]).parent
    width = max(len(name) for name, _, _ in done.rows)
    story = f"A press of {FORCE:g} N, then {SHEAR:g} N of shear, on a gel pad: simulated by the kernels of the layer"
    names = f"{folder / 'frames'} --pad {folder / 'pad.toml'} --depth {folder / 'depth.npy'}"
    lines = [
        f"{story}, photographed with {GREY:g} grey levels of noise, rebuilt from the images.",
        in_words(done.reconstruction),
        "against the truth, strongest frame:",
        *(f"  {name:{width}s}  {estimate}  truth {true}" for name, estimate, true in done.rows),
        f"written: {', '.join(done.written)}",
        "the same from the files, as from your own:",
        f"  loadid tactile {names} --unloaded {UNLOADED} -o map.h5 --plot map.png",
    ]
    return "\n".join(lines)
