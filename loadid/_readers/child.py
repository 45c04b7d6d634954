"""Formats whose parser is a C library run in a child process: a damaged file may hang or crash that only.

One child serves all files; it is started by the first, killed when a file takes too long, and started again. Requests
and answers are JSON and raw numbers over pipes, so nothing is unpickled on either side.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from structures._advice import from_plain, to_plain
from structures._flags import Flag
from structures.errors import InputError

from .source import BUDGET, Options, Source, Table

PATIENCE = 4.0  # seconds that a small file may take
SPEED = 1e7  # bytes per second that a large one must at least be read with
_START = (
    "import sys; sys.path.append(sys.argv[1]); from loadid._readers import asked_for, child; child.serve(asked_for)"
)
_lock = threading.Lock()
_process: subprocess.Popen[bytes] | None = None
_owner = 0


def load_apart(form: str, source: Source, options: Options) -> list[Table]:
    """Tables that the reader `form` finds, read in the child.

    Raises
    ------
    InputError
        What the reader raised; or the library crashed or did not come back in time.
    """
    request = {"form": form, "path": str(source.path.resolve()), "shown": str(source.path), "axis": options.axis}
    with _lock:
        child = _running()
        stdin, stdout = _pipes(child)
        limit = PATIENCE + source.size / SPEED
        late = threading.Timer(limit, child.kill)
        late.start()
        try:
            _send(stdin, request)
            answer = _receive(stdout)
            tables = [_unpack(entry, stdout) for entry in answer["tables"]] if "tables" in answer else []
        except (OSError, EOFError, ValueError, KeyError, TypeError, MemoryError, OverflowError):
            in_time = late.is_alive()
            stop()
            source.refuse(
                f"the {form} library crashed on this file" if in_time else f"the {form} library hangs on this file",
                "a damaged file" if in_time else f"no answer in {limit:.0f} s",
                "an undamaged file",
                "transfer or export it again",
            )
        finally:
            late.cancel()
    if "error" in answer:
        raise InputError(**{k: from_plain(v) for k, v in answer["error"].items()})
    return tables


def stop() -> None:
    """End the child, if there is one."""
    global _process
    child, _process = _process, None
    if child is None or _owner != os.getpid():
        return
    child.kill()
    child.wait()
    for pipe in (child.stdin, child.stdout):
        if pipe:
            with contextlib.suppress(OSError):
                pipe.close()


def serve(tables: Callable[[dict[str, Any]], list[Table]]) -> None:
    """The child: answer requests by `tables` until the caller is gone."""
    _restrict()
    wanted, out = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a library prints must not get into the answers
    _send(out, {"ready": True})
    while True:
        try:
            request = _receive(wanted)
        except EOFError:
            return
        try:
            packed = [_pack(t) for t in tables(request)]
        except InputError as error:
            parts = {k: getattr(error, k) for k in ("what", "where", "found", "expected", "hint", "code")}
            _send(
                out,
                {
                    "error": {
                        k: v if v is None else to_plain(v if isinstance(v, str) else str(v)) for k, v in parts.items()
                    }
                },
            )
            continue
        _send(out, {"tables": [entry for entry, _ in packed]})
        for _, data in packed:
            out.write(data)
        out.flush()


def _running() -> subprocess.Popen[bytes]:
    global _process, _owner
    if _process is None or _owner != os.getpid() or _process.poll() is not None:
        if _owner == os.getpid():
            stop()
        root = str(Path(__file__).resolve().parents[2])
        _process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, root],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        _owner = os.getpid()
        try:
            _receive(_pipes(_process)[1])
        except (OSError, EOFError):
            stop()
            raise InputError(
                "the child process that reads this format does not start", where="readers", found=sys.executable,
                expected="a Python interpreter that can import loadid",
            ) from None  # fmt: skip
    return _process


def _pipes(child: subprocess.Popen[bytes]) -> tuple[Any, Any]:
    return child.stdin, child.stdout


def _restrict() -> None:
    """A cap on memory, no core dumps; where the system has such limits."""
    try:
        import resource
    except ImportError:
        return
    for kind, value in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_AS, 4 * BUDGET)):
        _, hard = resource.getrlimit(kind)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))


def _pack(table: Table) -> tuple[dict[str, Any], bytes]:
    values = np.ascontiguousarray(table.values)
    entry = {k: v for k, v in vars(table).items() if k not in ("values", "flags")}
    entry["flags"] = [f.to_dict() for f in table.flags]
    return {**entry, "dtype": values.dtype.str, "shape": values.shape}, values.tobytes()


def _unpack(entry: dict[str, Any], pipe: BinaryIO) -> Table:
    dtype, shape = np.dtype(entry.pop("dtype")), tuple(entry.pop("shape"))
    values = np.frombuffer(_exactly(pipe, dtype.itemsize * int(np.prod(shape))), dtype).reshape(shape)
    flags = tuple(Flag.from_dict(f) for f in entry.pop("flags"))
    entry = {k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()}
    return Table(values, flags=flags, **entry)


def _send(pipe: BinaryIO, message: dict[str, Any]) -> None:
    data = json.dumps(message).encode()
    pipe.write(len(data).to_bytes(8, "little") + data)
    pipe.flush()


def _receive(pipe: BinaryIO) -> dict[str, Any]:
    message = json.loads(_exactly(pipe, int.from_bytes(_exactly(pipe, 8), "little")))
    return dict(message)


def _exactly(pipe: BinaryIO, size: int) -> bytes:
    data = pipe.read(size)
    if len(data) != size:
        raise EOFError
    return data


atexit.register(stop)
