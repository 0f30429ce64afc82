"""Limits of a server: a deadline for each request as a whole, and a number of connections at a time.

A time limit of a socket is one of each read: who sends a byte now and then would keep a thread for ever.
"""

from __future__ import annotations

import io
import socket
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

__all__ = ["MOST_CONNECTIONS", "SECONDS", "LimitedHandler", "LimitedServer"]

SECONDS = 15.0
"""That a request may take to arrive, the wait for its first byte included, and an answer to be taken."""
MOST_CONNECTIONS = 32
"""At a time; a browser opens six."""
BUSY = b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


class LimitedServer(ThreadingHTTPServer):
    """A server with a bound on the connections that it serves at a time; further ones are told that it is busy."""

    daemon_threads = True

    def __init__(self, *words: Any) -> None:
        self._slots = threading.BoundedSemaphore(MOST_CONNECTIONS)
        super().__init__(*words)

    def process_request(self, request: socket.socket, client_address: Any) -> None:
        """Serve a connection in a thread of its own, if there is one left."""
        if not self._slots.acquire(blocking=False):
            with suppress(OSError):
                request.settimeout(0.1)
                request.sendall(BUSY)
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread could be started
            self._slots.release()
            raise

    def process_request_thread(self, request: socket.socket, client_address: Any) -> None:
        """What the thread does."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._slots.release()


class LimitedHandler(BaseHTTPRequestHandler):
    """A handler that gives up a request which has not arrived after :data:`SECONDS`, however it trickles in."""

    def setup(self) -> None:
        super().setup()
        self._arriving = _Arriving(self.connection)
        self.rfile = io.BufferedReader(self._arriving)

    def handle_one_request(self) -> None:
        """One request of a connection; the time of the next begins when this one is answered."""
        self._arriving.end = time.monotonic() + SECONDS
        super().handle_one_request()

    def begin_answer(self) -> None:
        """To be called before an answer is sent: it has a time of its own."""
        self.connection.settimeout(SECONDS)


class _Arriving(io.RawIOBase):
    """What a socket receives until a point in time; then TimeoutError."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__()
        self._connection, self.end = connection, 0.0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left = self.end - time.monotonic()
        if left <= 0:
            raise TimeoutError("The request has taken too long to arrive.")
        self._connection.settimeout(left)
        return self._connection.recv_into(buffer)
