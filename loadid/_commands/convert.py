"""``loadid convert``: a log, a result or a model in another format."""

from __future__ import annotations

import io
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError
from structures.files import _storage as storage

from . import Command, UsageError, add_log_options, emit, load_model, one_record, require_outputs, settings

if TYPE_CHECKING:
    from .._record import Record
    from .._results.estimate import LoadEstimate

EXAMPLES = """\
examples:
  a log in the units of the SI:                        loadid convert run.lvm --record record_2 --unit F=N -o run.csv
  the loads of a result with their std, over time:     loadid convert result.h5 -o load.csv
  lines, FRFs and channels of a model for NumPy:       loadid convert frfs.uff -o frfs.npz
"""
RESULT = "load estimate"


# -- what is written by which suffix: the one place that says it -------------------------------------------------------
def _npz(record: Record, path: Path) -> None:
    import numpy as np

    whole = {"x": record.values, "dt": np.array(record.dt), "channels": np.array(record.labels)}
    _archive(path, whole | {"units": np.array([c.unit for c in record.channels])})


def _written(name: str) -> Callable[[Any, Path], None]:
    """A writer of the record's own."""
    return lambda record, path: getattr(record, name)(path)


RECORDS: dict[str, Callable[[Any, Path], None]] = {
    ".npz": _npz, ".csv": _written("to_csv"), ".txt": _written("to_csv"), ".parquet": _written("to_parquet"),
    ".mat": _written("to_mat"), ".uff": _written("to_uff"), ".unv": _written("to_uff"),
}  # fmt: skip
MODELS = (".npz", ".h5", ".hdf5")


def _archive(path: Path, arrays: dict[str, Any]) -> None:
    import numpy as np

    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    storage.replace(path, buffer.getvalue())


def loads_of(estimate: LoadEstimate) -> Record:
    """Loads and stds of an estimate over time, as a record.

    Raises
    ------
    InputError
        An estimate over something else than time.
    """
    import numpy as np

    from structures import Channel

    from .._record import Record

    if estimate.axis is None or estimate.axis.name != "time":
        raise InputError("the result is no history", where="convert",
                         found="one load" if estimate.axis is None else f"a load over {estimate.axis.name}",
                         expected="a load over time",
                         hint="loadid info RESULT --json-full prints all of its numbers")  # fmt: skip
    t = np.asarray(estimate.axis.values)
    stds = (
        []
        if estimate.std is None
        else [(f"{label} std", estimate.std[:, j]) for j, label in enumerate(estimate.labels)]
    )
    columns = [*((label, estimate.load[:, j]) for j, label in enumerate(estimate.labels)), *stds]
    twice = [*estimate.units, *(estimate.units if stds else ())]
    named = [Channel(label=name, unit=unit) for (name, _), unit in zip(columns, twice, strict=True)]
    return Record(np.column_stack([x for _, x in columns]), float(t[1] - t[0]), named, name="loads")


def convert(
    path: str | Path, output: str | Path, *, record: str | Sequence[str] | None = None, **reading: Any
) -> tuple[str, tuple[str, ...]]:
    """Write what a file holds in the format that the suffix of another names; what was in it, and how a log was read.

    Parameters
    ----------
    path, output : path
    record : str or sequence of str, optional
        Of a log that holds several; several are put onto one clock.
    **reading
        As for `loadid._readers.read`.

    Raises
    ------
    InputError
        From the readers; a suffix that nothing is written under; a result that is no history.
    """
    target, kind = storage.as_path(output), None
    if storage.as_path(path).is_file():
        kind = storage.kind_of(path)
    if kind == RESULT:
        from .._results.estimate import LoadEstimate

        RECORDS[_known(target, tuple(RECORDS))](loads_of(LoadEstimate.read(path)), target)
        return "result", ()
    if kind is not None or _is_frfs(path):
        _model(path, target)
        return "model", ()
    from .._readers import read

    write, log = RECORDS[_known(target, tuple(RECORDS))], read(path, record=record, **reading)
    write(log, target)
    return "log", log.notes


def _is_frfs(path: str | Path) -> bool:
    from .info import universal

    return bool(universal(path))


def _model(path: str | Path, target: Path) -> None:
    import numpy as np

    suffix = _known(target, MODELS)
    model: Any = load_model(path)
    if suffix != ".npz":
        model.save(target)
    elif model.structure is not None:
        from structures.files import save

        save(model.structure, target)
    elif model.frequencies is not None:
        told = {"sensors": model.sensors, "loads": model.loads}
        texts = {name: np.array([c.label for c in some]) for name, some in told.items()}
        texts |= {f"{name[:-1]}_units": np.array([c.unit for c in some]) for name, some in told.items()}
        f = model.frequencies
        _archive(target, {"frequencies": f, "frf": model.frf(f), **texts})
    else:
        raise InputError("this kind of model is written as HDF5 alone", where=str(target), expected=".h5",
                         hint=f"name it {target.with_suffix('.h5').name}")  # fmt: skip


def _known(target: Path, suffixes: tuple[str, ...]) -> str:
    suffix = target.suffix.lower()
    if suffix not in suffixes:
        raise InputError("nothing is written under this suffix", where=f"-o {target}", found=suffix or "no suffix",
                         expected=", ".join(suffixes), hint="end the name with one of them")  # fmt: skip
    return suffix


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("file", metavar="FILE", help="log, result or model")
    parser.add_argument("-o", "--output", required=True, metavar="OUT",
                        help=f"file to write: {', '.join(RECORDS)}; of models {', '.join(MODELS)}")  # fmt: skip
    add_log_options(parser)


def _run(args: Namespace) -> int:
    every = tuple(dict.fromkeys((*RECORDS, *MODELS)))
    require_outputs({"-o": args.output}, [args.file], suffixes={"-o": every})
    if not Path(args.output).suffix:
        raise UsageError(f"-o {args.output} names no format: end it with one of {', '.join(every)}")
    kind, notes = convert(args.file, args.output, record=one_record(args), **settings(args))
    said = [f"{kind} {args.file} written to {args.output}", *(f"  {note}" for note in notes)]
    emit(args, {"kind": kind, "written": args.output, "notes": notes}, "\n".join(said))
    return 0


command = Command("convert", "write a log, a result or a model in another format", _configure, _run)
