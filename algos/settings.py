"""Settings of training and physics: dataclasses behind the YAML files of ``warpvox/configs``."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, make_dataclass
from typing import TYPE_CHECKING, Any

from warpvox.errors import ConfigError
from warpvox.keys import Settings, key, plain
from warpvox.types import Physics

if TYPE_CHECKING:
    from warpvox.batch.options import SimOptions


WIDEST = 1 << 16
"""Maximum number of observations, actions or units of a layer."""
MAX_LAYERS = 256
"""Maximum number of layers of a network."""
MLP = "mlp"
"""Policy name of fully connected layers on the whole observation; all other policies work by voxel."""
REFRESH = ("none", "new", "random", "performance")
"""Values of ``designs.refresh``: how environments get other bodies while one policy is trained."""
LOGGERS = ("tensorboard", "wandb", "neptune", "none")


@dataclass
class Ppo(Settings):
    """Keys ``ppo.*``: policy, value function and optimisation.

    The defaults are for hundreds to thousands of environments, tuned on Walker-v0 with 512. Short rollouts and as many
    updates as the KL divergence allows need the fewest control steps.
    """

    steps: int = key(16, "control steps of each environment per iteration", low=1)
    epochs: int = key(5, "passes over the data of an iteration", low=1)
    minibatches: int = key(4, "minibatches of a pass", low=1)
    gamma: float = key(0.99, "discount factor per control step", low=0, high=1)
    lam: float = key(0.95, "lambda of generalised advantage estimation", low=0, high=1)
    clip: float = key(0.2, "clip range of the probability ratio (and of value changes)", above=0, high=1e30)
    clip_values: bool = key(False, "clip changes of the value function")
    value_coef: float = key(1.0, "weight of the value loss", low=0)
    entropy_coef: float = key(0.002, "weight of the entropy bonus", low=0)
    max_grad_norm: float = key(1.0, "gradient norm above which gradients are scaled down to it", above=0)
    learning_rate: float = key(1e-3, "learning rate of Adam (at the start)", above=0)
    schedule: str = key(
        "adaptive",
        "schedule of the learning rate: fixed, linear decay to 0, or adaptive to the KL divergence",
        choices=("fixed", "linear", "adaptive"),
    )
    desired_kl: float = key(0.02, "schedule=adaptive: target KL divergence of an update", above=0)
    adam_eps: float = key(1e-8, "epsilon of Adam", above=0)
    hidden: list[int] = key([64, 64], "units of the hidden layers of both networks", low=1, high=WIDEST)
    activation: str = key(
        "tanh", "activation function of the hidden layers", choices=("tanh", "elu", "relu", "selu", "gelu", "swish")
    )
    init_std: float = key(1.0, "initial standard deviation of the policy's output a", above=0)
    action_scale: float = key(0.5, "an action is 1.1 + action_scale * a for the policy's output a", above=0, high=1e4)
    normalize_obs: bool = key(True, "normalise observations by their running mean and standard deviation")
    reward_scale: float = key(10.0, "factor by which rewards are multiplied for PPO", above=0)
    normalize_reward: bool = key(False, "divide rewards by the running standard deviation of the discounted return")
    bootstrap_time_limit: bool = key(True, "bootstrap from the value function where the time limit ends an episode")
    random_start: bool = key(True, "give the first episodes random lengths, so that they do not all end together")
    rnn: Any = key(None, "recurrent networks: settings of rsl-rl's RNNModel, {rnn_type:gru,rnn_hidden_dim:64}")
    extra: Any = key(None, "further settings of rsl-rl's PPO by name, such as rnd_cfg")

    def __post_init__(self) -> None:
        """Validate the values, and convert ``rnn`` and ``extra`` to plain dictionaries."""
        super().__post_init__()
        self.rnn = plain(self.rnn, "ppo.rnn")
        self.extra = plain(self.extra, "ppo.extra")

    def check(self, num_envs: int, prefix: str = "ppo") -> None:
        """Raise ConfigError if ``num_envs`` environments give too few samples for the minibatches."""
        samples = self.steps * num_envs
        if not self.hidden:
            raise ConfigError(f"{prefix}.hidden must name the width of one layer or more, got [].")
        if len(self.hidden) > MAX_LAYERS:
            raise ConfigError(f"{prefix}.hidden may have {MAX_LAYERS} layers at most, got {len(self.hidden)}.")
        if self.rnn is not None and self.steps < 2:
            raise ConfigError(f"{prefix}.rnn needs {prefix}.steps of 2 or more, got {self.steps}.")
        if samples < 2:
            raise ConfigError(f"An iteration needs 2 samples or more, got {prefix}.steps=1 of one environment.")
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
class DesignTraining(Settings):
    """Keys ``training.*``: training and evaluation of each design in a search.

    The defaults take as many control steps as the paper's and spend them better: on Walker-v0 the example design
    ``walker`` gets to the end of the terrain within a third of them.
    """

    envs: int = key(32, "training environments for each design", low=1)
    iterations: int = key(250, "training iterations for each design", low=1)
    eval_interval: int = key(
        25, "iterations between deterministic evaluations, of which the best is the fitness", low=1
    )
    episodes: int | None = key(
        None,
        "evaluation episodes for each design; null: 1, with protocol=noise 8, with fitness=gaits those of a gait",
        low=1,
    )
    inherit: bool = key(False, "start a child's training from the policy of its best parent")
    rungs: list[float] = key(
        [],
        "successive halving: fractions of the iterations after which the worst designs are dropped, [0.2,0.5] for"
        " instance",
        above=0,
        high=1,
    )
    keep: float = key(0.5, "successive halving: fraction of the designs that is kept at each rung", above=0, high=1)
    ppo: Ppo = key(lambda: Ppo(steps=64, epochs=8), "settings of PPO")  # large batches

    def halvings(self) -> list[int]:
        """Return the iterations at which successive halving drops designs, ascending."""
        return sorted({max(1, round(share * self.iterations)) for share in self.rungs} - {self.iterations})

    def kept(self, designs: int) -> int:
        """Return how many of ``designs`` survive a rung of successive halving."""
        # 0.28 of 25 must be 7, whatever rounding makes of it
        return max(1, math.ceil(round(self.keep * designs, 9)))

    def steps_of_design(self, designs: int) -> float:
        """Return the mean number of control steps of a design's training, of ``designs`` in one batch."""
        left = designs
        before = 0
        iterations = 0
        for end in [*self.halvings(), self.iterations]:
            iterations += left * (end - before)
            left = self.kept(left)
            before = end
        return iterations * self.envs * self.ppo.steps / designs


_Constants: Any = make_dataclass(
    "PhysicsConfig",
    [
        (
            "preset",
            str,
            key(
                "auto",
                "preset to start from; auto: the one that belongs to rules",
                choices=("auto", *Physics.presets()),
            ),
        ),
        *(
            (one.name, type(one.default) | None, key(None, f"{one.metadata['help']}; null: the preset's value"))
            for one in dataclasses.fields(Physics)
            if one.name != "name"
        ),
    ],
    bases=(Settings,),
    namespace={"__module__": __name__},
)


class PhysicsConfig(_Constants):
    """Keys ``physics.*``: a preset and changed constants (paper section A, Table 1)."""

    @classmethod
    def of(cls, given: Any) -> Any:
        """Convert a preset's name or a set of constants to these keys; other values are returned unchanged."""
        if isinstance(given, Physics):
            given = dataclasses.asdict(given)
            return cls(given.pop("name"), **given)
        return cls(given) if isinstance(given, str) else given


PRESETS = {name: PhysicsConfig(preset=name) for name in ("auto", *Physics.presets())}
"""Choices of the group ``physics``."""


def physics_of(config: Any) -> Physics:
    """Return the physics constants selected by ``physics`` and ``rules`` of a configuration."""
    values = dataclasses.asdict(config.physics)
    preset = values.pop("preset")
    changes = {name: value for name, value in values.items() if value is not None}
    return Physics.preset(config.rules if preset == "auto" else preset, **changes)


def sim_of(config: Any) -> SimOptions:
    """Collect the simulation options from a configuration."""
    from warpvox.batch.options import SimOptions  # and torch with it, for which mistakes in keys do not wait

    return SimOptions(
        config.device,
        config.dtype,
        config.arithmetic,
        physics_of(config),
        getattr(config, "lanes", None),
        config.threads,
        memory_check=config.memory_check,
    )
