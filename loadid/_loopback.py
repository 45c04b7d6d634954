"""HTTP on the loopback alone, for what shows itself to browsers and monitors of the same machine.

Who asks under another name than the loopback's is refused: a page of another site can let its own name point here (DNS
rebinding), but not choose the ``Host`` that a browser sends. A client that says nothing, or says it a byte at a time,
is left after `Handler.timeout`; one that leaves is no error.
"""

from __future__ import annotations

import io
import logging
import socket
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import BoundedSemaphore
from typing import Any, ClassVar

from structures.errors import InputError

LOCAL = ("127.0.0.1", "localhost")
LINGER = 0.5  # s
CLIENTS = 64  # connections at a time; a browser opens six
log = logging.getLogger(__name__)


class LoopbackServer(ThreadingHTTPServer):
    """A server on 127.0.0.1, with a thread for each connection.

    Parameters
    ----------
    port : int
        0 for any that is free.
    handler : type of LoopbackHandler
    where : str
        What named the port, for the error.

    Raises
    ------
    InputError
        A port that is taken, or that the user may not have.
    """

    daemon_threads = True
    request_queue_size = CLIENTS

    def __init__(self, port: int, handler: type[LoopbackHandler], *, where: str = "--port") -> None:
        self._places, self._open = BoundedSemaphore(CLIENTS), set[socket.socket]()
        try:
            super().__init__(("127.0.0.1", port), handler)
        except (OSError, OverflowError) as error:
            said = error.strerror if isinstance(error, OSError) else str(error)
            raise InputError("the port cannot be had", where=f"{where} {port}", found=said,
                             expected="a port of this machine that is free",
                             hint="name another one, or 0 for any that is free") from None  # fmt: skip
        self.address = f"http://127.0.0.1:{self.server_address[1]}"

    def process_request(self, request: Any, client_address: Any) -> None:
        """A thread for the connection, where one is left."""
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """The connection, to its end."""
        self._open.add(request)
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._open.discard(request)
            self._places.release()

    def server_close(self) -> None:
        """Answer nobody any more, on connections that are open neither."""
        super().server_close()
        for one in list(self._open):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Who asked has left before the answer."""
        log.debug("no answer to %s", client_address, exc_info=True)


class _Patient(io.RawIOBase):
    """What a client sends, until a time after which nobody waits."""

    def __init__(self, connection: socket.socket, timeout: float) -> None:
        self._connection, self._timeout = connection, timeout
        self.until = time.monotonic() + timeout

    def readable(self) -> bool:
        """It is."""
        return True

    def readinto(self, into: Any) -> int:
        """As much as has come."""
        left = self.until - time.monotonic()
        if left <= 0:
            raise TimeoutError("the client is too slow")
        self._connection.settimeout(left)
        try:
            return self._connection.recv_into(into)
        finally:
            self._connection.settimeout(self._timeout)


class LoopbackHandler(BaseHTTPRequestHandler):
    """One connection: the host is checked, nothing is logged, errors are words."""

    timeout: ClassVar[float] = 10.0  # s, for a whole request and for each piece of an answer
    disable_nagle_algorithm = True
    wbufsize = -1  # head and body in one piece
    _refused = False
    headers_of_all: ClassVar[dict[str, str]] = {}

    def setup(self) -> None:
        """Read with a clock."""
        super().setup()
        self.rfile.close()
        self._patient = _Patient(self.connection, self.timeout)
        self.rfile = io.BufferedReader(self._patient)

    def finish(self) -> None:
        """Say all, and let who was refused while sending read why: a connection closed on unread data is reset."""
        super().finish()
        if self._refused:
            self.connection.shutdown(socket.SHUT_WR)
            self._patient.until = time.monotonic() + LINGER
            with suppress(OSError):
                while self._patient.readinto(bytearray(1 << 16)):
                    pass

    def wait(self, seconds: float) -> None:
        """How long this client may still take to say what it says."""
        self._patient.until = time.monotonic() + seconds

    def handle_one_request(self) -> None:
        """One request, from its first byte on."""
        self.wait(self.timeout)
        super().handle_one_request()

    @property
    def local(self) -> bool:
        """Whether it was asked for under a name of the loopback, with its port or without."""
        host, _, port = (self.headers.get("Host") or "").partition(":")
        return host in LOCAL and port in ("", str(self.server.server_address[1]))  # type: ignore[index]

    def say(self, code: int, kind: str, content: str | bytes, more: dict[str, str] | None = None) -> None:
        """Answer; after anything but a success the connection ends, as more of the request may lie unread."""
        data = content.encode() if isinstance(content, str) else content
        self._refused = code >= 400
        self.close_connection |= self._refused
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        for name, value in {**self.headers_of_all, **(more or {})}.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What the library refuses by itself: a line that is no request, a method that is not known."""
        if code == 501:
            self.say(405, "text/plain", "this server does not know this method\n")
        else:
            self.say(int(code), "text/plain", f"no request that can be read: {message or code}\n")

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing."""
