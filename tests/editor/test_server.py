"""The editor's server: it answers whoever holds the token, under its own name, within its limits; nobody else."""

import contextlib
import http.client
import json
import socket
import threading
from urllib.parse import quote

import numpy as np
import pytest
from damage import damaged_bytes, damaged_tree, refusals

from warpvox.code import Code
from warpvox.design import example_designs
from warpvox.editor.documents import document_of
from warpvox.editor.server import LARGEST, EditorServer
from warpvox.errors import DeviceError, WarpvoxError

WALKER = document_of(example_designs()["walker"])


def request(server: EditorServer, method: str, path: str, body: bytes | None = None, **headers: str):
    """Status, headers and text of an answer; headers replace those that a browser would send."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
    usual = {"Host": f"127.0.0.1:{server.port}"}
    if body is not None:
        usual |= {"Content-Type": "application/json", "Content-Length": str(len(body))}
    connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    for name, value in (usual | {key.replace("_", "-"): value for key, value in headers.items()}).items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(body)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, dict(answer.getheaders()), text


def ask(server: EditorServer, action: str, **content: object) -> dict:
    status, _, text = request(server, "POST", f"/{server.token}/{action}", json.dumps(content).encode())
    assert status == 200, text
    return json.loads(text)


def test_it_listens_on_the_loopback_address_only(server: EditorServer) -> None:
    assert server.socket.getsockname()[0] == "127.0.0.1"


def test_the_page_comes_with_a_strict_policy(server: EditorServer) -> None:
    status, headers, text = request(server, "GET", f"/{server.token}/")
    assert status == 200
    assert "warpvox design" in text
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cache-Control"] == "no-store"
    assert "http://" not in text.replace("http://www.w3.org", "")  # nothing comes from elsewhere
    assert "https://" not in text
    assert server.token not in text


def test_every_start_has_a_token_of_its_own(server: EditorServer, tmp_path) -> None:
    with EditorServer(tmp_path) as other:
        assert other.token != server.token
        assert len(other.token) >= 32


@pytest.mark.parametrize("path", ["/", "/wrong/", "/wrong/check", "//", "/{token}x/", "/{cut}/", "/%2e%2e/{token}/"])
def test_without_the_token_there_is_nothing(server: EditorServer, path: str) -> None:
    for method, body in (("GET", None), ("POST", b"{}")):
        status, _, text = request(server, method, path.format(token=server.token, cut=server.token[:-1]), body)
        assert status == 403
        assert server.token not in text


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "", None])
def test_other_hosts_are_refused(server: EditorServer, host: str | None) -> None:
    host = host.replace("{port}", str(server.port)) if host else host
    for method, path, body in (("GET", "", None), ("POST", "save", json.dumps({"document": WALKER, "name": "x"}))):
        content = body.encode() if body else None
        status, _, _ = request(server, method, f"/{server.token}/{path}", content, Host=host)
        assert status == 403
    assert not server.folder.exists()


@pytest.mark.parametrize("origin", ["http://evil.example", "https://127.0.0.1:{port}", "http://127.0.0.1:1", "null"])
def test_other_origins_are_refused(server: EditorServer, origin: str) -> None:
    body = json.dumps({"document": WALKER, "name": "x"}).encode()
    origin = origin.replace("{port}", str(server.port))
    status, headers, _ = request(server, "POST", f"/{server.token}/save", body, Origin=origin)
    assert status == 403
    assert "Access-Control-Allow-Origin" not in headers
    assert not server.folder.exists()
    own = request(server, "POST", f"/{server.token}/files", b"{}", Origin=f"http://127.0.0.1:{server.port}")
    assert own[0] == 200


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        (b"{}", {"Content_Type": "text/plain"}, 415),
        (b"{}", {"Content_Type": "application/x-www-form-urlencoded"}, 415), (b"{}", {"Content_Length": None}, 411),
        (b"{}", {"Content_Length": "-5"}, 411), (b"{}", {"Content_Length": str(LARGEST + 1)}, 413),
        (b"{}", {"Content_Length": "9" * 30}, 413), (b"{}", {"Content_Length": "²".encode()}, 411),
        (b"{}", {"Content_Length": "9" * 5000}, 413), (b"{broken", {}, 400), (b"[1]", {}, 400),
        (b"[" * 100_000, {}, 400), (rb'{"a":"\ud800"}', {}, 400), (b"\xff\xfe", {}, 400), (b'{"a":1,"a":2}', {}, 400),
    ],
)  # fmt: skip
def test_requests_have_a_form_and_a_size(server: EditorServer, body: bytes, headers: dict, status: int) -> None:
    assert request(server, "POST", f"/{server.token}/check", body, **headers)[0] == status
    assert ask(server, "files") == {"files": []}  # it goes on


def test_other_methods_and_places_do_not_exist(server: EditorServer) -> None:
    assert request(server, "POST", f"/{server.token}/delete", b"{}")[0] == 404
    assert request(server, "GET", f"/{server.token}/save")[0] == 404
    for number in ("7", "-1", "²", "1" * 5000):
        assert request(server, "GET", f"/{server.token}/rollout/{quote(number)}")[0] == 404
    assert request(server, "GET", f"/{server.token}/../../etc/passwd")[0] == 404
    assert request(server, "PUT", f"/{server.token}/", b"{}")[0] == 501
    assert request(server, "OPTIONS", f"/{server.token}/save")[0] == 501


def test_a_silent_client_stops_nobody_and_is_disconnected(server: EditorServer, monkeypatch) -> None:
    monkeypatch.setattr("warpvox.editor.server._Handler.timeout", 0.3)
    with socket.create_connection(("127.0.0.1", server.port), timeout=30) as silent:
        silent.sendall(b"POST / HTTP/1.1\r\n")
        assert ask(server, "files") == {"files": []}
        assert silent.recv(10) == b""


def test_check_save_open(server: EditorServer) -> None:
    assert ask(server, "check", document=WALKER)["message"].startswith("A valid robot")
    assert "empty" in ask(server, "check", document=WALKER | {"types": [[0]], "owners": [[0]]})["error"]
    assert "no document" in ask(server, "check")["error"]
    assert "Saved" in ask(server, "save", document=WALKER, name="one")["message"]
    assert ask(server, "save", document=WALKER, name="one") == {"exists": "one.json"}
    assert "Saved" in ask(server, "save", document=WALKER, name="one", overwrite=True)["message"]
    assert ask(server, "files") == {"files": ["one.json"]}
    assert ask(server, "open", name="one.json") == WALKER
    assert "Did you mean" in ask(server, "open", name="on.json")["error"]
    for name in ("../one", "/etc/passwd", "..%2fone"):
        assert "name may hold" in ask(server, "open", name=name)["error"]
        assert "name may hold" in ask(server, "save", document=WALKER, name=name)["error"]
    assert [path.name for path in server.folder.iterdir()] == ["one.json"]


def test_random_bodies(server: EditorServer) -> None:
    found = ask(server, "sample", rows=4, columns=3)
    assert np.shape(found["types"]) == (4, 3)
    assert "1 to 10" in ask(server, "sample", rows=0, columns=99)["error"]


def test_a_rollout_is_a_page(server: EditorServer) -> None:
    settings = {"agent": "sine", "seconds": 0.1, "seed": 0, "task": "Walker-v0"}
    numbers = [ask(server, "rollout", document=WALKER, **settings)["rollout"] for _ in range(6)]
    status, _, page = request(server, "GET", f"/{server.token}/rollout/{numbers[-1]}")
    assert status == 200
    assert "<title>Walker-v0</title>" in page
    assert len(server.rollouts) == 4  # the oldest are gone
    assert request(server, "GET", f"/{server.token}/rollout/{numbers[0]}")[0] == 404
    assert "seconds must be" in ask(server, "rollout", document=WALKER, **settings | {"seconds": 1e9})["error"]


def test_one_rollout_at_a_time(server: EditorServer) -> None:
    with server._busy:
        assert "Another rollout" in ask(server, "rollout", document=WALKER)["error"]


def test_a_port_that_is_taken(server: EditorServer, tmp_path) -> None:
    with pytest.raises(DeviceError):
        EditorServer(tmp_path, server.port)


def test_it_begins_with_a_file(server: EditorServer) -> None:
    ask(server, "save", document=WALKER, name="mine")
    with EditorServer(server.folder, file="mine.json") as other:
        assert '"name":"mine"' in other.page
    with pytest.raises(WarpvoxError):
        EditorServer(server.folder, file="yours")


def test_a_request_cannot_name_code(server: EditorServer, tmp_path) -> None:
    marker = tmp_path / "marker"
    (tmp_path / "evil.py").write_text(f"from pathlib import Path\nPath({str(marker)!r}).touch()\n")
    (tmp_path / "designs").mkdir()
    settings = {"agent": "zero", "seconds": 0.1, "seed": 0}
    for task in (
        f"{tmp_path}/evil.py:X",
        f"{tmp_path}/evil.py:",
        "this:s",
        "os:path",
        3,
        None,
        ["Walker-v0"],
        "walker-v0",
    ):
        answer = ask(server, "rollout", document=WALKER, **settings, task=task)
        assert "Unknown task" in answer["error"] or "must be the id of a task" in answer["error"], task
    assert not marker.exists()


def test_tasks_of_ones_own_are_named_at_the_start(tmp_path) -> None:
    (tmp_path / "my_own.py").write_text(
        "from dataclasses import replace\nfrom warpvox.envs.registry import get_task\n"
        'MINE = replace(get_task("Walker-v0"), id="Mine-v0")\n'
        'OTHER = replace(get_task("Walker-v0"), id="Other-v0")\n'
    )
    name = f"{tmp_path.as_posix()}/my_own.py:MINE"
    with EditorServer(tmp_path / "designs", tasks=[Code(name)]) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        settings = {"agent": "zero", "seconds": 0.1, "seed": 0}
        found = ask(server, "rollout", document=WALKER, **settings, task=name)
        other = ask(server, "rollout", document=WALKER, **settings, task=name.replace("MINE", "OTHER"))
        server.shutdown()
        thread.join()
    assert "Mine-v0" in server.rollouts[found["rollout"]].decode()
    assert "tasks=[file.py:NAME]" in other["error"]
    assert name in server.page
    with pytest.raises(WarpvoxError):
        EditorServer(tmp_path, tasks=[Code("nowhere.py:MINE")])


@pytest.mark.parametrize("action", ["check", "open", "save", "rollout"])
def test_damaged_questions_are_answered_or_refused(server: EditorServer, action: str) -> None:
    question = {"document": WALKER, "name": "one", "overwrite": True, "agent": "sine", "seconds": 0.04, "seed": 1}
    question |= {"task": "Walker-v0", "rows": 3, "columns": 4}
    server.save(question)
    assert refusals(lambda ask: json.dumps(getattr(server, action)(ask)), damaged_tree(question, 40)) > 0


@pytest.mark.parametrize(
    "head",
    [
        "POST /{token}/files HTTP/1.1\r\nContent-Length: 2\r\nContent-Length: {length}",
        "POST /{token}/files HTTP/1.1\r\nContent-Length: 2\r\nTransfer-Encoding: chunked",
        "GET /{token}/ HTTP/1.1\r\nContent-Length: {length}",
        "GET /{token}/ HTTP/1.1\r\nTransfer-Encoding: chunked",
    ],
)
def test_a_request_inside_another_one_is_not_answered(head: str, server: EditorServer) -> None:
    inner = f"GET /{server.token}/nothing HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n"
    names = f"Host: 127.0.0.1:{server.port}\r\nContent-Type: application/json"
    text = f"{head.format(token=server.token, length=len(inner) + 2)}\r\n{names}\r\n\r\n{{}}{inner}"
    answer = b""
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as line:
        line.sendall(text.encode())
        line.shutdown(socket.SHUT_WR)
        with contextlib.suppress(ConnectionError):
            while part := line.recv(65536):
                answer += part
    assert answer.startswith(b"HTTP/1.1 400"), answer
    assert answer.count(b"HTTP/1.1") == 1


def test_damaged_requests_are_answered_or_refused(server: EditorServer) -> None:
    body = json.dumps({"document": WALKER}).encode()
    head = f"POST /{server.token}/check HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nConnection: close\r\n".encode()
    head += f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n".encode()
    for data in damaged_bytes(head + body, 60):
        line = socket.create_connection(("127.0.0.1", server.port), timeout=20)
        with line, contextlib.suppress(OSError):  # it may have closed already
            line.sendall(data)
            line.shutdown(socket.SHUT_WR)
            while line.recv(65536):
                pass
    assert request(server, "GET", f"/{server.token}/")[0] == 200
