"""A running editor on a free port."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from warpvox.editor.server import EditorServer


@pytest.fixture
def server(tmp_path: Path) -> Iterator[EditorServer]:
    """An editor whose folder is ``tmp_path / "designs"``."""
    with EditorServer(tmp_path / "designs") as started:
        thread = threading.Thread(target=started.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        yield started
        started.shutdown()
        thread.join()
