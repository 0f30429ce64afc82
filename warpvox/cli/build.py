"""From a checked configuration to environments."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from warpvox.algos.policies.registry import MLP, check_policy, layout_for, make_network
from warpvox.batch.options import SimOptions, lanes_for
from warpvox.design import load_design
from warpvox.devices.names import resolve_device
from warpvox.devices.startup import LOGGER, start_warp
from warpvox.envs.registry import get_task
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ConfigError, DesignError
from warpvox.types import Physics

__all__ = ["load_bodies", "make_env", "physics_of", "prepare", "resolve", "sim_of", "training_lanes", "voxels_of"]

OBS_OF_VOXELS = {"task": "voxel", "timed": "timed_voxel"}
"""What a policy for voxels observes in place of what ``obs`` says."""


class _Console(logging.Handler):
    """Messages of the library go to the output, like those of the commands."""

    def emit(self, record: logging.LogRecord) -> None:
        print(record.getMessage(), flush=True)


def prepare(torch_threads: int, seed: int) -> None:
    """Settings of the process: threads, random numbers, and no chatter from Warp."""
    if not LOGGER.handlers:
        LOGGER.addHandler(_Console())
    start_warp()
    torch.set_num_threads(torch_threads)
    torch.manual_seed(seed)


def load_bodies(spec: Any, seed: int) -> list[np.ndarray | dict[str, np.ndarray]]:
    """The bodies that the key ``design`` names: one, or one an entry for a list of names, files or bodies.

    A mapping ``{robot name: body}`` is a design for a task with several robots.

    Raises:
        DesignError: not valid or not readable.
    """
    if isinstance(spec, Mapping):
        return [{name: load_design(body, seed=seed + number) for number, (name, body) in enumerate(spec.items())}]
    if isinstance(spec, str):
        return [load_design(spec, seed=seed)]
    if isinstance(spec, list) and spec and all(isinstance(item, Mapping) for item in spec):
        return [body for number, item in enumerate(spec) for body in load_bodies(item, seed + number)]
    if not isinstance(spec, list) or not spec:
        raise DesignError(f"design must be a name, a file or rows of cells such as [[3,3],[4,4]]; got {spec!r}.")
    several = all(isinstance(item, str) or _is_body(item) for item in spec)
    if not several:
        return [load_design(spec, seed=seed)]
    return [load_design(item, seed=seed + number) for number, item in enumerate(spec)]


def _cells(design: np.ndarray | dict[str, np.ndarray]) -> Any:
    """A design as lists."""
    return {name: _cells(body) for name, body in design.items()} if isinstance(design, dict) else design.tolist()


def _is_body(item: Any) -> bool:
    return isinstance(item, list) and bool(item) and all(isinstance(row, list) for row in item)


def physics_of(config: Any) -> Physics:
    """The constants that ``physics`` and ``rules`` name together.

    Raises:
        ConfigError: a constant out of range.
    """
    values = dict(config.physics if isinstance(config.physics, Mapping) else dataclasses.asdict(config.physics))
    preset = values.pop("preset")
    changes = {name: value for name, value in values.items() if value is not None}
    return Physics.preset(config.rules if preset == "auto" else preset, **changes)


def sim_of(config: Any) -> SimOptions:
    """How a configuration has environments computed."""
    return SimOptions(
        config.device,
        config.dtype,
        config.arithmetic,
        physics_of(config),
        getattr(config, "lanes", None),
        config.threads,
        memory_check=config.memory_check,
    )


def resolve(config: Any) -> Any:
    """A copy of a training configuration with what its names stand for: bodies, constants, device.

    Raises:
        TaskError, DesignError, DeviceError, ConfigError: what does not exist or is not valid.
    """
    from warpvox.cli.designs import resolved

    get_task(config.task)
    check_policy(config.policy)
    designs = getattr(config, "designs", None)
    changes = {}
    if designs is not None:
        kept = {"bodies": config.seed, "held_out": config.seed}
        kept = {name: resolved(getattr(designs, name), seed, f"designs.{name}") for name, seed in kept.items()}
        changes["designs"] = dataclasses.replace(designs, **kept)
    bodies = [_cells(body) for body in load_bodies(config.design, config.seed)]
    constants = dataclasses.asdict(physics_of(config))
    preset = constants.pop("name")
    return dataclasses.replace(
        config,
        design=bodies[0] if len(bodies) == 1 else bodies,
        obs=config.obs if config.policy == MLP else OBS_OF_VOXELS.get(config.obs, config.obs),
        physics=type(config.physics)(preset=preset, **constants),
        device=resolve_device(config.device, config.num_envs),
        **changes,
    )


def voxels_of(config: Any, env: VoxelVecEnv) -> dict[str, Any] | None:
    """``network``, ``settings`` and ``layout`` of the policy that a resolved training configuration names; None: mlp.

    Raises:
        ConfigError: settings that it does not have, or environments that it is not for.
    """
    if config.policy == MLP:
        if config.network is not None:
            raise ConfigError("network has the settings of the other policies; those of policy=mlp are ppo.hidden.")
        return None
    if config.network is not None and not isinstance(config.network, Mapping):
        raise ConfigError(f"network must be settings by name, such as {{width:32}}; got {config.network!r:.80}.")
    layout = layout_for(config.policy, env)
    settings = dict(config.network or {})
    make_network(config.policy, layout, False, settings)
    return {"network": config.policy, "settings": settings, "layout": layout.dict()}


def make_env(config: Any, num_envs: int, *, auto_reset: bool, **changes: Any) -> VoxelVecEnv:
    """Environments of a resolved training configuration; ``changes`` are other arguments of ``make_vec``."""
    options = {"rules": config.rules, "seed": config.seed, "obs": config.obs, "sim": sim_of(config)}
    options["designs"] = load_bodies(config.design, config.seed)
    return make_vec(config.task, num_envs=num_envs, auto_reset=auto_reset, **(options | changes))


def training_lanes(config: Any, device: str) -> int | None:
    """The lanes that training with ``config`` uses: evaluations with as many need no kernels of their own."""
    if config.lanes is not None or device != "cpu":
        return config.lanes if device == "cpu" else None
    return lanes_for(config.num_envs // len(load_bodies(config.design, config.seed)))
