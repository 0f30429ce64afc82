"""Refuses trainings and searches that do not fit into the memory that is free, before anything is made."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from warpvox.algos.needs import training_bytes
from warpvox.algos.settings import PpoConfig
from warpvox.cli.build import make_env, physics_of
from warpvox.devices.names import resolve_device
from warpvox.devices.out_of_memory import free_memory
from warpvox.envs.needs import PROBED, check_fits
from warpvox.envs.vec_env import make_vec
from warpvox.kernels.lanes import MAX_WIDTH
from warpvox.types import Cell

__all__ = ["check_screening", "check_search", "check_training"]

ROUGH = 16_000, 10_000, 20
"""Bytes of a cell and environment, of a transition, and of a unit of a hidden layer and a transition: more than any
simulation or training takes. What fits many times by these is not looked at more closely."""
SMALL = 0.25
"""Of the memory that is free, what is taken without a closer look."""


def check_training(config: Any, bodies: Sequence[Any]) -> None:
    """Raise MemoryLimitError, with the number of environments that fits, if a training does not.

    Args:
        config: resolved training configuration.
        bodies: its designs.
    """
    free = free_memory(config.device) if config.memory_check else None
    sizes = [_cells(body) for body in bodies]
    if free is None or _rough(config.num_envs, max(sizes), config.ppo) <= SMALL * free:
        return
    per_design = max(1, config.num_envs // len(bodies))
    largest = [bodies[number] for number in np.argsort(sizes)[::-1][:PROBED]]
    count = min(per_design, MAX_WIDTH) * len(largest)
    probe = make_env(config, count, auto_reset=True, designs=largest, memory_check=False)
    needed = training_bytes(probe, per_design, len(bodies), config.ppo)
    check_fits(needed, free, config.num_envs, len(bodies), config.device)


def check_screening(config: Any) -> None:
    """:func:`check_search` for one policy that learns on all designs of a generation.

    Args:
        config: resolved configuration of such a search.
    """
    how = config.screening
    training = dataclasses.replace(config.training, envs=how.envs, ppo=PpoConfig(**how.ppo), method="sequential")
    check_search(dataclasses.replace(config, training=training), config.search.population, "search.population")


def check_search(config: Any, together: int, key: str = "batch") -> None:
    """Raise MemoryLimitError if the designs that a search trains together do not fit; full bodies are assumed.

    Args:
        config: configuration of a search that is made in this process.
        together: designs that are trained at once.
        key: that says how many these are.
    """
    config.training.ppo.check(config.training.envs, "training.ppo")
    device = resolve_device(config.device, together * config.training.envs)
    free = free_memory(device) if config.memory_check else None
    training, body = config.training, np.full(config.shape, Cell.H_ACT, np.int8)
    if free is None or _rough(together * training.envs, body.size, training.ppo) <= SMALL * free:
        return
    probe = make_vec(
        config.task,
        [body],
        min(training.envs, MAX_WIDTH),
        device=device,
        rules=config.rules,
        dtype=config.dtype,
        physics=physics_of(config),
        threads=1,
        memory_check=False,
    )
    needed = training_bytes(probe, training.envs, together, training.ppo, together=training.method == "population")
    if together == 1:
        check_fits(needed, free, training.envs, 1, device, "training.envs")
    check_fits(needed, free, together, 1, device, key, f"designs of {training.envs:,} environments each")


def _rough(num_envs: int, cells: int, ppo: Any) -> int:
    of_cell, of_transition, of_unit = ROUGH
    return num_envs * (of_cell * cells + ppo.steps * (of_transition + of_unit * sum(ppo.hidden)))


def _cells(body: Any) -> int:
    """Cells of a design, of all its robots."""
    bodies = body.values() if isinstance(body, dict) else [body]
    return sum(int(np.count_nonzero(one)) for one in bodies)
