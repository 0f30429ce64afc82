"""Settings of training: dataclasses whose values the YAML files of ``warpvox/configs`` set."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

from dataclasses import dataclass

from warpvox.errors import ConfigError
from warpvox.keys import MISSING, key

__all__ = ["ACTIVATIONS", "CPG", "LOGGERS", "MLP", "REFRESH", "PpoConfig", "TrainingConfig"]

MLP = "mlp"
"""The policy that is no network for voxels: fully connected layers on the whole observation."""
CPG = "cpg"
"""The policy without feedback, which gradients through the physics train."""
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

    def check(self, num_envs: int, prefix: str = "ppo") -> None:
        """Raise ConfigError if an iteration of so many environments is too small for its minibatches."""
        samples = self.steps * num_envs
        if samples < self.minibatches:
            raise ConfigError(
                f"{prefix}.minibatches={self.minibatches} is more than the samples of an iteration: {num_envs}"
                f" environments make {samples} in {self.steps} steps."
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
