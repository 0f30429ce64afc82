"""The page of the design editor, put together from its parts."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from warpvox.design import example_designs
from warpvox.editor.documents import BODY_SIDE, WORLD_SIZE, document_of
from warpvox.editor.trials import LONGEST
from warpvox.examples import EXAMPLES
from warpvox.view.palette import CELL_NAMES, RAMPS
from warpvox.view.player import asset, fill_template
from warpvox.view.rollout import AGENTS

SCRIPTS = ("drawing.js", "board.js", "editor.js")


def editor_page(start: dict[str, Any] | None, folder: Path, tasks: list[str]) -> str:
    """The page as text.

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
        "colours": {int(cell): ramp[1] for cell, ramp in RAMPS.items()},
        "names": {0: "empty"} | {int(cell): name for cell, name in CELL_NAMES.items()},
    }
    part = partial(asset, package="warpvox.editor")
    style, script = asset("player.css") + part("editor.css"), "\n".join(map(part, SCRIPTS))
    return fill_template(part("editor.html"), values={"setup": setup}, style=style, script=script)
