"""The code of the pages under ``docs/`` runs as it is printed, one page in one empty folder."""

import importlib
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from episodes import short_episodes
from tiny import once

from warpvox.cli import main
from warpvox.envs.registry import task_ids

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
PAGES = sorted(path.name for path in (ROOT / "docs").glob("*.md") if BLOCK.search(path.read_text(encoding="utf-8")))
# Commands are run with these besides: the page is about what they do, not about how long.
SMALL = {
    "train": "num_envs=8 max_iterations=1 eval_interval=1 ppo.steps=4 ppo.epochs=1 ppo.hidden=[8] threads=1 device=cpu",
    "play": "num_envs=1 steps=5 threads=1 device=cpu",
    "export": "threads=1 device=cpu",
    "evaluate": "episodes=1 threads=1 device=cpu",
    "tasks": "",
}


def run_command(line: str) -> None:
    program, command, *words = shlex.split(line)
    assert program == "warpvox"
    threads = torch.get_num_threads()
    assert main([command, *once(*words, *SMALL[command].split())]) == 0, line
    torch.set_num_threads(threads)


@pytest.mark.parametrize("page", ["../README.md", *PAGES])
def test_names_of_python_on_a_page_exist(page: str) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    for name in sorted(set(re.findall(r"`(warpvox(?:\.[A-Za-z_]\w*)+)[`(]", text))):
        module, _, last = name.rpartition(".")
        try:
            importlib.import_module(name)
        except ImportError:
            assert hasattr(importlib.import_module(module), last), f"{page}: {name}"


@pytest.fixture
def episodes(page: str) -> Iterator[None]:
    """Short ones, but on the page that repeats recorded episodes."""
    with short_episodes(*([] if page == "results.md" else task_ids())):
        yield


@pytest.mark.usefixtures("episodes", "narrow_packs")
@pytest.mark.parametrize("page", PAGES)
def test_the_code_of_a_page_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("SB3_LOGDIR", str(tmp_path / "sb3"))  # or Stable-Baselines3 logs beside all temporary files
    names: dict[str, object] = {}
    ran = 0
    blocks = BLOCK.findall((ROOT / "docs" / page).read_text(encoding="utf-8"))
    for _, title, _ in blocks:  # what a page imports from its own files is forgotten afterwards
        if title:
            monkeypatch.setitem(sys.modules, Path(title).stem, None)
            del sys.modules[Path(title).stem]
    for language, title, text in blocks:
        if title:
            (tmp_path / title).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, f"{page}:{ran}", "exec"), names)
        elif language == "sh":
            for line in text.splitlines():
                run_command(line)
        ran += language in ("python", "sh")
    assert ran, f"docs/{page} has blocks, but none that can be run"
