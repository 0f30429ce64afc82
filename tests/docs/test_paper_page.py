"""``docs/paper.md`` names every task and every part of it that ``rules=paper`` changes, and no other."""

import re
from pathlib import Path

from warpvox.envs.registry import get_task, task_ids

PAGE = Path(__file__).resolve().parents[2] / "docs" / "paper.md"
ROW = re.compile(r"^\| ([\w-]+-v\d) \| ([a-z, ]+) \| .+ \| .+ \|$", re.MULTILINE)
WORDS = {"ends": "terminations", "max episode steps": "max_episode_steps"}


def test_the_table_is_complete() -> None:
    named: dict[str, set[str]] = {}
    for task, parts in ROW.findall(PAGE.read_text(encoding="utf-8")):
        named.setdefault(task, set()).update(WORDS.get(part, part) for part in parts.split(", "))
    changed = {task: set(get_task(task).paper) for task in task_ids()}
    assert named == {task: parts for task, parts in changed.items() if parts}


def test_the_number_of_tasks_that_differ_is_the_one_that_is_printed() -> None:
    count = sum(bool(get_task(task).paper) for task in task_ids())
    assert f"{count} of the {len(task_ids())} tasks" in " ".join(PAGE.read_text(encoding="utf-8").split())
    readme = (PAGE.parents[1] / "README.md").read_text(encoding="utf-8")
    assert f"differ in {count} tasks" in " ".join(readme.split())
