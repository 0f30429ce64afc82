"""Estimates of the memory that training needs.

PPO keeps a storage of transitions and, while it learns, copies of a minibatch and the activations of both networks for
it. The factors were found by measuring processes; ``tests/algos/test_needs.py`` compares.
"""

from __future__ import annotations

from warpvox.algos.settings import PpoConfig
from warpvox.envs.needs import environment_bytes, simulation_bytes
from warpvox.envs.vec_env import VoxelVecEnv

__all__ = ["learning_bytes", "training_bytes"]

FLOAT = 4
"""Bytes of a number that networks work on."""
SCALARS = 6
"""Numbers of a transition besides observation, action, mean and deviation: reward, termination, value, ..."""
COPIES, COPIES_TOGETHER = 3.1, 2.2
"""Copies of a transition in storage and learning; for one policy and for a population."""
ACTIVATIONS, ACTIVATIONS_TOGETHER = 0.6, 2.4
"""Numbers that are kept for a unit of a network and a transition of a minibatch, gradients included; likewise."""
ACTING = 2
"""Numbers that are kept for a unit of a network and an environment when actions are chosen."""


def learning_bytes(
    num_envs: int, num_obs: int, num_actions: int, itemsize: int, ppo: PpoConfig, together: bool = False
) -> int:
    """Bytes that PPO takes at its peak, besides the environments.

    Args:
        num_obs, num_actions: of an environment; itemsize: bytes of a number of an observation.
        together: whether a population of policies learns side by side.
    """
    units = 2 * sum(ppo.hidden)
    transition = itemsize * num_obs + FLOAT * (3 * num_actions + SCALARS)
    copies, kept = (COPIES_TOGETHER, ACTIVATIONS_TOGETHER) if together else (COPIES, ACTIVATIONS)
    activations = kept * FLOAT * units / ppo.minibatches
    return round(num_envs * (ppo.steps * (copies * transition + activations) + ACTING * FLOAT * units))


def training_bytes(probe: VoxelVecEnv, per_design: int, designs: int, ppo: PpoConfig, together: bool = False) -> int:
    """Bytes of environments and learning together.

    Args:
        probe: a few environments of the largest designs.
        per_design, designs: environments of each design, and designs, that are asked for.
        together: whether the designs' policies learn side by side.
    """
    count, itemsize = per_design * designs, probe.dtype.itemsize
    sizes = (probe.num_obs, probe.num_actions, itemsize)
    return (
        simulation_bytes(probe.sim, designs, per_design)
        + environment_bytes(count, *sizes)
        + learning_bytes(count, *sizes, ppo, together=together)
    )
