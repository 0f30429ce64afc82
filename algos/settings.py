"""Settings of training: dataclasses whose values the YAML files of ``warpvox/configs`` set."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warpvox.keys import MISSING, key

__all__ = ["ACTIVATIONS", "LOGGERS", "REFRESH", "PpoConfig", "ScreeningConfig", "TrainingConfig"]

REFRESH = ("none", "new", "random", "performance")
"""Ways in which bodies take the place of others while one policy learns to control them."""
ACTIVATIONS = ("tanh", "elu", "relu", "selu", "gelu", "swish")
LOGGERS = ("tensorboard", "wandb", "neptune", "none")


@dataclass
class PpoConfig:
    """Keys ``ppo.*``: policy, value function and their optimisation."""

    steps: int = key(MISSING, "control steps of each environment in an iteration", low=1)
    epochs: int = key(MISSING, "passes over the data of an iteration", low=1)
    minibatches: int = key(MISSING, "parts into which a pass is cut", low=1)
    gamma: float = key(MISSING, "discount of a control step", low=0, high=1)
    lam: float = key(MISSING, "lambda of generalised advantage estimation", low=0, high=1)
    clip: float = key(MISSING, "clip range of the probability ratio (and of value changes)", above=0)
    clip_values: bool = key(MISSING, "clip changes of the value function")
    value_coef: float = key(MISSING, "weight of the value loss", low=0)
    entropy_coef: float = key(MISSING, "weight of the entropy bonus", low=0)
    max_grad_norm: float = key(MISSING, "gradients are scaled down to this norm", above=0)
    learning_rate: float = key(MISSING, "step size of Adam (at the start)", above=0)
    schedule: str = key(
        MISSING,
        "of the learning rate: fixed, linear decay to 0, or adaptive to the KL divergence",
        choices=("fixed", "linear", "adaptive"),
    )
    desired_kl: float = key(MISSING, "KL divergence of an update that the adaptive schedule aims at", above=0)
    adam_eps: float = key(MISSING, "epsilon of Adam", above=0)
    hidden: list[int] = key([64, 64], "units of the hidden layers of both networks", low=1)
    activation: str = key(MISSING, "of the hidden layers", choices=ACTIVATIONS)
    init_std: float = key(MISSING, "standard deviation of exploration at the start, in units of a", above=0)
    action_scale: float = key(0.5, "an action is 1.1 + action_scale * a for the policy's output a", above=0)
    normalize_obs: bool = key(MISSING, "scale observations by their running mean and deviation")
    reward_scale: float = key(MISSING, "factor of the rewards that PPO sees", above=0)
    normalize_reward: bool = key(MISSING, "divide rewards by the running deviation of the discounted return")
    bootstrap_time_limit: bool = key(MISSING, "a time limit ends the episode, not the future: add its value")
    random_start: bool = key(MISSING, "spread the ends of the first episodes over time")


@dataclass
class TrainingConfig:
    """Keys ``training.*``: how a design search trains and evaluates a design."""

    method: str = key(
        "population",
        "population: all designs of a generation in one batch; sequential: one after another",
        choices=("population", "sequential"),
    )
    envs: int = key(MISSING, "environments of a design", low=1)
    iterations: int = key(MISSING, "training iterations of a design", low=1)
    eval_interval: int = key(MISSING, "iterations between deterministic evaluations; the best is the fitness", low=1)
    eval_envs: int = key(1, "environments of an evaluation, for each design", low=1)
    save_interval: int = key(50, "iterations between checkpoints of an evaluation under way", low=1)
    inherit: bool = key(False, "a child's training starts from the policy of its best parent")
    rungs: list[float] = key(
        [],
        "successive halving: shares of the iterations after which the worst designs stop: [0.2,0.5]",
        above=0,
        high=1,
    )
    keep: float = key(0.5, "successive halving: share of the designs that goes on after a rung", above=0, high=1)
    ppo: PpoConfig = key(PpoConfig, "training method")


@dataclass
class ScreeningConfig:
    """Keys ``screening.*``: how designs are compared without a training for each."""

    policy: str = key(
        "grid",
        "its network: grid, transformer, module:Class, file.py:Class; evaluation=few_shot has that of pretrained",
        path="read",
    )
    network: Any = key(None, "settings of this network: {width:32}; null: its own")
    envs: int = key(16, "environments of a design", low=1)
    iterations: int = key(
        10, "iterations that it learns for on the designs of a generation; few_shot: 0 for none", low=0
    )
    eval_envs: int = key(1, "environments of the evaluation after them, for each design", low=1)
    save_interval: int = key(10, "iterations between checkpoints of an evaluation under way", low=1)
    ppo: Any = key(None, "settings of PPO that differ from training.ppo: {epochs:4,schedule:adaptive}")
    gaits: int = key(8, "evaluation=gaits: open-loop gaits that a design is tried with in a round", low=1)
    rounds: int = key(
        2, "evaluation=gaits: rounds of them; in each further one, mutants of the best gait so far are tried", low=1
    )
    final_rounds: int = key(40, "evaluation=gaits: the same for finalists, before their training", low=1)
