"""Sentences on the console: neither coloured, nor folded, nor searched for markup such as ``[gif,html]``."""

from __future__ import annotations

from rich.console import Console

__all__ = ["say"]


def say(console: Console, text: str) -> None:
    """Print ``text`` as it is."""
    console.print(text, highlight=False, soft_wrap=True, markup=False)
