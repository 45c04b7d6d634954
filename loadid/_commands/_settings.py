"""The settings of all families as options of a command and keys of a job: one table, of which both are made.

The names are those of Python, `Arguments` of `loadid/_spellings.py`: settings that belong together there stand one by
one here (``noise``, ``noise_source``). Light: families are loaded when one is asked for.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, BooleanOptionalAction
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from typing import Any

from structures.errors import InputError

from ..settings import CLASSES, ENGINES, GROUPS, METHODS, OVER, PATHS, SIGNALS, VARIANCES
from . import DICTIONARIES, STARTS, band, channels, choice, count, leak, names, penalty, positive

FAMILIES = {
    "auto": ("loadid._families.automatic", "AutomaticInversion"),
    "deconvolution": ("loadid._families.deconvolution", "Deconvolution"),
    "field": ("loadid._families.field", "FieldDeconvolution"),
    "frequency": ("loadid._families.frequency", "FrequencyInversion"),
    "harmonic": ("loadid._families.harmonic", "HarmonicInversion"),
    "location": ("loadid._families.location", "LocationSearch"),
    "sparse": ("loadid._families.sparse", "SparseDeconvolution"),
    "static": ("loadid._families.static", "StaticInversion"),
    "tracker": ("loadid._families.kalman", "LoadTracker"),
}
UNWRITTEN = {  # arguments that no text says, and why
    "model": "the model file",
    "progress": "the bar of the command",
    "coverage": "an object of loadid.validate",
    "constraints": "nonnegative, bounds, resultant and acting say them",
    "ambient": "an object with matrices",
    "family": "the family of the job itself; a search rebuilds its load by Deconvolution",
}
CONSTRAINTS = ("nonnegative", "bounds", "resultant", "acting")
BESIDE = {  # what a family takes beside its own settings: said here, not there
    "auto": ("validation", "at", "mean"),
    "deconvolution": ("validation",),
    "field": ("validation", "initial", "support", "hold"),
    "location": ("grid",),
    "sparse": ("validation",),
    "static": ("validation", "at", "mean"),
}

Parse = Callable[[str], Any]


# -- texts to values ---------------------------------------------------------------------------------------------------
def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise ArgumentTypeError(f"{text!r} is no number")
    return value


def whole(text: str) -> int:
    """A whole number, 0 or more."""
    if not (text.strip().isascii() and text.strip().isdecimal()):
        raise ArgumentTypeError(f"{text!r} is no whole number >= 0")
    return int(text)


def numbers(text: str) -> float | list[float]:
    """``0.1`` or ``0.1,0.2``."""
    found = [number(part) for part in text.split(",")]
    return found[0] if len(found) == 1 else found


def table(text: str) -> dict[str, Any]:
    """``a=0.1,b=0.2``."""
    found: dict[str, Any] = {}
    for part in text.split(","):
        name, sign, value = part.rpartition("=")
        if not (sign and name.strip()):
            raise ArgumentTypeError(f"{part!r} is not NAME=NUMBER")
        found[name.strip()] = number(value)
    return found


def level(text: str) -> Any:
    """Noise: ``0.1``, ``0.1,0.2`` or ``acc1=0.1,acc2=0.2``."""
    return table(text) if "=" in text else numbers(text)


def window(text: str) -> list[float]:
    """``0.01:0.016`` in s."""
    low, sign, high = text.partition(":")
    ends = [number(low), number(high)] if sign else []
    if not ends or not ends[0] < ends[1]:
        raise ArgumentTypeError(f"{text!r} is no window BEGIN:END in s")
    return ends


def limits(text: str) -> Any:
    """``0:10`` for all loads, or ``F1=0:10``; a side may be left empty."""
    name, sign, span = text.rpartition("=")
    low, colon, high = span.partition(":")
    if not colon or not (low.strip() or high.strip()) or (sign and not name.strip()):
        raise ArgumentTypeError(f"{text!r} is no LOW:HIGH, with NAME= before it or without")
    ends = [number(low) if low.strip() else float("-inf"), number(high) if high.strip() else float("inf")]
    return {name.strip(): ends} if sign else ends


def total(text: str) -> dict[str, Any]:
    """``Fz=100`` or ``Fz=100:2`` with its std."""
    name, sign, rest = text.rpartition("=")
    if not sign or not name.strip():
        raise ArgumentTypeError(f"{text!r} is not NAME=VALUE or NAME=VALUE:STD")
    value, colon, std = rest.partition(":")
    return {name.strip(): [number(value), number(std)] if colon else number(value)}


def grid(text: str) -> list[int]:
    """``19`` places along a beam, ``6x5`` on a plate."""
    return [count(part) for part in text.lower().split("x")]


def knots(text: str) -> Any:
    """``scan``, or spacings in samples."""
    if text == "scan":
        return text
    found = [count(part) for part in text.split(",")]
    return found[0] if len(found) == 1 else found


def start(text: str) -> Any:
    """``static``, or stds of the states."""
    return text if text == "static" else numbers(text)


def lag(text: str) -> Any:
    """``auto``, or samples."""
    return text if text == "auto" else whole(text)


def gate(text: str) -> float | None:
    """Stds; ``none`` for no gate."""
    return None if text == "none" else positive(text)


# -- the table ---------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Switch:
    """One setting.

    Parameters
    ----------
    help : str
    metavar : str
    parse : callable, optional
        Text of the command line -> value; None where only a job can write it (tables, matrices).
    choices : sequence of str
        Words that it may be.
    several : bool
        May repeat: values are listed, or their tables put together.
    flag : bool
        True where it is named; a job may say true or false.
    """

    help: str
    metavar: str = ""
    parse: Parse | None = None
    choices: tuple[str, ...] = ()
    several: bool = False
    flag: bool = False

    @property
    def job_only(self) -> bool:
        """Whether no text says it."""
        return self.parse is None and not self.choices and not self.flag


OPTIONS: dict[str, Switch] = {
    "noise": Switch("noise std of the sensors in SI: one for all, one for each, or by name; may repeat",
                    "STD|CH=STD,...", level, several=True),
    "noise_source": Switch("where that level comes from: datasheet, repeatability, pre_trigger, quiet, or a text",
                           "KIND", str),
    "errors": Switch("relative std of what the model is wrong by: gain, frequency, damping, shape", "NAME=STD,...",
                     table),
    "interpolation": Switch("matrix (sensors, markers) that made the readings"),
    "frf": Switch("relative std of the entries of the FRF", "SHARE", number),
    "sensors": Switch("sensors of the model to invert; default all", "CH,...", channels),
    "validation": Switch("sensors that are kept out and predicted", "CH,...", channels),
    "support": Switch("window in s outside which the load is zero, from the first sample; may repeat", "T0:T1", window,
                      several=True),
    "nonnegative": Switch("loads that push and never pull", flag=True),
    "bounds": Switch("limits of the loads, of all or of one; may repeat", "[LOAD=]LOW:HIGH", limits, several=True),
    "resultant": Switch("known resultant of the loads (F, M, Fz, ..., sum), with its std or exact; may repeat",
                        "NAME=VALUE[:STD]", total, several=True),
    "acting": Switch("loads that act; the others are none", "LOAD,...", channels),
    "method": Switch("default tikhonov", choices=METHODS),
    "penalty": Switch("identity (default), first_difference, second_difference, gradient, laplacian; none is plain "
                      "least squares", "NAME", penalty),
    "size": Switch("weight of the size of the loads beside the penalty; expected relative size of the loads of the "
                   "frequency family", "W,...", numbers),
    "leak": Switch("with first_difference: a load that returns to zero by itself, for sensors that see no constant",
                   "PHI", leak),
    "from_zero": Switch("the load is zero before the record", flag=True),
    "variance": Switch("of the load: local learns from the record where it acts, for impacts; smooth over how many "
                       "samples it is smooth", choices=VARIANCES),
    "time": Switch("field family: penalty in time", "NAME", penalty),
    "choice": Switch("rule (discrepancy, upre, gcv, robust_gcv, l_curve, evidence, ...), or a relative lambda", "RULE",
                     choice),
    "path": Switch("solver; default auto, which the result names: by length and model", choices=PATHS),
    "initial": Switch("state of the structure at the first sample; default rest", choices=STARTS),
    "hold": Switch("how a load moves between samples: linear (foh) or constant (zoh); default that of the model",
                   choices=("foh", "zoh")),
    "load_class": Switch("what is known of the load", choices=CLASSES),
    "dictionary": Switch("waveforms of the sparse family: spikes (default), splines for longer pulses, wavelets",
                         choices=DICTIONARIES),
    "knots": Switch("spacing of B-splines in samples, or scan", "N,...|scan", knots),
    "groups": Switch("sparse family: which of the loads act (loads), or loads that act at the same times (slots)",
                     choices=GROUPS),
    "reweighted": Switch("sparse family: rounds of reweighting", "N", whole),
    "debias": Switch("sparse family: least squares on the support", flag=True),
    "tol": Switch("sparse family: relative duality gap", "GAP", positive),
    "impacts": Switch("location family: loads that act, each at its own place", "N", count),
    "refine": Switch("location family: places between the candidates", flag=True),
    "places": Switch("places of the candidates in m, [[x, y], ...]"),
    "grid": Switch("location family: candidate places, evenly over the structure, for the first load of the model",
                   "N|NxM", grid),
    "workers": Switch("location family: threads", "N", count),
    "settings": Switch("location family: further settings of the family that rebuilds the load"),
    "space": Switch("spatial prior of the load field", choices=("gradient", "laplacian")),
    "length": Switch("length of the spatial prior in m", "M", positive),
    "ratio": Switch("field family: the penalties in time and space are added, at this ratio", "R", positive),
    "shapes": Switch("field family: matrix (loads, unknowns) of shapes that make the load"),
    "frequency": Switch("harmonic family: the line in Hz", "HZ", positive),
    "over": Switch("frequency family: who decides on lambda; default neighbours", choices=OVER),
    "neighbours": Switch("frequency family: lines to either side that inform a line", "N", whole),
    "count": Switch("frequency family: singular values that truncation keeps", "N", count),
    "level": Switch("frequency family: predicted error to flag, as 0.1", "SHARE", positive),
    "signal": Switch("frequency family: averaged into spectra of the loads, or transformed once into their history",
                     choices=SIGNALS),
    "window": Switch("frequency family: window of the averaged segments", "NAME", str),
    "segment": Switch("frequency family: length of the averaged segments", "SAMPLES", count),
    "overlap": Switch("frequency family: overlap of the averaged segments", "SHARE", number),
    "band": Switch("frequency family: lines that are inverted, Hz", "LOW:HIGH", band),
    "prior": Switch("tracker family: matern32 (default), matern52, ou, random_walk, white; for each load", "NAME,...",
                    lambda text: names(text) if "," in text else text),
    "start": Switch("tracker family: std of the states before the first sample, or static", "STD|static", start),
    "dummy": Switch("tracker family: std in m of dummy displacements at the loads", "M", positive),
    "bias": Switch("tracker family: std that a second adds to the offset of a sensor", "STD,...", numbers),
    "model_error": Switch("tracker family: relative std of stiffness, mass, damping", "NAME=STD,...", table),
    "scales": Switch("tracker family: parameters of the model to tune", "NAME,...", channels),
    "state_noise": Switch("tracker family: std that a sample adds to the states", "STD", number),
    "gate": Switch("tracker family: stds beyond which a sample is kept out, or none", "STD|none", gate),
    "lag": Switch("tracker family: samples of late answers, or auto", "N|auto", lag),
    "replay": Switch("tracker family: samples by which one may come late", "N", whole),
    "limits": Switch("tracker family: ranges of the sensors, a number or a table"),
    "engine": Switch("tracker family: what runs the filter", choices=ENGINES),
    "at": Switch("static family: time in s of the reading; default every row is one", "T", number),
    "mean": Switch("static family: window in s whose mean is the reading", "T0:T1", window),
    "allow": Switch("refusals to override (E306, ...); printed on every picture", "CODE,...", names),
}  # fmt: skip


def add_settings(parser: ArgumentParser) -> None:
    """Every setting as an option; what was not given is None."""
    group = parser.add_argument_group("settings of the families", "the same names as in Python and in a job file")
    for name, one in OPTIONS.items():
        if one.job_only:
            continue
        option = f"--{name.replace('_', '-')}"
        if one.flag:
            group.add_argument(option, action=BooleanOptionalAction, default=None, help=one.help)
        elif one.choices:
            group.add_argument(option, choices=one.choices, help=one.help)
        else:
            action = "append" if one.several else "store"
            group.add_argument(option, action=action, type=one.parse or str, metavar=one.metavar, help=one.help)


def given(values: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that were given on a command line, repeated ones put together.

    Raises
    ------
    InputError
        One name twice.
    """
    found: dict[str, Any] = {}
    for name, one in OPTIONS.items():
        value = values.get(name)
        if value is not None:
            found[name] = _together(name, value) if one.several else value
    return found


def _together(name: str, values: list[Any]) -> Any:
    tables = [value for value in values if isinstance(value, dict)]
    if len(tables) == len(values):
        joined: dict[str, Any] = {}
        for one in tables:
            if twice := set(one) & set(joined):
                raise InputError("a name is given twice", where=f"--{name}", found=", ".join(sorted(twice)),
                                 expected="each once", hint="leave one of them out")  # fmt: skip
            joined |= one
        return joined
    if len(values) > 1 and (tables or name != "support"):
        raise InputError("one value is needed, or each with its name", where=f"--{name}", found=f"{len(values)} values",
                         expected="one", hint="leave one of them out")  # fmt: skip
    return values[0] if len(values) == 1 else values


# -- what a family takes -----------------------------------------------------------------------------------------------
def load_family(name: str) -> Any:
    """The class of a family.

    Raises
    ------
    InputError
        No such family.
    """
    if name not in FAMILIES:
        near = get_close_matches(str(name), FAMILIES, n=1)
        raise InputError("no such family", where="family", found=str(name)[:80], expected=" or ".join(FAMILIES),
                         hint=f"did you mean {near[0]!r}?" if near else "")  # fmt: skip
    module, kind = FAMILIES[name]
    return getattr(import_module(module), kind)


def known(family: str) -> list[str]:
    """Names of all settings that a family takes here, its constraints one by one."""
    from .._spellings import ARGUMENTS

    module, kind = FAMILIES[family]
    import_module(module)
    written = ARGUMENTS[kind]
    taken = [name for name in written.names if name not in UNWRITTEN]
    if "constraints" in written.defaults:
        taken += CONSTRAINTS
    elif family == "field":
        taken += ["nonnegative"]
    return list(dict.fromkeys([*taken, *BESIDE.get(family, ())]))


def require_known(family: str, settings: Mapping[str, Any]) -> None:
    """Nothing, where a family takes all of some settings.

    Raises
    ------
    InputError
        One that it does not take, with the nearest name or the families that do.
    """
    taken = known(family)
    for name in settings:
        if name in taken or (name == "constraints" and "nonnegative" in taken):
            continue
        near = get_close_matches(name, taken, n=1)
        others = [other for other in FAMILIES if name in OPTIONS and name in known(other)] if name in OPTIONS else []
        hint = f"did you mean {near[0]!r}?" if near else f"{', '.join(others)} take it" if others else "leave it out"
        raise InputError(f"{FAMILIES[family][1]} has no such setting", where="identify", found=name,
                         expected=f"some of {', '.join(taken)}", hint=hint)  # fmt: skip
