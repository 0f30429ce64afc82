"""Builds of the wheel and the source distribution, as for a package index."""

import shutil
import subprocess
import sys
from pathlib import Path

LINKED = ("kernels", "envs", "algos", "configs")
"""Top-level folders that are linked into warpvox as subpackages."""
FOLDERS = ("warpvox", *LINKED, "benchmarks", "lab", "tests")


def copy_sources(repository: Path, place: Path) -> Path:
    """Copy all of a checkout that a build could read, including lab and tests, which distributions must leave out."""
    for path in repository.iterdir():
        if path.name in FOLDERS:
            ignore = shutil.ignore_patterns("__pycache__", "recordings")
            shutil.copytree(path, place / path.name, symlinks=True, ignore=ignore)
        elif path.is_file() and not path.is_symlink():  # in a worktree, .git is a file
            shutil.copy(path, place / path.name)
    return place


def build(kind: str, sources: Path, out: Path) -> Path:
    """Build ``wheel`` or ``sdist`` with the installed setuptools; return the file in ``out``."""
    code = f"import sys; from setuptools import build_meta; build_meta.build_{kind}(sys.argv[1])"
    out.mkdir(exist_ok=True)
    run = subprocess.run([sys.executable, "-c", code, str(out)], cwd=sources, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    (built,) = out.iterdir()
    return built
