"""The machine that figures belong to, and the memory that an environment takes."""

import platform
from typing import Any

import torch
import warp as wp

from warpvox import __version__
from warpvox.kernels.state import DATA
from warpvox.system import processor_name, usable_cores

GROUPS = {
    "state": ("pos", "vel", "true_vel", "frozen", "status", "time"),
    "state at the start of the control step": ("saved_pos", "saved_vel", "saved_true_vel"),
    "springs": ("goal", "spring"),
    "boxes": ("box", "near_box"),
    "broad phase": ("pairs", "pair_count", "near", "near_count", "pair_bit", "grid_head", "grid_next", "grid_voxel"),
}
"""Arrays by what they are for; those not named are the integrator's."""
REST = "integrator"


def machine(device: str) -> dict[str, Any]:
    """Processor with the widest vectors that torch finds in it, device and versions."""
    facts: dict[str, Any] = {
        "cpu": f"{processor_name()} ({torch.backends.cpu.get_cpu_capability()})",
        "cores": usable_cores(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "warp": wp.__version__,
        "warpvox": __version__,
    }
    if device != "cpu":
        properties = torch.cuda.get_device_properties(device)
        facts |= {"gpu": properties.name, "gpu_gib": round(properties.total_memory / 2**30, 1)}
    return facts


def machine_line(facts: dict[str, Any]) -> str:
    """The same as a sentence."""
    gpu = f"{facts['gpu']}, " if "gpu" in facts else ""
    versions = ", ".join(f"{name} {facts[name.lower()]}" for name in ("Python", "torch", "warp", "warpvox"))
    return f"{gpu}{facts['cores']} usable cores of {facts['cpu']}; {versions}"


def memory(env: Any) -> dict[str, float]:
    """Bytes an environment of the simulator's arrays, by what they are for, and of the torch tensors kept."""
    named = {name: group for group, names in GROUPS.items() for name in names}
    sizes: dict[str, float] = dict.fromkeys((*GROUPS, REST), 0.0)
    for name in DATA:
        sizes[named.get(name, REST)] += env.sim.buffers.arrays[name].capacity / env.num_envs
    tensors = [*env.sim.sensing_buffers, *env.episodes.memory.values(), *env.episodes.before.values()]
    tensors += [value for owner in (env, env.sim, env.episodes) for value in vars(owner).values()]
    kept = [t for t in tensors if isinstance(t, torch.Tensor) and t.ndim and len(t) == env.num_envs]
    return sizes | {"tensors of the task": sum(t.element_size() * t.nelement() for t in kept) / env.num_envs}


def per_environment(env: Any) -> float:
    """Bytes an environment in all."""
    return sum(memory(env).values())
