"""locks/ and constraints.txt say the same, and nothing is installed from a lock without its hash."""

import functools
import re
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest
import yaml
from closure import canonical, installed_closure, required
from packaging.requirements import Requirement

import warpvox

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

EXTRAS = {
    "run": {"view"},
    "test": {"dev", "view", "search", "ray", "analysis", "export", "sb3"},
    "docs": {"docs"},
    "all": {"*"},
}  # the locks and the extras that each is for
ALONE = {"ptxas"}  # locks of programs for tests, which are installed by themselves, without what they depend on
PYTHONS = ("3.10.13", "3.11.0", "3.11.7", "3.12.1", "3.13.0", "3.14.0")
PLATFORMS = {"linux": "Linux", "darwin": "Darwin", "win32": "Windows"}
UNLOCKED = {"torch"}  # which build of torch fits depends on the machine, and every index has hashes of its own
CUDA_PARTS = re.compile(r"(nvidia|cuda)-|triton$")


@functools.cache
def entries(path: Path) -> list[tuple[Requirement, set[str]]]:
    """The requirements of a file in pip's format, with their hashes."""
    lines = path.read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    found = []
    for line in lines:
        if line.strip() and not line.lstrip().startswith("#"):
            words = line.split(" --hash=")
            found.append((Requirement(words[0].strip()), {word.strip() for word in words[1:]}))
    return found


def selected(path: Path, python: str, platform: str) -> dict[str, str]:
    """Name -> version of what a file means on a Python and a platform; fails where it says two versions."""
    environment = {
        "python_version": ".".join(python.split(".")[:2]),
        "python_full_version": python,
        "sys_platform": platform,
        "platform_system": PLATFORMS[platform],
        "platform_machine": "x86_64",
        "os_name": "nt" if platform == "win32" else "posix",
    }
    pins: dict[str, str] = {}
    for asked, _ in entries(path):
        if asked.marker is None or asked.marker.evaluate(environment):
            name = canonical(asked.name)
            assert name not in pins, f"{path.name}: {name} twice on Python {python}, {platform}"
            (pin,) = asked.specifier
            assert pin.operator == "==", f"{path.name}: {asked} is not pinned"
            pins[name] = pin.version
    return pins


@pytest.fixture(scope="module")
def locks(repository: Path) -> Path:
    return repository / "locks"


def test_the_locks_are_these(locks: Path) -> None:
    assert sorted(path.name for path in locks.iterdir()) == sorted(f"{name}.txt" for name in {*EXTRAS, *ALONE})


@pytest.mark.parametrize("name", [*EXTRAS, *ALONE])
def test_every_entry_has_hashes(locks: Path, name: str) -> None:
    for asked, hashes in entries(locks / f"{name}.txt"):
        assert hashes, f"{asked} has no hash"
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", one) for one in hashes), asked


@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize("python", PYTHONS)
def test_locks_and_constraints_say_the_same(repository: Path, locks: Path, python: str, platform: str) -> None:
    constraints = selected(repository / "constraints.txt", python, platform)
    complete = selected(locks / "all.txt", python, platform)
    assert {name: pin for name, pin in constraints.items() if name not in UNLOCKED} == complete
    assert set(constraints) >= UNLOCKED
    for name in EXTRAS:
        assert selected(locks / f"{name}.txt", python, platform).items() <= complete.items(), name


@pytest.mark.parametrize("name", EXTRAS)
def test_the_hashes_are_the_same_in_all_locks(locks: Path, name: str) -> None:
    complete = {str(asked): hashes for asked, hashes in entries(locks / "all.txt")}
    for asked, hashes in entries(locks / f"{name}.txt"):
        same = [known for text, known in complete.items() if Requirement(text).specifier == asked.specifier
                and canonical(Requirement(text).name) == canonical(asked.name)]  # fmt: skip
        assert same == [hashes], asked


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("name", EXTRAS)
def test_a_lock_meets_what_the_project_asks_for(repository: Path, locks: Path, name: str, python: str) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(project["optional-dependencies"]) if EXTRAS[name] == {"*"} else EXTRAS[name]
    asked = list(project["dependencies"])
    for extra in sorted(extras):
        asked += project["optional-dependencies"][extra]
    pins = selected(locks / f"{name}.txt", python, "linux")
    environment = {"python_version": ".".join(python.split(".")[:2]), "python_full_version": python}
    for one in map(Requirement, asked):
        wanted = one.marker is None or one.marker.evaluate(environment)
        if wanted and canonical(one.name) not in UNLOCKED:
            assert one.specifier.contains(pins[canonical(one.name)]), one


@pytest.mark.parametrize("name", ["run", "test"])
def test_a_lock_is_the_whole_closure(locks: Path, name: str) -> None:
    # the metadata of what is installed here are a second source, other than the resolver that made the locks
    running = ".".join(map(str, sys.version_info[:3]))
    pins = selected(locks / f"{name}.txt", running, sys.platform)
    closure = {one for one in installed_closure("warpvox", EXTRAS[name]) if not CUDA_PARTS.match(one)}
    assert closure <= set(pins) | UNLOCKED


def test_what_the_locks_know_of_torch_is_true(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))
    (told,) = project["tool"]["uv"]["dependency-metadata"]
    names = {canonical(Requirement(text).name) for text in told["requires-dist"]}
    installed = {canonical(asked.name) for asked in required(distribution("torch"), set())}
    assert names == {name for name in installed if not CUDA_PARTS.match(name)}
    (pin,) = [asked for asked, _ in entries(repository / "constraints.txt") if asked.name == "torch"]
    assert pin.specifier.contains(told["version"])


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
