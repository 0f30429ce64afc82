"""The checks of ``warpvox bench suite=gpu``: the device computes what the CPU computes, and always the same."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch

from warpvox.bench.case import one_body
from warpvox.bench.progress import Progress
from warpvox.bench.report import Report, number
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import SimulationError

__all__ = ["determinism", "graph", "independence", "recordings", "trajectories"]

STEPS, ENVS, FEW, MOST = 30, 32, 3, 4096
"""Control steps; environments of a comparison with the CPU, of a small batch; environments of different actions."""
POSITION = {"float64": 1e-9, "float32": 1e-5}
"""Largest difference of a centre of mass between device and CPU over STEPS control steps, in simulator units."""
REWARD = {"float64": 1e-8, "float32": 1e-4}
TEST_SECONDS = 240


def trajectories(config: Any, progress: Progress, part: str, tasks: list[str], dtype: str) -> None:
    """Tasks in one precision: device against scalar code on the CPU in float64.

    Raises:
        SimulationError: they are further apart than rounding explains.
    """
    wrong: list[str] = []
    worst = {"centre": 0.0, "reward": 0.0}
    for task in tasks:
        if not progress.time_for(f"{part}: {task}"):
            continue
        exact = _outcomes(_make(config, ENVS, task=task, dtype="float64", device="cpu", lanes=1))
        found = _outcomes(_make(config, ENVS, task=task, dtype=dtype))
        row = {key: float((found[key].double() - exact[key]).abs().max()) for key in worst}
        good = row["centre"] < POSITION[dtype] and row["reward"] < REWARD[dtype]  # NaN is not
        worst = {key: max(worst[key], row[key]) for key in worst}
        wrong += [] if good else [f"{task} by {row['centre']:.1e}"]
        text = f"{task}, {dtype}: centre within {number(row['centre'])}, reward within {number(row['reward'])}"
        progress.row(part, f"{text}{'' if good else ' WRONG'}", task=task, dtype=dtype, good=good, **row)
    if wrong:
        raise SimulationError(f"The device differs from the CPU in {', '.join(wrong[:6])}.")
    progress.report.note(
        f"{dtype}, {len(progress.figures.get(part, []))} tasks, {STEPS} control steps: within {number(worst['centre'])}"
        f" (centres of mass) and {number(worst['reward'])} (rewards) of the CPU in float64."
    )


def determinism(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """Two runs are equal bit for bit: centres, rewards, observations, state.

    Raises:
        SimulationError: they are not.
    """
    env = _make(config, envs)
    _compare(_outcomes(env), _outcomes(env), "Two runs of the same actions")
    report.note(f"Two runs of {envs:,} environments over {STEPS} control steps are equal bit for bit.")
    return {"num_envs": envs, "steps": STEPS}


def independence(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """The first environments of a large batch do what they do in a small one, bit for bit.

    Raises:
        SimulationError: they do not.
    """
    large = _outcomes(_make(config, max(envs, ENVS)))
    small = _outcomes(_make(config, FEW))
    first = {name: value[:FEW] for name, value in large.items()}
    _compare(first, small, "Environments in batches of two sizes")
    count = len(large["reward"])
    report.note(f"Environments do the same in batches of {FEW} and of {count:,}, bit for bit.")
    return {"num_envs": count, "steps": STEPS}


def graph(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """Control steps launched as one graph are those launched one by one, bit for bit, past ends of episodes.

    Raises:
        SimulationError: they are not.
    """
    if config.device == "cpu":
        report.note("No graph was captured: that needs a GPU.")
        return {"captured": False}
    options = dict(auto_reset=True, max_episode_steps=STEPS // 2)
    with_graph, without = (_outcomes(_make(config, envs, cuda_graph=wanted, **options)) for wanted in (True, False))
    _compare(with_graph, without, "Steps with and without a graph")
    report.note(f"{envs:,} environments over {STEPS} control steps are equal with and without a graph, bit for bit.")
    return {"captured": True, "num_envs": envs}


def _make(config: Any, envs: int, task: str | None = None, **options: Any) -> VoxelVecEnv:
    common = dict(device=config.device, dtype=config.dtype, seed=config.seed, threads=config.threads, auto_reset=False)
    common["lanes"] = 8 if config.device == "cpu" else None
    return make_vec(task or config.task, [one_body(config)], envs, **(common | options))


def _outcomes(env: VoxelVecEnv) -> dict[str, torch.Tensor]:
    """On the CPU, of STEPS control steps from a reset on, environments first.

    Centres of mass and rewards of every step, the last observations and the state. Actions are the same on every device
    and for the first environments of any number: whole multiples of 1 / 1024, exact in both precisions.
    """
    random = torch.Generator().manual_seed(0)
    centres, rewards = [], []
    env.reset(env.seed)
    for _ in range(STEPS):
        draws = torch.randint(615, 1639, (env.num_actions, MOST), generator=random).T / 1024
        rows = torch.arange(env.num_envs) % MOST
        obs, reward, *_ = env.step(draws[rows].to(env.device, env.dtype))
        rewards.append(reward.cpu())
        centres.append(env.sim.com("robot").cpu())
    state = {name: value.cpu() for name, value in env.sim.state().items()}
    return {"centre": torch.stack(centres, 1), "reward": torch.stack(rewards, 1), "obs": obs.cpu(), **state}


def _compare(found: dict[str, torch.Tensor], expected: dict[str, torch.Tensor], what: str) -> None:
    wrong = [name for name, value in expected.items() if not torch.equal(found[name], value)]
    if wrong:
        raise SimulationError(f"{what} differ in {', '.join(wrong)}.")


def recordings(config: Any, report: Report, seconds: float) -> dict[str, Any]:
    """The tests marked ``gpu``, recordings of the reference among them, where this is a checkout with pytest.

    Raises:
        SimulationError: a test has failed.
    """
    tests = Path(__file__).resolve().parents[2] / "tests"
    if config.device == "cpu" or not (tests / "parity").is_dir() or find_spec("pytest") is None:
        reason = "tests of the GPU need one" if config.device == "cpu" else "this is no checkout with pytest"
        report.note(f"Recordings of the reference were not replayed: {reason}.")
        return {"replayed": False, "reason": reason}
    words = [sys.executable, "-m", "pytest", "-q", "-m", "gpu", "-p", "no:cacheprovider", str(tests)]
    limit = max(1.0, min(TEST_SECONDS, seconds))
    try:
        done = subprocess.run(words, cwd=tests.parent, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        report.note(f"Tests of the GPU were stopped after {limit:.0f} s.")
        return {"replayed": False, "reason": f"stopped after {limit:.0f} s"}
    last = (done.stdout.strip().splitlines() or [""])[-1]
    report.note(f"Tests of the GPU: {last}")
    if done.returncode:
        raise SimulationError(f"Tests of the GPU failed: {last}\n{done.stdout[-6000:]}")
    return {"replayed": True, "result": last}
