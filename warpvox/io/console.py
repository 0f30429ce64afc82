"""The console that commands print to."""

import os

from rich.console import Console
from rich.text import Text

from warpvox.io.text import escaped


def echo(console: Console, text: str) -> None:
    """Print ``text`` to the console verbatim: no colours, no line breaks, no markup such as ``[gif,html]``."""
    lines = "\n".join(escaped(line) for line in text.split("\n"))
    console.print(lines, highlight=False, soft_wrap=True, markup=False, emoji=False)


def make_console() -> Console:
    """Create a rich console that is wide enough for tables when the output is not a terminal."""
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = 200
    return console


def literal(text: object, style: str = "") -> Text:
    """Wrap ``text`` for a rich table or title, with markup and control characters disabled."""
    return Text(escaped(text), style)
