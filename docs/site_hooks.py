"""What mkdocs asks while it builds the site: the order of the pages, and the help of the commands.

Not part of the library. A page's line ``<!-- help COMMAND -->`` becomes what ``warpvox COMMAND --help`` prints, so that
the site cannot say anything else; ``<!-- help of all others -->`` becomes a section for every command that the page
does not mention.
"""

from __future__ import annotations

import contextlib
import io
import os
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
    "search",
    "evaluation",
    "policies",
    "physics",
    "paper",
    "performance",
    "formats",
    "evogym",
    "faq",
)
"""Pages as they follow each other; any others come last."""
OTHERS = "<!-- help of all others -->"
HELP = re.compile(r"^<!-- help (\w+) -->$", re.MULTILINE)
WIDTH = "82"


def on_config(config: Any) -> Any:
    """Put the pages that there are into order."""
    found = {path.stem for path in Path(config["docs_dir"]).glob("*.md")}
    config["nav"] = [f"{name}.md" for name in [*(n for n in ORDER if n in found), *sorted(found - set(ORDER))]]
    return config


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Insert the help of commands."""
    if OTHERS in markdown:
        from warpvox.cli import COMMANDS

        others = [name for name in COMMANDS if name not in HELP.findall(markdown)]
        sections = [f"## {name}\n\n<!-- help {name} -->" for name in others]
        markdown = markdown.replace(OTHERS, "\n\n".join(sections))
    return HELP.sub(lambda match: f"```text\n{help_of(match[1])}\n```", markdown)


def help_of(command: str) -> str:
    """What ``warpvox COMMAND --help`` prints."""
    from warpvox.cli import main

    os.environ["COLUMNS"] = WIDTH
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        code = main([command, "--help"])
    if code:
        raise ValueError(f"warpvox {command} --help failed")
    return text.getvalue().strip()
