"""What mkdocs asks while it builds the site: the order of the pages. Not part of the library."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ORDER = (
    "index",
    "quickstart",
    "concepts",
    "commands",
    "see",
    "editor",
    "custom_tasks",
    "observations",
    "codesign",
    "suite",
    "search",
    "zoo",
    "evaluation",
    "policies",
    "universal",
    "design_in_episode",
    "gradients",
    "results",
    "physics",
    "paper",
    "performance",
    "trials",
    "formats",
    "evogym",
    "faq",
)
"""Pages as they follow each other; any others come last."""
MARK = re.compile(r"^<!-- (help .*|end of help) -->\n?", re.MULTILINE)


def on_config(config: Any) -> Any:
    """Put the pages that there are into order."""
    found = {path.stem for path in Path(config["docs_dir"]).glob("*.md")}
    config["nav"] = [f"{name}.md" for name in [*(n for n in ORDER if n in found), *sorted(found - set(ORDER))]]
    return config


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Leave out the marks between which the tables of keys are made."""
    return MARK.sub("", markdown)
