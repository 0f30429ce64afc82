"""Every launch is on torch's current stream, and every kernel is compiled alike: shown with stand-ins for CUDA."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from warpvox.kernels import episodes, sensing
from warpvox.kernels.reset import follow_kernel, reset_kernel, save, settle, shift_kernel
from warpvox.kernels.step import STAGES, action_kernel, stage_kernel, step_kernel

ROOT = Path(__file__).resolve().parents[2]
HELPER = ROOT / "kernels" / "device.py"
CAPTURE = ROOT / "envs" / "graph.py"
FOLDERS = ("warpvox", "kernels", "envs", "algos", "configs")
OURS_ALONE = {"launch", "launch_tiled", "kernel", "Launch.launch", "zeros", "empty", "ones", "full", "copy", "clone"}
OURS_ALONE |= {"from_numpy", "ScopedStream", "set_stream", "stream_from_torch", "ScopedCapture", "capture_launch"}
"""What goes to Warp's own streams, or chooses a stream: only the helper may do so."""
CAPTURING = {"capture_begin", "capture_end"}
EVERY_KERNEL = {"control_step", "place_actions", "reset", "follow", "shift", "replace_nonfinite"}
EVERY_KERNEL |= {*sensing.KERNELS, *episodes.KERNELS}


def uses_of_warp(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and name of what is taken from Warp, and of what its arrays do on streams of Warp's."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("wp", "warp"):
            yield node.lineno, node.attr
        if isinstance(node, ast.ImportFrom) and node.module == "warp":
            yield from ((node.lineno, alias.name) for alias in node.names)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            called = node.func
            of_warp = isinstance(called.value, ast.Name) and called.value.id == "wp"
            if called.attr == "assign":
                yield node.lineno, "assign"
            if (
                of_warp
                and called.attr == "array"
                and (node.args or {"data", "device"} & {k.arg for k in node.keywords})
            ):
                yield node.lineno, "array of values"


def offences(path: Path, text: str) -> list[str]:
    barred = OURS_ALONE | {"capture_begin", "capture_end", "assign", "array of values"}
    allowed = barred if path == HELPER else CAPTURING if path == CAPTURE else set()
    return [f"{path.name}:{line} wp.{name}" for line, name in uses_of_warp(ast.parse(text)) if name in barred - allowed]


def test_nothing_is_launched_or_allocated_but_by_the_helper() -> None:
    paths = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    assert len(paths) > 150
    assert not [found for path in paths for found in offences(path, path.read_text(encoding="utf-8"))]


@pytest.mark.parametrize(("arithmetic", "precision"), [("fast", "float32"), ("fast", "float64"), ("exact", "float64")])
def test_every_kernel_is_compiled_without_fused_operations(arithmetic: str, precision: str) -> None:
    """One decorator makes them (the test above); what it makes of them is looked at here."""
    kernels = [step_kernel(arithmetic, precision, width) for width in (1, 8)]
    kernels += [stage_kernel(stage, precision, 1) for stage in (*STAGES[arithmetic], save, settle)]
    kernels += [
        build(precision) for build in (action_kernel, reset_kernel, follow_kernel, shift_kernel, episodes.finite_kernel)
    ]
    kernels += [*sensing.KERNELS.values(), *episodes.KERNELS.values()]
    assert EVERY_KERNEL <= {kernel.func.__name__ for kernel in kernels}
    assert not [kernel.func.__name__ for kernel in kernels if kernel.module.options["fuse_fp"]]
