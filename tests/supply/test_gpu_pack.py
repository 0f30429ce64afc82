"""The pack for a GPU machine without a package index, made of small wheels and without a network."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WITH_TORCH = set(
    "torch numpy sympy mpmath fsspec typing-extensions attrs filelock jinja2 networkx markupsafe setuptools".split()
)
WITH_TENSORBOARD = {"tensorboard", "absl-py", "protobuf", "grpcio", "markdown", "werkzeug", "tensorboard-data-server"}
LOADED = """
import importlib.metadata, json, sys
import warpvox.bench.gpu_check, warpvox.bench.gpu, warpvox.cli.commands.bench
from warpvox.cli import main
assert main([]) is not None
tops = {name.split(".")[0] for name in sys.modules}
found = importlib.metadata.packages_distributions()
print(json.dumps(sorted({name for top in tops if not top.startswith("_") for name in found.get(top, [])})))
"""


def load(name: str):
    spec = importlib.util.spec_from_file_location(name, ROOT / ".ci" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


gpu_pack = load("gpu_pack")


def wheel(folder: Path, name: str, files: dict[str, bytes]) -> None:
    folder.mkdir(exist_ok=True)
    with zipfile.ZipFile(folder / f"{name}-1.0-py3-none-any.whl", "w") as archive:
        for place, data in files.items():
            archive.writestr(place, data)


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A pack of several parts: a package with a compiled part, and one whose examples are left out."""
    noise = os.urandom(30_000)
    wheel(tmp_path / "wheels", "small", {"small/__init__.py": b"VALUE = 7\n", "small/native.so": noise})
    wheel(
        tmp_path / "wheels", "warp", {"warp/__init__.py": b"", "warp/examples/big.bin": noise, "warp/tests/t.py": b""}
    )
    words = ["--wheels", tmp_path / "wheels", "--out", tmp_path / "pack", "--part", "8000", "--python", "3.12"]
    done = subprocess.run([sys.executable, ROOT / ".ci" / "gpu_pack.py", *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return tmp_path / "pack"


def install(pack: Path, target: Path) -> subprocess.CompletedProcess:
    words = [sys.executable, "-S", str(pack / "install.py"), str(target)]
    return subprocess.run(words, capture_output=True, text=True, env={"PATH": os.defpath})


def test_a_pack_is_installed_by_python_alone(made: Path, tmp_path: Path) -> None:
    parts = sorted(path.name for path in made.glob("part*"))
    assert len(parts) == 4
    assert all(path.stat().st_size <= 8000 for path in made.glob("part*"))
    done = install(made, tmp_path / "site")
    assert f"export PYTHONPATH={tmp_path / 'site'}" in done.stdout
    assert (
        "This machine lacks torch, numpy, tensorboard, typing_extensions" in done.stderr
    )  # -S hides what is installed
    with zipfile.ZipFile(tmp_path / "wheels" / "small-1.0-py3-none-any.whl") as archive:
        assert (tmp_path / "site/small/native.so").read_bytes() == archive.read("small/native.so")
    assert (tmp_path / "site/warp/__init__.py").is_file()
    assert not (tmp_path / "site/warp/examples").exists()


def test_a_part_that_is_missing_or_damaged_is_named(made: Path, tmp_path: Path) -> None:
    data = (made / "part02").read_bytes()
    (made / "part02").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert "The part part02 is damaged" in install(made, tmp_path / "site").stderr
    (made / "part02").unlink()
    assert "The part part02 is missing" in install(made, tmp_path / "site").stderr
    assert not (tmp_path / "site").exists()


def test_without_wheels_nothing_is_packed(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no wheel"):
        gpu_pack.pack([], tmp_path / "pack", "3.12")
    assert not (tmp_path / "pack").exists()


def test_what_is_brought_has_a_pinned_version() -> None:
    pinned = set(re.findall(r"^([\w.-]+)==", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    assert set(gpu_pack.BROUGHT) <= pinned
    assert set(gpu_pack.SOURCES_ALONE) <= set(gpu_pack.BROUGHT)


def test_everything_that_the_check_imports_is_brought_or_there() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    loaded = {name.lower().replace("_", "-") for name in json.loads(done.stdout.splitlines()[-1])} - {"warpvox"}
    assert {"warp-lang", "rsl-rl-lib", "hydra-core", "tensordict"} <= loaded
    assert loaded <= set(gpu_pack.BROUGHT) | WITH_TORCH | WITH_TENSORBOARD
