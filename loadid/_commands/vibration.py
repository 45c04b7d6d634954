"""``loadid vibration``: the drives that make a specification or a field record, under limits, by a job file."""

from __future__ import annotations

import math
import os
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError
from structures.files import _storage as storage

from .. import _toml
from .._toml import PlanReader, is_number
from . import Bar, Command, emit, load_model, require_outputs

if TYPE_CHECKING:
    from structures._model import Model

    from ..vibration import Drives, Limit, Profile

EXAMPLES = """\
examples:
  a job that names the model, the specification and the limits:
    loadid vibration job.toml
  the same with other outputs:
    loadid vibration job.toml -o drives.h5 --report drives.html

job.toml:
  model = "frfs.h5"                       # FRFs of the sensors over the drives (a model, or a universal file)
  output = "drives.h5"
  report = "drives.html"
  lines = {from = 20, to = 400, step = 2} # Hz; default those of the model
  [[target]]                              # one for all sensors, or one for each group of them
  sensors = ["a1", "a2"]
  frequencies = [20, 80, 350, 2000]
  levels = [2.5e-4, 1e-3, 1e-3, 1.8e-4]
  unit = "g^2/Hz"                         # of a sine: "g"
  [[limit]]                               # of a drive or of any sensor: rms, density or amplitude
  channel = "shaker 1"
  rms = 40.0
In place of [[target]]: field = "field.csv", the record whose cross spectra are to be made (segment = 1024).
"""
NAMES = {
    "job": ("model", "output", "report", "plot", "lines", "tolerance", "frf_error", "target", "limit", "field",
            "segment"),
    "lines": ("from", "to", "step"),
    "target": ("sensors", "frequencies", "levels", "unit"),
    "limit": ("channel", "rms", "density", "amplitude", "unit", "frequencies"),
}  # fmt: skip
OUTPUTS = ("output", "report", "plot")
MOST = 100_000  # lines of a job


def read_job(path: str | os.PathLike[str]) -> tuple[dict[str, Any], PlanReader]:
    """What a job says, its paths from its folder on, its keys checked; and who refuses its values.

    Raises
    ------
    InputError
        No such file, no TOML, a key that is none.
    """
    job = _toml.read(path, "job")
    plan = PlanReader(os.fspath(path), NAMES)
    plan.known(job, "job", plan.where)
    folder = Path(path).parent
    for name in ("model", "field"):
        if name == "model" or name in job:
            job[name] = plan.file(job, name, "the job", folder)
    for name in OUTPUTS:
        if name in job:
            job[name] = os.fspath(folder / plan.text(job, name, "the job"))
    for name in ("tolerance", "frf_error"):
        if name in job and not (is_number(job[name]) and job[name] > 0):
            plan.refused(name, job[name], "a number > 0")
    if ("target" in job) == ("field" in job):
        raise InputError("a job has one target", where=plan.where, found="both" if "target" in job else "none",
                         expected="[[target]] tables, or field = a record")  # fmt: skip
    if "segment" in job and "field" not in job:
        plan.refused("segment", job["segment"], "none beside [[target]]: it cuts a field record")
    for kind in ("target", "limit"):
        tables = job.get(kind, [])
        if not isinstance(tables, list) or not all(isinstance(one, dict) for one in tables):
            plan.refused(kind, tables, f"tables [[{kind}]]")
        for one in tables:
            plan.known(one, kind, f"[[{kind}]]")
    return job, plan


def drives_of(job: Mapping[str, Any], plan: PlanReader, progress: Any = None) -> Drives:
    """The drives that a job asks for.

    Raises
    ------
    InputError
        Sensors, units or lines that do not fit, values that are none.
    """
    import numpy as np

    from ..vibration import Target, find_drives

    model: Model = load_model(job["model"])
    lines = _lines(job, plan)
    if lines is None and "target" in job and model.frequencies is None:
        raise InputError("the model has an FRF at any frequency, and the job names no lines", where=plan.where,
                         expected="the lines of the drives",
                         hint="add lines = {from = 20, to = 400, step = 2}, in Hz: one every quarter of the narrowest "
                         "resonance, say")  # fmt: skip
    if "field" in job:
        target: Any = _field(job, plan, model, lines)
    else:
        labels, profiles = [s.label for s in model.sensors], {}
        for one in job["target"]:
            for name in _sensors(one, plan, labels):
                if name in profiles:
                    plan.refused("sensors of [[target]]", name, "each sensor in one table")
                profiles[name] = _profile(one, plan, "target", one.get("levels"))
        target = Target.of(model, profiles, None if lines is None else np.asarray(lines))
    given = {name: float(job[name]) for name in ("tolerance", "frf_error") if name in job}
    limits = [_limit(one, plan) for one in job.get("limit", [])]
    return find_drives(model, target, limits=limits, progress=progress, **given)


def _lines(job: Mapping[str, Any], plan: PlanReader) -> Any:
    import numpy as np

    if "lines" not in job:
        return None
    table = plan.table(job, "lines")
    plan.known(table, "lines", "lines")
    ends: list[Any] = [table.get(name) for name in NAMES["lines"]]
    low, high, step = (float(x) if is_number(x) else math.nan for x in ends)
    if not (0 < low < high and 0 < step <= high - low):
        plan.refused("lines", table, "{from, to, step} in Hz, 0 < from < to, step > 0")
    if (high - low) / step > MOST:
        plan.refused("lines", table, f"{MOST} lines at most: a larger step")
    return low + step * np.arange(int((high - low) / step + 1e-9) + 1)


def _sensors(one: Mapping[str, Any], plan: PlanReader, labels: list[str]) -> list[str]:
    given = one.get("sensors", labels)
    if not (isinstance(given, list) and given and all(isinstance(name, str) for name in given)):
        plan.refused("sensors of [[target]]", given, 'a list of names, such as ["a1", "a2"]')
    return given


def _profile(one: Mapping[str, Any], plan: PlanReader, kind: str, levels: Any) -> Profile:
    from ..vibration import Profile

    return Profile(one.get("frequencies", []), levels or [], plan.text(one, "unit", f"[[{kind}]]"))


def _limit(one: Mapping[str, Any], plan: PlanReader) -> Limit:
    from ..vibration import Limit

    channel = plan.text(one, "channel", "[[limit]]")
    given: dict[str, Any] = {name: one[name] for name in ("rms", "density", "amplitude") if name in one}
    if "frequencies" in one:
        given = {name: _profile(one, plan, "limit", value) for name, value in given.items()}
    elif "unit" in one:
        given["unit"] = plan.text(one, "unit", "[[limit]]")
    return Limit(channel, **given)


def _field(job: Mapping[str, Any], plan: PlanReader, model: Model, lines: Any) -> Any:
    """Cross spectra of the field record, of the sensors of the model that it holds, on lines of both."""
    import numpy as np

    from structures import cross_spectra

    from .._readers import read

    segment = job.get("segment")
    if segment is not None and not (isinstance(segment, int) and not isinstance(segment, bool) and segment > 0):
        plan.refused("segment", segment, "a whole number of samples > 0")
    record = read(job["field"])
    some = [s.label for s in model.sensors if s.label in record.labels]
    if not some:
        raise InputError("the field record holds no sensor of the model", where=str(job["field"]),
                         found=", ".join(record.labels[:8]),
                         expected=", ".join(s.label for s in model.sensors[:8]))  # fmt: skip
    spectra = cross_spectra(record.select(some), segment=segment)
    f, wanted = spectra.frequencies, lines if lines is not None else model.frequencies
    if wanted is None:
        return spectra.lines(f > 0)
    inside = (f > 0) & (f >= np.min(wanted) * (1 - 1e-9)) & (f <= np.max(wanted) * (1 + 1e-9))
    if model.frequencies is not None:  # a table: lines that it has, where these are some
        own = np.asarray(model.frequencies)
        shared = inside & (np.min(np.abs(f[:, None] - own), axis=1) <= 1e-6 * f)
        inside = shared if shared.any() else inside
    return spectra.lines(inside)


# -- the command -------------------------------------------------------------------------------------------------------
def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("job", metavar="JOB.toml", help="job: model, target or field record, limits")
    parser.add_argument("-o", "--output", metavar="DRIVES.h5", help="drives to write (loadid.vibration.Drives.read)")
    parser.add_argument("--report", metavar="PAGE.html", help="also write a page")
    parser.add_argument("--plot", metavar="PICTURE", help="also write a picture (png, svg, pdf)")


def _run(args: Namespace) -> int:
    job, plan = read_job(args.job)
    job |= {name: getattr(args, name) for name in OUTPUTS if getattr(args, name) is not None}
    outputs = {"-o": job.get("output"), "--report": job.get("report"), "--plot": job.get("plot")}
    require_outputs(outputs, [args.job, job["model"], job.get("field")])
    with Bar() as bar:
        found = drives_of(job, plan, bar)
    ready: list[tuple[str, bytes]] = []
    if job.get("plot") is not None:
        from .._plots import rendered

        ready.append((job["plot"], rendered(found.plot(), job["plot"])))
    if job.get("report") is not None:
        ready.append((job["report"], page(found, str(args.job)).encode()))
    if job.get("output") is not None:
        found.save(job["output"])
    for path, data in ready:
        storage.replace(Path(path), data)
    written = [str(path) for path in outputs.values() if path is not None]
    said = [found.summary(), *([f"written: {', '.join(written)}"] if written else [])]
    emit(args, {**described(found), "written": written}, "\n".join(said))
    return 0


def described(found: Drives) -> dict[str, Any]:
    """Numbers of some drives: errors in dB, rms (of a sine the largest line), limits that are met."""
    return {
        "kind": found.kind, "lines": len(found.frequencies), "band": [found.frequencies[0], found.frequencies[-1]],
        "rms_error_db": found.rms_error, "within": found.within, "tolerance_db": found.tolerance,
        "drives": {c.label: {"rms": x, "unit": c.unit} for c, x in zip(found.loads, found.rms, strict=True)},
        "error_db": {c.label: {"rms": float((e**2).mean() ** 0.5), "worst": float(abs(e).max())}
                     for c, e in zip(found.sensors, found.error.T, strict=True)},
        "limits": list(found.limits), "limits_met": list(found.bound), "flags": [f.to_dict() for f in found.flags],
    }  # fmt: skip


def page(found: Drives, job: str) -> str:
    """A page of its own: errors, drives, limits, a picture, and what to mind."""
    from .. import _page
    from .._plots.style import drawn
    from .._results.report import flag_list

    told = described(found)
    sensors = [(name, f"{e['rms']:.2f}", f"{e['worst']:.1f}") for name, e in told["error_db"].items()]
    drives = [(name, f"{d['rms']:.4g} {d['unit']}") for name, d in told["drives"].items()]
    limits = [(name, "binds" if met > 0 else "kept, with room")
              for name, met in zip(found.limits, found.met, strict=True)]  # fmt: skip
    first = (f"{found.rms_error:.2f} dB rms off the target, {found.within:.1%} of lines and sensors within "
             f"{found.tolerance:g} dB")  # fmt: skip
    picture = _page.image(drawn(found.plot(), "png"), "target, response and drives over frequency")
    sections = [
        _page.PageSection("Result", _page.joined(_page.paragraphs(first, *found.bound), picture)),
        _page.PageSection("Cautions", flag_list(found.flags) if found.flags else ""),
        _page.PageSection("Drives", _page.table(drives, ("drive", "rms"))),
        _page.PageSection("Sensors", _page.table(sensors, ("sensor", "rms error, dB", "worst, dB"))),
        _page.PageSection("Limits", _page.table(limits, ("limit", "")) if limits else ""),
    ]  # fmt: skip
    return _page.document(f"Drives: {', '.join(c.label for c in found.loads[:4])}", sections, about=job)


command = Command(
    "vibration", "drives of shakers for a specification or a field record, under limits", _configure, _run
)
