"""Reports of NVIDIA's assembler on a kernel, without a GPU: registers, memory, instructions by place in the source.

The programs ``ptxas`` and ``nvdisasm`` are in build/ptxas, where ``make ptxas`` (and ``make test``) fetches
them, or on PATH with a CUDA toolkit.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpvox.errors import WarpvoxError

ARCHITECTURES = {80: "A100", 89: "RTX 40", 90: "H100, H200", 100: "B200"}
"""Compute capabilities for which limits are held, and what has them."""
FETCHED = Path(__file__).resolve().parents[2] / "build" / "ptxas" / "nvidia"
OUTSIDE = "outside"
"""Instructions that belong to no counted place: before the first sub-step, after the last, and detours."""


@dataclass(frozen=True)
class Limits:
    """Resources of a kernel, per thread but for ``shared``; bytes but for ``registers``."""

    registers: int
    stack: int
    spilled: int
    shared: int


def find_program(name: str) -> Path:
    """The program ``ptxas`` or ``nvdisasm``, fetched or on PATH; WarpvoxError: it is nowhere."""
    found = max(map(str, FETCHED.glob(f"*/bin/{name}")), default=shutil.which(name))
    if found is None:
        raise WarpvoxError(f"There is no program {name!r}: `make ptxas` fetches it (Linux, x86-64).")
    return Path(found)


def _run(program: str, *arguments: str) -> tuple[str, str]:
    done = subprocess.run([find_program(program), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.strip()[-500:]
        raise WarpvoxError(f"{program} failed; one that is too old for Warp `make ptxas` replaces: {said}")
    return done.stdout, done.stderr


def assemble(kernel: wp.Kernel, architecture: int, folder: Path, lines: bool = False) -> Limits:
    """Compile for a compute capability (90: 9.0) into ``folder``/kernel.cubin; ``lines``: with the source's lines."""
    before = kernel.module.options.get("lineinfo")
    kernel.module.options["lineinfo"] = lines
    try:
        wp.compile_aot_module(kernel.module, arch=architecture, module_dir=str(folder), use_ptx=True)
    finally:
        kernel.module.options["lineinfo"] = before
    ptx = next(folder.glob("*.ptx"))  # ends in NUL, which ptxas refuses
    ptx.write_text(ptx.read_text(encoding="utf-8").replace("\0", ""), encoding="utf-8")
    options = [*(["-lineinfo"] if lines else []), f"-arch=sm_{architecture}", "-v"]
    _, said = _run("ptxas", *options, "-o", str(folder / "kernel.cubin"), str(ptx))
    # One function is the kernel; others are called by it, and its registers and stack include theirs.
    frames = [list(map(int, found)) for found in re.findall(r"(\d+) bytes stack frame, (\d+).*stores, (\d+)", said)]
    used = re.search(r"Used (\d+) registers.*", said)
    if used is None or not frames:
        raise WarpvoxError(f"ptxas said something else than expected: {said[-500:]}")
    stack, shared = (re.search(rf"(\d+) bytes {what}", used[0]) for what in ("cumulative stack", "smem"))
    own, stored, loaded = zip(*frames, strict=True)
    return Limits(
        int(used[1]), int(stack[1]) if stack else max(own), sum(stored + loaded), int(shared[1]) if shared else 0
    )


def counted(kernel: wp.Kernel, architecture: int = 90) -> Mapping[str, np.ndarray]:
    """Instructions of the machine code by the place of the source (``COUNT`` in ``native/group``) they come from.

    All, those in float64 (conversions included), and the wavefronts of shared memory that they would take without
    conflicts of banks. A place is the rest of the block in which it stands; what is inlined there belongs to it.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        assemble(kernel, architecture, folder, lines=True)
        assembly, _ = _run("nvdisasm", "-c", "-gi", str(folder / "kernel.cubin"))
        place = _places(next(folder.glob("*.cu")).read_text(encoding="utf-8"))
    found: Mapping[str, np.ndarray] = defaultdict(lambda: np.zeros(3, int))
    chain: list[int] = []  # lines of the generated source: of the instruction, and of the calls that were inlined
    begins, apart = True, False  # apart: the detours of diverged warps and of special numbers, at the end of the code
    for line in assembly.splitlines():
        origin = re.match(r'\s*//## File "([^"]*)", line (\d+)', line)
        if origin:
            chain = [*([] if begins else chain), *([int(origin[2])] if origin[1].endswith(".cu") else [])]
            begins = False
        elif re.match(r"\s+/\*[0-9a-f]{4,}\*/", line):
            begins = True
            apart |= "WARPSYNC.COLLECTIVE" in line
            at = OUTSIDE if apart else next((place[at] for at in chain if place.get(at)), OUTSIDE)
            wide = re.search(r"\*/ +(@!?U?P\d+ +)?(D[A-Z]+|F2F\.\w*F64)", line)
            access = re.search(r"\*/ +(?:@!?U?P\d+ +)?(?:LDS|STS|ATOMS)(\.64|\.128)?", line)
            found[at] += 1, bool(wide), int((access[1] or ".32")[1:]) // 32 if access else 0
    return found


def _places(source: str) -> dict[int, Any]:
    """The place to which each line of a source belongs."""
    found: dict[int, Any] = {}
    blocks: list[str | None] = [None]
    for number, line in enumerate(source.splitlines(), 1):
        code = re.sub(r"//.*", "", line)
        marker = re.match(r"\s*COUNT\((\w+)\);", code)
        if marker:
            blocks[-1] = marker[1]
        found[number] = blocks[-1]
        for brace in re.findall(r"[{}]", code):
            if brace == "{":
                blocks.append(blocks[-1])
            elif len(blocks) > 1:
                blocks.pop()
    return found
