"""The console that commands print to."""

import os

from rich.console import Console
from rich.text import Text

from warpvox.io.text import escaped


def echo(console: Console, text: str) -> None:
    """Print ``text`` as it is: neither coloured, nor folded, nor searched for markup such as ``[gif,html]``."""
    lines = "\n".join(escaped(line) for line in text.split("\n"))
    console.print(lines, highlight=False, soft_wrap=True, markup=False, emoji=False)


def make_console() -> Console:
    """Return a rich console that is wide enough for tables without a terminal, for which rich has 80 columns."""
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = 200
    return console


def literal(text: object, style: str = "") -> Text:
    """Return ``text`` for a table, a title or a rule: no markup, no control characters."""
    return Text(escaped(text), style)
