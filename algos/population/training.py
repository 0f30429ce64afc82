"""Training of several designs in one batch: environments, networks and training loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from rsl_rl.utils import resolve_class
from tensordict import TensorDict

from warpvox.algos.checkpoints.files import actions_of
from warpvox.algos.disturbance import as_judged
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.evaluate import evaluate
from warpvox.algos.generators import Generators
from warpvox.algos.ppo.fused import FusedPPO
from warpvox.algos.ppo.iteration import Iteration
from warpvox.algos.ppo.networks import PopulationActor, PopulationModel
from warpvox.algos.ppo.population import PopulationPPO, Streams
from warpvox.algos.ppo.stock import rsl_rl_config
from warpvox.algos.settings import DesignTraining, Ppo
from warpvox.algos.training.runner import adapt
from warpvox.design import Design
from warpvox.envs.adapters.rsl_rl import OBS_GROUP


@dataclass
class Networks:
    """New networks of one design, with the CPU's random state after their creation."""

    actor: MLPModel
    critic: MLPModel
    random_state: torch.Tensor


def fresh_networks(ppo: Ppo, num_obs: int, num_actions: int, seed: int) -> Networks:
    """Create the networks that rsl-rl would create in a training with this ``seed``."""
    config = rsl_rl_config(ppo, 1)
    obs = TensorDict({OBS_GROUP: torch.zeros(1, num_obs)}, batch_size=[1])

    def network(name: str, outputs: int) -> MLPModel:
        model, settings = resolve_class(config[name])
        return model(obs, config["obs_groups"], name, outputs, **settings)

    with Generators(seed) as generators:
        return Networks(network("actor", num_actions), network("critic", 1), generators.state()["cpu"])


class PopulationTraining:
    """Trains one policy per design, all in one batch.

    Each design's training is that which :class:`warpvox.algos.training.runner.Runner` would give it alone with its
    seed, up to rounding.

    Args:
        prepare: may change a design's networks before training; called with its number, the environments and the
            networks.
    """

    def __init__(
        self,
        factory: EnvFactory,
        bodies: Sequence[Design],
        seeds: Sequence[int],
        settings: DesignTraining,
        prepare: Callable[[int, Any, Networks], None] | None = None,
        eval_seed: int = 0,
    ) -> None:
        self.factory = factory
        self.bodies = list(bodies)
        self.seeds = list(seeds)
        self.settings = settings
        self.eval_seed = eval_seed
        self.ppo = settings.ppo
        self.iteration = 0
        self._make_environments()
        inner = self.env.env
        networks = []
        sizes = zip(inner.obs_mask.sum(1).tolist(), inner.action_mask.sum(1).tolist(), strict=True)
        for d, (num_obs, num_actions) in enumerate(sizes):
            networks.append(fresh_networks(self.ppo, num_obs, num_actions, self.seeds[d]))
            if prepare is not None:
                prepare(d, inner, networks[-1])
        self.algorithm = self._algorithm(networks)
        self._iterate = Iteration(self.env, self.algorithm, self.env.env.capture)

    def _make_environments(self) -> None:
        """Create the environments for training and evaluation of the present bodies."""
        settings = self.settings
        training = self.factory.make(self.bodies, settings.envs, self.seeds, auto_reset=True)
        self.env = adapt(training, self.ppo, apart=True)
        self._eval_seeds = [self.eval_seed] * self.num_designs
        self._judge = self.factory.make(
            self.bodies, self.factory.episodes(settings.episodes), self._eval_seeds, auto_reset=False
        )

    def _algorithm(self, networks: Sequence[Networks]) -> PopulationPPO:
        """Create the PPO algorithm from ``networks``, with a random generator for each design."""
        device = str(self.env.device)
        obs = self.env.get_observations()
        # On the CPU a design's stream goes on where its networks were made; on another device it begins with the seed.
        generators = [torch.Generator(device).manual_seed(seed) for seed in self.seeds]
        if device == "cpu":
            for generator, network in zip(generators, networks, strict=True):
                generator.set_state(network.random_state)
        actor = PopulationActor([network.actor for network in networks]).to(device)
        critic = PopulationModel([network.critic for network in networks]).to(device)
        storage = RolloutStorage("rl", self.env.num_envs, self.ppo.steps, obs, [self.env.num_actions], device)
        settings = dict(rsl_rl_config(self.ppo, self.settings.iterations)["algorithm"])
        settings.pop("class_name")
        threads = self.env.env.sim.threads if device == "cpu" else 1
        streams = Streams(generators, device)
        kind = PopulationPPO if device == "cpu" else FusedPPO
        return kind(actor, critic, storage, streams, threads=threads, device=device, **settings)

    @property
    def num_designs(self) -> int:
        return len(self.bodies)

    @property
    def steps_per_iteration(self) -> int:
        """Control steps per design in one iteration."""
        return self.ppo.steps * self.settings.envs

    def iterate(self) -> None:
        """Run one training iteration; the first one starts at random episode lengths if so set."""
        if self.iteration == 0 and self.ppo.random_start:
            lengths = self.algorithm.streams.integers(int(self.env.max_episode_length), self.settings.envs)
            self.env.episode_length_buf = lengths.flatten().to(self.env.device)
        self._iterate()
        self.iteration += 1

    def evaluate(self) -> torch.Tensor:
        """Run the deterministic evaluation episodes; return the mean returns, float64 ``[designs]``.

        NaN for a design whose policy gives actions that are not numbers; the others are not affected. The networks are
        evaluated in float64, as :class:`warpvox.algos.checkpoints.policy.Policy` is.
        """
        actor = self.algorithm.actor.part(slice(None)).double()

        def policy(obs: torch.Tensor) -> torch.Tensor:
            means = actor.run(actor.scaled(obs.double())).float()
            diverged.logical_or_(means.isnan().flatten(1).any(1))
            means = means.flatten(0, 1).nan_to_num(0.0, math.inf, -math.inf)
            return actions_of(means, self.ppo.action_scale)

        diverged = torch.zeros(self.num_designs, dtype=torch.bool, device=self.algorithm.device)
        judged = as_judged(policy, self._judge, self.eval_seed, self.factory.protocol)
        return evaluate(self._judge, judged, seed=self._eval_seeds).fitness.masked_fill(diverged.cpu(), math.nan)

    def policy(self, design: int) -> dict[str, torch.Tensor]:
        """Return a design's policy as the state of a standard actor."""
        return self.algorithm.actor.member(design)

    def keep(self, index: Sequence[int]) -> None:
        """Continue with the designs at ``index`` only; their training is unaffected, up to rounding."""
        state = self.env.pick(index)
        self.bodies = [self.bodies[d] for d in index]
        self.seeds = [self.seeds[d] for d in index]
        self._make_environments()
        self.env.set_state(state)
        self.algorithm.keep(index, self.env.get_observations())
        self._iterate = Iteration(self.env, self.algorithm, self.env.env.capture)
