"""The files that describe the project to others say what is true here."""

import re
from pathlib import Path

import yaml

import warpvox


def test_workflows_run_targets_of_the_makefile(repository: Path) -> None:
    makefile = (repository / "Makefile").read_text(encoding="utf-8")
    targets = set(re.search(r"^\.PHONY: (.+)$", makefile, re.MULTILINE)[1].split())
    asked = set()
    for path in (repository / ".github/workflows").glob("*.yml"):
        for job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"].values():
            asked |= {*job.get("strategy", {}).get("matrix", {}).get("target", ())}
            for step in job["steps"]:
                asked |= set(re.findall(r"\bmake ([\w-]+)", step.get("run", "")))
    assert {"lint", "types", "test", "docs", "packaging", "release"} <= asked <= targets


def test_versions_and_dates_agree(repository: Path) -> None:
    citation = yaml.safe_load((repository / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == warpvox.__version__
    changes = (repository / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{citation['version']}] - {citation['date-released']}" in changes
    readme = (repository / "README.md").read_text(encoding="utf-8")
    assert f"version = {{{citation['version']}}}" in readme
    hook = (repository / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    pins = (repository / "constraints.txt").read_text(encoding="utf-8")
    assert re.search(r"^ruff==(\S+)", pins, re.MULTILINE)[1] == re.search(r"rev: v(\S+)", hook)[1]
