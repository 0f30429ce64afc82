"""Results are checked before a time is printed: with the reference, and with our own scalar code in float64."""

from typing import Any

import numpy as np
import torch

from warpvox.bench.cases import make
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import SimulationError

STEPS = 60
TOLERANCE = 1e-6
"""Largest difference of the centre of mass over STEPS in float64, in simulator units: over so many
steps the two differ by round-off only, which contacts have not yet amplified beyond this."""
SHORT = 10
ROUNDING = {"float32": 1e-5, "float64": 1e-9}
"""Largest difference of the centre of mass over SHORT steps, in simulator units (0.1 a voxel)."""


def against_reference(config: Any, task: str, body: np.ndarray, reference: Any, steps: int = STEPS) -> float:
    """The largest difference of the centre of mass to the reference, which has started the task then."""
    env = make(config, [body], 1, task, dtype="float64", arithmetic=None, auto_reset=False, threads=1)
    env.reset()
    actions = _waves(steps, env.num_actions, config.seed)
    ours = []
    for action in actions:
        env.step(action[None])
        ours.append(env.sim.com("robot")[0].tolist())
    reference.start(task, body)
    error = float(np.abs(np.array(ours) - np.array(reference.centres(actions))).max())
    return _allowed(error, TOLERANCE, f"{task}: the centre of mass differs from the reference", steps)


def against_scalar(env: VoxelVecEnv, seed: int) -> float:
    """The largest difference of the centre of mass between the first and last environment of a batch and each alone.

    Those alone are computed on the CPU in float64, one lane wide: by the code that the recordings of the reference
    are replayed with. The batch is left at the start of an episode.
    """
    alone = make_vec(
        env.spec, [env.designs[0], env.designs[-1]], 2, device="cpu", rules=env.rules, dtype="float64",
        physics=env.sim.physics, seed=env.seed, auto_reset=False, threads=1, lanes=1,
    )  # fmt: skip
    env.reset(seed=env.seed)
    drawn = {name: env.memory[name][[0, -1]][..., : own.shape[-1]].cpu() for name, own in alone.memory.items()}
    alone.reset(memory=drawn or None)
    actions = np.rint(_waves(SHORT, env.num_actions, seed) * 1024) / 1024  # exact in every precision
    error = 0.0
    for step, action in enumerate(actions):
        batch = torch.as_tensor(np.roll(action, step)).repeat(env.num_envs, 1)
        batch[0] = batch[-1] = torch.as_tensor(action)
        env.step(batch.to(env.device))
        alone.step(np.tile(action[: alone.num_actions], (2, 1)))
        apart = env.sim.com("robot")[[0, -1]].cpu() - alone.sim.com("robot")
        error = max(error, float(apart.abs().max()))
    env.reset(seed=env.seed)
    allowed = ROUNDING[env.sim.options.dtype]
    return _allowed(error, allowed, f"{env.spec.id}: an environment of the batch differs from one alone", SHORT)


def _waves(steps: int, actuators: int, seed: int) -> np.ndarray:
    """float64 ``[steps, actuators]``: sine waves of a period of 25 steps with random phases."""
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, actuators)
    return 1.1 + 0.45 * np.sin(2 * np.pi * np.arange(steps)[:, None] / 25 + phase)


def _allowed(error: float, allowed: float, what: str, steps: int) -> float:
    if error < allowed:
        return error
    raise SimulationError(
        f"{what} by {error:.1e} within {steps} steps (allowed: {allowed:.0e}): no speed is worth printing."
    )
