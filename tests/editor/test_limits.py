"""The editor's server does not wait for ever, nor for everybody: deadlines of requests, a bound on connections."""

from __future__ import annotations

import http.client
import socket
import time

import pytest

from warpvox.editor import limits
from warpvox.editor.limits import MOST_CONNECTIONS
from warpvox.editor.server import EditorServer

SECONDS = 0.6
PATIENCE = 20.0
"""Seconds after which a test has failed; a shared machine may stall."""


def connect(server: EditorServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE)


def trickle(connection: socket.socket, text: bytes) -> float:
    """Send a byte now and then until the other side closes; how long that took."""
    began = time.monotonic()
    connection.settimeout(SECONDS / 6)
    for byte in text * 1000:
        assert time.monotonic() - began < PATIENCE, "the server waits for ever"
        try:
            connection.sendall(bytes([byte]))
            if connection.recv(1000) == b"":
                break
        except TimeoutError:
            continue
        except ConnectionError:
            break
    return time.monotonic() - began


@pytest.fixture
def hurried(server: EditorServer, monkeypatch: pytest.MonkeyPatch) -> EditorServer:
    """A server that waits less."""
    monkeypatch.setattr(limits, "SECONDS", SECONDS)
    return server


@pytest.mark.parametrize("part", ["line", "headers", "body"])
def test_a_request_that_trickles_in_is_given_up(part: str, hurried: EditorServer) -> None:
    """Each byte is in time, the whole is not."""
    line = f"POST /{hurried.token}/check HTTP/1.1\r\n".encode()
    headers = f"Host: 127.0.0.1:{hurried.port}\r\nContent-Type: application/json\r\n".encode()
    sent = {"line": b"", "headers": line, "body": line + headers + b"Content-Length: 900000\r\n\r\n"}[part]
    with connect(hurried) as connection:
        connection.sendall(sent)
        assert SECONDS * 0.5 < trickle(connection, b"X") < PATIENCE


def test_a_connection_without_a_request_is_closed(hurried: EditorServer) -> None:
    with connect(hurried) as connection:
        assert connection.recv(10) == b""


def test_a_connection_may_ask_again_and_again(hurried: EditorServer) -> None:
    """The time begins anew with each request."""
    connection = http.client.HTTPConnection("127.0.0.1", hurried.port, timeout=PATIENCE)
    opened = None
    for _ in range(4):
        time.sleep(SECONDS / 2)
        connection.request("GET", f"/{hurried.token}/", headers={"Host": f"127.0.0.1:{hurried.port}"})
        answer = connection.getresponse()
        assert answer.status == 200
        answer.read()
        opened = opened or connection.sock
        assert connection.sock is opened
    connection.close()


def test_connections_are_bounded(server: EditorServer) -> None:
    idle = [connect(server) for _ in range(MOST_CONNECTIONS)]
    try:
        with connect(server) as further:
            assert further.recv(1000).startswith(b"HTTP/1.1 503 ")
            assert further.recv(1000) == b""
    finally:
        for connection in idle:
            connection.close()
    end = time.monotonic() + PATIENCE
    while status(server) != 200:  # the threads of the closed ones end
        assert time.monotonic() < end
        time.sleep(0.02)


def status(server: EditorServer) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
    try:
        connection.request("GET", f"/{server.token}/")
        answer = connection.getresponse()
        answer.read()
    except ConnectionError:  # refused before the request was read
        return 503
    finally:
        connection.close()
    return answer.status
