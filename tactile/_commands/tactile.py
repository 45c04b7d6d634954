"""``loadid tactile``: contact force maps from marker images, or a demonstration that needs no file."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace, RawDescriptionHelpFormatter

from loadid._commands import Bar, Command, UsageError, choice, emit, names, positive, require_outputs, seed
from structures._flags import known_codes

from . import live

DEMO = "demo"
SENSORS = ("multilayer", "gelslim")
EXAMPLES = """\
examples:
  simulate a press and a slide, rebuild it, and leave images, depth maps, pad.toml, map, picture, report and video:
    loadid tactile demo --out tactile-demo
  the same from those files, as from your own:
    loadid tactile tactile-demo/frames --pad tactile-demo/pad.toml --depth tactile-demo/depth.npy \\
        --unloaded 6 -o map.h5 --plot map.png --report map.html --video map.mp4
  a sensor that goes on running, with a page, a state that outlives a kill, and a recording; and that played again:
    loadid tactile live --camera 0 --pad pad.toml --view 8000 --state state.h5 --record run.h5
    loadid tactile live --replay run.h5 --speed 2 --view 8000

INPUT is a folder of images, an NPY or NPZ stack (frames, rows, columns), a video, or marker motions: CSV with the
header frame,id,x,y[,z], CSV of gsrobotics, or NPY (frames, markers, 2 or 3). A folder that is called demo
or live is ./demo or ./live.
In-plane markers alone hardly tell the pressure: give --depth, or read what flag N606 says.
"""
REQUIRED = (("pad", "--pad PAD.toml"), ("output", "-o MAP.h5"))
ONLY_DEMO = ("out", "seed")
NOT_LIVE = ("output", "report", "plot", "video", "depth", "frames", "sensor", "map", *ONLY_DEMO)


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
    parser.add_argument(
        "input", metavar="INPUT", help="images, stack, video or marker motions; or the word demo, or live"
    )
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
    parser.add_argument(
        "--map", metavar="MAP.h5", help="learned map of this sensor, which answers where it knows frames like these"
    )
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
    live.configure(parser)


def _run(args: Namespace) -> int:
    if args.input == live.WORD:
        return _live(args)
    given = [n for n in live.OPTIONS if getattr(args, n) is not None and getattr(args, n) is not False]
    if given:
        raise UsageError(f"{', '.join(_spelled(n) for n in given)} is for live only: loadid tactile live ...")
    return _demo(args) if args.input == DEMO else _map(args)


def _live(args: Namespace) -> int:
    """The sensor that goes on running; options of one map would be silently without effect."""
    given = [name for name in (*_options(args), *ONLY_DEMO) if name in NOT_LIVE and getattr(args, name) is not None]
    if given:
        raise UsageError(f"live takes no {', '.join(_spelled(n) for n in given)}")
    return live.run(args)


def _demo(args: Namespace) -> int:
    """The demonstration; options of a map would be silently without effect."""
    given = [name for name in _options(args) if name not in ONLY_DEMO]
    if given:
        raise UsageError(f"the demo takes --out and --seed only, not {', '.join(_spelled(n) for n in given)}")

    from ._demo import demo, text

    with Bar() as bar:
        done = demo(args.out or "tactile-demo", seed=args.seed or 0, progress=bar)
    emit(args, done.data, text(done))
    return 0


def _map(args: Namespace) -> int:
    missing = [words for name, words in REQUIRED if getattr(args, name) is None]
    if missing:
        raise UsageError(f"needed too: {', '.join(missing)} (see loadid tactile --help)")
    given = [name for name in ONLY_DEMO if getattr(args, name) is not None]
    if given:
        raise UsageError(f"{', '.join(_spelled(n) for n in given)} is for the demo only")
    outputs = {"-o": args.output, "--report": args.report, "--plot": args.plot, "--video": args.video}
    inputs = [args.input, args.pad, args.depth, args.map]
    require_outputs(outputs, inputs)
    if args.video is not None:
        from .._results.film import require_video

        require_video(args.video)
    from ._chain import data, reconstruct, text, write_all

    with Bar() as bar:
        found = reconstruct(
            args.input, args.pad, depth=args.depth, unloaded=args.unloaded, sensor=args.sensor, friction=args.friction,
            no_pull=args.no_pull, lam=args.lam, learned=args.map, frames=args.frames, rate=args.rate,
            allow=known_codes(args.allow, where="--allow"), progress=bar,
        )  # fmt: skip
        written = write_all(
            found, args.output, report=args.report, plot=args.plot, video=args.video, fps=args.rate, progress=bar
        )
    emit(args, {**data(found), "written": written}, f"{text(found)}\nwritten: {', '.join(written)}")
    return 0


def _options(args: Namespace) -> list[str]:
    """Options that were given."""
    named = {
        "pad",
        "output",
        "report",
        "plot",
        "video",
        "depth",
        "unloaded",
        "friction",
        "lam",
        "frames",
        "rate",
        "map",
    }
    found = [name for name in sorted(named) if getattr(args, name) is not None]
    found += [name for name in ("no_pull", "allow") if getattr(args, name)]
    return found + (["sensor"] if args.sensor != "multilayer" else [])


def _spelled(name: str) -> str:
    return "-o" if name == "output" else f"--{name.replace('_', '-')}"


command = Command("tactile", "contact force maps from images of a marked gel pad; or a demonstration", _configure, _run)
