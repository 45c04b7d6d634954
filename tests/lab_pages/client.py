"""A client of the lab: what the script of a page asks, and whatever else may be said over HTTP."""

from __future__ import annotations

import http.client
import json
from pathlib import Path
from typing import Any
from urllib.parse import quote

from loadid._lab.server import TOKEN, Lab


def requested(
    lab: Lab, path: str, body: bytes | None = None, headers: dict[str, str] | None = None, method: str = ""
) -> tuple[int, http.client.HTTPMessage, bytes]:
    """Status, headers and body of one request, on a connection of its own."""
    connection = http.client.HTTPConnection("127.0.0.1", lab.http.server_address[1], timeout=60)
    try:
        connection.request(method or ("GET" if body is None else "POST"), path, body, headers or {})
        found = connection.getresponse()
        return found.status, found.headers, found.read()
    finally:
        connection.close()


def known(lab: Lab, **more: str) -> dict[str, str]:
    """Headers of a call that is let in."""
    return {"Content-Type": "application/json", TOKEN: lab.token, **{k.replace("_", "-"): v for k, v in more.items()}}


def posted(lab: Lab, path: str, body: bytes, headers: dict[str, str]) -> tuple[int, Any]:
    """Status and answer: JSON, or bytes of a download."""
    status, told, data = requested(lab, path, body, {TOKEN: lab.token, **headers})
    return status, json.loads(data) if told["Content-Type"].startswith("application/json") else data


def asked(lab: Lab, path: str, **given: Any) -> tuple[int, Any]:
    """A call of a page, ``page/call``."""
    return posted(lab, f"/{path}", json.dumps(given).encode(), known(lab))


def called(lab: Lab, path: str, **given: Any) -> Any:
    """Answer of a call that must be answered."""
    status, found = asked(lab, path, **given)
    assert status == 200, found
    return found


def sent(lab: Lab, path: str, content: bytes | Path, name: str = "", **given: str) -> tuple[int, Any]:
    """A file sent to a call of a page."""
    data = content.read_bytes() if isinstance(content, Path) else content
    name = name or (content.name if isinstance(content, Path) else "file")
    told = {"X-Lab-File": quote(name), "X-Lab-Parameters": quote(json.dumps(given))}
    return posted(lab, f"/{path}", data, {"Content-Type": "application/octet-stream", **told})
