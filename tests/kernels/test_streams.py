"""Every launch is on torch's current stream, and every kernel is compiled alike: shown with stand-ins for CUDA."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import warp as wp

from warpvox.design import example_design
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.kernels import device, sensing
from warpvox.kernels.launch import stage_kernel
from warpvox.kernels.reset import follow_kernel, reset_kernel, save, settle
from warpvox.kernels.step import STAGES, action_kernel, step_kernel
from warpvox.view.rollout import record

ROOT = Path(__file__).resolve().parents[2]
HELPER = ROOT / "kernels" / "device.py"
CAPTURE = ROOT / "envs" / "graph.py"
FOLDERS = ("warpvox", "kernels", "envs", "algos", "configs")
OURS_ALONE = {"launch", "launch_tiled", "kernel", "Launch.launch", "zeros", "empty", "ones", "full", "copy", "clone"}
OURS_ALONE |= {"from_numpy", "ScopedStream", "set_stream", "stream_from_torch", "ScopedCapture", "capture_launch"}
"""What goes to Warp's own streams, or chooses a stream: only the helper may do so."""
CAPTURING = {"capture_begin", "capture_end"}
EVERY_KERNEL = {"control_step", "place_actions", "reset", "follow", *sensing.KERNELS}


# ----------------------------------------------------------------------------------------------- the source


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


@pytest.mark.parametrize(
    "line",
    [
        "wp.launch(k, 1, [])",
        "from warp import launch",
        "wp.zeros(3, dtype=int)",
        "wp.array([1, 2], dtype=int)",
        "array.assign(values)",
        "with wp.ScopedStream(s): pass",
        "k = wp.kernel(f)",
    ],
)
def test_another_way_would_be_found(line: str) -> None:
    assert offences(ROOT / "warpvox" / "sim.py", line)
    assert not offences(HELPER, line)


@pytest.mark.parametrize(("arithmetic", "precision"), [("fast", "float32"), ("fast", "float64"), ("exact", "float64")])
def test_every_kernel_is_compiled_without_fused_operations(arithmetic: str, precision: str) -> None:
    """One decorator makes them (the test above); what it makes of them is looked at here."""
    kernels = [step_kernel(arithmetic, precision, width) for width in (1, 8)]
    kernels += [stage_kernel(stage, precision, 1) for stage in (*STAGES[arithmetic], save, settle)]
    kernels += [build(precision) for build in (action_kernel, reset_kernel, follow_kernel)]
    kernels += sensing.KERNELS.values()
    assert EVERY_KERNEL <= {kernel.func.__name__ for kernel in kernels}
    assert not [kernel.func.__name__ for kernel in kernels if kernel.module.options["fuse_fp"]]


# ------------------------------------------------------------------------------------------ a life on streams


class Stream:
    """Stands in for a stream of torch."""

    def __init__(self, number: int) -> None:
        self.cuda_stream = number


class Recorded:
    """Stands in for a recorded launch on CUDA."""

    def __init__(self, streams: Streams, name: str, command: wp.Launch) -> None:
        self._streams, self._name, self._command = streams, name, command

    def launch(self, stream: Any = None) -> None:
        self._streams.seen.append((self._name, stream, self._streams.current.cuda_stream))
        self._command.launch()


class Streams:
    """Torch's current stream, and what was launched: kernel, its stream, torch's current one at this moment."""

    def __init__(self) -> None:
        self.current = Stream(0)
        self.seen: list[tuple[str, Any, int]] = []
        self.converted: list[int] = []
        self._launch = wp.launch

    def of_torch(self, device: Any = None) -> Stream:
        return self.current

    def of_warp(self, stream: Stream) -> tuple[str, int]:
        self.converted.append(stream.cuda_stream)
        return "warp", stream.cuda_stream

    def launch(self, kernel: wp.Kernel, dim: Any, inputs: Any, record_cmd: bool = False, **options: Any) -> Any:
        stream, block = options.pop("stream", None), options.pop("block_dim", None)
        assert block == device.BLOCK <= 64
        made = self._launch(kernel, dim, inputs, record_cmd=record_cmd, **options)
        if record_cmd:
            return Recorded(self, kernel.func.__name__, made)
        self.seen.append((kernel.func.__name__, stream, self.current.cuda_stream))
        return None


@pytest.fixture
def streams(monkeypatch: pytest.MonkeyPatch) -> Streams:
    found = Streams()
    monkeypatch.setattr(device, "on_cuda", lambda name: True)
    monkeypatch.setattr(device, "_streams", {})
    monkeypatch.setattr(torch.cuda, "current_stream", found.of_torch)
    monkeypatch.setattr(wp, "stream_from_torch", found.of_warp)
    monkeypatch.setattr(wp, "launch", found.launch)
    return found


def life(task: str, streams: Streams | None = None) -> list[torch.Tensor]:
    """All that environments do, on another stream each time; what they gave."""
    given: list[torch.Tensor] = []

    def on_a_stream() -> None:
        if streams is not None:
            streams.current = Stream(streams.current.cuda_stream + 1)

    def act(env: VoxelVecEnv) -> torch.Tensor:
        return torch.linspace(0.6, 1.6, 2 * env.num_actions).view(2, -1)

    on_a_stream()
    options = dict(device="cpu", lanes=1, threads=1, max_episode_steps=3, seed=3)
    env = make_vec(task, [example_design("walker")], 2, grid=(5, 5), **options)
    on_a_stream()
    given.append(env.reset()[0])
    for _ in range(4):  # an end and a reset among them
        on_a_stream()
        given.append(env.step(act(env))[0])
    for sense in (env.sim.com, env.sim.velocity, env.sim.orientation, env.sim.extent, env.sim.hull_area):
        on_a_stream()
        given.append(sense("robot"))
    on_a_stream()
    env.set_state(env.state())
    on_a_stream()
    body = example_design("walker").copy()
    body[0, 0] = 0 if body[0, 0] else 3
    given.append(env.set_designs([body], torch.tensor([False, True])))
    on_a_stream()
    given.append(torch.from_numpy(record(env, "zero", 4).positions))
    given.append(env.step(act(env))[1])
    return given


@pytest.mark.parametrize("task", ["Walker-v0", "UpStepper-v0", "Catcher-v0"])
def test_a_whole_life_is_on_torchs_current_stream(task: str, streams: Streams) -> None:
    life(task, streams)
    assert len(streams.seen) > 50
    assert not [launch for launch in streams.seen if launch[1] != ("warp", launch[2])]
    assert len(set(launch[2] for launch in streams.seen)) > 10
    assert sorted(streams.converted) == sorted(set(streams.converted)), "a stream is converted once"
    missing = EVERY_KERNEL - {launch[0] for launch in streams.seen}
    assert missing <= (set() if task == "UpStepper-v0" else {"scans"})


def test_arrays_of_torch_change_no_bit(streams: Streams, monkeypatch: pytest.MonkeyPatch) -> None:
    found = life("Catcher-v0", streams)
    monkeypatch.undo()
    assert all(torch.equal(mine, plain) for mine, plain in zip(found, life("Catcher-v0"), strict=True))


def test_arrays_are_of_torch_where_there_are_streams(streams: Streams, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wp, "zeros", None)
    for dtype, inner in (
        (wp.float64, ()),
        (int, ()),
        (wp.int64, ()),
        (wp.vec2i, (2,)),
        (wp.vec4i, (4,)),
        (wp.vec3d, (3,)),
    ):
        array = device.zeros((2, 3), dtype, "cpu")
        view = wp.to_torch(array)
        assert array.shape == (2, 3)
        assert tuple(view.shape) == (2, 3, *inner)
        assert not view.any()
        assert array.capacity == view.numel() * view.element_size()
    values = torch.arange(6.0).view(1, 3, 2).double()
    assert torch.equal(wp.to_torch(device.from_numpy(values.numpy(), wp.vec2d, "cpu")), values)
