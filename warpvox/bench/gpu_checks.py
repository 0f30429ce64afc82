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

STEPS, ENVS = 30, 32
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
        exact = _trace(_make(config, task, "float64", "cpu", lanes=1))
        found = _trace(_make(config, task, dtype, config.device, lanes=8 if config.device == "cpu" else None))
        apart = [float((mine - theirs).abs().max()) for mine, theirs in zip(found, exact, strict=True)]
        row = dict(zip(worst, apart, strict=True))
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


def _make(config: Any, task: str, dtype: str, device: str, lanes: int | None = None, envs: int = ENVS) -> VoxelVecEnv:
    options = dict(device=device, dtype=dtype, seed=config.seed, threads=config.threads, lanes=lanes)
    return make_vec(task, [one_body(config)], envs, auto_reset=False, **options)


def _actions(env: VoxelVecEnv, seed: int) -> list[torch.Tensor]:
    """The same on every device and for the first environments of any number: whole multiples of 1 / 1024."""
    random = torch.Generator().manual_seed(seed)
    shape = (env.num_actions, max(env.num_envs, ENVS))
    draws = [torch.randint(615, 1639, shape[::-1], generator=random) for _ in range(STEPS)]
    return [draw[: env.num_envs].to(env.device, env.dtype) / 1024 for draw in draws]


def _trace(env: VoxelVecEnv) -> tuple[torch.Tensor, torch.Tensor]:
    """On the CPU, float64: centres of mass ``[STEPS, envs, 2]`` and rewards ``[STEPS, envs]``."""
    env.reset()
    centres, rewards = [], []
    for action in _actions(env, 0):
        rewards.append(env.step(action)[1].double().cpu())
        centres.append(env.sim.com("robot").cpu())
    return torch.stack(centres), torch.stack(rewards)


def determinism(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """Two runs are equal bit for bit, state and observations.

    Raises:
        SimulationError: they are not.
    """
    env = _make(config, config.task, config.dtype, config.device, envs=envs)
    first, second = _final(env), _final(env)
    _compare(first, second, "Two runs of the same actions")
    report.note(f"Two runs of {envs:,} environments over {STEPS} control steps are equal bit for bit.")
    return {"num_envs": envs, "steps": STEPS}


def graph(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """Control steps launched as one graph are those launched one by one, bit for bit, past ends of episodes.

    Raises:
        SimulationError: they are not.
    """
    if config.device == "cpu":
        report.note("No graph was captured: that needs a GPU.")
        return {"captured": False}
    options = dict(
        device=config.device, dtype=config.dtype, arithmetic=config.arithmetic, seed=config.seed,
        max_episode_steps=STEPS // 2,
    )  # fmt: skip
    both = []
    for wanted in (False, True):
        env = make_vec(config.task, [one_body(config)], envs, cuda_graph=wanted, **options)
        env.reset()
        outcomes = [env.step(action) for action in _actions(env, 1)]
        rewards = torch.stack([reward for _, reward, *_ in outcomes])
        both.append({"rewards": rewards, "obs": outcomes[-1][0], **env.sim.state()})
    _compare(*both, "Steps with and without a graph")
    report.note(f"{envs:,} environments over {STEPS} control steps end alike with and without a graph, bit for bit.")
    return {"captured": True, "num_envs": envs}


def independence(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """The first environments of a large batch end as they do in a small one, bit for bit.

    Raises:
        SimulationError: they do not.
    """
    large = _make(config, config.task, config.dtype, config.device, envs=max(envs, ENVS), lanes=_lanes(config))
    small = _make(config, config.task, config.dtype, config.device, envs=3, lanes=_lanes(config))
    actions = [action.clone() for action in _actions(large, 1)]
    few = [action[:3].clone() for action in actions]
    found, expected = _final(large, actions), _final(small, few)
    _compare({name: value[:3] for name, value in found.items()}, expected, "Environments in batches of two sizes")
    report.note(f"Environments end alike in batches of 3 and of {large.num_envs:,}, bit for bit.")
    return {"num_envs": large.num_envs, "steps": STEPS}


def _lanes(config: Any) -> int | None:
    return 8 if config.device == "cpu" else None


def _final(env: VoxelVecEnv, actions: list[torch.Tensor] | None = None) -> dict[str, torch.Tensor]:
    env.reset()
    for action in actions if actions is not None else _actions(env, 1):
        obs = env.step(action)[0]
    return {"obs": obs, **env.sim.state()}


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
