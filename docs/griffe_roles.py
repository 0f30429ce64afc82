"""Makes links of the roles in docstrings, ``:func:`make_vec```, for the pages of the Python interface.

A link that leads nowhere stays text: docstrings also speak of what has no page.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension

ROLE = re.compile(r":(?:func|class|meth|mod|data|attr|exc):`~?([\w.]+)`")


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

        obj.docstring.value = ROLE.sub(link, obj.docstring.value)
