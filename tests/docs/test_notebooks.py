"""The notebooks run as they are printed, and keep small pictures of what they show."""

import json
import re
from pathlib import Path
from typing import Any

import notebooks
import pytest
import torch
from episodes import short_episodes

from warpvox.algos.robots import zoo
from warpvox.envs.registry import task_ids

ROOT = Path(__file__).resolve().parents[2]
PATHS = sorted(notebooks.FOLDER.glob("*.ipynb"))
BYTES = 400_000
QUICK: dict[str, dict[str, Any]] = {
    "first_robot": {"ENVS": 8, "ITERATIONS": 1},
    "own_task": {"ENVS": 8, "ITERATIONS": 1},
    "own_search": {
        "GENERATIONS": 2,
        "POPULATION": 4,
        "STEPS": 5,
        "BODIES": 2,
        "TRAINING": {"envs": 2, "iterations": 1, "eval_interval": 1, "ppo": {"steps": 4, "epochs": 1}},
    },
    "many_bodies": {"ENVS": 8, "ITERATIONS": 1, "STEPS": 4},
}


def shown(notebook: dict[str, Any]) -> list[str]:
    """The representation that each cell would like to be seen by."""
    data = [one["data"] for cell in notebook["cells"] for one in cell.get("outputs", ()) if "data" in one]
    return [max(kinds) for kinds in data]  # text/plain, text/html and image/png in this order of preference


def run(path: Path, parameters: dict[str, Any] | None, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.chdir(folder)
    threads = torch.get_num_threads()
    try:
        found = notebooks.run(path, parameters)
    finally:
        torch.set_num_threads(threads)
    assert shown(found) == shown(json.loads(path.read_text(encoding="utf-8")))
    assert not list(folder.iterdir()), "a notebook leaves nothing behind"


@pytest.mark.usefixtures("narrow_packs")
@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with short_episodes(*task_ids()):
        run(path, QUICK[path.stem], monkeypatch, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_a_notebook_runs_as_it_is_printed(path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run(path, None, monkeypatch, tmp_path)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_a_notebook_keeps_what_it_shows(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text) < BYTES
    assert f"warpvox/blob/main/{path.relative_to(ROOT)})" in text, "the badge opens this notebook"
    outputs = [one for cell in json.loads(text)["cells"] for one in cell.get("outputs", ())]
    assert {one["output_type"] for one in outputs} == {"stream", "execute_result"}
    assert not re.search(r"/(tmp|home|root|work)/", json.dumps(outputs))


def test_robots_that_notebooks_show_are_those_of_the_zoo() -> None:
    texts = [one for path in PATHS for one in re.findall(r'"(Robot\(.*\))"', path.read_text(encoding="utf-8"))]
    assert texts == [repr(zoo(re.match(r"Robot\(([\w-]+)", text)[1])) for text in texts] != []


def test_the_site_shows_the_notebooks() -> None:
    pages = notebooks.pages()
    assert {Path(page).stem for page in pages} == {path.stem for path in PATHS}
    first = pages["notebooks/first_robot.md"]
    assert first.startswith("# The first robot\n")
    assert "](own_task.md)" in first
    assert "colab-badge" not in first, "the site can be read without a network"
    assert re.search(r'^<div><iframe srcdoc="[^"\n]+"[^\n]*</iframe></div>$', first, re.MULTILINE)
