"""The keys of the commands that list what there is."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warpvox.keys import key

__all__ = ["InfoConfig", "TasksConfig"]


@dataclass
class TasksConfig:
    """Keys of ``warpvox tasks``."""

    task: str | None = key(
        None,
        "task id, module:NAME or file.py:NAME to show in detail, with its world; its key may be omitted",
        path="read",
    )
    rules: str = key("evogym", "as released (evogym) or as printed (paper)", choices=("evogym", "paper"))
    design: Any = key(
        "walker", "body that worlds are shown with, and that the layout of the observation is for", path="read"
    )
    picture: str | None = key(None, "with a task: also write its world as a picture (.png)", path="written")
    gallery: str | None = key(None, "instead of the list write all worlds into one picture (.png)", path="written")


@dataclass
class InfoConfig:
    """``warpvox info`` has no keys."""
