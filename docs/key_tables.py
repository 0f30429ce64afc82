"""Writes the tables of keys into the pages: ``python docs/key_tables.py`` (``make tables``).

Not part of the library. What stands between ``<!-- help COMMAND -->`` and ``<!-- end of help -->`` is rewritten from
what ``warpvox COMMAND --help`` prints; between ``<!-- help of all others -->`` and that mark is a section for every
command that the page does not mention, with the sentence of ``warpvox --help``. ``tests/docs``
says when a page is not up to date.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from warpvox.cli import COMMANDS as SENTENCES
from warpvox.cli.config import load
from warpvox.cli.help import flat_values, help_rows
from warpvox.configs.schema import COMMANDS
from warpvox.io.writing import write_text

END = "<!-- end of help -->"
OTHERS = "of all others"
PART = re.compile(rf"^<!-- help (?P<what>\w+|{OTHERS}) -->\n(?:.*?^{END}$)?", re.DOTALL | re.MULTILINE)
FOLDER = Path(__file__).resolve().parent


def with_tables(text: str) -> str:
    """A page with its tables as they should be."""
    named = [match["what"] for match in PART.finditer(text)]

    def part(match: re.Match[str]) -> str:
        what = match["what"]
        if what == OTHERS:
            others = {name: f"{text[0].upper()}{text[1:]}." for name, text in SENTENCES.items() if name not in named}
            lines = []
            for name, text in others.items():  # demo has the keys of train
                lines += [f"## {name}", _prose(text), *([table_of(name)] if name in COMMANDS else [])]
            inside = "\n\n".join(lines)
        else:
            inside = table_of(what)
        return f"<!-- help {what} -->\n\n{inside}\n\n{END}"

    return PART.sub(part, text)


def table_of(command: str) -> str:
    """The keys of a command as a table; parts of its groups that are those of ``train`` are left out, which is said."""
    rows, known = rows_of(command), rows_of("train") if command != "train" else {}
    same = [name for name in rows if "." in name and rows[name] == known.get(name.removeprefix("training."))]
    lines = [f"`usage: warpvox {command} [KEY=VALUE ...]`"]
    for name, (value, meaning) in rows.items():
        lines += ["", "| key | default | meaning |", "|---|---|---|"] if len(lines) == 1 else []
        lines += [] if name in same else [f"| {_code(name)} | {_code(value)} | {_prose(meaning)} |"]
    groups = list(dict.fromkeys(f"`{name.rpartition('.')[0]}.*`" for name in same))
    theirs = ", ".join(groups).replace("training.", "")
    return "\n".join(
        lines + ["", f"All others of {', '.join(groups)} are as {theirs} of [train](#train)."] * bool(same)
    )


def rows_of(command: str) -> dict[str, tuple[str, str]]:
    """Default and meaning of the keys of a command."""
    values = flat_values(command, dataclasses.asdict(load(command, [])))
    return {name: (value or "", meaning) for name, value, meaning in help_rows(command, values)}


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|") if text else ""


def _prose(text: str) -> str:
    """Text outside of backticks without what Markdown would take for its own."""
    parts = text.replace("|", "\\|").split("`")
    for number in range(0, len(parts), 2):
        parts[number] = re.sub(r"([*_\[\]])", r"\\\1", parts[number]).replace("<", "&lt;")
    return "`".join(parts)


def pages() -> list[Path]:
    """The pages with tables."""
    return [path for path in sorted(FOLDER.glob("*.md")) if PART.search(path.read_text(encoding="utf-8"))]


if __name__ == "__main__":
    for page in pages():
        write_text(page, with_tables(page.read_text(encoding="utf-8")))
