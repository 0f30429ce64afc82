"""Docstrings as the pages of the Python interface need them.

Roles such as ``:func:`make_vec``` become links; one that leads nowhere stays text: docstrings also speak of what has no
page. Every error has an item of its own. Settings have their values and meanings in place of the calls that hold them.
"""

from __future__ import annotations

import dataclasses
import pydoc
import re
from typing import Any

import api_pages
from griffe import Extension

ROLE = re.compile(r":(?:func|class|meth|mod|data|attr|exc):`~?([\w.]+)`")
RAISES = re.compile(r"^Raises:\n(?:[ \t].*\n?|\n)+", re.MULTILINE)
NEXT = re.compile(r"(?<=[.;])\s+(?=\w+Error: )")
BESIDE = {f"warpvox.{name}" for names in api_pages.BESIDE.values() for name in names}


class Roles(Extension):
    """The extension that mkdocs.yml names."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Rewrite a docstring."""
        if obj.docstring is None:
            return
        owner = obj.path if obj.is_class else obj.parent.path if obj.parent is not None else obj.path

        def link(match: re.Match[str]) -> str:
            name = match[1]
            if not name.startswith("warpvox."):
                name = f"{owner}.{name}"
            return f'<autoref optional identifier="{name}"><code>{match[1]}</code></autoref>'

        text = RAISES.sub(lambda match: NEXT.sub("\n    ", match[0]), ROLE.sub(link, obj.docstring.value))
        if obj.path in BESIDE:
            text = f"`from {obj.parent.path} import {obj.name}`\n\n{text}"
        obj.docstring.value = text

    def on_class(self, *, cls: Any, **_: Any) -> None:
        """Replace the calls of ``key`` in a dataclass by their defaults, and list their meanings."""
        if cls.docstring is None or not any("key(" in str(one.value) for one in cls.attributes.values()):
            return
        fields = dataclasses.fields(pydoc.locate(cls.path))
        settings = [item for item in fields if "help" in item.metadata and item.name in cls.parameters]
        for item in settings:
            cls.parameters[item.name].default = _default(item)
        meanings = "".join(f"    {item.name}: {item.metadata['help']}.\n" for item in settings).replace("<", "&lt;")
        text, found, errors = cls.docstring.value.partition("Raises:\n")
        cls.docstring.value = f"{text}\n\nArgs:\n{meanings}\n{found}{errors}"


def _default(item: Any) -> str:
    """A field's default; of an object only what differs from the object's own."""
    value = item.default if item.default_factory is dataclasses.MISSING else item.default_factory()
    if not dataclasses.is_dataclass(value):
        return repr(value)
    kind = type(value)
    given = [one for one in dataclasses.fields(kind) if getattr(value, one.name) != getattr(kind(), one.name)]
    return f"{kind.__name__}({', '.join(f'{one.name}={getattr(value, one.name)!r}' for one in given)})"
