"""``loadid tactile``: contact force maps from marker images, or a demonstration that needs no file."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loadid.commands import Command, emit, names
from loadid.commands._arguments import UsageError, choice, positive, seed
from structures.errors import InputError

from ..pad import padfile

if TYPE_CHECKING:
    from ..closed.presses import Press
    from ..pad.pad import Pad
    from ._chain import Reconstruction


Array = NDArray[np.float64]
FORCE, SHEAR, RADIUS, TRAVEL = 0.25, 0.08, 3e-3, 1e-3  # N, N, m, m: strains stay below 10 %
UNLOADED, LOADED = 6, 18  # frames
ROWS, COLUMNS, PITCH, DOT = 20, 26, 0.9e-3, 0.22e-3  # markers; m
BLUR, GREY = 1.0, 2.0  # px, grey levels


@dataclass(frozen=True)
class Demonstration:
    """What the demonstration found, and what was true.

    Parameters
    ----------
    found : Reconstruction
    rows : list of (str, str, str)
        Name, estimate and truth of what was compared, in the strongest frame.
    numbers : dict
        The same as ratios and errors.
    written : list of str
    """

    found: Reconstruction
    rows: list[tuple[str, str, str]]
    numbers: dict[str, float]
    written: list[str]

    @property
    def data(self) -> dict[str, Any]:
        """All of it, for JSON."""
        from ._output import data

        return {**data(self.found), "against_truth": self.numbers, "written": self.written}


def presses() -> list[Press]:
    """The loaded frames: a press that grows, then shear while it slides."""
    from ..closed.presses import press_and_slide

    return press_and_slide(force=FORCE, shear=(SHEAR, 0.0), radius=RADIUS, travel=(TRAVEL, 0.0), frames=LOADED)


def demo(
    folder: str | Path = "tactile-demo", *, seed: int = 0, progress: Callable[[float, str], None] | None = None
) -> Demonstration:
    """Simulate, rebuild and compare; leave images, depth maps, pad file, map, picture, report and video.

    The truth comes from the kernels of the bonded layer, the maps from the images and from depth maps with noise: the
    inversion knows neither the presses nor their shape.

    Parameters
    ----------
    folder : path
        Made where it is not there.
    seed : int
        Of the noise.
    progress : callable, optional

    Raises
    ------
    InputError
        If the folder cannot be made or written.
    """
    from loadid.commands._outputs import require_outputs

    from ._chain import reconstruct
    from ._output import write_all

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
    from ..vision.images import installed

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
    from structures.files.storage import replace

    from ..pad.pad import Pad

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
    from ..vision.images import grid

    return grid(ROWS, COLUMNS, PITCH)


def _photograph(settings: padfile.SensorFile, pad: Pad, press: Press | None, noise: np.random.Generator) -> bytes:
    """PNG file of a frame."""
    from io import BytesIO

    from PIL import Image

    from ..vision.images import Scene

    rest = markers()
    u = np.zeros((len(rest), 3)) if press is None else press.displacement(pad.layer, rest)
    scene = Scene(radius=DOT, blur=BLUR, noise=GREY)
    assert settings.view is not None
    image = scene.photograph(settings.view, np.column_stack([rest + u[:, :2], u[:, 2]]), seed=noise)
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


def _npy(array: NDArray) -> bytes:
    from io import BytesIO

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
    from .. import metrics

    one = found.map.frame(found.strongest)
    resultant, contact, vector = one.resultant(), one.contact(), np.array(press.vector)
    error = float(np.linalg.norm(resultant.value - vector) / np.linalg.norm(vector))
    cosine = metrics.cosine(one.traction(), press.traction(found.pad.nodes2d), one.areas)
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
    from ._output import text as told

    folder = Path(done.written[0]).parent
    width = max(len(name) for name, _, _ in done.rows)
    story = f"A press of {FORCE:g} N, then {SHEAR:g} N of shear, on a gel pad: simulated by the kernels of the layer"
    names = f"{folder / 'frames'} --pad {folder / 'pad.toml'} --depth {folder / 'depth.npy'}"
    lines = [
        f"{story}, photographed with {GREY:g} grey levels of noise, rebuilt from the images.",
        told(done.found),
        "against the truth, strongest frame:",
        *(f"  {name:{width}s}  {estimate}  truth {true}" for name, estimate, true in done.rows),
        f"written: {', '.join(done.written)}",
        "the same from the files, as from your own:",
        f"  loadid tactile {names} --unloaded {UNLOADED} -o map.h5 --plot map.png",
    ]
    return "\n".join(lines)


DEMO = "demo"
SENSORS = ("multilayer", "gelslim")
EXAMPLES = """\
examples:
  simulate a press and a slide, rebuild it, and leave images, depth maps, pad.toml, map, picture, report and video:
    loadid tactile demo --out tactile-demo
  the same from those files, as from your own:
    loadid tactile tactile-demo/frames --pad tactile-demo/pad.toml --depth tactile-demo/depth.npy \\
        --unloaded 6 -o map.h5 --plot map.png --report map.html --video map.mp4

INPUT is a folder of images, an NPY or NPZ stack (frames, rows, columns), a video, or marker motions: CSV with the
header frame,id,x,y[,z], CSV of gsrobotics, or NPY (frames, markers, 2 or 3). A folder that is called demo is ./demo.
In-plane markers alone hardly tell the pressure: give --depth, or read what flag N606 says.
"""
REQUIRED = (("pad", "--pad PAD.toml"), ("output", "-o MAP.h5"))
ONLY_DEMO = ("out", "seed")


def span(text: str) -> tuple[int, int]:
    """``"20:80"`` as first and last frame, from 1, both included."""
    low, colon, high = text.partition(":")
    ends = tuple(int(x) if x.strip().isascii() and x.strip().isdecimal() else 0 for x in (low or "1", high))
    last = ends[1] if high.strip() else 10**9
    if not colon or ends[0] < 1 or last < ends[0] or (high.strip() and ends[1] < 1):
        raise ArgumentTypeError(f"{text!r} is no span FIRST:LAST of frames, from 1, both included")
    return ends[0], last


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("input", metavar="INPUT", help="images, stack, video or marker motions; or the word demo")
    parser.add_argument("--pad", metavar="PAD.toml", help="pad, camera, markers, depth map and contact")
    parser.add_argument("-o", "--output", metavar="MAP.h5", help="result file to write")
    parser.add_argument("--report", metavar="PAGE.html", help="also write a report")
    parser.add_argument("--plot", metavar="PICTURE", help="also write a picture of the strongest frame (png, svg, pdf)")
    parser.add_argument("--video", metavar="VIDEO", help="also write a video (.mp4 with OpenCV, .gif without)")
    parser.add_argument("--depth", metavar="MAPS", help="depth maps, one per frame: NPY, NPZ or a folder")
    parser.add_argument(
        "--unloaded", metavar="N|SOURCE",
        help="frames of the untouched pad: how many the input begins with, or a source of their own (default: the "
        "first frame where the noise is stated, else the first five)",
    )  # fmt: skip
    parser.add_argument("--sensor", choices=SENSORS, default=SENSORS[0], help="default %(default)s")
    parser.add_argument("--friction", type=positive, metavar="MU", help="tractions stay in their friction cone")
    parser.add_argument("--no-pull", action="store_true", help="pressures are not negative")
    parser.add_argument(
        "--lam",
        type=choice,
        metavar="LAMBDA|RULE",
        help="relative lambda, or its rule; default upre, or gcv where the noise is above, on the strongest frames",
    )
    parser.add_argument("--frames", type=span, metavar="A:B", help="frames to invert, from 1; all before are tracked")
    parser.add_argument("--rate", type=positive, metavar="HZ", help="frames a second of the camera")
    parser.add_argument(
        "--allow", type=names, default=[], metavar="CODE,...", help="refusals to override (E603, ...); always printed"
    )
    parser.add_argument("--out", metavar="DIR", help="demo: folder to write to (default: tactile-demo)")
    parser.add_argument("--seed", type=seed, metavar="N", help="demo: of the noise (default: 0)")


def _run(args: Namespace) -> int:
    return _demo(args) if args.input == DEMO else _map(args)


def _demo(args: Namespace) -> int:
    """The demonstration; options of a map would be silently without effect."""
    from loadid.commands._outputs import Bar

    given = [name for name in _options(args) if name not in ONLY_DEMO]
    if given:
        raise UsageError(f"the demo takes --out and --seed only, not {', '.join(_spelled(n) for n in given)}")

    with Bar() as bar:
        done = demo(args.out or "tactile-demo", seed=args.seed or 0, progress=bar)
    emit(args, done.data, text(done))
    return 0


def _map(args: Namespace) -> int:
    from loadid.codes import known_codes
    from loadid.commands._outputs import Bar, require_outputs

    missing = [words for name, words in REQUIRED if getattr(args, name) is None]
    if missing:
        raise UsageError(f"needed too: {', '.join(missing)} (see loadid tactile --help)")
    given = [name for name in ONLY_DEMO if getattr(args, name) is not None]
    if given:
        raise UsageError(f"{', '.join(_spelled(n) for n in given)} is for the demo only")
    outputs = {"-o": args.output, "--report": args.report, "--plot": args.plot, "--video": args.video}
    inputs = [args.input, args.pad, args.depth]
    require_outputs(outputs, inputs)
    if args.video is not None:
        from ..results.film import require_video

        require_video(args.video)
    from ._chain import reconstruct
    from ._output import data, text, write_all

    with Bar() as bar:
        found = reconstruct(
            args.input, args.pad, depth=args.depth, unloaded=args.unloaded, sensor=args.sensor, friction=args.friction,
            no_pull=args.no_pull, lam=args.lam, frames=args.frames, rate=args.rate,
            allow=known_codes(args.allow, where="--allow"), progress=bar,
        )  # fmt: skip
        written = write_all(
            found, args.output, report=args.report, plot=args.plot, video=args.video, fps=args.rate, progress=bar
        )
    emit(args, {**data(found), "written": written}, f"{text(found)}\nwritten: {', '.join(written)}")
    return 0


def _options(args: Namespace) -> list[str]:
    """Options that were given."""
    named = {"pad", "output", "report", "plot", "video", "depth", "unloaded", "friction", "lam", "frames", "rate"}
    found = [name for name in sorted(named) if getattr(args, name) is not None]
    found += [name for name in ("no_pull", "allow") if getattr(args, name)]
    return found + (["sensor"] if args.sensor != "multilayer" else [])


def _spelled(name: str) -> Any:
    return "-o" if name == "output" else f"--{name.replace('_', '-')}"


command = Command("tactile", "contact force maps from images of a marked gel pad; or a demonstration", _configure, _run)
