"""A running editor on a free port."""

import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from warpvox.editor.server import EditorServer


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[EditorServer]:
    """An editor whose folder is ``tmp_path / "designs"``; nothing that is asked of it may make it fail."""
    failures = []

    def note(*_: object) -> None:
        error = sys.exc_info()[1]
        if not isinstance(error, ConnectionError):  # a test may leave before the end of an answer
            failures.append(error)

    monkeypatch.setattr(EditorServer, "handle_error", note)
    with EditorServer(tmp_path / "designs") as started:
        thread = threading.Thread(target=started.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        yield started
        started.shutdown()
        thread.join()
    assert failures == []
