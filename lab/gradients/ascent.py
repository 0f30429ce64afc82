"""Training by gradients through the physics of a policy that depends on body and time only."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import nn

import warpvox as wv
from lab.gradients.cpg import DRIVEN, CpgNetwork, clock, describe_bodies
from warpvox.envs.snapshot import Snapshot

UNIVERSAL = Path(__file__).with_name("universal.pt")
"""Policy trained by ``train.py`` with its defaults, for bodies up to 5x5 on Walker-v0."""
DERIVED = ("com", "velocity")
"""State quantities with gradients, which rewards may use."""
CENTER, SCALE = 1.1, 0.5
"""Scaling of outputs to actions: ``CENTER + SCALE * output``."""
PROBE = 40
"""Control steps within which some reward must have a gradient."""
STEP = 0.25
"""Distance from a body's weights to the target, root mean square."""
ROLLOUTS = 16
"""Number of past rollouts whose targets are kept."""
BATCH = 256
"""Number of bodies per step of Adam."""
SMOOTHING = 0.995
"""Fraction of the averaged policy kept at each step of the learner."""
DECAY, MAX_GRAD_NORM = 0.01, 1.0
"""Weight decay and gradient clipping of the learner."""


class Motion:
    """Policy made of a network's weights for given bodies: a function of observations that end with the time.

    Args:
        weights: of the network for the bodies, ``[num_envs, cells, 1 + clock]``.
        bodies: ``[num_envs, cells, 10]``.
    """

    def __init__(self, weights: torch.Tensor, bodies: torch.Tensor) -> None:
        driven = bodies[..., DRIVEN].sum(-1) > 0
        cells = weights.shape[1]
        # actuators in row-major order; cells without one share the last column, which is dropped
        action = torch.where(driven, driven.long().cumsum(1) - 1, cells)
        place = action[..., None].expand(-1, -1, weights.shape[2])
        self.weights = weights.new_zeros(len(weights), cells + 1, weights.shape[2]).scatter(1, place, weights)[:, :-1]

    def at(self, time: torch.Tensor) -> torch.Tensor:
        """Compute actions ``[num_envs, cells]`` at times ``[num_envs or 1, 1]``."""
        swing = self.weights[..., 1:] * clock(time)[:, None]
        return CENTER + SCALE * torch.tanh(self.weights[..., 0] + swing.sum(-1))

    def __call__(self, obs: torch.Tensor) -> torch.Tensor:
        return self.at(obs[:, -1:].to(self.weights))


class Targets:
    """Replay buffer of training targets: bodies and weights; a repeated body replaces the old entry."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._known: dict[bytes, tuple[torch.Tensor, torch.Tensor]] = {}

    def __len__(self) -> int:
        return len(self._known)

    def add(self, bodies: torch.Tensor, targets: torch.Tensor) -> None:
        """Add bodies and weights, ``[rows, ...]`` each; of equal bodies the last row counts."""
        for body, target in zip(bodies, targets, strict=True):
            key = body.cpu().numpy().tobytes()
            self._known.pop(key, None)
            self._known[key] = body, target
        while len(self._known) > self.limit:
            self._known.pop(next(iter(self._known)))

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Sample bodies and targets at random, with torch's CPU generator."""
        pairs = list(self._known.values())
        chosen = [pairs[row] for row in torch.randint(len(pairs), (count,)).tolist()]
        return torch.stack([body for body, _ in chosen]), torch.stack([target for _, target in chosen])


def roll_out(
    env: Any, gradients: wv.Gradients, weights: torch.Tensor, bodies: torch.Tensor, steps: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Simulate the first control steps of episodes, and differentiate the sum of their rewards.

    Bonuses at ends of episodes do not count.

    Returns:
        The returns ``[num_envs]``, their derivatives by the weights, and bool ``[num_envs]``: where an episode was
        stopped or derivatives are not finite. These returns and derivatives are 0.
    """
    leaf = weights.clone().requires_grad_()
    motion = Motion(leaf, bodies)
    state = gradients.state()
    total = leaf.new_zeros(len(leaf))
    stopped = torch.zeros(len(leaf), dtype=torch.bool, device=leaf.device)
    before = _snapshot(gradients, state)
    for step in range(steps):
        state = gradients.step(state, motion.at(leaf.new_full((1, 1), step)))
        stopped |= env.sim.unstable
        after = _snapshot(gradients, state)
        total = total + sum(term(before, after) * term.weight for term in env.spec.rewards)
        before = after
    (slope,) = torch.autograd.grad(total.sum(), leaf)
    stopped |= ~slope.isfinite().flatten(1).all(1)
    returns = total.detach().masked_fill(stopped, 0.0)
    return returns, slope.masked_fill(stopped[:, None, None], 0.0), stopped


def _snapshot(gradients: wv.Gradients, state: torch.Tensor) -> Snapshot:
    """Build a differentiable state for rewards."""
    return Snapshot(_Differentiated(**{name: partial(getattr(gradients, name), state) for name in DERIVED}))


class _Differentiated(SimpleNamespace):
    """Differentiable replacement of a simulation for rewards."""

    def __getattr__(self, quantity: str) -> Any:
        raise wv.ConfigError(f"Rewards made of centres of mass and velocities are differentiated, not of {quantity}.")


class Ascent:
    """Trains one policy by the gradients of the rewards in the first control steps.

    In each iteration all environments begin an episode, and each body gets a target: the weights that the network gives
    it, and :data:`STEP` along the derivative of its return. A copy of the network, the learner, is fitted to the
    targets of the last :data:`ROLLOUTS` iterations by ``updates`` steps of Adam, each for :data:`BATCH` bodies at most.
    The policy is the mean of the learner's parameters over its last steps.

    Args:
        network: the policy, which is trained in place.
        env: of :func:`make_env`, with ``layout="lanes"``.
        iterations: over which the learning rate falls to 0, linearly; None: it stays.

    Raises:
        ConfigError: the rewards have no derivative by the actions. SimulationError: see :class:`warpvox.Gradients`.
    """

    def __init__(
        self,
        network: CpgNetwork,
        env: Any,
        steps: int = 120,
        updates: int = 24,
        learning_rate: float = 1e-3,
        iterations: int | None = None,
    ) -> None:
        self.network, self.env, self.steps, self.updates = network, env, steps, updates
        self.learning_rate, self.iterations = learning_rate, iterations
        self.learner = copy.deepcopy(network)
        self.learner.response = network.response  # known responses are known to both
        parameters = self.learner.parameters()
        self.optimizer = torch.optim.AdamW(parameters, learning_rate, (0.9, 0.99), weight_decay=DECAY, fused=True)
        self.gradients = wv.Gradients(env.sim)
        self.targets = Targets(ROLLOUTS * env.num_envs)
        self.done = self.made = 0
        self._check()

    def _check(self) -> None:
        name, steps = self.env.spec.id, self.steps
        if self.env.spec.memory:
            raise wv.ConfigError(f"The rewards of {name} depend on its memory, which is not differentiated.")
        if steps > self.env.max_episode_steps:
            raise wv.ConfigError(f"steps={steps} is more than an episode has, {self.env.max_episode_steps}.")
        bodies, weights = self.look()
        self.env.reset()
        _, slope, stopped = roll_out(self.env, self.gradients, weights, bodies, min(PROBE, steps))
        if not bool(slope.any()) and not bool(stopped.any()):
            raise wv.ConfigError(
                f"The rewards of {name} have no derivative by the actions. What a robot pushes or carries has none, nor"
                " have contacts of voxels with each other."
            )

    def look(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the bodies' descriptions ``[num_envs, cells, 10]``, and the network's weights for them."""
        designs = [self.env.designs[number] for number in self.env.design_index.tolist()]
        bodies = describe_bodies(pad_bodies(designs, self.network.shape)).to(self.env.device)
        with torch.no_grad():
            return bodies, self.network(bodies)

    def iterate(self) -> dict[str, float]:
        """Run one iteration: simulate, set targets, fit the learner.

        Returns:
            ``return``: the mean return of the first control steps (NaN: all were stopped), ``stopped``: the number of
            episodes that were, ``distance``: the mean squared distance to the targets.
        """
        # Rollout
        bodies, weights = self.look()
        self.env.reset()
        returns, slope, stopped = roll_out(self.env, self.gradients, weights, bodies, self.steps)

        # Targets
        norm = slope.flatten(1).norm(dim=1)
        known = ~stopped & (norm > 0)
        size = (bodies[..., DRIVEN].sum((1, 2)) * slope.shape[2]).sqrt()  # of a vector of ones for the body's weights
        targets = weights + (STEP * size / norm.clamp(min=1e-12))[:, None, None] * slope
        self.targets.add(bodies[known], targets[known])

        # Learning
        if self.iterations is not None:
            for group in self.optimizer.param_groups:
                group["lr"] = self.learning_rate * max(0.0, 1 - self.done / self.iterations)
        distance = self._fit() if len(self.targets) else 0.0
        self.done += 1
        return {"return": float(returns[~stopped].mean()), "stopped": int(stopped.sum()), "distance": distance}

    def _fit(self) -> float:
        total = 0.0
        for _ in range(self.updates):
            bodies, wanted = self.targets.draw(min(BATCH, len(self.targets)))
            driven = bodies[..., DRIVEN].sum(-1, keepdim=True)
            apart = ((self.learner(bodies) - wanted).square() * driven).sum()
            loss = apart / (driven.sum().clamp(min=1) * wanted.shape[2])
            self.optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.learner.parameters(), MAX_GRAD_NORM)
            self.optimizer.step()
            self.made += 1
            share = max(1 - SMOOTHING, 9 / (self.made + 9))  # the policy follows the learner, faster at first
            for mean, value in zip(self.network.parameters(), self.learner.parameters(), strict=True):
                mean.data.lerp_(value.data, share)
            total += loss.item() / self.updates
        return total


def make_env(task: Any, bodies: Sequence[Any], shape: tuple[int, int], **options: Any) -> Any:
    """Create differentiable environments, one for each body, with the time as observation."""
    settings = {"obs": "timed_voxel", "layout": "lanes", "arithmetic": "fast", "auto_reset": False} | options
    return wv.make_vec(task, list(bodies), len(bodies), grid=shape, **settings)


def judge(network: CpgNetwork, env: Any, bodies: Sequence[Any]) -> np.ndarray:
    """Return each body's return in one episode, ``[num_envs]``; ``env`` has these bodies and ``auto_reset=False``."""
    described = describe_bodies(pad_bodies(bodies, network.shape)).to(env.device)
    with torch.no_grad():
        motion = Motion(network(described), described)
        obs, _ = env.reset()
        for _ in range(env.max_episode_steps):
            obs, _, terminated, truncated, info = env.step(motion(obs))
            if bool((terminated | truncated).all()):
                break
    return info["episode"]["return"].cpu().numpy()


def pad_bodies(bodies: Sequence[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """Place bodies in the upper left corner of a grid of ``shape``, ``[n, rows, columns]``."""
    grids = np.zeros((len(bodies), *shape), np.int64)
    for grid, body in zip(grids, bodies, strict=True):
        rows, columns = body.shape
        if rows > shape[0] or columns > shape[1]:
            raise wv.DesignError(f"A body of {rows}x{columns} cells does not fit into the policy's grid {shape}.")
        grid[:rows, :columns] = body
    return grids


def load_network(file: str | Path = UNIVERSAL, shape: tuple[int, int] = (5, 5)) -> CpgNetwork:
    """Load a network for a grid of ``shape`` from a file of ``train.py`` (default: the packaged one)."""
    network = CpgNetwork(*shape)
    network.load_state_dict(torch.load(file, weights_only=True))
    return network
