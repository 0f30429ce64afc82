"""Memory of an environment, from the sizes of the arrays."""

from __future__ import annotations

from typing import Any

import torch

from warpvox.kernels.state import DATA

__all__ = ["groups", "per_environment"]

GROUPS = {
    "state": ("pos", "vel", "true_vel", "frozen", "status", "time"),
    "state at the start of the control step": ("saved_pos", "saved_vel", "saved_true_vel"),
    "springs": ("goal", "spring"),
    "boxes": ("box", "near_box"),
    "broad phase": ("pairs", "pair_count", "near", "near_count", "pair_bit", "grid_head", "grid_next", "grid_voxel"),
}
"""Arrays by what they are for; those not named are the integrator's."""
REST = "integrator"


def groups(env: Any) -> dict[str, float]:
    """Bytes an environment of the simulator's arrays, by what they are for, and of the torch tensors kept."""
    arrays = env.sim.buffers.arrays
    named = {name: group for group, names in GROUPS.items() for name in names}
    sizes: dict[str, float] = dict.fromkeys((*GROUPS, REST), 0.0)
    for name in DATA:
        sizes[named.get(name, REST)] += arrays[name].capacity / env.num_envs
    sizes["tensors of the task"] = sum(t.element_size() * t.nelement() for t in _tensors(env)) / env.num_envs
    return sizes


def per_environment(env: Any) -> float:
    """Bytes an environment in all."""
    return sum(groups(env).values())


def _tensors(env: Any) -> list[torch.Tensor]:
    """Tensors with a row for every environment that the simulator and the environment hold."""
    found = [*env.sim.sensing_buffers, *env.episodes.memory.values(), *env.episodes.before.values()]
    for owner in (env, env.sim, env.episodes):
        found += [value for value in vars(owner).values() if isinstance(value, torch.Tensor)]
    return [tensor for tensor in found if tensor.ndim and len(tensor) == env.num_envs]
