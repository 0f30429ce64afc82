"""What is installed is what lies in the checkout, and importing it stays cheap."""

import importlib
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from build_distributions import LINKED, build, copy_sources

import warpvox

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

HEAVY = "torch warp botorch neat ribs hydra omegaconf rsl_rl gymnasium matplotlib pxr tensorboard".split()
IMPORT_SECONDS = 1.0


@pytest.fixture(scope="module")
def project(repository: Path) -> dict[str, object]:
    return tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))


def shipped_files(repository: Path) -> set[str]:
    """Every file of the package, those behind the links included."""
    return {
        Path(place, name).relative_to(repository).as_posix()
        for place, _, names in os.walk(repository / "warpvox", followlinks=True)
        for name in names
        if Path(place).name != "__pycache__"
    }


def test_links_make_the_four_folders_subpackages(repository: Path) -> None:
    links = {path.name: path.readlink() for path in (repository / "warpvox").iterdir() if path.is_symlink()}
    assert links == {folder: Path("..", folder) for folder in LINKED}


def test_linked_folders_refuse_a_second_import(repository: Path) -> None:
    for folder in LINKED:
        code = f"import {folder}"
        run = subprocess.run([sys.executable, "-c", code], cwd=repository, capture_output=True, text=True)
        assert run.returncode != 0
        assert f"import this package as warpvox.{folder}" in run.stderr


def test_the_wheel_holds_every_file_of_the_tree(repository: Path, wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert inside == shipped_files(repository)


def contents(built: Path) -> dict[str, bytes]:
    """The files of a wheel, those of its description included."""
    with zipfile.ZipFile(built) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_the_source_distribution_builds_the_same_wheel(wheel: Path, sdist: Path, tmp_path: Path) -> None:
    shutil.unpack_archive(sdist, tmp_path)
    (unpacked,) = tmp_path.iterdir()
    assert contents(build("wheel", unpacked, tmp_path / "out")) == contents(wheel)


def test_sources_without_links_build_the_same_wheel(repository: Path, wheel: Path, tmp_path: Path) -> None:
    """With ``core.symlinks=false``, the default of git for Windows."""
    sources = copy_sources(repository, tmp_path)
    for folder in LINKED:
        (sources / "warpvox" / folder).unlink()
        (sources / "warpvox" / folder).write_text(f"../{folder}")
    assert contents(build("wheel", sources, tmp_path / "out")) == contents(wheel)


def test_the_source_distribution_holds_nothing_else(repository: Path, sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames() if archive.getmember(name).isfile()}
    described = {name for name in inside if name.startswith("warpvox.egg-info/")} | {"PKG-INFO", "setup.cfg"}
    sources = {name for name in inside - described if name.startswith("warpvox/")}
    assert sources == shipped_files(repository)
    assert inside - described - sources == {
        "pyproject.toml",
        "setup.py",
        "README.md",
        "LICENSE",
        "NOTICE",
        "MANIFEST.in",
    }


def test_the_wheel_works_without_the_checkout(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    code = (
        "import importlib.resources as r\n"
        "import warpvox, warpvox.kernels, warpvox.envs, warpvox.algos, warpvox.configs\n"
        "print(warpvox.__file__)\n"
        "print(sum(f.name.endswith('.yaml') for f in r.files('warpvox.configs').iterdir()))\n"
    )
    # an editable install of the checkout comes after PYTHONPATH
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    place, configs = run.stdout.split()
    assert Path(place).is_relative_to(tmp_path)
    assert int(configs) > 0


def test_the_version_is_said_once(project: dict, wheel: Path) -> None:
    assert project["project"]["dynamic"] == ["version"]
    assert wheel.name.startswith(f"warpvox-{warpvox.__version__}-")


def run_python(code: str, cwd: Path) -> str:
    run = subprocess.run([sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_import_is_fast_and_light(tmp_path: Path) -> None:
    code = (
        "import sys, time; start = time.process_time(); import warpvox\n"
        "print(time.process_time() - start, *[m for m in sys.modules if '.' not in m])"
    )
    seconds, *modules = run_python(code, tmp_path).split()
    assert not set(HEAVY) & set(modules)
    assert float(seconds) < IMPORT_SECONDS


@pytest.mark.parametrize("name", sorted(warpvox.__all__))
def test_every_public_name_resolves(name: str) -> None:
    value = getattr(warpvox, name)
    assert value is getattr(importlib.import_module(value.__module__), name)
    assert value.__doc__
