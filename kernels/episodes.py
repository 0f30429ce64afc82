"""Episodes: counting steps, adding up rewards, finding what ends. One thread an environment; the host never waits."""

from collections.abc import Mapping
from typing import Any

import warp as wp

from warpvox.kernels import device
from warpvox.kernels.device import kernel
from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.state import DIVERGED, STOPPED

MOST_DRAWS = 2**16
"""Random numbers that an episode may draw, and one."""
_STEP = wp.constant(wp.uint64(0x9E3779B97F4A7C15))  # of SplitMix64 (Steele, Lea and Flood 2014), as the factors
_FACTOR = wp.constant(wp.uint64(0xBF58476D1CE4E5B9))
_SECOND_FACTOR = wp.constant(wp.uint64(0x94D049BB133111EB))


@wp.struct
class EpisodeArrays:
    """The arrays of both kernels: of the simulation, of episodes, and what a step brings, all by environment.

    See :class:`warpvox.envs.episodes.Episodes` and :class:`warpvox.envs.outcomes.Outcomes`. ``terms`` and ``factors``
    begin with the rewards; then come the penalty of a stopped step and the terminations.
    """

    status: wp.array2d(dtype=int)
    frozen: wp.array2d(dtype=int)
    env_pack: wp.array(dtype=int)
    env_lane: wp.array(dtype=int)

    length: wp.array(dtype=wp.int64)
    limit: wp.array(dtype=wp.int64)
    returns: wp.array(dtype=wp.float64)
    was_terminated: wp.array(dtype=wp.bool)
    was_truncated: wp.array(dtype=wp.bool)

    is_counted: wp.array(dtype=wp.bool)
    nonfinite: wp.array(dtype=wp.bool)
    nonfinite_rewards: wp.array(dtype=wp.int64)
    factors: wp.array(dtype=wp.float64)
    hits: wp.array2d(dtype=wp.bool)
    terms: wp.array2d(dtype=wp.float64)
    unstable: wp.array(dtype=wp.bool)
    diverged: wp.array(dtype=wp.bool)
    terminated: wp.array(dtype=wp.bool)
    truncated: wp.array(dtype=wp.bool)
    done: wp.array(dtype=wp.bool)
    reward: wp.array(dtype=wp.float64)
    episode_return: wp.array(dtype=wp.float64)
    episode_length: wp.array(dtype=wp.float64)


@kernel
def count_step(arrays: EpisodeArrays):
    """Count the step of an episode that is running, and note whether the simulation stopped it."""
    env = wp.tid()
    active = not (arrays.was_terminated[env] or arrays.was_truncated[env])
    pack = arrays.env_pack[env]
    lane = arrays.env_lane[env]
    status = arrays.status[pack, lane]
    unstable = active and (status & STOPPED) != 0
    diverged = unstable and (status & DIVERGED) != 0
    if active:
        arrays.length[env] = arrays.length[env] + wp.int64(1)
    arrays.unstable[env] = unstable
    arrays.diverged[env] = diverged
    arrays.is_counted[env] = active and not diverged
    arrays.nonfinite[env] = False


@kernel
def score_step(arrays: EpisodeArrays, auto_reset: bool):
    """Add up the reward of a step, find out whether it ends the episode, and prepare the next step."""
    env = wp.tid()
    pack = arrays.env_pack[env]
    lane = arrays.env_lane[env]
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    rewards = arrays.nonfinite_rewards.shape[0]
    active = not (arrays.was_terminated[env] or arrays.was_truncated[env])

    # Rewards. An environment in which something is not finite is stopped as diverged. The state before the step may be
    # non-finite, too, so only the penalty remains of its reward.
    nonfinite = bool(arrays.nonfinite[env])
    for k in range(rewards):
        value = arrays.terms[k, env] * arrays.factors[k]
        arrays.terms[k, env] = value
        if arrays.is_counted[env] and not wp.isfinite(value):
            wp.atomic_add(arrays.nonfinite_rewards, k, wp.int64(1))
            nonfinite = True
    unstable = arrays.unstable[env] or nonfinite
    diverged = arrays.diverged[env] or nonfinite
    if diverged or not active:
        for k in range(rewards):
            arrays.terms[k, env] = zero
    arrays.terms[rewards, env] = wp.where(unstable, one, zero) * arrays.factors[rewards]

    # Terminations
    terminated = bool(unstable)
    for k in range(arrays.hits.shape[0]):
        hit = active and arrays.hits[k, env]
        place = rewards + 1 + k
        arrays.terms[place, env] = wp.where(hit, one, zero) * arrays.factors[place]
        terminated = terminated or hit
    truncated = active and arrays.length[env] >= arrays.limit[env]

    # Sums
    reward = wp.float64(0.0)
    for k in range(arrays.terms.shape[0]):
        reward = reward + arrays.terms[k, env]
    arrays.returns[env] = arrays.returns[env] + reward
    arrays.reward[env] = reward
    arrays.episode_return[env] = arrays.returns[env]
    arrays.episode_length[env] = wp.float64(arrays.length[env])
    arrays.nonfinite[env] = nonfinite
    arrays.unstable[env] = unstable
    arrays.diverged[env] = diverged
    arrays.done[env] = terminated or truncated

    # The next step: a new episode begins, or one that has ended waits for its reset.
    if auto_reset:
        if terminated or truncated:
            arrays.length[env] = wp.int64(0)
            arrays.returns[env] = zero
    else:
        terminated = terminated or arrays.was_terminated[env]
        truncated = truncated or arrays.was_truncated[env]
        arrays.was_terminated[env] = terminated
        arrays.was_truncated[env] = truncated
        arrays.frozen[pack, lane] = wp.where(terminated or truncated, 1, 0)
    arrays.terminated[env] = terminated
    arrays.truncated[env] = truncated


def record(state: Any, name: str, tensors: Mapping[str, Any], *inputs: Any) -> wp.Launch | device.Command:
    """Record the launch of ``count_step`` or ``score_step``; return the command.

    Args:
        tensors: of torch, the fields of :class:`EpisodeArrays` but for the simulation's.
        inputs: follow the arrays.
    """
    arrays = EpisodeArrays()
    for field in ("status", "frozen"):
        setattr(arrays, field, state.arrays[field])
    for field in ("env_pack", "env_lane"):
        setattr(arrays, field, getattr(state, field))
    for field, tensor in tensors.items():
        setattr(arrays, field, wp.from_torch(tensor))
    return device.record(KERNELS[name], state.num_envs, [arrays, *inputs], state.device)


@kernel
def draw(
    keys: wp.array(dtype=wp.int64),
    episode: wp.array(dtype=wp.int64),
    first: int,
    low: wp.int64,
    span: wp.uint64,
    out: wp.array2d(dtype=wp.int64),
):
    """Write random integers in [low, low + span): [environment, number]; ``first`` counts those of the episode."""
    env, n = wp.tid()
    place = wp.uint64(episode[env] * wp.int64(MOST_DRAWS) + wp.int64(first + n))
    word = wp.uint64(keys[env]) + place * _STEP
    word = (word ^ (word >> wp.uint64(30))) * _FACTOR
    word = (word ^ (word >> wp.uint64(27))) * _SECOND_FACTOR
    word = word ^ (word >> wp.uint64(31))
    out[env, n] = low + wp.int64((word >> wp.uint64(11)) % span)


def record_draw(keys: Any, episode: Any, first: int, low: int, high: int, out: Any) -> wp.Launch | device.Command:
    """Record the drawing of integers in [low, high) into ``out`` [environment, number]; all are tensors of torch."""
    arrays = [wp.from_torch(tensor) for tensor in (keys, episode)]
    inputs = [*arrays, first, low, high - low, wp.from_torch(out)]
    return device.record(draw, tuple(out.shape), inputs, str(out.device))


KERNELS = {k.func.__name__: k for k in (count_step, score_step, draw)}


@builder
def finite_kernel(kit: Kit) -> wp.Kernel:
    """Build the kernel over (environments, columns) that writes 0 in place of values that are not finite."""

    @kernel
    def replace_nonfinite(
        values: wp.array2d(dtype=kit.real),
        where: wp.array(dtype=wp.bool),
        row: wp.array(dtype=wp.int64),
        counts: wp.array2d(dtype=int),
        found: wp.array(dtype=wp.bool),
    ):
        """Replace one value; where ``where`` is True, add 1 to the ``row`` of ``counts`` and set ``found``."""
        env, column = wp.tid()
        if not wp.isfinite(values[env, column]):
            values[env, column] = kit.real(0.0)
            if where[env]:
                wp.atomic_add(counts, int(row[env]), column, 1)
                found[env] = True

    return replace_nonfinite


def replace_nonfinite(state: Any, values: Any, *tensors: Any) -> None:
    """Write 0 in place of what is not finite in ``values``; all are tensors of torch, in the order of the kernel's."""
    arrays = [wp.from_torch(tensor) for tensor in (values, *tensors)]
    device.launch(finite_kernel(state.precision), values.shape, arrays, state.device)
