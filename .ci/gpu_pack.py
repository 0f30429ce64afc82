"""``make gpu_pack``: packs what a GPU machine without a package index needs to run warpvox, in parts of limited size.

There must be Python with torch for CUDA, numpy and tensorboard; the pack brings warpvox, Warp and what training needs,
in the versions of ``constraints.txt``. Carry the folder there, at once or part by part, and run ``python3 install.py``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import lzma
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BROUGHT = (
    "warp-lang", "rsl-rl-lib", "tensordict", "pyvers", "hydra-core", "omegaconf", "antlr4-python3-runtime",
    "gymnasium", "farama-notifications", "gitpython", "gitdb", "smmap", "cloudpickle", "pyyaml", "rich", "pygments",
    "markdown-it-py", "mdurl", "packaging", "pillow", "lazy-loader",
)  # fmt: skip
"""Distributions in the pack, besides warpvox itself; what they need in turn is among them or comes with torch."""
NEEDED = ("torch", "numpy", "tensorboard", "typing_extensions")
"""Modules that must be there already."""
LEFT_OUT = ("warp/examples", "warp/tests")
"""Folders that nothing of warpvox imports."""
SOURCES_ALONE = ("antlr4-python3-runtime",)
"""Distributions without a wheel in the index."""
SOURCES = ("warpvox", "kernels", "envs", "algos", "configs", "pyproject.toml", "README.md", "LICENSE", "MANIFEST.in")
"""What warpvox is built from."""
PLATFORMS = ("manylinux_2_34_x86_64", "manylinux_2_28_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64")
PART = 48_000_000
"""Bytes of a part."""
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")


def fetch(wheels: Path, python: str) -> None:
    """Download the wheels for Linux on x86-64, and build that of this checkout."""
    pinned = dict(re.findall(r"^([\w.-]+)==([\w.]+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    lines = {name: f"{name}=={pinned[name]}" for name in BROUGHT}
    binary = [line for name, line in lines.items() if name not in SOURCES_ALONE]
    platforms = [word for name in PLATFORMS for word in ("--platform", name)]
    kind = ["--only-binary=:all:", "--python-version", python, "--implementation", "cp", *platforms]
    run(*PIP, "download", "--quiet", "--no-deps", *kind, "--dest", str(wheels), *binary)
    for name in SOURCES_ALONE:
        run(*PIP, "wheel", "--quiet", "--no-deps", "--wheel-dir", str(wheels), lines[name])
    with tempfile.TemporaryDirectory() as scratch:  # a build leaves files behind, which the next would take up
        for name in SOURCES:
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
            copy(ROOT / name, Path(scratch, name))
        run(*PIP, "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(wheels), scratch)


def run(*words: str) -> None:
    """Run a program; end with what it says if it fails."""
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(words)} failed:\n{done.stderr.strip()[-2000:]}")


def pack(wheels: Sequence[Path], out: Path, python: str, part: int = PART) -> list[Path]:
    """Put the contents of wheels into ``out``: parts of at most ``part`` bytes, their digests, and what unpacks them.

    The folder appears when everything is in it; one of that name is replaced.
    """
    if not wheels:
        sys.exit("There is no wheel to pack.")
    with tempfile.TemporaryDirectory() as scratch:
        site, made = Path(scratch, "site"), Path(scratch, "pack")
        made.mkdir()
        for wheel in wheels:
            with zipfile.ZipFile(wheel) as archive:
                archive.extractall(site)
        for name in LEFT_OUT:
            shutil.rmtree(site / name, ignore_errors=True)
        whole = Path(scratch, "site.tar.xz")
        with lzma.open(whole, "wb", preset=6) as stream, tarfile.open(fileobj=stream, mode="w|") as archive:
            for path in sorted(site.iterdir()):
                archive.add(path, path.name)
        digests = {}
        with whole.open("rb") as stream:
            while data := stream.read(part):
                name = f"part{len(digests):02}"
                digests[name] = hashlib.sha256(data).hexdigest()
                (made / name).write_bytes(data)
        contents = {"python": python, "needs": NEEDED, "wheels": [path.name for path in wheels], "parts": digests}
        (made / "contents.json").write_text(json.dumps(contents, indent=2) + "\n")
        shutil.copy(ROOT / ".ci" / "gpu_install.py", made / "install.py")
        out.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(out, ignore_errors=True)
        shutil.move(made, out)
    return [out / name for name in digests]


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--python", default="3.12", help="version of Python on the GPU machine (default: 3.12)")
    words.add_argument(
        "--out", type=Path, default=ROOT / "build" / "gpu", help="folder of the pack (default: build/gpu)"
    )
    words.add_argument("--part", type=int, default=PART, help=f"bytes of a part at most (default: {PART:,})")
    words.add_argument("--wheels", type=Path, help="folder of wheels to pack instead of fetching them")
    given = words.parse_args()
    if given.part < 1:
        words.error(f"--part must be at least 1, got {given.part}")
    with tempfile.TemporaryDirectory() as scratch:
        wheels = given.wheels or Path(scratch)
        if given.wheels is None:
            fetch(wheels, given.python)
        parts = pack(sorted(wheels.glob("*.whl")), given.out, given.python, given.part)
    sizes = ", ".join(f"{path.name} {path.stat().st_size / 1e6:.1f} MB" for path in parts)
    print(f"{given.out}: {sizes}; there: python3 install.py")


if __name__ == "__main__":
    main()
