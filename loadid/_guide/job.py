"""The guide of one job: begun, asked where it stands, signed step by step, written down as a page."""

from __future__ import annotations

import getpass
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from structures.errors import InputError
from structures.files import _storage as storage

from .. import __version__, _toml
from .._commands._job import FILES
from .._commands._job import resolved as job_text
from .._stream.output import StateLock
from . import ledger as ledgers
from .ledger import SUFFIX, Ledger, Signature, hashed
from .recipe import STEPS, VERIFY, RecipeStep, step
from .standing import files_of, lock, relative, settings_of, stale

JOB = ".job.toml"
LONGEST = 2000  # characters of a note, a name or a word about the job
SIGNED, STALE, OPEN, LOCKED, FAILED = "signed", "stale", "open", "locked", "does not hold"


@dataclass(frozen=True)
class StepStanding:
    """Where one step stands.

    Parameters
    ----------
    step : RecipeStep
    state : str
        ``"signed"``, ``"stale"``, ``"does not hold"``, ``"open"`` or ``"locked"``.
    why : tuple of str
        Reasons of a state that is not ``"signed"`` or ``"open"``.
    signature : Signature or None
    command : str
        What signs it.
    """

    step: RecipeStep
    state: str
    why: tuple[str, ...]
    signature: Signature | None
    command: str

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""
        one = self.signature
        signed = None if one is None else {
            "by": one.by, "date": one.date, "version": one.version, "said": one.said, "holds": one.holds,
            "note": one.note, "figures": dict(one.figures), "flags": [dict(flag) for flag in one.flags],
            "files": dict(one.files), "evidence": dict(one.evidence), "checksum": one.checksum,
        }  # fmt: skip
        return {"step": self.step.number, "name": self.step.name, "state": self.state, "why": list(self.why),
                "needs": self.step.needs, "command": self.command, "signature": signed}  # fmt: skip


@dataclass(frozen=True)
class Guide:
    """The ten steps of one job.

    Parameters
    ----------
    path : Path
        Its state, ``NAME.guide.toml`` beside the job.
    ledger : Ledger
    job : mapping
        The job as it is now.
    """

    path: Path
    ledger: Ledger
    job: Mapping[str, Any]

    # -- begun and opened ---------------------------------------------------------------------------------------------
    @classmethod
    def new(
        cls, job: str | os.PathLike[str], *, about: Mapping[str, str] | None = None, log: str | None = None,
        model: str | None = None,
    ) -> Guide:  # fmt: skip
        """Begin the guide of a job file; of `log` and `model` a job file is written, where there is none.

        Raises
        ------
        InputError
            No job, a job that names no model or no log, a guide that is there already, a folder that cannot be written.
        """
        place = storage.as_path(job)
        if place.name.endswith(SUFFIX) or place.suffix.lower() != ".toml":
            raise InputError("a job is a TOML file", where=str(place), found=place.name, expected="NAME.toml",
                             hint="name it job.toml, with the lines log = ... and model = ...")  # fmt: skip
        path = state_of(place)
        if path.exists():
            raise InputError("this job has a guide already", where=str(path), found="a file of signatures",
                             expected="a job without one", hint=f"loadid guide status --job {place.name}")  # fmt: skip
        if log is not None or model is not None:
            _write_job(place, log, model)
        from .context import require_frozen

        found = _settled(place)
        if found.get("family", "auto") != "auto":
            require_frozen(found["family"])
        words = {name: value for name, value in (about or {}).items() if value}
        for name, value in words.items():
            _short(value, name)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        made = Ledger(place.name, now, words)
        with StateLock(path):
            ledgers.write(path, made)
        return cls(path, made, found)

    @classmethod
    def open(cls, job: str | os.PathLike[str] | None = None) -> Guide:
        """The guide of a job, by its job file or its own; of None the only one of the folder where we are.

        Raises
        ------
        InputError
            None, or several; one that is damaged; its job is gone.
        """
        path = _only_one() if job is None else state_of(storage.as_path(job))
        found = ledgers.read(path)
        if Path(found.job).name != found.job:
            raise InputError("the job of a guide lies beside it", where=str(path), found=repr(found.job)[:80],
                             expected="the name of a file", hint=ledgers.MEND)  # fmt: skip
        return cls(path, found, _settled(path.with_name(found.job)))

    @property
    def folder(self) -> Path:
        """Where the job lies."""
        return self.path.parent

    # -- where it stands ----------------------------------------------------------------------------------------------
    def standing(self) -> tuple[StepStanding, ...]:
        """Every step as it stands now: files are hashed and settings compared anew."""
        latest, old = self.ledger.latest(), stale(self.ledger, self.job, self.folder)
        found = []
        for one in STEPS:
            signature = latest.get(one.number)
            why = tuple(old.get(one.number, ()))
            state = STALE if why else SIGNED
            if signature is None or why:
                locked = lock(one.number, latest, old)
                if locked is not None and signature is None:
                    state, why = LOCKED, (locked[1],)
                elif signature is None:
                    state = OPEN
            elif not signature.holds:
                state, why = FAILED, (signature.said,)
            found.append(StepStanding(one, state, why, signature, self.command(one)))
        return tuple(found)

    def next(self) -> StepStanding | None:
        """The first step that waits: stale, open or failed; None where all ten are signed and hold."""
        return next((one for one in self.standing() if one.state in (STALE, OPEN, FAILED)), None)

    def command(self, one: RecipeStep) -> str:
        """What a user types to sign a step."""
        job = shlex.quote(os.path.relpath(self.path.with_name(self.ledger.job)))
        return f"loadid guide sign {one.number} --job {job}" + (f" --evidence {one.evidence}" if one.evidence else "")

    # -- signed -------------------------------------------------------------------------------------------------------
    def sign(
        self, number: int, evidence: Sequence[str | os.PathLike[str]] = (), *, by: str = "", note: str = "",
        reading: Mapping[str, Any] | None = None, record: str | Sequence[str] | None = None, truth: Sequence[str] = (),
        preview: bool = False, progress: Callable[[float, str], None] | None = None,
    ) -> tuple[Guide, Signature]:  # fmt: skip
        """Compute a step and sign it.

        Parameters
        ----------
        number : int
        evidence : sequence of path
            Logs are read, whatever else is named is kept by its hash.
        by, note : str
            Who signs, default the name at the system; words beside the figures.
        reading : mapping, optional
            Keyword arguments of `loadid.read` for the evidence; default those of the job.
        record : str or list of str, optional
            Record of a log that holds several.
        truth : sequence of str
            Channels of the known loads.
        preview : bool
            Compute and write nothing.
        progress : callable, optional

        Returns
        -------
        (Guide, Signature)
            The guide with the signature.

        Raises
        ------
        InputError, NotIdentifiable
            A step that is locked; evidence that is missing or does not fit; another process that signs; from the
            families. Nothing is written then.
        """
        from .context import Reading, kind_of
        from .figures import compute
        from .models import certificate
        from .outcome import Asked, tidied

        one, who = step(number), _short(by.strip() or _user(), "--by")
        _short(note, "--note")
        places = [storage.as_path(path) for path in evidence]
        files = {relative(path, self.folder): hashed(path) for path in places}
        with StateLock(self.path):
            now = Guide.open(self.path)  # another may have signed meanwhile
            latest, old = now.ledger.latest(), stale(now.ledger, now.job, now.folder)
            if (locked := lock(number, latest, old)) is not None:
                before, why = locked
                raise InputError(
                    f"step {one.title} is {why}",
                    where="loadid guide sign",
                    found="nothing was signed",
                    expected=f"step {before}, signed and standing",
                    hint=now.command(step(before)),
                )
            stood = files_of(number, now.job, now.folder)
            known = certificate(latest[VERIFY]) if VERIFY in latest and number > VERIFY else None
            job = kind_of(now.job)(now.job, Reading(dict(reading or {}), record, tuple(truth)), known)
            if progress is not None:
                progress(0.1, one.title)
            stem = self.path.name.removesuffix(SUFFIX)
            outcome = compute(number, Asked(job, places, latest, now.folder, stem))
            figures = tidied(outcome.figures)
            if said := job.reading.said():
                figures["evidence_read"] = tidied(said)
            made = {relative(path, now.folder): data for path, data in outcome.made.items()}
            signature = Signature(
                step=number, said=outcome.said, holds=bool(outcome.holds), by=who,
                date=datetime.now(UTC).isoformat(timespec="seconds"), version=__version__, note=note, figures=figures,
                flags=tuple(_flag(flag) for flag in outcome.flags), files=stood | _digests(made), evidence=files,
                settings=tidied(settings_of(number, now.job, now.folder)),
                after={str(k): s.checksum for k, s in latest.items() if k < number},
            )  # fmt: skip
            changed = replace(now, ledger=now.ledger.with_signature(signature))
            _unchanged(files | stood, now.folder)
            if not preview:
                for path, data in outcome.made.items():
                    storage.replace(path, data)
                ledgers.write(now.path, changed.ledger)
        return changed, changed.ledger.signatures[-1]

    def page(self) -> str:
        """The document as one HTML page."""
        from .page import document

        return document(self)


# -- files -------------------------------------------------------------------------------------------------------------
def state_of(job: Path) -> Path:
    """Where the guide of a job stands: ``beam.guide.toml`` of ``beam.toml`` and of ``beam.job.toml``."""
    if job.name.endswith(SUFFIX):
        return job
    return job.with_name(job.name.removesuffix(".toml").removesuffix(".job") + SUFFIX)


def _only_one() -> Path:
    found = sorted(Path().glob(f"*{SUFFIX}"))
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(
            "no guide is here",
            where=str(Path.cwd()),
            found=f"no file *{SUFFIX}",
            expected="the folder of a job",
            hint="loadid guide new JOB.toml, or --job JOB.toml",
        )
    raise InputError("several guides are here", where=str(Path.cwd()), found=", ".join(path.name for path in found[:8]),
                     expected="one", hint=f"name it: --job {found[0].name}")  # fmt: skip


def _settled(path: Path) -> dict[str, Any]:
    """A job that names its model and its log."""
    tree = _toml.read(path, "job")
    for name in FILES:
        if name not in tree:
            raise InputError(f"the job names no {name}", where=str(path), expected=f'{name} = "FILE"',
                             hint="add the line")  # fmt: skip
    from .context import kind_of

    return kind_of(tree).read(path)


def _write_job(path: Path, log: str | None, model: str | None) -> None:
    if path.exists():
        raise InputError(
            "the job file names its own log and model",
            where=str(path),
            found="--log or --model beside it",
            expected="a job file that is not there yet",
            hint="leave --log and --model out, or edit the job file",
        )
    if log is None or model is None:
        raise InputError("a job needs both", where="loadid guide new", found="--model" if log is None else "--log",
                         expected="--log LOG --model MODEL", hint="give both")  # fmt: skip
    storage.replace(path, job_text({"log": log, "model": model}, path.parent.resolve()).encode())


def _digests(made: Mapping[str, bytes]) -> dict[str, str]:
    import hashlib

    return {name: hashlib.sha256(data).hexdigest() for name, data in made.items()}


def _unchanged(files: Mapping[str, str], folder: Path) -> None:
    """Nothing, if files are as they were when the step began.

    Raises
    ------
    InputError
    """
    for name, digest in files.items():
        if hashed(folder / name) != digest:
            raise InputError("a file changed while the step was computed", where=name, found="another hash",
                             expected="files that stay as they are", hint="sign again; nothing was signed")  # fmt: skip


def _flag(flag: Any) -> dict[str, Any]:
    from structures._advice import on_command_line

    return {"code": flag.code, "level": flag.level, "message": on_command_line(flag.message),
            "evidence": str(flag.evidence), "advice": on_command_line(flag.advice)}  # fmt: skip


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        raise InputError("the system does not say who you are", where="--by", expected="a name",
                         hint='sign with --by "NAME"') from None  # fmt: skip


def _short(text: str, where: str) -> str:
    if len(text) > LONGEST or any(ord(c) < 32 and c not in "\n\t" for c in text):
        raise InputError("too long, or with control characters", where=where, found=f"{len(text)} characters",
                         expected=f"at most {LONGEST} of plain text")  # fmt: skip
    return text
