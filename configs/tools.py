"""Keys of the commands about bodies, tasks and stored robots: design, zoo, tasks, info."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from dataclasses import dataclass
from typing import Any

from warpvox.configs.schema import SHOW
from warpvox.keys import Settings, key
from warpvox.types import RULES


@dataclass
class DesignConfig(Settings):
    """Keys of ``warpvox design``."""

    file: str | None = key(None, "file of the folder to open at the start")
    folder: str = key("designs", "folder in which files are opened and saved; made when something is saved")
    tasks: list[str] = key([], "tasks of your own to try bodies in, beside the benchmark's: file.py:NAME, module:NAME")
    port: int = key(0, "port of the server on 127.0.0.1; 0: any free port", low=0, high=65535)
    browser: str = key("auto", "open the page in a browser: on, off, or auto (if there is a display)", choices=SHOW)


@dataclass
class ZooConfig(Settings):
    """Keys of ``warpvox zoo``."""

    task: str | None = key(None, "show the robot of this task in detail")
    folder: str | None = key(None, "folder of the entries; null: that of the package")


@dataclass
class TasksConfig(Settings):
    """Keys of ``warpvox tasks``."""

    task: str | None = key(
        None,
        "task id, module:NAME or file.py:NAME to show in detail, with its world; its key may be omitted",
    )
    rules: str = key("evogym", "as released (evogym) or as printed (paper)", choices=RULES)
    design: Any = key("walker", "body that worlds are shown with, and that the layout of the observation is for")
    picture: str | None = key(None, "with a task: also write its world as a picture (.png)")
    gallery: str | None = key(None, "instead of the list write all worlds into one picture (.png)")


@dataclass
class InfoConfig(Settings):
    """``warpvox info`` has no keys."""
