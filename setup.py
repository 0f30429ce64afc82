"""The four folders beside ``warpvox/`` are its subpackages, also where git has made files of the links (Windows)."""

from pathlib import Path

from setuptools import find_namespace_packages, setup

UNLINKED = [name for name in ("algos", "configs", "envs", "kernels") if not Path("warpvox", name).is_dir()]
INSIDE = [f"{name}.{inner}" for name in UNLINKED for inner in find_namespace_packages(name)]

setup(
    packages=[*find_namespace_packages(include=["warpvox*"]), *(f"warpvox.{name}" for name in (*UNLINKED, *INSIDE))],
    # an editable installation with the links is a path, which editors follow, not a finder
    package_dir={"": ".", **{f"warpvox.{name}": name for name in UNLINKED}},
)
