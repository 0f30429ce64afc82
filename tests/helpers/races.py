"""Detection of data races in the group kernel, on the CPU by gcc and ``races.cpp``.

A race is that a thread reads or writes what another has written since the last barrier, or writes what another has
read since they last met. Votes are no barriers: CUDA promises nothing about memory there.
"""

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import warp as wp

from warpvox.kernels.device import record, zeros
from warpvox.kernels.group import WARP, choose, group_kernel
from warpvox.kernels.step import record_actions
from warpvox.simulation import Simulation
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["races"]

KINDS = "write, write", "write, read", "read, write", "threads at different barriers"
OPTIONS = "-std=c++17 -O1 -g -fPIC -shared -w -fpermissive -fno-strict-aliasing -fno-math-errno".split()
SHARED_ARRAYS = (
    "box hull pairs pair_bit folds pos vel true_vel goal status time drift pair_count near_count overflow".split()
)  # arrays of the Data that the kernel writes


def races(
    sim: Simulation, steps: int, folder: Path, parts: int | None = None, change: Callable[[str], str] = str
) -> tuple[list[str], int]:
    """Run control steps with random actions; return conflicts and the number of watched accesses.

    Args:
        sim: float32, in the group layout on the CPU, whole warps of it.
        folder: for what is compiled.
        parts: threads of a group; None: as on CUDA.
        change: of the source.
    """
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("needs g++, whose -fsanitize=thread tells what is read and written")
    state, substeps = sim.buffers, sim.physics.substeps
    group = choose(state.sizes, "float32", "cuda:0")
    if parts is not None:
        sizes = (-(-state.sizes[name] // WARP) * WARP for name in ("point", "mover", "spring", "rigid"))
        group = type(group)("float32", parts, *sizes, True)
    kernel = group_kernel(group, whole_warps=True)
    scratch = zeros((sim.num_envs, group.row), wp.float64, "cpu")
    actions = torch.zeros((sim.num_envs, sim.num_actions), dtype=sim.dtype)
    take = record_actions(state, wp.from_torch(actions), ACTION_LOW, ACTION_HIGH)
    inputs = [state.model, state.data, scratch, 0, sim.num_envs, 0, substeps, state.dt]
    command = record(kernel, (sim.num_envs, group.parts), inputs, "cpu", max(WARP, group.parts), together=True)
    text = change(_source(kernel, folder))
    path = str(_build(compiler, text, folder))
    library = ctypes.CDLL(path)
    library.watch.argtypes = [ctypes.c_size_t] * 4
    library.conflicts.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
    library.watch(scratch.ptr, scratch.capacity, scratch.strides[0], group.bytes)
    for array in (state.arrays[name] for name in SHARED_ARRAYS):
        library.watch(array.ptr, array.capacity, array.capacity, array.capacity)
    forward = library[f"{kernel.get_mangled_name()}_cpu_forward"]
    forward.argtypes, forward.restype = [ctypes.c_void_p] * 2, None
    command.hooks = SimpleNamespace(forward=forward)
    draw = torch.Generator().manual_seed(0)
    for step in range(steps):
        actions.uniform_(ACTION_LOW, ACTION_HIGH, generator=draw)
        take.launch()
        library.run_backwards(step % 2)
        command.launch()
    return list(_conflicts(library, path, text)), library.watched()


def _source(kernel: wp.Kernel, folder: Path) -> str:
    """Generate the kernel's C++ with distinguishable barriers and votes."""
    before, wp.config.enable_cpu_blocks = wp.config.enable_cpu_blocks, True
    try:
        wp.compile_aot_module(kernel.module, device="cpu", module_dir=str(folder))
    finally:
        wp.config.enable_cpu_blocks = before
    text = next(folder.glob("*.cpp")).read_text(encoding="utf-8")
    assert "{ WP_TILE_SYNC(); }" in text
    text = text.replace("{ WP_TILE_SYNC(); }", "{ meet(1); }")
    text = text.replace("(WHOLE_WARPS && PARTS <= 32) sync();", "(PARTS <= 32) meet(0);")
    before, rest = text.split("auto join =", 1)
    votes, after = rest.split("return joined;", 1)
    return f'extern "C" void meet(int);\n{before}auto join ={votes.replace("sync();", "meet(0);")}return joined;{after}'


def _build(compiler: str, text: str, folder: Path) -> Path:
    source, part, library = (folder / name for name in ("raced.cpp", "raced.o", "raced.so"))
    source.write_text(text, encoding="utf-8")
    headers = Path(wp.__file__).with_name("native")
    watcher = Path(__file__).with_suffix(".cpp")
    for arguments in (
        [*OPTIONS, "-fsanitize=thread", "-I", headers, "-c", source, "-o", part],
        [*OPTIONS, watcher, part, "-o", library, "-lm"],
    ):
        done = subprocess.run([compiler, *map(str, arguments)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:2000]
    return library


def _conflicts(library: ctypes.CDLL, path: str, text: str) -> Iterator[str]:
    """Describe each conflict with its source lines."""
    rows = np.zeros((1000, 4), np.uintp)
    found = rows[: library.conflicts(rows.ctypes.data, len(rows))].tolist()
    maps = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    base = next((int(line.split("-")[0], 16) for line in maps if path in line), 0)
    lines = ["", *text.splitlines()]

    def line(place: int) -> str:
        said = subprocess.run(
            ["addr2line", "-e", path, hex(place - base - 1)], capture_output=True, text=True, check=False
        )
        number = said.stdout.partition(":")[2].split()
        return lines[int(number[0])].strip() if number and number[0].isdigit() else "?"

    for kind, first, second, count in found:
        yield f"{KINDS[kind]} {count} times: {line(first)!r}, {line(second)!r}"
