"""A type checker's answers to a user: an editable installation is followed, and a wrong keyword is found."""

import dataclasses
import json
import re
import site
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

from warpvox.batch.options import SimKeywords, SimOptions

SCRIPT = """
import torch

import warpvox as wv
import warpvox.algos.search
import warpvox.envs
import warpvox.kernels
from warpvox.envs.spec import TaskSpec

env = wv.make_vec("Walker-v0", wv.example_design("walker"), num_envs=4, device="cpu", threads=1)
obs, _ = env.reset()
for _ in range(2):
    obs, reward, terminated, truncated, info = env.step(torch.rand(env.num_envs, env.num_actions))
spec: TaskSpec = env.spec
world = wv.World(9, 1)
world.add_from_array("robot", wv.sample_design((5, 5), seed=0), 0, 0)
sim = wv.Simulation([world], wv.SimOptions(device="cpu"))
"""
WRONG = """
import warpvox as wv

wv.make_vec("Walker-v0", num_env=4)
"""


def test_keywords_are_the_fields_of_the_options() -> None:
    assert SimKeywords.__annotations__.keys() == {field.name for field in dataclasses.fields(SimOptions)}


@pytest.fixture
def python(repository: Path, tmp_path: Path) -> Path:
    """An environment with an editable installation, and what else is installed here."""
    venv.create(tmp_path / "venv", with_pip=False)
    (packages,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    code = "import sys; from setuptools import build_meta; build_meta.build_editable(sys.argv[1])"
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], cwd=repository, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(packages)
    others = [path for path in sys.path if "site-packages" in path]
    (packages / "others.pth").write_text("\n".join([*others, *site.getsitepackages()]))
    return tmp_path / "venv" / "bin" / "python"


def documented(repository: Path) -> dict[str, str]:
    """What newcomers copy, as scripts by name: of README, quick start and notebooks, and the examples."""
    pages = {name: (repository / name).read_text(encoding="utf-8") for name in ("README.md", "docs/quickstart.md")}
    found = {
        Path(name).stem: "\n".join(re.findall(r"^```python\n(.*?)^```", pages[name], re.M | re.S)) for name in pages
    }
    for path in sorted((repository / "examples").rglob("*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        found[path.stem] = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    return found | {path.stem: path.read_text(encoding="utf-8") for path in (repository / "examples").glob("*.py")}


@pytest.mark.packaging
def test_what_is_documented(python: Path, tmp_path: Path, repository: Path) -> None:
    for name, text in documented(repository).items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    files = sorted(path.name for path in tmp_path.glob("*.py"))
    assert len(files) >= 10
    # cells end with what they show; a loop over a constant number of rounds binds its names
    config = {"include": files, "reportUnusedExpression": False, "reportPossiblyUnboundVariable": False}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(config))
    command = [sys.executable, "-m", "pyright", "--pythonpath", str(python)]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout


@pytest.mark.packaging
@pytest.mark.parametrize(("script", "rules"), [(SCRIPT, []), (WRONG, ["reportCallIssue"])], ids=["right", "wrong"])
def test_a_script_of_a_user(python: Path, tmp_path: Path, script: str, rules: list[str]) -> None:
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "script.py").write_text(script)
    command = [sys.executable, "-m", "pyright", "--pythonpath", str(python), "--outputjson", "script.py"]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    found = json.loads(run.stdout)["generalDiagnostics"]
    assert [one.get("rule") for one in found] == rules, found
