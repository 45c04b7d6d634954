"""``loadid guide``: the ten steps of one job, computed, signed and kept."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.files import _storage as storage

from . import Bar, Command, UsageError, add_log_options, channels, emit, one_record, require_outputs, settings, table

if TYPE_CHECKING:
    from .._guide.job import Guide, StepStanding

ACTIONS = ("new", "status", "sign", "page")
EXAMPLES = """\
examples:
  begin: the job is what loadid identify takes (log, model, settings), and may be written here
    loadid guide new beam.toml --log service.csv --model beam.h5 --structure "steel cantilever, 0.3 m"
  what is the next step, what does it need, and what do I type
    loadid guide status
  sign: the figures are computed, the evidence is kept by its sha256; --preview computes and signs nothing
    loadid guide sign 1 --evidence certificate_of_steel.pdf
    loadid guide sign 2 --evidence hit1.csv --truth hammer --by "A. Engineer"
    loadid guide sign 4
  one page for whoever has to accept it
    loadid guide page -o beam.html

The steps: 1 characterise, 2 verify the forward model, 3 loads and sensors, 4 recoverable modes, 5 constraints,
6 penalty, 7 lambda, 8 the inverse, 9 validation, 10 drift. Steps 3 to 10 are locked until 2 is signed. What a signature
stands on is hashed again by every command: a change makes it stale, and those after it. The state is one file,
NAME.guide.toml, beside the job.
"""


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("action", choices=ACTIONS, help="new JOB.toml; status; sign STEP; page")
    parser.add_argument("what", nargs="?", metavar="JOB.toml|STEP", help="the job that is begun, or the step to sign")
    parser.add_argument("--job", metavar="JOB.toml", help="default the only job with a guide in this folder")
    begun = parser.add_argument_group("new")
    begun.add_argument("--log", metavar="LOG", help="with --model: write the job file")
    begun.add_argument("--model", metavar="MODEL.h5", help="with --log: write the job file")
    begun.add_argument("--structure", metavar="TEXT", help="what it is, for the head of the page")
    begun.add_argument("--client", metavar="TEXT", help="for whom")
    signed = parser.add_argument_group("sign")
    signed.add_argument("--evidence", nargs="+", metavar="FILE", default=[],
                        help="logs are read, other files are kept by their sha256")  # fmt: skip
    signed.add_argument(
        "--truth",
        type=channels,
        metavar="CH,...",
        default=[],
        help="channels of the known loads, in the order of the model; default those of the same names",
    )
    signed.add_argument("--by", metavar="NAME", default="", help="who signs; default the user of the system")
    signed.add_argument("--note", metavar="TEXT", default="", help="words that stand beside the figures")
    signed.add_argument("--preview", action="store_true", help="show the figures, sign nothing")
    page = parser.add_argument_group("page")
    page.add_argument("-o", "--output", metavar="PAGE.html", help="default NAME.guide.html beside the job")
    add_log_options(parser)


def _run(args: Namespace) -> int:
    return {"new": _new, "status": _status, "sign": _sign, "page": _page}[args.action](args)


def _opened(args: Namespace, *, named: bool = True) -> Guide:
    from .._guide.job import Guide

    if named and args.what is not None and args.job is not None:
        raise UsageError("the job is named twice: once is enough (see loadid guide --help)")
    return Guide.open(args.job if args.job is not None else args.what if named else None)


def _new(args: Namespace) -> int:
    from .._guide.job import Guide

    job = args.what if args.what is not None else args.job
    if job is None:
        raise UsageError("name the job: loadid guide new JOB.toml (see loadid guide --help)")
    about = {"structure": args.structure or "", "client": args.client or ""}
    guide = Guide.new(job, about=about, log=args.log, model=args.model)
    _answer(args, guide, [f"guide begun: {guide.path}"])
    return 0


def _status(args: Namespace) -> int:
    guide = _opened(args)
    _answer(args, guide, [], whole=True)
    return 0


def _answer(args: Namespace, guide: Guide, first: list[str], *, whole: bool = False, **more: Any) -> None:
    """The next step with its command; `whole`: then all ten."""
    standing, waits = guide.standing(), guide.next()
    data = {
        "job": guide.ledger.job,
        "state": str(guide.path),
        "seal": guide.ledger.seal,
        "next": None
        if waits is None
        else {
            "step": waits.step.number,
            "name": waits.step.name,
            "state": waits.state,
            "needs": waits.step.needs,
            "why": list(waits.why),
            "command": waits.command,
        },
        "steps": [one.to_dict() for one in standing],
        **more,
    }
    rows = [table([["step", "", "state", "outcome"], *map(_row, standing)])] if whole else []
    emit(args, data, "\n".join([*first, *_waiting(waits), *rows]))


def _waiting(waits: StepStanding | None) -> list[str]:
    if waits is None:
        return ["all ten steps are signed and hold: loadid guide page"]
    lines = [f"next: step {waits.step.title} ({waits.state})"]
    lines += [f"  because {why}" for why in waits.why[:4]]
    return [*lines, f"  needs: {waits.step.needs}", f"  type:  {waits.command}"]


def _row(one: StepStanding) -> list[str]:
    said = one.why[0] if one.why else "" if one.signature is None else one.signature.said
    return [str(one.step.number), one.step.name, one.state, said if len(said) < 110 else f"{said[:107]}..."]


def _sign(args: Namespace) -> int:
    from .._guide.recipe import number_of

    if args.what is None:
        raise UsageError("name the step: loadid guide sign STEP (see loadid guide --help)")
    number = number_of(args.what)
    guide = _opened(args, named=False)
    with Bar() as bar:
        changed, signature = guide.sign(
            number, args.evidence, by=args.by, note=args.note, reading=settings(args), record=one_record(args),
            truth=args.truth, preview=args.preview, progress=bar,
        )  # fmt: skip
    word = "would be signed (preview: nothing is written)" if args.preview else f"signed by {signature.by}"
    lines = [f"step {number} {word}: {signature.said}"]
    lines += [f"  {flag['code']} {flag['level']}: {flag['message']}" for flag in signature.flags
              if flag["level"] != "note"]  # fmt: skip
    if args.preview:
        from .._guide.page import in_lines

        lines += in_lines(signature)
    _answer(
        args,
        guide if args.preview else changed,
        lines,
        signed=None if args.preview else number,
        signature={
            "step": number,
            "said": signature.said,
            "holds": signature.holds,
            "figures": dict(signature.figures),
            "flags": [dict(flag) for flag in signature.flags],
        },
    )
    return 0


def _page(args: Namespace) -> int:
    guide = _opened(args)
    path = guide.path.with_suffix(".html") if args.output is None else Path(args.output)
    require_outputs(
        {"-o": path}, [guide.path, guide.path.with_name(guide.ledger.job)], suffixes={"-o": (".html", ".htm")}
    )
    storage.replace(path, guide.page().encode())
    waits = guide.next()
    state = "all ten steps signed" if waits is None else f"next: step {waits.step.title} ({waits.state})"
    emit(args, {"written": [str(path)], "seal": guide.ledger.seal}, f"page written: {path}; {state}")
    return 0


command = Command("guide", "the ten steps of a job: computed, signed, kept as one page", _configure, _run)
