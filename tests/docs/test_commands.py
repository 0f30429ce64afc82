"""Every command line of the pages that is not run is one that the parser takes."""

import re
import shlex
from pathlib import Path

import pytest

from warpvox.cli.application import read_options
from warpvox.cli.config import load, read_words
from warpvox.configs.schema import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
CODE = re.compile(r"^```\w.*?^```$", re.DOTALL | re.MULTILINE)
QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
LINE = re.compile(rf"^(?: {{4}})?warpvox ((?:{'|'.join(COMMANDS)})(?: .+)?)$", re.MULTILINE)


def command_lines() -> list[str]:
    """Those of README and the pages, after ``warpvox``, in blocks without a language and indented ones."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    texts = (CODE.sub("", page.read_text(encoding="utf-8")).replace("\\\n", " ") for page in pages)
    return list(dict.fromkeys(re.sub(r" +(#.*)?$", "", line) for text in texts for line in LINE.findall(text)))


def test_there_are_command_lines() -> None:
    assert len(command_lines()) > 50


@pytest.mark.parametrize("line", command_lines())
def test_a_command_line_is_taken(line: str) -> None:
    assert not re.search(r"[][*?{}]", QUOTED.sub("", line)), "a shell such as zsh takes this for a pattern: quote it"
    command, *words = (word for word in shlex.split(line) if word != "...")
    words = [f"task={word}" if command == "tasks" and "=" not in word else word for word in words]
    options = read_options(command, words)
    overrides = read_words(command, [word for word in options.overrides if not word.startswith("hydra")])
    first = [
        one.sweep_string_iterator() if one.is_sweep_override() else iter([one.get_value_string()])
        for one in overrides.values()
    ]
    words = [f"{key}={next(values)}" for key, values in zip(overrides, first, strict=True) if key != "resume"]
    load(command, words, options.config_dir)
