"""The design editor's web server: reachable from this machine only, with a secret token.

It listens on the loopback address. Every address begins with a token that is drawn at each start, so that
other users of the machine and pages of other sites cannot guess it. A request whose Host is not this server's is
refused (a page cannot reach the editor under a name of its own that leads to 127.0.0.1), and so is one whose
Origin is another's. Requests have a size limit, a client that stays silent is disconnected; files are read and written
in one folder only.
"""

import hmac
import json
import re
import secrets
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from warpvox.design import example_designs, sample_design
from warpvox.editor.documents import (
    BODY_SIDE,
    WORLD_SIZE,
    check,
    check_file_name,
    document_of,
    file_names,
    read_file,
    save_file,
)
from warpvox.editor.trials import LONGEST, try_out
from warpvox.envs.registry import get_task, task_ids
from warpvox.errors import ConfigError, DeviceError, WarpvoxError
from warpvox.examples import EXAMPLES
from warpvox.io.reading import parse_json
from warpvox.types import MATERIALS
from warpvox.view.player import asset, fill_template, page_of
from warpvox.view.rollout import AGENTS

_ADDRESS = "127.0.0.1"
LARGEST = 1_000_000
"""Maximum size of a request in bytes."""


class EditorServer(ThreadingHTTPServer):
    """A web server for the editor's page, reachable from this machine only.

    Args:
        port: 0 takes a free one.
        tasks: tasks of the user's own to try bodies in (``file.py:NAME`` or ``module:NAME``), beside the benchmark's.
            They are imported here; a request cannot name another.
    """

    request_queue_size = 128  # connections that wait to be taken; five are the usual, and the others try again later

    def __init__(self, folder: Path, port: int = 0, file: str | None = None, tasks: Sequence[str] = ()) -> None:
        self.folder = folder
        self.token = secrets.token_urlsafe(24)
        start = None if file is None else {"name": Path(file).stem} | self._read(file)
        self.tasks = {name: get_task(name) for name in [*task_ids(), *tasks]}
        self.page = _editor_page(start, folder, list(self.tasks))
        self.rollouts: dict[int, bytes] = {}
        self._busy = threading.Lock()
        try:
            super().__init__((_ADDRESS, port), _Handler)
        except OSError as error:
            raise DeviceError(f"The port {port} cannot be used: {error.strerror}. port=0 takes a free one.") from None
        self.port = self.server_address[1]
        self.hosts = {f"{_ADDRESS}:{self.port}", f"localhost:{self.port}"}
        self.url = f"http://{_ADDRESS}:{self.port}/{self.token}/"

    def _read(self, name: object) -> dict[str, Any]:
        return read_file(self.folder / check_file_name(name))

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print an error in a request, unless the browser closed its connection."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)

    def check(self, ask: dict[str, Any]) -> dict[str, Any]:
        """Validate the document in the request ``ask``, and describe it in a sentence."""
        return {"message": check(_document(ask))}

    def files(self, ask: dict[str, Any]) -> dict[str, Any]:
        """List the files that the editor can open."""
        return {"files": file_names(self.folder)}

    def open(self, ask: dict[str, Any]) -> dict[str, Any]:
        """Read a document from the file named in the request."""
        return self._read(ask.get("name"))

    def save(self, ask: dict[str, Any]) -> dict[str, Any]:
        """Write the document to a file; replace an existing file only if ``overwrite`` is set."""
        try:
            path = save_file(_document(ask), self.folder, ask.get("name"), ask.get("overwrite") is True)
        except FileExistsError as error:
            return {"exists": str(error)}
        except OSError as error:
            raise ConfigError(f"It cannot be saved: {error.strerror}.") from None
        return {"message": f"Saved as {path}.", "path": str(path)}

    def sample(self, ask: dict[str, Any]) -> dict[str, Any]:
        """Return a document with a randomly sampled valid body."""
        rows = ask.get("rows", 0)
        columns = ask.get("columns", 0)
        if not all(type(n) is int and 1 <= n <= 10 for n in (rows, columns)):
            raise ConfigError("A random body has 1 to 10 rows and columns.")
        return document_of(sample_design((rows, columns)))

    def rollout(self, ask: dict[str, Any]) -> dict[str, Any]:
        """Simulate the document and store the rollout's page; return its number and a message with the return.

        Raises:
            ConfigError: another rollout is being simulated.
        """
        if not self._busy.acquire(blocking=False):
            raise ConfigError("Another rollout is being simulated: wait for its end.")
        try:
            settings = (ask.get(key) for key in ("agent", "seconds", "seed", "task"))
            rollout = try_out(_document(ask), *settings, tasks=self.tasks)
            title = rollout.title if rollout.metadata["task"] else "world"
            number = max(self.rollouts, default=0) + 1
            kept = [*self.rollouts.items(), (number, page_of(rollout, title=title).encode())]
            # Four rollouts stay to be looked at.
            self.rollouts = dict(kept[-4:])  # a new one: other threads may be looking into the old
        finally:
            self._busy.release()
        total = float(rollout.returns[-1, 0])
        steps = int(rollout.lengths[0])
        return {"rollout": number, "message": f"return {total:.3f} in {steps} steps"}


def _document(ask: dict[str, Any]) -> dict[str, Any]:
    document = ask.get("document")
    if not isinstance(document, dict):
        raise ConfigError("The request holds no document.")
    return document


class _Refused(Exception):
    """Raised to answer a request with an HTTP error status and a reason."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    """HTTP request handler of the editor."""

    # Seconds without a byte from a client, or without one taken by it, after which its connection is closed.
    timeout = 15.0
    server: EditorServer
    server_version = "warpvox"
    sys_version = ""
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: object) -> None:
        """Disable the access log, because addresses contain the token."""

    def do_GET(self) -> None:
        """Serve the editor's page or the page of a rollout."""
        self._answer(self._page)

    def do_POST(self) -> None:
        """Run an action of the server, JSON in and JSON out; warpvox errors are returned as ``error``."""
        self._answer(self._act)

    def _answer(self, make: Callable[[], tuple[bytes, str]]) -> None:
        """Send the result of ``make``, or the HTTP error that it raised."""
        try:
            self._send(*make())
        except _Refused as refusal:
            self.close_connection = True  # what was not read would be taken for the next request
            self._send(str(refusal).encode(), "text/plain; charset=utf-8", refusal.status)

    def _page(self) -> tuple[bytes, str]:
        """Return the page at the requested address, and its content type."""
        path = self._path()
        number = path.removeprefix("rollout/")
        page = self.server.rollouts.get(int(number)) if re.fullmatch("[0-9]{1,9}", number) else None
        page = self.server.page.encode() if path == "" else page
        if page is None:
            raise _Refused(HTTPStatus.NOT_FOUND, "There is nothing here.")
        return page, "text/html; charset=utf-8"

    def _act(self) -> tuple[bytes, str]:
        """Run the action at the requested address; return its result as JSON, and the content type."""
        name = self._path()
        # Only these methods are for pages to call.
        if name not in ("check", "files", "open", "sample", "save", "rollout"):
            raise _Refused(HTTPStatus.NOT_FOUND, "There is no such action.")
        ask = self._body()
        try:
            answer = getattr(self.server, name)(ask)
        except WarpvoxError as error:
            answer = {"error": " ".join(str(error).split())}
        return json.dumps(answer).encode(), "application/json"

    def _path(self) -> str:
        """Verify host, origin and token of the request; return the path after the token."""
        if self.headers.get("Host", "") not in self.server.hosts:
            raise _Refused(HTTPStatus.FORBIDDEN, "This server answers to its own name only.")
        origin = self.headers.get("Origin")
        if origin is not None and origin not in {f"http://{host}" for host in self.server.hosts}:
            raise _Refused(HTTPStatus.FORBIDDEN, "Requests of other sites are refused.")
        lengths = self.headers.get_all("Content-Length", [])
        if "Transfer-Encoding" in self.headers or len(lengths) > (self.command == "POST"):
            raise _Refused(HTTPStatus.BAD_REQUEST, "A request says its length once, by Content-Length, if it has any.")
        token, _, rest = self.path.removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            raise _Refused(HTTPStatus.FORBIDDEN, "The address lacks the right token: use the one that was printed.")
        return rest

    def _body(self) -> dict[str, Any]:
        """Parse the JSON object in the request; _Refused if it is missing or too long."""
        if self.headers.get_content_type() != "application/json":
            raise _Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "Expected JSON.")
        length = self.headers.get("Content-Length", "")
        if not re.fullmatch("[0-9]+", length):
            raise _Refused(HTTPStatus.LENGTH_REQUIRED, "The request does not say how long it is.")
        if len(length) > 12 or int(length) > LARGEST:
            raise _Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"A request has {LARGEST} bytes at most.")
        try:
            ask = parse_json(self.rfile.read(int(length)).decode("utf-8"))
        except ValueError:  # no UTF-8, or Unreadable
            raise _Refused(HTTPStatus.BAD_REQUEST, "This is not JSON.") from None
        if not isinstance(ask, dict):
            raise _Refused(HTTPStatus.BAD_REQUEST, "Expected a JSON object.")
        return ask

    def _send(self, content: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        """Send ``content`` with headers that keep other sites from using it."""
        self.send_response(status)
        headers = {
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline';"
            " img-src data:; connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none';"
            " frame-ancestors 'self'",
        }
        for name, value in headers.items() | {("Content-Type", kind), ("Content-Length", str(len(content)))}:
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)


def _editor_page(start: dict[str, Any] | None, folder: Path, tasks: list[str]) -> str:
    """Build the editor's HTML page.

    Args:
        start: a document with a ``name``, to begin with; None: an example.
        folder: where files are opened and saved, to be named on the page.
    """
    setup = {
        "start": start or document_of(example_designs()["walker"]) | {"name": "my_robot"},
        "folder": str(folder),
        "examples": EXAMPLES,
        "tasks": tasks,
        "agents": list(reversed(AGENTS)),
        "limits": {"body": [BODY_SIDE, BODY_SIDE], "world": list(WORLD_SIZE), "seconds": LONGEST},
        "colours": {int(cell): material.colours[1] for cell, material in MATERIALS.items()},
        "names": {0: "empty"} | {int(cell): material.name for cell, material in MATERIALS.items()},
    }
    part = partial(asset, package="warpvox.editor")
    style = asset("player.css") + part("editor.css")
    script = "\n".join(map(part, ("drawing.js", "board.js", "editor.js")))
    return fill_template(part("editor.html"), values={"setup": setup}, style=style, script=script)
