"""Settings of training: dataclasses whose values the YAML files of ``warpvox/configs`` set."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warpvox.errors import ConfigError
from warpvox.keys import MISSING, key

__all__ = ["ACTIVATIONS", "LOGGERS", "REFRESH", "PpoConfig", "ScreeningConfig", "TrainingConfig"]

REFRESH = ("none", "new", "random", "performance")
"""Ways in which bodies take the place of others while one policy learns to control them."""
ACTIVATIONS = ("tanh", "elu", "relu", "selu", "gelu", "swish")
LOGGERS = ("tensorboard", "wandb", "neptune", "none")


@dataclass
class PpoConfig:
    """Keys ``ppo.*``: policy, value function and their optimisation."""

    steps: int = key(MISSING, "control steps of each environment per iteration", low=1)
    epochs: int = key(MISSING, "passes over the data of an iteration", low=1)
    minibatches: int = key(MISSING, "minibatches of a pass", low=1)
    gamma: float = key(MISSING, "discount factor per control step", low=0, high=1)
    lam: float = key(MISSING, "lambda of generalised advantage estimation", low=0, high=1)
    clip: float = key(MISSING, "clip range of the probability ratio (and of value changes)", above=0)
    clip_values: bool = key(MISSING, "clip changes of the value function")
    value_coef: float = key(MISSING, "weight of the value loss", low=0)
    entropy_coef: float = key(MISSING, "weight of the entropy bonus", low=0)
    max_grad_norm: float = key(MISSING, "gradient norm above which gradients are scaled down to it", above=0)
    learning_rate: float = key(MISSING, "learning rate of Adam (at the start)", above=0)
    schedule: str = key(
        MISSING,
        "schedule of the learning rate: fixed, linear decay to 0, or adaptive to the KL divergence",
        choices=("fixed", "linear", "adaptive"),
    )
    desired_kl: float = key(MISSING, "schedule=adaptive: target KL divergence of an update", above=0)
    adam_eps: float = key(MISSING, "epsilon of Adam", above=0)
    hidden: list[int] = key([64, 64], "units of the hidden layers of both networks", low=1)
    activation: str = key(MISSING, "activation function of the hidden layers", choices=ACTIVATIONS)
    init_std: float = key(MISSING, "initial standard deviation of the policy's output a", above=0)
    action_scale: float = key(0.5, "an action is 1.1 + action_scale * a for the policy's output a", above=0)
    normalize_obs: bool = key(MISSING, "normalise observations by their running mean and standard deviation")
    reward_scale: float = key(MISSING, "factor by which rewards are multiplied for PPO", above=0)
    normalize_reward: bool = key(MISSING, "divide rewards by the running standard deviation of the discounted return")
    bootstrap_time_limit: bool = key(MISSING, "bootstrap from the value function where the time limit ends an episode")
    random_start: bool = key(MISSING, "give the first episodes random lengths, so that they do not all end together")

    rnn: Any = key(None, "recurrent networks: settings of rsl-rl's RNNModel, {rnn_type:gru,rnn_hidden_dim:64}")
    extra: Any = key(None, "further settings of rsl-rl's PPO by name, such as rnd_cfg")

    def check(self, num_envs: int, prefix: str = "ppo") -> None:
        """Raise ConfigError if an iteration of so many environments is too small for its minibatches."""
        samples = self.steps * num_envs
        if samples < self.minibatches:
            raise ConfigError(
                f"{prefix}.minibatches={self.minibatches} is more than the samples of an iteration: {num_envs}"
                f" environments make {samples} in {self.steps} steps."
            )
        if self.rnn is not None and num_envs < self.minibatches:
            raise ConfigError(
                f"{prefix}.minibatches={self.minibatches} is more than the {num_envs} environments, whose episodes"
                f" minibatches of recurrent networks consist of ({prefix}.rnn)."
            )


@dataclass
class TrainingConfig:
    """Keys ``training.*``: how a design search trains and evaluates a design."""

    method: str = key(
        "population",
        "population: all designs of a generation in one batch; sequential: one after another",
        choices=("population", "sequential"),
    )
    envs: int = key(MISSING, "training environments for each design", low=1)
    iterations: int = key(MISSING, "training iterations for each design", low=1)
    eval_interval: int = key(
        MISSING, "iterations between deterministic evaluations, of which the best is the fitness", low=1
    )
    eval_envs: int = key(1, "evaluation environments for each design", low=1)
    save_interval: int = key(50, "iterations between checkpoints while designs are trained", low=1)
    inherit: bool = key(False, "start a child's training from the policy of its best parent")
    rungs: list[float] = key(
        [],
        "successive halving: fractions of the iterations after which the worst designs are dropped, [0.2,0.5] for"
        " instance",
        above=0,
        high=1,
    )
    keep: float = key(0.5, "successive halving: fraction of the designs that is kept at each rung", above=0, high=1)
    ppo: PpoConfig = key(PpoConfig, "settings of PPO")


@dataclass
class ScreeningConfig:
    """Keys ``screening.*``: how designs are compared without a training for each."""

    policy: str = key(
        "grid",
        "network of the policy: grid, transformer, cpg, module:Class, file.py:Class; with evaluation=few_shot that of"
        " pretrained",
        path="read",
    )
    network: Any = key(None, "settings of this network, {width:32} for instance; null: its defaults")
    envs: int = key(16, "training environments for each design", low=1)
    iterations: int = key(10, "training iterations on the designs of each generation; 0 (few_shot only): none", low=0)
    eval_envs: int = key(1, "evaluation environments for each design", low=1)
    save_interval: int = key(10, "iterations between checkpoints of this training", low=1)
    ppo: Any = key(None, "settings of PPO that differ from training.ppo: {epochs:4,schedule:adaptive}")
    gaits: int = key(8, "evaluation=gaits: open-loop gaits that each design tries in a round", low=1)
    rounds: int = key(
        2, "evaluation=gaits: number of rounds; from the second on mutants of the best gait so far are tried", low=0
    )
    stages: int = key(4, "evaluation=gaits: parts of an episode in which a gait has a motion each", low=1, high=100)
    final_rounds: int = key(40, "evaluation=gaits: number of rounds for finalists, before their training", low=0)
    final_gaits: int | None = key(
        None, "evaluation=gaits: gaits that a finalist tries in a round; null: as many as the others", low=1
    )
    passes: int = key(
        0, "evaluation=gaits: beam searches before the rounds, in which a gait grows stage by stage", low=0
    )
    beam: int = key(32, "evaluation=gaits: motions that a design tries in each stage of a beam search", low=1)
    stage_steps: int = key(
        20,
        "evaluation=gaits: control steps of a stage in the first beam search; others have longer and shorter ones",
        low=1,
    )
    final_passes: int = key(14, "evaluation=gaits: beam searches for finalists, before their rounds", low=0)
    final_beam: int = key(64, "evaluation=gaits: motions that a finalist tries in each stage of a beam search", low=1)

    @property
    def gaits_of_finalist(self) -> int:
        """Gaits that a finalist tries in a round."""
        return self.final_gaits or self.gaits
