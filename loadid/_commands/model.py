"""``loadid model``: a forward model of a beam, a plate or a frame, or one that is imported, as a file."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures._advice import did_you_mean
from structures.errors import InputError

from . import Bar, Command, UsageError, emit, require_outputs
from ._imported import imported, is_fe

if TYPE_CHECKING:
    from structures._model import Model
    from structures._models.forward import ForwardModel
    from structures._system.structure import Structure

KINDS = ("beam", "plate", "frame", "import")
ENDS = ("cantilever", "simply_supported", "clamped", "free")
PAIRS = {
    "clamped free": "cantilever",
    "pinned pinned": "simply_supported",
    "clamped clamped": "clamped",
    "free free": "free",
}  # each end by its own name
SAME = {"fixed": "clamped", "hinged": "pinned"}
SENSORS = {"accelerometer": "Accelerometer", "velocity": "Velocity", "displacement": "Displacement",
           "strain": "StrainGauge"}  # fmt: skip
LOADS = {"point": "Point", "moment": "Moment"}
NUMBERS = ("fibre", "length", "angle", "noise", "highpass")
WORDS = ("x", "y", "z", "direction", "label", *NUMBERS)
SLOWEST, SLOW, FASTEST = 0.1, 100.0, 3e4  # m/s, of sound in any solid; SLOW of those denser than DENSE (kg/m^3)
DENSE, WIDE = 4000.0, 2.0
WHERE = "loadid model"
EXAMPLES = """\
examples:
  a steel cantilever with an accelerometer at node 12, hit at its tip:
    loadid model beam --length 300mm --section rectangle:40mm,10mm --material steel --damping 0.02 \\
        --sensor accelerometer:12+Z --load point:31+Z --modes 6 -o model.h5
  a wing with strain gauges, by its bending stiffness and mass:
    loadid model beam --length 6 --EI 9e5 --mass-per-length 20 --sensor strain:x=0.2,fibre=0.08 \\
        --sensor strain:x=3,fibre=0.08 --load point:x=5 -o wing.h5
  a plate; matrices of another program, in mm and N; FRFs of a universal file; a file with the same names:
    loadid model plate --lengths 0.5,0.4 --thickness 3mm --material aluminium --edges CSFS \\
        --sensor accelerometer:x=0.1,y=0.2 --load point:x=0.3,y=0.1 --modes 12 -o plate.h5
    loadid model import K.mtx M.mtx --length-unit mm --sensor displacement:3+S --load point:7+S -o model.h5
    loadid model import frfs.uff -o model.h5
  K, M and nodes of a solver, in mm, N and t, reduced to the places of sensors and loads up to 500 Hz:
    loadid model import job_STIF2.mtx job_MASS2.mtx job.inp --units mm,N --band 500 --damping 0.01 \\
        --sensor accelerometer:1204+Z --load point:77+Z -o model.h5
    loadid model --from model.toml -o model.h5

A place is a degree of freedom of the mesh (12+Z: node 12, direction +Z) or x=..., y=... in m. Numbers are SI, or have
their unit behind them: 300mm.
"""


# -- words -------------------------------------------------------------------------------------------------------------
def size(value: Any, name: str, unit: str = "m") -> float:
    """A number in SI, or with its unit: ``0.3``, ``"300mm"``, ``"300 mm"``.

    Raises
    ------
    InputError
        No number, or a unit of another kind.
    """
    from structures import units

    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    text = str(value).strip()
    cut = next((k for k in range(len(text), 0, -1) if _is_number(text[:k])), 0)
    if not cut:
        raise InputError("this is no number", where=f"{WHERE}, {name}", found=repr(value),
                         expected=f"a number in {unit}, or one with its unit")  # fmt: skip
    symbol = text[cut:].strip()
    if not symbol:
        return float(text)
    found = units.parse(symbol, where=f"{WHERE}, {name}")
    if found.dimension != units.parse(unit).dimension:
        raise InputError("a unit of another kind", where=f"{WHERE}, {name}", found=repr(text),
                         expected=f"a number in {unit}, or in a unit of that kind")  # fmt: skip
    return float(units.to_si(float(text[:cut]), found))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text[-1].isdigit() or text[-1] == "."


def sizes(value: Any, name: str) -> list[float]:
    """Several lengths: ``"0.5,0.4"``, or a list."""
    return [size(v, name) for v in (value if isinstance(value, list | tuple) else str(value).split(","))]


def section(value: Any) -> Any:
    """``"rectangle:0.04,0.01"``, ``"circle:0.02"``, ``"tube:0.05,0.003"``."""
    from structures import beams

    kind, _, rest = str(value).partition(":")
    made: dict[str, tuple[Callable[..., Any], int]] = {
        "rectangle": (beams.Section.rectangle, 2), "circle": (beams.Section.circle, 1), "tube": (beams.Section.tube, 2)
    }  # fmt: skip
    _one_of(kind, made, "section", "rectangle:WIDTH,HEIGHT, circle:DIAMETER or tube:DIAMETER,WALL")
    build, count = made[kind]
    found = sizes(rest, "section")
    if max(found, default=0.0) > WIDE and any(_is_number(part.strip()) for part in rest.split(",")):
        raise InputError(f"a section wider than {WIDE:g} m without its unit", where=f"{WHERE}, section",
                         found=repr(value), expected="sizes in m, or with their unit",
                         hint=f"{kind}:{','.join(f'{x:g}mm' for x in found)}, or the same with m")  # fmt: skip
    if len(found) != count:
        raise InputError(f"a {kind} has {count} size{'s' * (count > 1)}", where=f"{WHERE}, section", found=repr(value),
                         expected="rectangle:WIDTH,HEIGHT, circle:DIAMETER or tube:DIAMETER,WALL")  # fmt: skip
    return build(*found)


def material(value: Any) -> Any:
    """``"steel"``, ``"aluminium"``, or ``"E=70e9,rho=2700,nu=0.33"``; a table of a file too."""
    from structures import beams

    known = {"steel": beams.materials.steel, "aluminium": beams.materials.aluminium}
    if isinstance(value, str) and "=" not in value:
        _one_of(value, known, "material", "steel, aluminium, or E=...,rho=...")
        return known[value]
    given = dict(value) if isinstance(value, Mapping) else _pairs(str(value), "material")
    for name in given:
        _one_of(name, ("E", "rho", "nu"), "material", "E, rho, nu")
    if missing := [name for name in ("E", "rho") if name not in given]:
        raise InputError("the material is not complete", where=f"{WHERE}, material", found=repr(value),
                         expected=f"{', '.join(missing)} too")  # fmt: skip
    kinds = {"E": "Pa", "rho": "kg/m^3", "nu": "1"}
    made = beams.Material(**{k: size(v, f"material, {k}", kinds[k]) for k, v in given.items()})
    speed = float((made.E / made.rho) ** 0.5)
    if not (SLOWEST if made.rho < DENSE else SLOW) < speed < FASTEST:
        raise InputError("there is no such solid", where=f"{WHERE}, material",
                         found=f"E = {made.E:g} Pa, rho = {made.rho:g} kg/m^3: sound of {speed:.3g} m/s",
                         expected="E in Pa and rho in kg/m^3 (steel: 210e9 and 7850)",
                         hint="state other units behind the numbers: E=210GPa,rho=7.85g/cm^3")  # fmt: skip
    return made


def placed(text: str, known: Mapping[str, str], module: Any, option: str) -> Any:
    """A sensor or a load: ``"accelerometer:12+Z"``, ``"strain:x=0.5,fibre=0.01,label=s1"``.

    Raises
    ------
    InputError
        Another kind, a word that is none, no place.
    """
    kind, _, rest = str(text).partition(":")
    _one_of(kind, known, option, f"{', '.join(known)}, each with its place: {next(iter(known))}:12+Z or "
            f"{next(iter(known))}:x=0.5")  # fmt: skip
    parts = [p.strip() for p in rest.split(",") if p.strip()]
    dofs = [p for p in parts if "=" not in p]
    given = _pairs(",".join(p for p in parts if "=" in p), option)
    for name in given:
        _one_of(name, WORDS, f"setting of a {option}", f"a place in x, y or z, direction, label, {', '.join(NUMBERS)}")
    if bare := next((p for p in dofs if p[0].isdigit() and _is_length(p)), None):
        second = "." in bare and "x" in given  # no decimal comma stands before a number with a point
        place = f"x={given['x']},y={bare}" if second else f"x={'0.5' if given else bare}"
        raise InputError("a number without its name", where=f"{WHERE}, {option}", found=repr(text),
                         expected=f"{kind}:{place} (a place in m), or {kind}:12+Z",
                         hint="a decimal point, where the comma was one" if given and not second else "")  # fmt: skip
    at = [size(given.pop(a), f"{option} {text}, {a}") for a in "xyz" if a in given]
    if len(dofs) + bool(at) != 1:
        raise InputError("a sensor or a load has one place", where=f"{WHERE}, {option}", found=repr(text),
                         expected=f"{kind}:12+Z (node and direction), or {kind}:x=0.5")  # fmt: skip
    words = {k: (float(size(v, f"{option}, {k}", "rad" if k == "angle" else "m" if k in ("fibre", "length") else "1"))
                 if k in NUMBERS else v) for k, v in given.items()}  # fmt: skip
    words |= {"at": at[0] if len(at) == 1 else tuple(at)} if at else {}
    made: Callable[..., Any] = getattr(module, known[kind])
    try:
        return made(*dofs, **words)
    except TypeError as error:
        raise InputError(f"no such {option}", where=f"{WHERE}, {option}", found=repr(text),
                         expected=f"what a {kind} takes",
                         hint=str(error).partition("() ")[2] or str(error)) from None  # fmt: skip


def _is_length(text: str) -> bool:
    try:
        size(text, "")
    except InputError:
        return False
    return True


def _pairs(text: str, name: str) -> dict[str, Any]:
    found = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        key, sign, value = part.partition("=")
        if not sign:
            raise InputError(
                "a word without its value", where=f"{WHERE}, {name}", found=repr(part), expected="NAME=VALUE"
            )
        found[key.strip()] = value.strip()
    return found


def _one_of(word: str, words: Any, name: str, expected: str) -> None:
    if word not in words:
        more = did_you_mean(word, words).removeprefix("; ")
        raise InputError(f"there is no {name} {word!r}", where=f"{WHERE}, {name}", expected=expected, hint=more)


def _known_ends(word: Any) -> None:
    """Refuse ends that there are not; whoever names each of both is told what they are called together."""
    sides = [SAME.get(side, side) for side in str(word).lower().replace("_", "-").split("-")]
    if word not in ENDS and len(sides) == 2 and set(sides) <= {"clamped", "pinned", "free"}:
        both = PAIRS.get(" ".join(sorted(sides)))
        hint = f"did you mean {both}?" if both else f"structures.beams.beam(left={sides[0]!r}, right={sides[1]!r}, ...)"
        raise InputError(f"there is no ends {word!r}", where=f"{WHERE}, ends", expected=", ".join(ENDS), hint=hint)
    _one_of(word, ENDS, "ends", ", ".join(ENDS))


# -- the model ---------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Key:
    """A setting of a model: an option of the command line, and a name in a file."""

    kinds: tuple[str, ...]
    metavar: str
    help: str


KEYS = {
    "length": Key(("beam",), "M", "length of the beam"),
    "lengths": Key(("plate",), "X,Y", "sides of the plate"),
    "thickness": Key(("plate",), "M", "of the plate"),
    "width": Key(("frame",), "M", "of a bay of a portal frame"),
    "height": Key(("frame",), "M", "of a storey of a portal frame"),
    "bays": Key(("frame",), "N", "of the frame; default 1"),
    "storeys": Key(("frame",), "N", "of the frame; default 1"),
    "section": Key(("beam", "frame"), "SHAPE", "rectangle:WIDTH,HEIGHT, circle:DIAMETER or tube:DIAMETER,WALL"),
    "material": Key(KINDS, "NAME", "steel, aluminium, or E=70e9,rho=2700,nu=0.33; of an import: of its mesh"),
    "EI": Key(("beam",), "NM2", "bending stiffness in N m^2, in place of section and material"),
    "mass_per_length": Key(("beam",), "KG/M", "with --EI"),
    "tension": Key(("beam",), "N", "axial tension"),
    "ends": Key(("beam",), "NAME", f"{', '.join(ENDS)}; default cantilever"),
    "edges": Key(("plate",), "SSSS", "of each edge: S simple, C clamped, F free; default SSSS"),
    "elements": Key(("beam", "plate", "frame"), "N", "of the mesh; for a plate one number or NX,NY"),
    "dofs": Key(("import",), "FILE", "table of the rows: node, direction[, x, y, z]"),
    "supports": Key(("import",), "DOF,...", "degrees of freedom that are held"),
    "length_unit": Key(("import",), "UNIT", "of the matrices; default m"),
    "force_unit": Key(("import",), "UNIT", "of the matrices; default N"),
    "units": Key(("import",), "LENGTH,FORCE", "of the files of a finite-element program: mm,N (mass in t) or m,N"),
    "names": Key(("import",), "K=NAME,...", "matrices of the files, where their names leave open which they are"),
    "band": Key(("import",), "HZ", "highest frequency of interest: a large finite-element model is reduced to it"),
    "modal_mass": Key(("import",), "MASS", "of modes whose file does not state it; 1 where normalised to mass"),
    "frf_kind": Key(("import",), "KIND", "of FRFs whose file does not say it: accelerance, mobility or receptance"),
    "response_unit": Key(("import",), "UNIT", "of the responses of FRFs, where the file does not state it"),
    "reference_unit": Key(("import",), "UNIT", "of the references of FRFs, where the file does not state it"),
    "damping": Key(KINDS, "RATIO", "modal damping ratio, one for all modes or one for each"),
    "modes": Key(KINDS, "N", "modes that are kept; default all"),
}
FRFS = {"frf_kind": "kind", "response_unit": "response_unit", "reference_unit": "reference_unit"}  # of read_frfs
LISTS = {"sensors": "sensor", "loads": "load"}


def build(
    kind: str,
    settings: Mapping[str, Any],
    files: Sequence[str | Path] = (),
    *,
    progress: Callable[[float, str], None] | None = None,
    tell: Callable[[str], None] | None = None,
) -> Model:
    """Model from the words of the command line or of a file.

    Parameters
    ----------
    kind : {"beam", "plate", "frame", "import"}
    settings : dict
        Some of `KEYS`, with ``sensors`` and ``loads``: lists of words.
    files : sequence of path
        Of an import: matrices, files of a finite-element program, or one file of FRFs.
    progress : callable, optional
        ``progress(fraction, text)``.
    tell : callable, optional
        Takes what an import says of the files of a finite-element program.

    Raises
    ------
    InputError
        A key that is none, or is none of this kind; a value that is none; no sensor or no load.
    """
    _one_of(kind, KINDS, "kind", ", ".join(KINDS))
    for name in settings:
        _one_of(name, (*KEYS, *LISTS), "setting", ", ".join(k for k, v in KEYS.items() if kind in v.kinds))
        if name in KEYS and kind not in KEYS[name].kinds:
            raise InputError(f"{name} is no setting of a model of kind {kind!r}", where=WHERE,
                             expected=", ".join(k for k, v in KEYS.items() if kind in v.kinds))  # fmt: skip
    fe = kind == "import" and is_fe(files, settings)
    if kind == "import" and not fe and len(files) == 1 and _holds_frfs(files[0], settings):
        return _frfs(files[0], settings)

    from structures import ForwardModel, loads, sensors

    given = {name: list(settings.get(name, ())) for name in LISTS}
    for name, option in LISTS.items():
        if not given[name]:
            raise InputError(f"the model has no {option}", where=WHERE, expected=f"at least one --{option}")
    heard = [placed(text, SENSORS, sensors, "sensor") for text in given["sensors"]]
    driven = [placed(text, LOADS, loads, "load") for text in given["loads"]]
    if fe:
        return _of_solver(settings, files, heard, driven, progress, tell)
    structure = _structure(kind, settings, files)
    made: ForwardModel = ForwardModel(structure, heard, driven, modes=_whole(settings.get("modes"), "modes"))
    return made


def _holds_frfs(path: str | Path, settings: Mapping[str, Any]) -> bool:
    """Whether a file is one of FRFs: by its suffix, or, where it may hold matrices, as nothing is placed there."""
    from structures.files._frf_text import TEXT
    from structures.files._uff import SUFFIXES

    suffix = Path(path).suffix.lower()
    return suffix in (*SUFFIXES, *TEXT) or (suffix in (".mat", ".npz") and not any(settings.get(n) for n in LISTS))


def _frfs(path: str | Path, settings: Mapping[str, Any]) -> Model:
    from structures.files import read_frfs

    strange = [name for name in settings if name not in FRFS]
    if strange:
        raise InputError("FRFs have no such setting", where=WHERE, found=", ".join(strange),
                         expected=f"the file, and {', '.join(FRFS)} where it leaves them open",
                         hint="for modes in place of FRFs state --units as well")  # fmt: skip
    return read_frfs(path, **{word: settings[name] for name, word in FRFS.items() if name in settings})


def _of_solver(
    settings: Mapping[str, Any],
    files: Sequence[str | Path],
    heard: list[Any],
    driven: list[Any],
    progress: Any,
    tell: Any,
) -> Model:
    """Model of the files of a finite-element program."""
    words = {"material": material(settings["material"])} if "material" in settings else {}
    words |= {"damping": ratios(settings["damping"])} if "damping" in settings else {}
    wrong = [name for name in ("length_unit", "force_unit", *FRFS) if name in settings]
    if wrong:
        raise InputError("no setting of the files of a finite-element program", where=WHERE, found=", ".join(wrong),
                         expected="units, dofs, supports, names, damping, band, modes, material and modal_mass",
                         )  # fmt: skip
    asked = dict(settings)
    asked |= {name: size(settings[name], name, "Hz") for name in ("band",) if name in settings}
    asked |= {"modes": _whole(settings.get("modes"), "modes")}
    if "names" in settings:
        asked["names"] = roles(settings["names"])
    if "modal_mass" in settings:
        asked["modal_mass"] = size(settings["modal_mass"], "modal_mass", "1")
    return imported(files, asked, heard, driven, words, progress or _silent, tell or _quiet)


def _silent(_fraction: float, _text: str) -> None:
    """Show no progress."""


def _quiet(_text: str) -> None:
    """Tell nobody."""


def roles(value: Any) -> dict[str, str]:
    """Matrices by what they are: ``"K=KGG,M=MGG"``, or a table.

    Raises
    ------
    InputError
        No such pair, or another role than K, M and C.
    """
    pairs = value.items() if isinstance(value, Mapping) else [p.partition("=")[::2] for p in str(value).split(",")]
    found = {str(role).strip().upper(): str(name).strip() for role, name in pairs}
    if not set(found) <= {"K", "M", "C"} or not all(found.values()):
        raise InputError("these name no matrices", where=f"{WHERE}, names", found=repr(value),
                         expected="K=KGG,M=MGG: K, M or C, and a name")  # fmt: skip
    return found


def ratios(value: Any) -> Any:
    """Modal damping ratios: ``0.02``, ``"0.01,0.02"``, or a list."""
    from structures import damping

    listed = [size(r, "damping", "1") for r in (value if isinstance(value, list) else str(value).split(","))]
    return damping.Modal(listed[0] if len(listed) == 1 else listed)


def _structure(kind: str, settings: Mapping[str, Any], paths: Sequence[str | Path]) -> Structure:

    from structures import beams, files, frames, plates

    words: dict[str, Any] = {}
    for name in ("length", "thickness", "width", "height", "EI", "mass_per_length", "tension"):
        if name in settings:
            unit = {"EI": "N*m^2", "mass_per_length": "kg/m", "tension": "N"}.get(name, "m")
            words[name] = size(settings[name], name, unit)
    words |= {name: _whole(settings[name], name) for name in ("bays", "storeys") if name in settings}
    words |= {"section": section(settings["section"])} if "section" in settings else {}
    words |= {"material": material(settings["material"])} if "material" in settings else {}
    if "elements" in settings:
        counts = [_whole(n, "elements") for n in str(settings["elements"]).strip("[]").split(",")]
        words["elements"] = counts[0] if len(counts) == 1 else tuple(counts)
    if "damping" in settings:
        words["damping"] = ratios(settings["damping"])
    if kind == "beam":
        ends = settings.get("ends", "cantilever")
        _known_ends(ends)
        beam: Callable[..., Structure] = getattr(beams, ends)
        return _needing(beam, words, ("length",))
    if kind == "plate":
        if "lengths" in settings:
            words["lengths"] = tuple(sizes(settings["lengths"], "lengths"))
        words |= {"edges": settings["edges"]} if "edges" in settings else {}
        return _needing(plates.plate, words, ("lengths", "thickness", "material"))
    if kind == "frame":
        return _needing(frames.portal, words, ("width", "height", "section", "material"))
    if not paths:
        raise InputError("nothing is imported", where=WHERE, expected="files of K and M, or a universal file of FRFs",
                         hint="loadid model import K.mtx M.mtx ...")  # fmt: skip
    for name in ("length_unit", "force_unit", "dofs"):
        words |= {name: settings[name]} if name in settings else {}
    if "supports" in settings:
        held = settings["supports"]
        words["supports"] = held if isinstance(held, list) else [p.strip() for p in str(held).split(",")]
    return files.load(paths[0] if len(paths) == 1 else list(paths), **words)


def _needing(make: Callable[..., Structure], words: dict[str, Any], needed: Sequence[str]) -> Structure:
    if missing := [name for name in needed if name not in words]:
        raise InputError("the structure is not complete", where=WHERE, found=", ".join(words) or "nothing",
                         expected=", ".join(f"--{name}" for name in missing))  # fmt: skip
    return make(**words)


def _whole(value: Any, name: str) -> int | None:
    if value is None:
        return None
    if isinstance(value, bool) or not str(value).strip().isdecimal() or int(value) < 1:
        raise InputError("this is no whole number > 0", where=f"{WHERE}, {name}", found=repr(value))
    return int(value)


# -- what is said ------------------------------------------------------------------------------------------------------
def describe(model: Model) -> dict[str, Any]:
    """Frequencies, sensors and loads of a model, as plain values."""
    found = model.natural_frequencies
    return {
        "model": repr(model),
        "frequencies": [] if found is None else [float(f) for f in found],
        "sensors": [{"label": c.label, "quantity": c.quantity, "unit": c.unit} for c in model.sensors],
        "loads": [{"label": c.label, "quantity": c.quantity, "unit": c.unit} for c in model.loads],
        "flags": [f.to_dict() for f in model.flags],
        "fingerprint": model.fingerprint,
    }


def show(data: dict[str, Any], remarks: Sequence[str]) -> str:
    """Answer of `describe` as text."""
    f = data["frequencies"]
    listed = ", ".join(f"{x:.4g}" for x in f[:12]) + (
        f" and {len(f) - 12} more, up to {f[-1]:.4g}" if len(f) > 12 else ""
    )
    lines = [data["model"], *([f"  natural frequencies {listed} Hz"] if f else [])]
    for name in ("sensors", "loads"):
        lines.append(f"  {name} " + ", ".join(f"{c['label']} [{c['unit']}] {c['quantity']}" for c in data[name]))
    return "\n".join([*lines, *(f"  {r}" for r in remarks)])


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("kind", nargs="?", choices=KINDS, metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("files", nargs="*", metavar="FILE", help="of an import: K and M, files of a solver, or FRFs")
    parser.add_argument("-o", "--output", required=True, metavar="MODEL.h5", help="model file to write")
    parser.add_argument("--from", dest="toml", metavar="MODEL.toml", help="settings by the names of the options; "
                        "sensors and loads are lists")  # fmt: skip
    parser.add_argument("--sensor", action="append", metavar="KIND:PLACE",
                        help=f"{', '.join(SENSORS)}; with fibre=, label=, noise= after commas; may repeat")  # fmt: skip
    parser.add_argument("--load", action="append", metavar="KIND:PLACE", help=f"{', '.join(LOADS)}; may repeat")
    for name, key in KEYS.items():
        told = "" if key.kinds == KINDS else f"{', '.join(key.kinds)}: "
        parser.add_argument(f"--{name.replace('_', '-')}", dest=name, metavar=key.metavar, help=told + key.help)


def _run(args: Namespace) -> int:
    require_outputs({"-o": args.output}, [*args.files, args.toml])
    kind, files, settings = args.kind, list(args.files), {}
    if args.toml is not None:
        from .. import _toml

        settings = _toml.read(args.toml)
        kind = kind or settings.pop("kind", None)
        settings.pop("kind", None)
        folder = Path(args.toml).parent
        files = files or [folder / name for name in settings.pop("files", ())]
    if kind is None:
        raise UsageError(f"what is the model of? name one of {', '.join(KINDS)} (see loadid model --help)")
    settings |= {name: getattr(args, name) for name in KEYS if getattr(args, name) is not None}
    settings |= {name: getattr(args, option) for name, option in LISTS.items() if getattr(args, option)}
    said: list[str] = []
    with Bar() as bar:
        model = build(kind, settings, files, progress=bar, tell=said.append)
    data = describe(model)
    model.save(args.output)
    remarks = [f.command for f in model.flags if f.level != "note"]
    told = {"summary": "\n".join(said)} if said else {}
    text = "\n".join([*said, show(data, remarks), f"model written to {args.output}"])
    emit(args, {**data, **told, "written": args.output}, text)
    return 0


command = Command("model", "make a forward model of a beam, a plate, a frame, or from files", _configure, _run)
