"""Resource usage of a kernel as reported by NVIDIA's assembler, without a GPU.

The program ``ptxas`` is in build/ptxas, where ``make ptxas`` (and ``make test``) fetches it, or on PATH.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import warp as wp

from warpvox.errors import WarpvoxError
from warpvox.kernels.group import WARP

ARCHITECTURES = {80: "A100", 89: "RTX 40", 90: "H100, H200", 100: "B200", 120: "RTX 50"}
"""Compute capabilities with tested limits, and GPUs that have them."""
FETCHED = Path(__file__).resolve().parents[2] / "build" / "ptxas" / "nvidia"
REGISTERS = 65536
"""Number of registers of a multiprocessor."""
SHARED = {80: 164, 89: 100, 90: 228, 100: 228, 120: 100}
"""Shared memory of a multiprocessor in KiB, by compute capability; a block can use one less."""
RESERVED = 1024
"""Shared memory that CUDA reserves in every block, in bytes."""


@dataclass(frozen=True)
class Limits:
    """Resources of a kernel: registers and bytes per thread, shared memory per block."""

    registers: int
    stack: int
    spilled: int
    shared: int
    asked: int = 0


def find_program() -> Path:
    """Find ``ptxas``, downloaded or on PATH; WarpvoxError: not found."""
    found = max(map(str, FETCHED.glob("*/bin/ptxas")), default=shutil.which("ptxas"))
    if found is None:
        raise WarpvoxError("There is no program 'ptxas': `make ptxas` fetches it (Linux, x86-64).")
    return Path(found)


def assemble(kernel: wp.Kernel, architecture: int, folder: Path) -> Limits:
    """Compile a kernel for a compute capability (90: 9.0) in ``folder``, and return its resources."""
    wp.compile_aot_module(kernel.module, arch=architecture, module_dir=str(folder), use_ptx=True)
    ptx = next(folder.glob("*.ptx"))  # ends in NUL, which ptxas refuses
    ptx.write_text(ptx.read_text(encoding="utf-8").replace("\0", ""), encoding="utf-8")
    words = [find_program(), f"-arch=sm_{architecture}", "-v", "-o", folder / "kernel.cubin", ptx]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    said = done.stderr
    if done.returncode:
        raise WarpvoxError(f"ptxas failed; one that is too old for Warp `make ptxas` replaces: {said.strip()[-500:]}")
    # One function is the kernel; others are called by it, and its registers and stack include theirs.
    frames = [list(map(int, found)) for found in re.findall(r"(\d+) bytes stack frame, (\d+).*stores, (\d+)", said)]
    used = re.search(r"Used (\d+) registers.*", said)
    if used is None or not frames:
        raise WarpvoxError(f"ptxas said something else than expected: {said[-500:]}")
    stack, shared = (re.search(rf"(\d+) bytes {what}", used[0]) for what in ("cumulative stack", "smem"))
    own, stored, loaded = zip(*frames, strict=True)
    asked = json.loads(next(folder.glob("*.meta")).read_text(encoding="utf-8"))  # what Warp reads when it launches
    return Limits(
        int(used[1]),
        int(stack[1]) if stack else max(own),
        sum(stored + loaded),
        int(shared[1]) if shared else 0,
        next(value for name, value in asked.items() if name.endswith("forward_smem_bytes")),
    )


def blocks(limits: Limits, architecture: int) -> int:
    """Return the number of one-warp blocks that fit a multiprocessor's registers and shared memory."""
    by_registers = 4 * (REGISTERS // 4 // (-(-limits.registers // 8) * 8 * WARP))  # a quarter has its own
    return min(by_registers, SHARED[architecture] * 1024 // (limits.shared + RESERVED))
