"""The server of the lab: pages for browsers that know the token of this start, and calls in strict JSON.

Every start makes a token, which the printed address carries; who has not got it sees nothing, on a machine of many
users neither. Pages, style and script are sent from memory under names that are known, so no path of a request
reaches the disk. The policy of a page lets only its own script run and lets it speak to this server alone.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import hmac
import json
import logging
import os
import re
import secrets
import tempfile
from collections.abc import Callable, Iterable
from importlib.resources import files
from pathlib import Path
from threading import Thread
from typing import Any, ClassVar, NoReturn, Self
from urllib.parse import parse_qs, unquote, urlsplit

from structures._threads import one_thread
from structures.errors import InputError, NotIdentifiable

from .._loopback import LOCAL, LoopbackHandler, LoopbackServer
from .._page import STYLE, TICKS, environment, text
from .contract import BODY, Call, Download, Page, script

TOKEN, PARAMETERS, NAME = "X-Lab-Token", "X-Lab-Parameters", "X-Lab-File"
SLOW = 600.0  # s that an upload may take
PIECE = 1 << 20
PACKED = 1400  # bytes: what fits in one packet is sent as it is
SCRIPT, CSS = "text/javascript; charset=utf-8", "text/css; charset=utf-8"
HTML, JSON, PLAIN = "text/html; charset=utf-8", "application/json", "text/plain; charset=utf-8"
POLICY = ("default-src 'none'; script-src 'self'{hash}; style-src 'self'; img-src 'self' data: blob:; "
          "connect-src 'self'; base-uri 'none'; form-action 'none'; "
          "frame-ancestors 'self' http://127.0.0.1:* http://localhost:*")  # fmt: skip
log = logging.getLogger(__name__)


class _Answered(Exception):
    """A request that ends here, with a status and a sentence."""

    def __init__(self, code: int, said: str) -> None:
        super().__init__(said)
        self.code, self.said = code, said


class Lab:
    """Pages, served until `close`.

    Parameters
    ----------
    pages : iterable of Page
    port : int
        0 for any that is free.

    Attributes
    ----------
    address : str
        With the token, for a browser.

    Raises
    ------
    InputError
        A port that cannot be had.
    """

    def __init__(self, pages: Iterable[Page], port: int = 0) -> None:
        self.pages = {page.name: page for page in pages}
        self.token = secrets.token_urlsafe(24)
        self.shared = {
            "lab.js": (SCRIPT, text(TICKS).encode() + _own("lab.js")),
            "lab.css": (CSS, text(STYLE).encode() + _own("lab.css")),
        }
        self.http = LoopbackServer(port, type("LabHandler", (_LabHandler,), {"lab": self}))
        self.address = f"{self.http.address}/?token={self.token}"

    def page(self, name: str) -> str:
        """Address of one page, with the token."""
        return f"{self.http.address}/{name}?token={self.token}"

    def start(self) -> Self:
        """Serve in a thread of its own."""
        Thread(target=self.http.serve_forever, args=(0.05,), name="lab", daemon=True).start()
        return self

    def run(self) -> None:
        """Serve here, until the process is interrupted."""
        self.http.serve_forever(0.2)

    def close(self) -> None:
        """Answer nobody any more; of a lab that was started."""
        self.http.shutdown()
        self.http.server_close()

    def __enter__(self) -> Self:
        """Serve while the block lasts."""
        return self.start()

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def html(self, name: str) -> tuple[str, str]:
        """A page, "" for the list of them, and its policy."""
        page = self.pages[name] if name else None
        body = page.body if page else ""
        code = script(body)
        found = environment().from_string(_own("shell.html").decode()).render(
            page=page, body=body, pages=self.pages.values(), token=self.token
        )  # fmt: skip
        digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
        return found, POLICY.format(hash=f" 'sha256-{digest}'" if code else "")


class _LabHandler(LoopbackHandler):
    lab: Lab
    protocol_version = "HTTP/1.1"
    headers_of_all: ClassVar[dict[str, str]] = {
        "Cache-Control": "no-store",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
    }

    def do_GET(self) -> None:
        """A page, the style or the script."""
        self._handled(self._get)

    def do_POST(self) -> None:
        """A call of a page."""
        self._handled(self._post)

    def do_HEAD(self) -> None:
        """Refused, as every other method is."""
        self.say(405, PLAIN, "pages are asked for by GET, calls by POST\n", {"Allow": "GET, POST"})

    do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_TRACE = do_CONNECT = do_HEAD

    def _handled(self, work: Callable[[], None]) -> None:
        """Answer what `work` answers, or what it stumbles over, in words."""
        try:
            self._require_local()
            work()
        except _Answered as found:
            self._told(found.code, found.said)
        except InputError as error:
            self._told(400, str(error))
        except NotIdentifiable as error:
            self._told(422, str(error))
        except TimeoutError:
            self._told(408, "the request took too long to arrive")
        except OSError:
            raise  # who asked has left
        except Exception as error:  # a fault of a page must end neither the server nor its page
            log.debug("fault in %s", self.path, exc_info=True)
            self._told(500, f"this is a fault of the lab ({type(error).__name__}), please report it")

    def _told(self, code: int, said: str) -> None:
        if self.command == "POST":
            self.say(code, JSON, _strict({"error": said}))
        else:
            self.say(code, PLAIN, said + "\n")

    def _require_local(self) -> None:
        """Nothing, unless another site is asking."""
        port = self.server.server_address[1]  # type: ignore[index]
        origin = self.headers.get("Origin")
        if not self.local:
            raise _Answered(403, "this server speaks to its own machine, under the address that it printed")
        if origin is not None and origin not in {f"http://{name}:{port}" for name in LOCAL}:
            raise _Answered(403, "a page of another site asks: only pages of this server may")

    def _require_token(self, given: str) -> None:
        if not hmac.compare_digest(given.encode(), self.lab.token.encode()):
            raise _Answered(403, "the token is missing or not that of this start: open the address that was printed")

    def _get(self) -> None:
        split = urlsplit(self.path)
        name = split.path.removeprefix("/")
        if name in self.lab.shared:
            self._send(*self.lab.shared[name])
            return
        if name and name not in self.lab.pages:
            raise _Answered(404, f"there is no such page; there are /, /{', /'.join(self.lab.pages)}")
        self._require_token(parse_qs(split.query).get("token", [""])[0])
        found, policy = self.lab.html(name)
        self.say(200, HTML, found, {"Content-Security-Policy": policy})

    def _post(self) -> None:
        self._require_token(self.headers.get(TOKEN) or "")
        page, _, name = urlsplit(self.path).path.removeprefix("/").partition("/")
        call = self.lab.pages[page].calls.get(name) if page in self.lab.pages else None
        if call is None:
            raise _Answered(404, "no page has such a call")
        answer = self._uploaded(call) if call.upload else self._asked(call)
        if isinstance(answer, Download):
            safe = re.sub(r"[^\w.-]", "_", answer.name, flags=re.ASCII)
            self.say(200, answer.kind, answer.content, {"Content-Disposition": f'attachment; filename="{safe}"'})
        else:
            self._send(JSON, _strict(answer).encode())

    def _asked(self, call: Call) -> Any:
        if (self.headers.get("Content-Type") or "").partition(";")[0].strip().lower() != JSON:
            raise _Answered(415, "a call is sent as application/json")
        arguments = call.read(parsed(self.rfile.read(self._length(BODY))))
        with one_thread():
            return call.answer(**arguments)

    def _uploaded(self, call: Call) -> Any:
        size = self._length(call.upload)
        arguments = call.read(parsed(unquote(self.headers.get(PARAMETERS) or "{}").encode()))
        name = re.sub(r"[^\w.-]", "_", unquote(self.headers.get(NAME) or "")).lstrip(".")[-100:] or "upload"
        self.wait(SLOW)
        with tempfile.TemporaryDirectory(prefix="loadid-lab-") as folder:
            target = Path(folder) / name
            with target.open("wb") as file:
                while size:
                    piece = self.rfile.read(min(size, PIECE))
                    if not piece:
                        raise _Answered(400, f"the file ended {size} bytes before its end")
                    size -= file.write(piece)
            try:
                with one_thread():
                    return call.answer(upload=target, **arguments)
            except InputError as error:  # where the file lies meanwhile is nobody's concern
                raise _Answered(400, str(error).replace(f"{target.parent}{os.sep}", "")) from None

    def _length(self, most: int) -> int:
        """Bytes of the body, which are not read before they are known to be few enough."""
        text = self.headers.get("Content-Length")
        if text is None or self.headers.get("Transfer-Encoding") is not None:
            raise _Answered(411, "the length of the body must be stated, in Content-Length")
        if not (text.isascii() and text.isdecimal() and len(text) < 19):
            raise _Answered(400, "Content-Length is no number of bytes")
        if int(text) > most:
            raise _Answered(413, f"the body has {int(text)} bytes; at most {most} are taken")
        return int(text)

    def _send(self, kind: str, data: bytes) -> None:
        if len(data) > PACKED and "gzip" in (self.headers.get("Accept-Encoding") or ""):
            self.say(200, kind, gzip.compress(data, 3, mtime=0), {"Content-Encoding": "gzip"})
        else:
            self.say(200, kind, data)


def parsed(body: bytes) -> Any:
    """A JSON value as the standard has it: no NaN, no infinity, no name twice.

    Raises
    ------
    InputError
        Anything else.
    """
    try:
        return json.loads(body.decode(), parse_constant=_constant, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        said = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)[:200]
        raise InputError("the body is no strict JSON", where="body", found=said,
                         expected="one JSON value, in UTF-8") from None  # fmt: skip


def _constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name stands twice in an object")
    return found


def _strict(answer: Any) -> str:
    from .._results.archive import plain

    return json.dumps(plain(answer), allow_nan=False, separators=(",", ":"))


def _own(name: str) -> bytes:
    return files(__package__).joinpath("files", name).read_bytes()
