"""Trained policies together with environments, for playing and evaluation."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from rsl_rl.modules import GaussianDistribution

from warpvox.algos.checkpoints.files import actions_of, load_checkpoint
from warpvox.algos.checkpoints.policy import Policy, policy_of
from warpvox.algos.disturbance import Disturbed
from warpvox.algos.policies.network import VoxelGaussian
from warpvox.algos.protocols import NOMINAL, parts_of
from warpvox.algos.settings import sim_of
from warpvox.algos.training.bodies import load_bodies, read_bodies, training_bodies
from warpvox.algos.training.settings import Training
from warpvox.code import is_code, passed_code
from warpvox.devices.names import resolve_device
from warpvox.envs.registry import get_task
from warpvox.envs.spec import TaskSpec
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ConfigError
from warpvox.runs import CONFIG, Run

SHOWN = 4
"""Default number of episodes shown of a random task."""


@dataclasses.dataclass(frozen=True)
class Playing:
    """Settings for playing a run's policy; None: as in training.

    Attributes:
        task, policy: code of the user's own that the run names, see :func:`warpvox.code.passed_code`.
        stochastic: sample actions as in training, instead of taking their mean.
        protocol: the disturbances of the episodes, see :mod:`warpvox.algos.disturbance`.
        num_envs: environments for each disturbance, in consecutive blocks. None: one for each design, or :data:`SHOWN`
            if something is random or the policy is for many bodies.
    """

    num_envs: int | None = 1
    checkpoint: str = "best"
    stochastic: bool = False
    seed: int | None = None
    device: str = "cpu"
    dtype: str | None = None
    arithmetic: str | None = None
    threads: int | None = None
    memory_check: bool = True
    task: Any = None
    policy: str | None = None
    protocol: str = NOMINAL


def own_code(settings: Any) -> dict[str, Any]:
    """Return the user's own task and policy code in ``settings``, as arguments for :class:`Playing`."""
    policy = getattr(settings, "policy", None)
    task = settings.task if is_code(settings.task) or isinstance(settings.task, TaskSpec) else None
    return {"task": task, "policy": policy if is_code(policy) else None}


class SampledPolicy:
    """Policy that samples actions from its Gaussian distribution instead of taking the mean.

    Args:
        policy: gives the mean action.
        actor: the checkpoint's actor, which holds the standard deviations.
        seed: of the random actions.
    """

    def __init__(self, policy: Policy, actor: Mapping[str, torch.Tensor], seed: int = 0) -> None:
        if "distribution.log_std_param" not in actor:
            raise ConfigError("stochastic=true goes with a trained policy; this one is an open-loop gait.")
        self.policy = policy
        self.reset = policy.reset
        log_std = actor["distribution.log_std_param"]
        self._std = log_std.clamp(*GaussianDistribution(1).log_std_range).exp()
        self._generator = torch.Generator(log_std.device).manual_seed(seed)

    @torch.no_grad()
    def __call__(self, obs: torch.Tensor) -> torch.Tensor:
        """Sample actions ``[n, num_actions]`` in [0.6, 1.6] for the observations ``[n, num_obs]``."""
        mean = self.policy.network(obs).float()
        noise = torch.randn(mean.shape, generator=self._generator, device=mean.device)
        deviation = self._std
        distribution = getattr(self.policy.actor, "distribution", None)
        if isinstance(distribution, VoxelGaussian):  # of the types of actuators
            deviation = distribution.by_kind(deviation).to(deviation.dtype)
        return actions_of(mean + deviation * noise, self.policy.spec.action_scale)


def load_trained(run: Run, config: Any, designs: Any = None, every: bool = False) -> tuple[VoxelVecEnv, Any]:
    """Load environments and policy of a training run (not of a stored robot).

    Args:
        config: :class:`Playing`, or the keys of a command that has the same.
        designs: bodies to run a policy for many bodies on; None: those held out. There are no more bodies than
            environments.
        every: run such a policy on all bodies, with the same number of environments for each.
    """
    device = resolve_device(config.device, config.num_envs or SHOWN)
    path = run.find_checkpoint(config.checkpoint)
    own = config.task if isinstance(config.task, TaskSpec) else None
    stored = run.config if own is None else run.config | {"task": own.id}
    trained = Training.of(stored, run.folder / CONFIG)
    trained = dataclasses.replace(
        trained,
        task=own or passed_code("task", trained.task, config.task, run.folder),
        policy=passed_code("policy", trained.policy, config.policy, run.folder),
    )
    named = {name: value for name in ("dtype", "arithmetic", "seed") if (value := getattr(config, name)) is not None}
    if "dtype" in named:
        named = {"arithmetic": None} | named
    trained = dataclasses.replace(trained, threads=config.threads, memory_check=config.memory_check, **named)
    bodies = training_bodies(trained)
    content = load_checkpoint(path, device)
    policy = policy_of(content, path, trained.policy).double()
    parts = parts_of(getattr(config, "protocol", NOMINAL), feedback=policy.spec.has_feedback)
    judged = bodies.judged
    drawn = config.stochastic or parts != (NOMINAL,) or get_task(trained.task).is_random
    if trained.is_many:
        judged = judged if designs is None else read_bodies(designs, trained.seed, "designs", bodies.trained)
        count = config.num_envs or min(SHOWN, len(judged))
        if every:
            count = len(judged) * max(1, count // len(judged))
        judged = judged[:count]
    elif designs is not None:
        raise ConfigError("Other bodies go with a run over many of them (designs=...); this one has its own.")
    else:
        count = config.num_envs or len(judged) * (SHOWN if drawn else 1)
        if every:
            check_episodes(count, len(judged))  # before make_vec counts environments
    sim = dataclasses.replace(sim_of(trained), device=device, lanes=bodies.lanes(trained, device), grid=bodies.grid)
    options: dict[str, Any] = {"rules": trained.rules, "obs": trained.obs, "seed": trained.seed, "sim": sim}
    env = make_vec(trained.task, judged, count * len(parts), auto_reset=False, **options)
    policy.check_sizes(env.num_obs, env.num_actions)
    acting = SampledPolicy(policy, content["actor_state_dict"], trained.seed) if config.stochastic else policy
    return env, disturbed(acting, env, parts, trained.seed)


def load_result(run: Run, settings: Any, device: str = "cpu") -> tuple[VoxelVecEnv, Any]:
    """Load the policy of a finished run, with one environment per design, to show an episode.

    ``settings``: of the training or design search, with the code that the user has named.
    """
    count = 1 if run.is_many else len(load_bodies(run.config["design"], 0))
    how = {"device": device, "threads": settings.threads, "memory_check": settings.memory_check}
    return load_trained(run, Playing(count, **how, **own_code(settings)))


def check_episodes(episodes: int, bodies: int) -> None:
    """Raise ConfigError unless ``episodes`` is a multiple of ``bodies``."""
    if episodes % bodies:
        raise ConfigError(f"{bodies} bodies need a multiple of that of episodes; got {episodes}.")


def disturbed(policy: Any, env: VoxelVecEnv, parts: Sequence[str], seed: int) -> Any:
    """Wrap ``policy`` so that each block of environments gets its disturbance, with common random numbers."""
    if parts == (NOMINAL,):
        return policy
    episodes = env.num_envs // len(parts)
    check_episodes(episodes, env.num_designs)
    # every block gets the random numbers of the first
    numbers = torch.arange(episodes).view(env.num_designs, 1, -1)
    env.draw_as(numbers.expand(-1, len(parts), -1).flatten())
    return Disturbed(policy, env, parts, seed)
