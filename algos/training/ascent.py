"""Training by gradients through the physics: ``method=gradients``, of a policy that moves by body and time alone."""

import copy
from functools import partial
from types import SimpleNamespace
from typing import Any

import torch
from torch import nn

from warpvox.algos.checkpoints.expected import AnyTensor, check_like
from warpvox.algos.generators import Generators
from warpvox.algos.policies.cpg import TYPE, CpgNetwork
from warpvox.algos.policies.layout import MOVING
from warpvox.algos.policies.model import VoxelModel
from warpvox.algos.training.ppo import PPO
from warpvox.algos.training.runner import Runner
from warpvox.envs.snapshot import Snapshot
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import ConfigError, RunError, SimulationError
from warpvox.gradients import Gradients
from warpvox.types import ACTION_CENTER

DERIVED = ("com", "velocity")
"""Quantities of a state that are differentiated, and that rewards may be made of."""
PROBE = 40
"""Control steps in which some reward must have a derivative."""
STEP = 0.25
"""From the weights of a body to its target, root mean square."""
MEMORY = 16
"""Rollouts whose bodies keep their targets."""
BATCH = 256
"""Bodies that a step of Adam is for, unless there are fewer."""
SMOOTHING = 0.995
"""Share of the policy that stays when the learner has made a step."""
DECAY = 0.01
"""Weight decay of the learner, by learning rate and step."""
DRIVEN = slice(TYPE.start + 2, TYPE.stop)
"""The types with an actuator, in what does not move."""
TINY = 1e-12


class Targets:
    """Targets of the policy: weights of the last bodies; a body that comes again has its newest ones."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._keys: list[bytes] = []
        self._bodies, self._targets = torch.empty(0), torch.empty(0)

    def __len__(self) -> int:
        return len(self._keys)

    def add(self, bodies: torch.Tensor, targets: torch.Tensor) -> None:
        """Add ``[rows, ...]`` of both; of equal bodies the last row counts."""
        keys = self._known_as(bodies)
        newest = {key: row for row, key in enumerate(keys)}
        rows = torch.tensor(list(newest.values()), device=bodies.device)
        bodies, targets = bodies[rows], targets[rows]
        if self._keys:
            stay = torch.tensor([key not in newest for key in self._keys], device=bodies.device)
            bodies, targets = torch.cat([self._bodies[stay], bodies]), torch.cat([self._targets[stay], targets])
        kept = [key for key in self._keys if key not in newest] + list(newest)
        self._keys = kept[-self.limit :]
        self._bodies, self._targets = bodies[-self.limit :], targets[-self.limit :]

    def draw(self, count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """So many bodies and targets, drawn at random with a generator of the CPU."""
        rows = torch.randint(len(self), (count,), generator=generator).to(self._bodies.device)
        return self._bodies[rows], self._targets[rows]

    def state(self) -> dict[str, torch.Tensor]:
        return {"bodies": self._bodies, "targets": self._targets}

    def set_state(self, state: dict[str, torch.Tensor]) -> None:
        self._bodies, self._targets = state["bodies"], state["targets"]
        self._keys = self._known_as(self._bodies)

    @staticmethod
    def _known_as(bodies: torch.Tensor) -> list[bytes]:
        return [row.tobytes() for row in bodies.cpu().numpy()]


class Ascent(PPO):
    """Ascent along given derivatives of returns by the weights of a :class:`CpgNetwork`, in the place of PPO's update.

    Each body gets a target: the weights that the network gives it, and :data:`STEP` along its derivative. A copy of
    the network, the learner, is fitted to the targets of the last :data:`MEMORY` rollouts by ``epochs * minibatches``
    steps of Adam, each for :data:`BATCH` bodies at most. The policy is the mean of the learner's parameters over its
    last steps. ``learning_rate``, ``schedule`` and ``max_grad_norm`` are those of PPO; critic and deviations do not
    learn.
    """

    actor: VoxelModel
    generators: Generators

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        network = getattr(self.actor, "network", None)
        if not isinstance(network, CpgNetwork):
            raise ConfigError("method=gradients trains policy=cpg: what other policies observe is not differentiated.")
        self.network, self.learner, self.steps = network, copy.deepcopy(network), 0
        self.learner.response = network.response  # known responses are known to both
        parameters, betas = self.learner.parameters(), (0.9, 0.99)
        self.optimizer = torch.optim.AdamW(parameters, self.learning_rate, betas, weight_decay=DECAY)
        self._configure_adam()

    def look(self, obs: Any) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """The constant part of the network's inputs, its weights for the bodies, and the actions of the cells:
        ``[num_envs, cells, 10]``, ``[num_envs, cells, 1 + clock]`` and long ``[num_envs, cells]``."""
        with torch.no_grad():
            cells, _, actions = self.actor.unpack(self.actor.get_latent(obs))
            bodies = cells[..., MOVING:].contiguous()
            return bodies, self.network.weights(bodies), actions.long()

    def ascend(self, targets: Targets) -> float:
        """Fit the learner; returns the mean squared distance to the targets."""
        if self.decays:
            self.set_learning_rate(self.decayed_rate)
        total, times = 0.0, self.num_learning_epochs * self.num_mini_batches
        for _ in range(times):
            bodies, wanted = targets.draw(min(BATCH, len(targets)), self.generators.on("cpu"))
            driven = bodies[..., DRIVEN].sum(-1, keepdim=True)
            apart = ((self.learner.weights(bodies) - wanted).square() * driven).sum()
            loss = apart / (driven.sum().clamp(min=1) * wanted.shape[2])
            self.optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.learner.parameters(), self.max_grad_norm)
            self.optimizer.step()
            self.steps += 1
            share = max(1 - SMOOTHING, 9 / (self.steps + 9))  # the policy follows the learner, faster at first
            for mean, value in zip(self.network.parameters(), self.learner.parameters(), strict=True):
                mean.data.lerp_(value.data, share)
            total += loss.item() / times
        self.updates += 1
        return total

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None = None, strict: bool = True) -> bool:
        """Restore what :meth:`save` gave; the learner begins with the policy's parameters."""
        result = super().load(loaded_dict, load_cfg, strict)
        self.learner.load_state_dict(self.network.state_dict())
        return result


class AscentRunner(Runner):
    """Trains one policy by the derivatives of what it gets in the first control steps of episodes.

    Each iteration begins new episodes, ``ppo.steps`` control steps of which are differentiated: rewards of the task by
    the weights that the policy gives the bodies. Bonuses at ends of episodes do not count, and episodes that were
    stopped are left out.
    """

    algorithm = Ascent
    alg: Ascent

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        check_gradients(self.env.env, self.group.size)
        if self.ppo.steps > (limit := self.env.env.max_episode_steps):
            raise ConfigError(f"method=gradients: ppo.steps={self.ppo.steps} is more than an episode has, {limit}.")
        self._gradients = Gradients(self.env.env.sim)
        _, slope, stopped = self._roll_out(*self.alg.look(self.env.reset())[1:], min(PROBE, self.ppo.steps))
        self.env.reset()
        if not bool(slope.any()) and not bool(stopped.any()):
            raise ConfigError(
                f"method=gradients: the rewards of {self.env.env.spec.id} have no derivative by the actions. What a"
                " robot pushes or carries has none, nor have contacts of voxels with each other."
            )
        self._targets = Targets(MEMORY * self.env.num_envs)
        self._found: dict[str, float] = {}

    def _roll_out(
        self, weights: torch.Tensor, actions: torch.Tensor, steps: int
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """So many control steps of episodes that have just begun.

        Returns:
            The returns ``[num_envs]``, their derivatives by the weights, and bool ``[num_envs]``: where an episode was
            stopped or derivatives are not finite. These derivatives are 0.
        """
        env, layout, inputs = self.env.env, self.alg.actor.layout, self.alg.actor.obs_normalizer.inputs
        leaf = weights.clone().requires_grad_()
        place = actions[..., None].expand(-1, -1, leaf.shape[2])
        by_action = leaf.new_zeros(len(leaf), layout.actions + 1, leaf.shape[2]).scatter(1, place, leaf)[:, :-1]
        state, total = self._gradients.state(), leaf.new_zeros(len(leaf))
        stopped = torch.zeros(self.env.num_envs, dtype=torch.bool, device=self.device)
        before = self._snapshot(state)
        for step in range(steps):
            outputs = CpgNetwork.motion(by_action, inputs.clock(leaf.new_full((1, 1), step)))
            state = self._gradients.step(state, ACTION_CENTER + self.ppo.action_scale * outputs)
            stopped |= env.sim.unstable
            after = self._snapshot(state)
            total = total + sum(term(before, after) * term.weight for term in env.spec.rewards)
            before = after
        (slope,) = torch.autograd.grad(total.sum(), leaf)
        stopped |= ~slope.isfinite().flatten(1).all(1)
        returns = total.detach().masked_fill(stopped, 0.0)
        return returns, slope.masked_fill(stopped[:, None, None], 0.0), stopped

    def _snapshot(self, state: torch.Tensor) -> Snapshot:
        """The state for rewards, differentiable."""
        return Snapshot(_Differentiated(**{name: partial(getattr(self._gradients, name), state) for name in DERIVED}))

    def _improve(self) -> None:
        self._collect()
        distance = self.alg.ascend(self._targets) if len(self._targets) else 0.0
        reached = 0.0 if self._found["unstable"] == self.env.num_envs else self._found["return_mean"]
        self.logger.losses = {"value": distance, "surrogate": -reached, "entropy": 0.0}
        self._exchange()

    def _collect(self) -> None:
        """Roll out, and give the bodies targets; all episodes have ended then."""
        bodies, weights, actions = self.alg.look(self.env.reset())
        returns, slope, stopped = self._roll_out(weights, actions, self.ppo.steps)
        norm = slope.flatten(1).norm(dim=1)
        known = ~stopped & (norm > 0)
        size = (bodies[..., DRIVEN].sum((1, 2)) * slope.shape[2]).sqrt()  # of a vector of ones for the body's weights
        targets = weights + (STEP * size / norm.clamp(min=TINY))[:, None, None] * slope
        if bool(known.any()):
            self._targets.add(bodies[known], targets[known])
        if self.bodies is not None:
            self.bodies.record(torch.ones_like(stopped), returns + self.env.env.spec.unstable_penalty * stopped)
        # NaN where all were stopped
        self._found = {"return_mean": float(returns[~stopped].mean()), "unstable": int(stopped.sum())}
        self.logger.means = {"Gradient/norm": float(norm.median()), "Episode/unstable": float(stopped.float().mean())}
        self.logger.ended = torch.ones_like(stopped)

    def state(self) -> dict[str, Any]:
        own = {"learner": self.alg.learner.state_dict(), "steps": self.alg.steps, "targets": self._targets.state()}
        return super().state() | {"ascent": own}

    def set_state(self, content: dict[str, Any]) -> None:
        super().set_state(content)
        if "env" not in content:
            return
        own: Any = content.get("ascent")
        check_like(own, {"learner": self.alg.learner.state_dict(), "steps": int, "targets": dict}, "ascent")
        bodies, weights, _ = self.alg.look(self.env.get_observations())
        shapes = {"bodies": bodies.shape[1:], "targets": weights.shape[1:]}
        if not any(map(len, own["targets"].values())):  # none yet
            shapes = dict.fromkeys(shapes, ())
        rows = {name: AnyTensor(torch.float32, (None, *shape)) for name, shape in shapes.items()}
        check_like(own["targets"], rows, "ascent.targets")
        if len({len(values) for values in own["targets"].values()}) > 1:
            raise RunError("Its ascent.targets are not as many as its bodies.")
        self.alg.learner.load_state_dict(own["learner"])
        self.alg.steps = own["steps"]
        self._targets.set_state(own["targets"])

    def _action_std(self) -> float:
        return 0.0

    def _episodes(self) -> dict[str, float]:
        return {"episodes": self.env.num_envs, "length_mean": self.ppo.steps, "diverged": 0} | self._found


class _Differentiated(SimpleNamespace):
    """The quantities of a state that are differentiated, in the place of a simulation."""

    def __getattr__(self, quantity: str) -> Any:
        raise ConfigError(f"method=gradients differentiates centres of mass and velocities, not {quantity}.")


def check_gradients(env: VoxelVecEnv, processes: int = 1) -> None:
    """Raise ConfigError where a training by gradients is not possible."""
    asked = {quantity[0] for quantity in env.episodes.before} | ({"memory"} if env.spec.memory else set())
    if not asked <= set(DERIVED):
        other = ", ".join(sorted(asked - set(DERIVED)))
        raise ConfigError(
            f"method=gradients differentiates rewards made of centres of mass and velocities; those of {env.spec.id}"
            f" are made of {other}, too."
        )
    if processes > 1:
        raise ConfigError(f"method=gradients learns in one process, not in {processes}.")
    try:
        Gradients.check(env.sim)
    except SimulationError as error:
        raise ConfigError(f"method=gradients: {error}") from None
