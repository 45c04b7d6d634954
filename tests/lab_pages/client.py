"""A client of the lab that may say anything."""

from __future__ import annotations

import http.client
import json
from typing import Any

from loadid._lab.server import TOKEN, Lab


def asked(
    lab: Lab, path: str, body: bytes | None = None, headers: dict[str, str] | None = None, method: str = ""
) -> tuple[int, http.client.HTTPMessage, bytes]:
    """Status, headers and body of one request, on a connection of its own."""
    connection = http.client.HTTPConnection("127.0.0.1", lab.http.server_address[1], timeout=30)
    try:
        connection.request(method or ("GET" if body is None else "POST"), path, body, headers or {})
        found = connection.getresponse()
        return found.status, found.headers, found.read()
    finally:
        connection.close()


def known(lab: Lab, **more: str) -> dict[str, str]:
    """Headers of a call that is let in."""
    return {"Content-Type": "application/json", TOKEN: lab.token, **{k.replace("_", "-"): v for k, v in more.items()}}


def called(lab: Lab, path: str, parameters: Any) -> Any:
    """Answer of a call of a page."""
    status, _, body = asked(lab, path, json.dumps(parameters).encode(), known(lab))
    assert status == 200, body
    return json.loads(body)
