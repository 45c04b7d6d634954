"""Files that a C library parses are read in a child process: what hangs or crashes there leaves the caller as it was.

One child serves all files. It is started by the first, ended when a file takes too long, and started again by the next.
Requests and answers are JSON and raw numbers over pipes, so that nothing is unpickled on either side. What is asked for
is a function by its name, ``"package.module:function"``: it takes the request and gives plain data and arrays.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import importlib.util
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .._advice import from_plain, to_plain
from ..errors import InputError

PATIENCE = 4.0  # seconds of processor time that a small file may take
SPEED = 1e7  # bytes per second that a large one must at least be read with
LOADED = 15.0  # times as long it may take, once and again, while the machine gives it some time beside other work
MEMORY = 2**33  # bytes of addresses of the child
Arrays = list[NDArray[Any]]
_START = "import sys; sys.path.append(sys.argv[1]); from structures.files._child import serve; serve()"
_PARTS = ("what", "where", "found", "expected", "hint", "code")
_CAN_COUNT = importlib.util.find_spec("resource") is not None  # the system counts and limits processor time
_lock = threading.Lock()
_process: subprocess.Popen[bytes] | None = None
_owner = 0


class NoChildError(InputError):
    """No child process can be started here."""


def apart(
    task: str, request: Mapping[str, Any], *, reader: str, where: str, size: int, speed: float = SPEED
) -> tuple[Any, Arrays]:
    """What a function makes of a request, in the child.

    Parameters
    ----------
    task : str
        ``"package.module:function"``; the function returns plain data and a list of arrays.
    request : dict
        Plain data; the packages named under ``library`` are imported before the time of the file runs.
    reader : str
        Name of the library, for messages.
    where : str
        The file, for messages.
    size : int
        Bytes of the file.
    speed : float
        Bytes per second that it must at least be read with.

    Returns
    -------
    object, list of arrays

    Raises
    ------
    InputError
        What the function raised; or the library crashed or did not come back in time; `NoChildError` where no child
        starts.
    """
    limit = PATIENCE + size / speed
    with _lock:
        child = _running()
        stdin, stdout = _pipes(child)
        late = _Late(child, limit * (LOADED if _CAN_COUNT else 1.0))
        try:
            _send(stdin, {"task": task, "seconds": limit, "request": dict(request)})
            answer = _receive(stdout)
            arrays = [_array(stdout, np.dtype(kind), tuple(shape)) for kind, shape in answer.get("arrays", ())]
        except (OSError, EOFError, ValueError, KeyError, TypeError, MemoryError, OverflowError):
            in_time = late.waits and not _out_of_time(child)
            stop()
            raise InputError(
                f"the {reader} library {'crashed' if in_time else 'hangs'} on this file",
                where=where,
                found="a damaged file" if in_time else f"no answer in {limit:.0f} s of processor time",
                expected="an undamaged file",
                hint="transfer or export it again",
            ) from None
        except BaseException:  # interrupted: the rest of this answer must not become the next one
            stop()
            raise
        finally:
            late.end()
    if "error" in answer:
        raise InputError(**{k: from_plain(v) for k, v in answer["error"].items()})
    return answer["data"], arrays


class _Late:
    """Ends a child that does not come back; one that still computes is waited for: its processor time is limited.

    Parameters
    ----------
    child : Popen
    seconds : float
        After which it is looked at, and again after as many.
    """

    def __init__(self, child: subprocess.Popen[bytes], seconds: float) -> None:
        self.waits, self._child, self._seconds = True, child, seconds
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        used = _used(self._child.pid)
        while not self._over.wait(self._seconds):
            before, used = used, _used(self._child.pid)
            if used is None or before is None or used <= before:
                self.waits = False
                self._child.kill()
                return

    def end(self) -> None:
        """Nothing is waited for any more."""
        self._over.set()


def _used(pid: int) -> int | None:
    """Processor time of a process in ticks of the system; None where it does not say."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
        return int(words[11]) + int(words[12])
    except (OSError, ValueError, IndexError):
        return None


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


def serve() -> None:
    """The child: answer requests until the caller is gone."""
    _restrict()
    wanted, out = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a library prints must not get into the answers
    _send(out, {"ready": True})
    while True:
        try:
            asked = _receive(wanted)
        except EOFError:
            return
        module, _, name = asked["task"].partition(":")
        function = getattr(importlib.import_module(module), name)
        if asked["request"].get("library"):
            with contextlib.suppress(Exception):
                importlib.import_module(asked["request"]["library"])
        _allow_seconds(asked["seconds"])
        try:
            data, arrays = function(asked["request"])
        except InputError as error:
            said = {k: getattr(error, k) for k in _PARTS}
            plain = {k: v if v is None else to_plain(v if isinstance(v, str) else str(v)) for k, v in said.items()}
            _send(out, {"error": plain})
            continue
        arrays = [np.asarray(x, order="C") for x in arrays]
        _send(out, {"data": data, "arrays": [(x.dtype.str, x.shape) for x in arrays]})
        for x in arrays:
            out.write(x.reshape(-1).view("u1").data)
        out.flush()


def _running() -> subprocess.Popen[bytes]:
    global _process, _owner
    if _process is None or _owner != os.getpid() or _process.poll() is not None:
        if _owner == os.getpid():
            stop()
        if not sys.executable or getattr(sys, "frozen", False):
            raise _none_starts()
        root = str(Path(__file__).resolve().parents[2])
        try:
            _process = subprocess.Popen(
                [sys.executable, "-P", "-c", _START, root],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
        except OSError:
            raise _none_starts() from None
        _owner = os.getpid()
        try:
            _receive(_pipes(_process)[1])
        except (OSError, EOFError):
            stop()
            raise _none_starts() from None
    return _process


def _none_starts() -> NoChildError:
    return NoChildError("the child process that reads this format does not start", where="readers",
                        found=sys.executable, expected="a Python interpreter that can import this package")  # fmt: skip


def _pipes(child: subprocess.Popen[bytes]) -> tuple[Any, Any]:
    return child.stdin, child.stdout


def _allow_seconds(seconds: float) -> None:
    """End this process after so much more processor time, however much of it the machine gives."""
    if _CAN_COUNT:
        import resource

        used = time.process_time()
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(used + seconds), hard))


def _out_of_time(child: subprocess.Popen[bytes]) -> bool:
    """Whether a child was ended by the limit on its processor time."""
    if not _CAN_COUNT:
        return False
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(1.0)
    return child.returncode == -signal.SIGXCPU


def _restrict() -> None:
    """A cap on memory, no core dumps; where the system has such limits."""
    try:
        import resource
    except ImportError:
        return
    for kind, value in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_AS, MEMORY)):
        _, hard = resource.getrlimit(kind)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))


def _send(pipe: BinaryIO, message: dict[str, Any]) -> None:
    data = json.dumps(message).encode()
    pipe.write(len(data).to_bytes(8, "little") + data)
    pipe.flush()


def _receive(pipe: BinaryIO) -> dict[str, Any]:
    message = json.loads(_exactly(pipe, int.from_bytes(_exactly(pipe, 8), "little")))
    return dict(message)


def _array(pipe: Any, kind: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    found = np.empty(shape, kind)
    view = memoryview(found.reshape(-1).view("u1"))  # type: ignore[arg-type]
    while len(view):
        count = pipe.readinto(view)
        if not count:
            raise EOFError
        view = view[count:]
    return found


def _exactly(pipe: BinaryIO, size: int) -> bytes:
    data = pipe.read(size)
    if len(data) != size:
        raise EOFError
    return data


atexit.register(stop)
