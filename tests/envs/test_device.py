"""A control step on a GPU is that of the CPU, and the same in every run and batch.

On the CPU the same comparisons are made between lanes of a vector and a single lane; with ``-m gpu`` on CUDA.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
import torch
import warp as wp

from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.types import Physics

STEPS, ENVS = 30, 32
SHARE = 0.9
"""Share of the control steps of all environments that must keep to the tolerances: in a few of them rounding decides
otherwise about a contact, in some tasks in all environments at once."""
SENSED = 0.75
"""Share of the entries of a term of the observation: points of a body at rest lie above the very edges at which the
terrain's height jumps."""
TOLERANCES = {
    "float32": {"pos": 2e-8, "vel": 1e-5, "obs": 2e-3, "reward": 1e-6},
    "float64": {"pos": 1e-12, "vel": 1e-9, "obs": 1e-9, "reward": 1e-9},
}
"""Largest differences to the CPU after one control step from the same state, in simulator units: some times what
float32 differs from float64 by on the CPU (4e-9 and 6e-7 for positions and velocities). Observations show whether
sensing is right; an angle near 0 has half of the digits."""
MOST = 4096
"""Environments with different actions."""
ON_CPU = ("Walker-v0", "Carrier-v0", "Climber-v2", "Lifter-v0", "Thrower-v0")
"""Tasks that are compared on the CPU: in some of them contacts part the trajectories of float32 and float64."""
CASES = [("cpu", task) for task in ON_CPU]
CASES += [pytest.param("cuda", task, marks=pytest.mark.gpu) for task in task_ids()]
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]


def make(device: str, num_envs: int, task: str = "Walker-v0", **options: Any) -> VoxelVecEnv:
    options = {"lanes": 8 if device == "cpu" else None, "auto_reset": False, "threads": 1} | options
    return make_vec(task, num_envs=num_envs, device=device, **options)


def random_actions(env: VoxelVecEnv, steps: int = STEPS) -> Iterator[torch.Tensor]:
    """The same on every device and for the first environments of any number; exact in both precisions."""
    random = torch.Generator().manual_seed(0)
    rows = torch.arange(env.num_envs) % MOST
    for _ in range(steps):
        yield (torch.randint(615, 1639, (env.num_actions, MOST), generator=random).T / 1024)[rows]


def differences(exact: VoxelVecEnv, env: VoxelVecEnv) -> dict[str, float]:
    """Largest difference of all but a few control steps, each from the state of ``exact``, which goes on."""
    found: dict[str, list[torch.Tensor]] = {name: [] for name in TOLERANCES["float64"]}
    exact.reset(exact.seed)
    for actions in random_actions(exact):
        env.set_state(exact.state())
        results = []
        for one in (exact, env):
            obs, reward, *_ = one.step(actions.to(one.device, one.dtype))
            state = one.sim.state()
            results.append({"pos": state["pos"], "vel": state["vel"], "obs": obs, "reward": reward[:, None]})
        for name, values in found.items():
            mine, theirs = (result[name].double().cpu() for result in results)
            apart = (mine - theirs).abs().flatten(1)
            if name == "obs":
                values.append(torch.minimum(apart, (apart - 2 * math.pi).abs()))  # an angle just below 2 pi is near 0
            else:
                values.append(apart.amax(1))
    all_steps = {name: torch.stack(values) for name, values in found.items()}
    shares = {name: float(all_steps[name].quantile(SHARE)) for name in ("pos", "vel", "reward")}
    terms = [place for place in exact.obs_columns[0].values() if place.stop > place.start]
    shares["obs"] = max(float(all_steps["obs"][..., place].quantile(SENSED)) for place in terms)
    return shares


def beyond(found: dict[str, float], dtype: str) -> dict[str, float]:
    """The differences that are larger than they may be, or NaN."""
    return {name: value for name, value in found.items() if not value <= TOLERANCES[dtype][name]}


@pytest.mark.parametrize("dtype", TOLERANCES)
@pytest.mark.parametrize(("device", "task"), CASES)
def test_a_control_step_is_that_of_one_lane_on_the_cpu(device: str, task: str, dtype: str) -> None:
    exact = make("cpu", ENVS, task, dtype="float64", lanes=1)
    assert not beyond(differences(exact, make(device, ENVS, task, dtype=dtype)), dtype)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("wrong", [{"gravity": 110.1}, {"friction": 0.0}, {"drag": 0.11}])
def test_a_step_that_is_a_little_wrong_is_found(wrong: dict[str, float], device: str) -> None:
    exact = make("cpu", ENVS, dtype="float64", lanes=1)
    assert beyond(differences(exact, make(device, ENVS, physics=Physics.preset("evogym", **wrong))), "float32")


def outcomes(env: VoxelVecEnv) -> dict[str, torch.Tensor]:
    """Centres and rewards of every step, the last observations and the state, environments first."""
    centres, rewards = [], []
    env.reset(env.seed)
    for actions in random_actions(env):
        obs, reward, *_ = env.step(actions.to(env.device, env.dtype))
        centres.append(env.sim.com("robot").cpu())
        rewards.append(reward.cpu())
    state = {name: value.cpu() for name, value in env.sim.state().items()}
    return {"centre": torch.stack(centres, 1), "reward": torch.stack(rewards, 1), "obs": obs.cpu(), **state}


@pytest.mark.gpu
@pytest.mark.parametrize("dtype", TOLERANCES)
def test_many_environments_do_the_same_again_and_as_a_few(dtype: str) -> None:
    env = make("cuda", MOST, dtype=dtype)
    first, again = outcomes(env), outcomes(env)
    few = outcomes(make("cuda", 3, dtype=dtype))
    for name, value in first.items():
        assert torch.equal(value, again[name]), name
        assert torch.equal(value[:3], few[name]), name


@pytest.mark.gpu
def test_no_launch_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Warp asks after every launch whether it has failed."""
    monkeypatch.setattr(wp.config, "verify_cuda", True)
    env = make("cuda", 2 * ENVS)
    env.reset()
    for actions in random_actions(env, 3):
        obs, *_ = env.step(actions.to(env.device, env.dtype))
    assert obs.isfinite().all()
