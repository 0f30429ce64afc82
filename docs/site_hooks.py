"""Hooks of mkdocs: parts of the site, pages that are made then, links. Not part of the library."""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

FOLDER = Path(__file__).resolve().parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]  # mkdocs runs with any folder in front

import api_pages  # noqa: E402
import notebooks  # noqa: E402
import task_pages  # noqa: E402
from page_order import PARTS  # noqa: E402

MARK = re.compile(r"^<!-- (help .*|end of help|bench \w+|end) -->\n?", re.MULTILINE)
FENCE = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
NAME = re.compile(r"(?<!\[)`(wv\.(\w+)[^`\n]*)`(?!\])")
TASK = re.compile(r"^\| (\w+-v\d) (?=\|)", re.MULTILINE)
CELL = re.compile(r"(?<=<td><code>)[^<\s]{16,}(?=</code>)")
OUTSIDE = re.compile(r"\]\(\.\./([^)\s]+)\)")


def on_config(config: Any) -> Any:
    """Put the pages into parts."""
    nav: list[Any] = [{"warpvox": "index.md"}]
    for part, pages in PARTS.items():
        found: list[Any] = [{title: f"{name}.md"} for name, title in pages.items()]
        if part == "Tutorials":
            found += list(notebooks.pages())
        if part == "Reference":
            found[1:1] = [{"Python": list(api_pages.pages())}, {"Tasks": list(task_pages.pages())}]
        nav.append(found[0] if part == "FAQ" else {part: found})
    config["nav"] = nav
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made here, and their pictures."""
    made = api_pages.pages() | notebooks.pages() | task_pages.pages() | task_pages.pictures()
    for place, content in made.items():
        files.append(File.generated(config, place, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Leave out the marks between which tables are made; link public names, tasks and files of the repository."""
    markdown = markdown.replace("```python no-run\n", "```python\n")  # which superfences does not know
    parts = FENCE.split(MARK.sub("", markdown))
    parts[::2] = [NAME.sub(_name, part) for part in parts[::2]]
    if "/" not in page.file.src_uri:
        outside = rf"]({config.extra['social'][0]['link']}/blob/main/\1)"
        parts[::2] = [OUTSIDE.sub(outside, TASK.sub(r"| [\1](tasks/\1.md) ", part)) for part in parts[::2]]
    return "".join(parts)


def on_page_content(html: str, **_: Any) -> str:
    """Let names in tables be broken where their parts end."""
    return CELL.sub(lambda match: re.sub(r"([._=,])(?=\w)", r"\1<wbr>", match[0]), html)


def _name(match: re.Match[str]) -> str:
    public = any(match[2] in names for names in api_pages.public_modules().values())
    return f"[{match[0]}][warpvox.{match[2]}]" if public else match[0]
