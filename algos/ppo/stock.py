"""rsl-rl's PPO extended by a linear schedule, Adam's epsilon and exact values at time limits."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Collection, Generator, Mapping
from contextlib import nullcontext
from typing import Any, cast

import torch
from rsl_rl.algorithms import PPO as RslRlPPO
from rsl_rl.extensions import resolve_rnd_config, resolve_symmetry_config
from rsl_rl.models import MLPModel, RNNModel
from rsl_rl.modules import EmpiricalDiscountedVariationNormalization
from rsl_rl.storage import RolloutStorage
from rsl_rl.utils import resolve_class
from tensordict import TensorDict
from torch import nn

from warpvox.algos.checkpoints.files import RNN
from warpvox.algos.expected import AnyTensor, check_like, optimizer_state
from warpvox.algos.generators import Generators
from warpvox.algos.policies.model import VoxelModel
from warpvox.algos.policies.network import LATENT, Gaussian, Network
from warpvox.algos.settings import WIDEST, Ppo
from warpvox.checks import check_choice, check_integer, is_mapping
from warpvox.code import load_code
from warpvox.envs.adapters.rsl_rl import OBS_GROUP
from warpvox.errors import ConfigError, did_you_mean, listing
from warpvox.keys import converted

SYMMETRY = "data_augmentation_func"
"""Key of ``symmetry_cfg`` whose value names a function."""
MLP_SETTINGS = inspect.signature(MLPModel.__init__).parameters
SETTINGS = {
    "num_learning_epochs": "epochs", "num_mini_batches": "minibatches", "clip_param": "clip",
    "use_clipped_value_loss": "clip_values", "value_loss_coef": "value_coef",
} | {name: name for name in (
    "schedule", "gamma", "lam", "entropy_coef", "max_grad_norm", "learning_rate", "desired_kl",
)}  # fmt: skip
"""Settings of rsl-rl's PPO by its names, with our names as values."""
GIVEN = ("self", "actor", "critic", "storage", "device", "multi_gpu_cfg")
"""Arguments of rsl-rl's PPO that are not settings."""


class PPO(RslRlPPO):
    """rsl-rl's PPO with further settings: schedule ``linear``, Adam's epsilon, generators of random numbers.

    Args:
        generators: of the random numbers; None: no random numbers are drawn.
        schedule: ``fixed``, ``adaptive`` (rsl-rl's) or ``linear``: the learning rate of update k of n is
            ``learning_rate * (1 - k / n)`` with k = 0, 1, ..., n - 1.
    """

    def __init__(
        self,
        *args: Any,
        total_iterations: int,
        adam_eps: float = 1e-8,
        schedule: str = "fixed",
        generators: Generators | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(*args, schedule="adaptive" if schedule == "adaptive" else "fixed", **settings)
        self.generators = generators
        if generators is not None:
            cast(Any, self.get_policy().distribution).generator = generators.on(self.device)
        self.decays = schedule == "linear"
        self.adam_eps = adam_eps
        self.initial_learning_rate = self.learning_rate
        self.total_iterations = total_iterations
        self.updates = 0
        self._configure_adam()
        self.storage.mini_batch_generator = self._minibatches
        self.critic.obs_normalizer = self.actor.obs_normalizer
        self.critic.update_normalization = lambda obs: None

    @classmethod
    def of(
        cls, env: Any, config: Mapping[str, Any], generators: Generators, processes: Mapping[str, int] | None = None
    ) -> PPO:
        """Make the algorithm that :func:`rsl_rl_config` describes, with new networks for an environment.

        Args:
            processes: that learn together, as rsl-rl describes them; None: this one alone.
        """
        obs = env.get_observations()
        groups = config["obs_groups"]
        device = str(env.device)
        settings = copy.deepcopy({name: value for name, value in config["algorithm"].items() if name != "class_name"})
        settings = resolve_symmetry_config(resolve_rnd_config(settings, obs, groups, env), env)
        with generators:
            networks = []
            for name, outputs in (("actor", env.num_actions), ("critic", 1)):
                kind, own = resolve_class(config[name])
                networks.append(kind(obs, groups, name, outputs, **own).to(device))
            storage = RolloutStorage("rl", env.num_envs, config["num_steps_per_env"], obs, [env.num_actions], device)
            return cls(*networks, storage, generators=generators, device=device, multi_gpu_cfg=processes, **settings)

    def _configure_adam(self) -> None:
        """Set Adam's epsilon, and its fused implementation where there is one."""
        for group in self.optimizer.param_groups:
            group |= {"eps": self.adam_eps, "fused": torch.device(self.device).type in ("cpu", "cuda")}

    @property
    def decayed_rate(self) -> float:
        """Learning rate of the linear schedule for the next update."""
        return self.initial_learning_rate * max(0.0, 1 - self.updates / self.total_iterations)

    def set_learning_rate(self, rate: float) -> None:
        """Set the learning rate here and in the optimiser."""
        self.learning_rate = rate
        for group in self.optimizer.param_groups:
            group["lr"] = rate

    @torch.no_grad()
    def act(self, obs: TensorDict) -> torch.Tensor:
        """Draw actions for observations, which are scaled once for actor and critic."""
        if self.actor.is_recurrent:
            return super().act(obs)
        actions = super().act(self._scaled(obs))
        self.transition.observations = obs
        return actions

    def _scaled(self, obs: TensorDict) -> TensorDict:
        """Return the observations with the scaled ones added under the name :data:`LATENT`."""
        return obs.copy().set(LATENT, self.actor.get_latent(obs))

    def process_env_step(
        self, obs: TensorDict, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, Any]
    ) -> None:
        """Record a step; where only the time limit ended an episode, add the value of its final state.

        rsl-rl would add the value of the state before the step, because it does not get the final one.
        """
        if "time_outs" in extras:
            rewards = self._bootstrap_time_limit(rewards, extras["time_outs"], extras["final_obs"])
        super().process_env_step(obs, rewards, dones, {})

    def _bootstrap_time_limit(
        self, rewards: torch.Tensor, time_outs: torch.Tensor, final_obs: TensorDict
    ) -> torch.Tensor:
        """Return the rewards plus the discounted values of final states where a time limit struck."""
        if (
            time_outs.device.type == "cpu" and not self.critic.is_recurrent
        ):  # on CUDA this check would wait for the device
            rows = time_outs.nonzero()[:, 0]
            if not len(rows):
                return rewards
            return rewards.index_add(0, rows, self.critic(final_obs[rows])[:, 0], alpha=self.gamma)
        hidden = self.critic.get_hidden_state()
        values = self.critic(final_obs).squeeze(-1)
        self.critic.reset(hidden_state=hidden)
        return rewards + self.gamma * values * time_outs

    def update(self) -> dict[str, float]:
        """Set the learning rate if it is linear, and run rsl-rl's update; returns the mean losses."""
        if self.decays:
            self.set_learning_rate(self.decayed_rate)
        self.updates += 1
        return super().update()

    def _minibatches(self, num_mini_batches: int, num_epochs: int = 8) -> Generator[RolloutStorage.Batch, None, None]:
        """Yield rsl-rl's minibatches, shuffled and scaled once and the same in every epoch."""
        with nullcontext() if self.generators is None else self.generators:
            batches = list(RolloutStorage.mini_batch_generator(self.storage, num_mini_batches, 1))
        if not self.symmetry:  # symmetry adds observations to a batch, which must be scaled later
            for batch in batches:
                with torch.no_grad():
                    batch.observations = self._scaled(batch.observations)
        for _ in range(num_epochs):
            yield from map(copy.copy, batches)

    def save(self) -> dict[str, Any]:
        """Return the state of networks and optimisers, and the number of updates."""
        return super().save() | {"updates": self.updates}

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None = None, strict: bool = True) -> bool:
        """Restore what :meth:`save` returned; of the optimisers only moments and learning rates.

        Raises:
            RunError: it does not fit these networks; nothing has changed.
        """
        wanted: Mapping[str, bool] = load_cfg or dict.fromkeys(("actor", "critic", "optimizer", "rnd"), True)
        networks: dict[str, Any] = {"actor": self._raw_actor, "critic": self._raw_critic}
        optimizers: dict[str, Any] = {"optimizer": self.optimizer}
        if self.rnd:
            networks["rnd"] = self.rnd
            optimizers["rnd"] = self.rnd.optimizer
        like = {f"{name}_state_dict": network.state_dict() for name, network in networks.items() if wanted.get(name)}
        check_like({"updates": 0, **loaded_dict}, like | {"updates": int})

        # Copies: torch's Adam would update the given tensors in place.
        own: dict[str, Any] = {}
        for name, optimizer in optimizers.items():
            if wanted.get(name):
                key = "optimizer_state_dict" if name == "optimizer" else f"{name}_optimizer_state_dict"
                own[key] = optimizer_state(loaded_dict.get(key), optimizer, key)
        result = super().load(loaded_dict | own, load_cfg, strict)
        self.updates = loaded_dict.get("updates", 0)
        return result

    def memory(self) -> dict[str, Any]:
        """Return the state of running episodes, for :meth:`set_memory`: hidden states, and RND's scale."""
        own: dict[str, Any] = {"actor": self.actor.get_hidden_state(), "critic": self.critic.get_hidden_state()}
        if self.rnd:
            scale = self.rnd.reward_normalizer
            average = scale.disc_avg.avg if isinstance(scale, EmpiricalDiscountedVariationNormalization) else None
            own |= {"rnd_steps": self.rnd.update_counter, "rnd_average": average}
        return own

    def set_memory(self, own: Mapping[str, Any]) -> None:
        """Restore what :meth:`memory` returned; RunError: it belongs to other networks."""
        like: dict[str, Any] = dict.fromkeys(("actor", "critic"))
        for name, model in (("actor", self.actor), ("critic", self.critic)):
            if model.is_recurrent and own.get(name) is not None:  # else no episode has begun
                layers = cast(Any, model).rnn.rnn
                hidden = AnyTensor(torch.float32, (layers.num_layers, self.storage.num_envs, layers.hidden_size))
                like[name] = (hidden, hidden) if isinstance(layers, nn.LSTM) else hidden
        if self.rnd:
            average = None if own.get("rnd_average") is None else AnyTensor(torch.float32, (self.storage.num_envs,))
            like |= {"rnd_steps": int, "rnd_average": average}
        check_like(own, like, "memory")
        self.actor.reset(hidden_state=own["actor"])
        self.critic.reset(hidden_state=own["critic"])
        if self.rnd:
            self.rnd.update_counter = own["rnd_steps"]
            if isinstance(scale := self.rnd.reward_normalizer, EmpiricalDiscountedVariationNormalization):
                scale.disc_avg.avg = own["rnd_average"]


def rsl_rl_config(ppo: Ppo, total_iterations: int, voxels: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the configuration dictionary of rsl-rl's runner.

    Args:
        voxels: ``network``, ``settings`` and ``layout`` of :class:`~warpvox.algos.policies.model.VoxelModel`; None:
            fully connected layers, behind recurrent ones where ``ppo.rnn`` says so.
    """
    network: dict[str, Any] = {"class_name": Network, "hidden_dims": list(ppo.hidden), "activation": ppo.activation}
    if voxels is not None:
        network = {"class_name": VoxelModel, **voxels}
    if ppo.rnn is not None:
        if voxels is not None:
            raise ConfigError("ppo.rnn goes with policy=mlp: policies for voxels are not recurrent.")
        network |= {"class_name": RNNModel, **_checked("rnn", ppo.rnn, RNNModel, MLP_SETTINGS)}
        sizes = RNN | ppo.rnn
        check_choice("ppo.rnn.rnn_type", sizes.pop("rnn_type"), ("lstm", "gru"))  # rsl-rl takes all else for lstm
        for name, size in sizes.items():
            check_integer(f"ppo.rnn.{name}", size, 1, WIDEST)
    network["obs_normalization"] = ppo.normalize_obs
    settings = {theirs: getattr(ppo, ours) for theirs, ours in SETTINGS.items()}
    extra = _checked("extra", {} if ppo.extra is None else ppo.extra, RslRlPPO, [*settings, *GIVEN])
    symmetry = extra.get("symmetry_cfg")
    if is_mapping(symmetry):
        if SYMMETRY not in symmetry:
            raise ConfigError(f"ppo.extra.symmetry_cfg needs {SYMMETRY}, a function of yours: FILE.py:NAME.")
        extra["symmetry_cfg"] = {**symmetry, SYMMETRY: load_code(symmetry[SYMMETRY])}
    own = {"class_name": PPO, "total_iterations": total_iterations, "adam_eps": ppo.adam_eps}
    noise = {"class_name": Gaussian, "init_std": ppo.init_std, "std_type": "log"}
    return {
        "num_steps_per_env": ppo.steps,
        "check_for_nan": False,
        "obs_groups": {name: [OBS_GROUP] for name in ("actor", "critic", "rnd_state")},
        "actor": network | {"distribution_cfg": noise},
        "critic": network,
        "algorithm": own | settings | extra,
    }


def _checked(name: str, given: Mapping[str, Any], made: type, others: Collection[str]) -> dict[str, Any]:
    """Check the settings of the key ``ppo.<name>`` for the class ``made``, without ``others``, and return them."""
    parameters = inspect.signature(made.__init__).parameters
    known = [one for one in parameters if one not in others]
    if not isinstance(given, Mapping):
        raise ConfigError(f"ppo.{name} must be settings by name, such as {{{known[0]}:...}}; got {given!r:.80}.")
    for wrong in given.keys() - known:
        hint = did_you_mean(str(wrong), known)
        raise ConfigError(f"ppo.{name} has the settings {listing(known)}; got {wrong!r:.80}.{hint}")
    flags = [one for one in given if isinstance(parameters[one].default, bool)]
    return {**given, **{one: converted(given[one], bool, f"ppo.{name}.{one}") for one in flags}}
