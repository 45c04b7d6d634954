"""The server of the lab, asked by who means well, who does not, and who is slow: words, no traceback, and it lives."""

from __future__ import annotations

import http.client
import json
import math
import re
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loadid._lab.contract import Call, Download, OneOf, OnOff, Page, Real, Reals, Text, Whole, rounded
from loadid._lab.pages import pages
from loadid._lab.server import NAME, PARAMETERS, TOKEN, Lab, _LabHandler
from loadid._loopback import CLIENTS, LoopbackHandler, LoopbackServer
from structures.errors import InputError, NotIdentifiable

from .client import called, known, requested
from .fuzz import SLOW, accepted, bodies

seen: list[Path] = []


def _up(upload: Path, keep: bool) -> dict[str, Any]:
    seen.append(upload)
    return {"size": upload.stat().st_size, "name": upload.name, "keep": keep}


def _fails(how: str) -> None:
    raise {
        "input": InputError("it is bent", where="x"),
        "told": NotIdentifiable("nothing is seen", advice="add a sensor", code="LID-E306"),
        "fault": ZeroDivisionError("secret"),
    }[how]


ECHO = Page(
    "echo", "Echo <b>", "says it again", "loadid._lab", "files/shell.html",
    {
        "say": Call(lambda **given: {**given, "array": np.array([1.5, math.nan])},
                    {"x": Real(0, 1), "n": Whole(-2, 3), "on": OnOff(), "word": OneOf(("a", "b")), "text": Text(5),
                     "list": Reals(0, 1, 3)}),
        "up": Call(_up, {"keep": OnOff()}, upload=200_000),
        "down": Call(lambda: Download('a"b\r\n.csv', b"1,2", "text/csv")),
        "fails": Call(_fails, {"how": Text()}),
        "nothing": Call(dict),
    },
)  # fmt: skip
GOOD = {"x": 0.5, "n": 1, "on": True, "word": "a", "text": "yes", "list": [0, 1]}


@pytest.fixture(scope="module")
def lab() -> Iterator[Lab]:
    with Lab([ECHO]) as server:
        yield server


def heading(lab: Lab, path: str) -> str:
    """Head of a call, which its length and an empty line must follow."""
    return f"POST {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{TOKEN}: {lab.token}\r\nContent-Type: application/json\r\n"


def said(body: bytes) -> str:
    """The sentence of a refusal, which no traceback and no path is part of."""
    text = json.loads(body)["error"]
    assert "Traceback" not in text
    assert "/loadid/" not in text
    assert len(text) < 1000
    return text


# -- who is let in -----------------------------------------------------------------------------------------------------
def test_the_printed_address_opens_the_list_of_pages_and_no_other_does(lab: Lab) -> None:
    status, headers, body = requested(lab, lab.address.removeprefix(lab.http.address))
    assert status == 200
    assert b"says it again" in body
    assert lab.token.encode() in body
    assert headers["Cache-Control"] == "no-store"
    assert headers["X-Content-Type-Options"] == "nosniff"
    for path in ("/", "/echo", "/?token=", "/echo?token=" + "x" * 32, f"/?token={lab.token}x", "/?token=%ff"):
        status, _, body = requested(lab, path)
        assert (status, lab.token.encode() in body) == (403, False), path


def test_the_token_is_new_at_every_start() -> None:
    with Lab([]) as one, Lab([]) as other:
        assert one.token != other.token


def test_names_are_escaped_and_the_policy_lets_only_the_own_script_run(lab: Lab) -> None:
    with Lab(pages()) as real:
        for page in real.pages.values():
            _, headers, body = requested(real, f"/{page.name}?token={real.token}")
            policy = dict(part.split(" ", 1) for part in headers["Content-Security-Policy"].split("; "))
            assert policy["default-src"] == "'none'"
            assert policy["connect-src"] == "'self'"
            assert re.fullmatch(r"'self' 'sha256-[\w+/=]+'", policy["script-src"]), page.name
            assert len(re.findall(rb"<script", body)) == 1
            assert not re.search(rb"\s(style|on\w+)=|<style|https?://|//[a-z]+\.", body), page.name
    assert b"Echo &lt;b&gt;" in requested(lab, f"/echo?token={lab.token}")[2]


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1:1", "", "127.0.0.1.evil.example"])
def test_another_name_of_this_host_is_refused(lab: Lab, host: str) -> None:
    assert requested(lab, f"/?token={lab.token}", headers={"Host": host})[0] == 403
    status, _, body = requested(lab, "/echo/nothing", b"{}", known(lab, Host=host))
    assert status == 403
    assert "its own machine" in said(body)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1:1", "file://"]
)
def test_pages_of_other_sites_are_refused(lab: Lab, origin: str) -> None:
    status, _, body = requested(lab, "/echo/nothing", b"{}", known(lab, Origin=origin))
    assert status == 403
    assert "another site" in said(body)


def test_its_own_pages_may_call(lab: Lab) -> None:
    port = lab.http.server_address[1]
    for name in ("127.0.0.1", "localhost"):
        headers = known(lab, Origin=f"http://{name}:{port}", Host=f"{name}:{port}")
        assert requested(lab, "/echo/nothing", b"{}", headers)[0] == 200


@pytest.mark.parametrize("token", ["", "x", "é"])
def test_a_call_needs_the_token(lab: Lab, token: str) -> None:
    headers = {**known(lab), TOKEN: token.encode("utf-8").decode("latin-1")}
    status, _, body = requested(lab, "/echo/nothing", b"{}", headers)
    assert status == 403
    assert "token" in said(body)


# -- what is asked -----------------------------------------------------------------------------------------------------
def test_a_call_answers_in_strict_json(lab: Lab) -> None:
    assert called(lab, "echo/say", **GOOD) == {**GOOD, "array": [1.5, None]}


WRONG = [
    ("x", 1.5), ("x", -1e-9), ("x", "0.5"), ("x", True), ("x", None), ("x", [0.5]), ("x", {}), ("n", 1.5), ("n", 4),
    ("n", True), ("n", "1"), ("on", 1), ("on", "true"), ("word", "c"), ("word", None), ("word", ["a"]),
    ("text", "123456"), ("text", "a\n"), ("text", 5), ("text", "\ud800"), ("list", [0, 0, 0, 0]), ("list", [2]),
    ("list", "0"), ("list", [None]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_a_value_out_of_its_range_is_named(lab: Lab, name: str, value: Any) -> None:
    status, _, body = requested(lab, "/echo/say", json.dumps({**GOOD, name: value}).encode(), known(lab))
    assert status == 400
    assert said(body).startswith(name)


RAW = [
    b"", b"{", b"null", b"[]", b"5", b'"x"', b"\xff\xfe", b"{}", b"[" * 30_000, b'{"x":' * 9000, b"\x00" * 40,
    b'{"x": NaN}', b'{"x": Infinity}', b'{"x": -Infinity}', b"{'x': 1}", b'{"x": 1, "x": 1}',
    b'{"x": 1' + b"0" * 5000 + b"}",
]  # fmt: skip


@pytest.mark.parametrize("raw", RAW, ids=range(len(RAW)))
def test_what_is_no_strict_object_of_all_parameters_is_refused(lab: Lab, raw: bytes) -> None:
    status, _, body = requested(lab, "/echo/say", raw, known(lab))
    assert status == 400
    assert said(body).startswith("body")


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999", "1" + "0" * 400])
def test_numbers_that_are_not_finite_do_not_reach_the_numerics(lab: Lab, number: str) -> None:
    body = json.dumps(GOOD).replace("0.5", number).encode()
    assert requested(lab, "/echo/say", body, known(lab))[0] == 400


def test_too_many_and_too_few_parameters(lab: Lab) -> None:
    for given in ({**GOOD, "more": 1}, {k: v for k, v in GOOD.items() if k != "x"}):
        status, _, body = requested(lab, "/echo/say", json.dumps(given).encode(), known(lab))
        assert status == 400
        assert "x, n, on, word, text, list" in said(body)


def test_other_kinds_of_bodies(lab: Lab) -> None:
    for kind, status in (
        ("text/plain", 415),
        ("application/json; charset=utf-8", 200),
        ("application/x-www-form-urlencoded", 415),
    ):
        assert requested(lab, "/echo/nothing", b"{}", {**known(lab), "Content-Type": kind})[0] == status


@pytest.mark.parametrize("size", [65_537, 3_000_000])
def test_a_body_that_is_too_long_is_told_so_before_it_is_read(lab: Lab, size: int) -> None:
    status, _, body = requested(lab, "/echo/say", b" " * size, known(lab))
    assert status == 413
    assert "65536" in said(body)


def test_places_that_do_not_exist(lab: Lab) -> None:
    assert requested(lab, "/nix")[0] == 404
    for path in ("/lab.py", "/../server.py", "/%2e%2e/server.py", "/files/shell.html", "//etc/passwd", "/echo/say"):
        assert requested(lab, path)[0] == 404, path
    for path in ("/echo", "/echo/nix", "/nix/say", "/", "/echo/say/more"):
        status, _, body = requested(lab, path, b"{}", known(lab))
        assert status == 404
        assert "no page" in said(body)


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "HEAD", "TRACE", "FOO"])
def test_other_methods(lab: Lab, method: str) -> None:
    assert requested(lab, "/echo/say", method=method)[0] == 405


@pytest.mark.parametrize(("how", "status", "words"), [
    ("input", 400, "it is bent"), ("told", 422, "add a sensor"), ("fault", 500, "fault of the lab (ZeroDivisionError)"),
])  # fmt: skip
def test_what_a_page_raises_is_told_in_words(lab: Lab, how: str, status: int, words: str) -> None:
    found, _, body = requested(lab, "/echo/fails", json.dumps({"how": how}).encode(), known(lab))
    assert found == status
    assert words in said(body)
    assert "secret" not in said(body)


def test_a_connection_serves_many_calls(lab: Lab) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", lab.http.server_address[1], timeout=10)
    for k in (1, 2, 3):
        connection.request("POST", "/echo/say", json.dumps({**GOOD, "n": k}), known(lab))
        found = connection.getresponse()
        assert json.loads(found.read())["n"] == k
    connection.request("POST", "/echo/say", b"{}", known(lab))
    refused = connection.getresponse()
    assert refused.status == 400
    assert "body" in said(refused.read())
    connection.close()


# -- files -------------------------------------------------------------------------------------------------------------
def test_an_upload_is_a_file_with_a_harmless_name_while_it_is_answered(lab: Lab) -> None:
    headers = {TOKEN: lab.token, NAME: "..%2F..%2Fetc%2Fpass wd%00.csv", PARAMETERS: "%7B%22keep%22%3Atrue%7D"}
    status, _, body = requested(lab, "/echo/up", b"x" * 150_000, headers)
    assert status == 200
    assert json.loads(body) == {"size": 150_000, "name": "_.._etc_pass_wd_.csv", "keep": True}
    assert not seen[-1].exists()
    assert not seen[-1].parent.exists()


def test_uploads_that_are_too_long_cut_or_without_parameters(lab: Lab) -> None:
    headers = {TOKEN: lab.token, PARAMETERS: '{"keep":true}'}
    assert requested(lab, "/echo/up", b"x" * 200_001, headers)[0] == 413
    assert requested(lab, "/echo/up", b"x", {TOKEN: lab.token})[0] == 400
    with socket.create_connection(lab.http.server_address, timeout=10) as line:
        more = f'{PARAMETERS}: {{"keep":true}}\r\nContent-Length: 100\r\n\r\n'
        line.sendall((heading(lab, "/echo/up") + more).encode() + b"x" * 60)
        line.shutdown(socket.SHUT_WR)
        assert b"ended 40 bytes before its end" in line.recv(10_000)


def test_a_download_has_a_harmless_name(lab: Lab) -> None:
    status, headers, body = requested(lab, "/echo/down", b"{}", known(lab))
    assert status == 200
    assert body == b"1,2"
    assert headers["Content-Type"] == "text/csv"
    assert headers["Content-Disposition"] == 'attachment; filename="a_b__.csv"'


# -- who is slow, or rude ----------------------------------------------------------------------------------------------
def test_slow_clients_are_left_and_hold_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LoopbackHandler, "timeout", 0.5)
    with Lab([ECHO]) as lab:
        port, head = lab.http.server_address[1], heading(lab, "/echo/say")
        slow = []
        for begun in (b"", b"GET / HT", head.encode(), f"{head}Content-Length: 50\r\n\r\n{{".encode()):
            slow.append(socket.create_connection(("127.0.0.1", port), timeout=10))
            slow[-1].sendall(begun)
        begin = time.monotonic()
        assert called(lab, "echo/say", **GOOD)["n"] == 1
        assert time.monotonic() - begin < 0.4
        ends = []
        for line in slow:
            try:
                while time.monotonic() - begin < 5:
                    line.sendall(b" ")  # a byte at a time keeps nobody waiting either
                    time.sleep(0.05)
            except OSError:
                ends.append(time.monotonic() - begin)
            line.close()
        assert len(ends) == 4
        assert max(ends) < 3


def test_more_connections_than_places_are_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LoopbackHandler, "timeout", 1.0)
    with Lab([ECHO]) as lab:
        lines = [socket.create_connection(lab.http.server_address, timeout=10) for _ in range(CLIENTS + 5)]
        time.sleep(0.2)
        assert lines[-1].recv(10) == b""
        for line in lines:
            line.close()
        time.sleep(0.2)
        assert called(lab, "echo/nothing") == {}


@pytest.mark.parametrize("raw", [
    b"\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00\x01", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n",
    b"GET " + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 200 + b"\r\n", b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    b"GET http://[ HTTP/1.1\r\n\r\n",
])  # fmt: skip
def test_what_is_no_request_ends_its_connection_alone(lab: Lab, raw: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_connection(lab.http.server_address, timeout=15) as line:
        line.sendall(raw)
        line.shutdown(socket.SHUT_WR)
        found = line.recv(100_000)
    assert b"Traceback" not in found
    assert b"200 OK" not in found
    assert called(lab, "echo/nothing") == {}
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("length", ["-1", "1e3", "x", "٣", "9" * 30, ""])
def test_lengths_that_are_none(lab: Lab, length: str) -> None:
    with socket.create_connection(lab.http.server_address, timeout=10) as line:
        line.sendall(f"{heading(lab, '/echo/nothing')}Content-Length: {length}\r\n\r\n{{}}".encode())
        assert line.recv(10_000).split()[1] == b"400"


def test_a_length_must_be_stated(lab: Lab) -> None:
    for more in ("", "Transfer-Encoding: chunked\r\nContent-Length: 2\r\n"):
        with socket.create_connection(lab.http.server_address, timeout=10) as line:
            line.sendall(f"{heading(lab, '/echo/nothing')}{more}\r\n".encode())
            assert line.recv(10_000).split()[1] == b"411"


def test_a_busy_port_is_one_clear_error() -> None:
    with Lab([]) as lab:
        port = lab.http.server_address[1]
        with pytest.raises(InputError, match=f"--port {port}") as found:
            Lab([], port)
        assert "any that is free" in str(found.value)
    with pytest.raises(InputError):
        LoopbackServer(70_000, _LabHandler)


GEL = ("steps", "solve")  # whole force maps: tests/lab_pages/test_gelpad.py asks them


# -- random bodies -----------------------------------------------------------------------------------------------------
def test_random_bodies_are_refused_or_right() -> None:
    """A slice of `python -m tests.benchmarks.lab fuzz`, which sends 10 000."""
    with Lab(pages()) as lab:
        connection = http.client.HTTPConnection("127.0.0.1", lab.http.server_address[1], timeout=60)
        with closing(connection):
            codes = [accepted(lab, connection, *one) for one in bodies(lab, 400, 1, (*SLOW, *GEL))]
        assert set(codes) <= {200, 400, 422}
        assert 10 < codes.count(200) < 200
        assert called(lab, "cards/cards")["cards"]


def test_rounded_keeps_what_it_is_given() -> None:
    given = {
        "a": np.array([1 / 3, np.nan, 0.0]),
        "b": (1, True, None, "x"),
        "c": np.float64(123456789.0),
        "d": np.int64(7),
    }
    assert rounded(given, 3) == {"a": [0.333, None, 0.0], "b": [1, True, None, "x"], "c": 123000000.0, "d": 7}
