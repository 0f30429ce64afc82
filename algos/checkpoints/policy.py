"""Trained policies as plain torch modules, and as files."""

import copy
import io
import math
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
import torch
from rsl_rl.modules import MLP, EmpiricalNormalization
from torch import nn

from warpvox.algos.checkpoints.files import (
    PolicySpec,
    build_actor,
    check_spec,
    load_checkpoint,
    spec_dict,
    spec_of,
    with_code,
)
from warpvox.algos.generators import Generators
from warpvox.algos.policies.model import VoxelModel
from warpvox.design import Design, load_design
from warpvox.devices.startup import own_torch
from warpvox.envs.adapters.rsl_rl import OBS_GROUP
from warpvox.errors import ConfigError, RunError, first_line
from warpvox.types import ACTION_HIGH, ACTION_LOW


class Layers(nn.Module):
    """Fully connected layers behind normalised observations, compilable by TorchScript.

    Its state has the names of rsl-rl's ``MLPModel``, but no exploration.
    """

    def __init__(self, spec: PolicySpec) -> None:
        """Create the layers described by ``spec``, with weights still to be loaded."""
        super().__init__()
        self.obs_normalizer = nn.Identity()
        if spec.normalize_obs:
            self.obs_normalizer = EmpiricalNormalization(spec.num_obs, spec.obs_eps)
        self.mlp = nn.Sequential(*MLP(spec.num_obs, spec.num_actions, list(spec.hidden), spec.activation))

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Compute outputs ``[..., num_actions]`` from observations ``[..., num_obs]``."""
        dtype = self.mlp[0].weight.dtype
        rows = obs.to(dtype)  # pyright: ignore[reportCallIssue, reportArgumentType]
        scaled = self.obs_normalizer(rows).reshape(obs.shape)  # the normaliser turns a single observation into a row
        return self.mlp(scaled)

    def random_obs(self, rows: int, generator: torch.Generator) -> torch.Tensor:
        """Draw observations ``[rows, num_obs]`` with a wider spread than in training."""
        first = cast(nn.Linear, self.mlp[0])
        obs = 3 * torch.randn((rows, first.in_features), generator=generator)
        normalizer = self.obs_normalizer
        if isinstance(normalizer, EmpiricalNormalization):
            return normalizer.mean + (normalizer.std + normalizer.eps) * obs
        return obs


class Actor(nn.Module):
    """Network of a policy that is no MLP: a voxel network, an open-loop gait or recurrent layers."""

    def __init__(self, spec: PolicySpec) -> None:
        """Create the network described by ``spec``, with weights still to be loaded."""
        super().__init__()
        self.num_obs = spec.num_obs
        self.num_actions = spec.num_actions
        self.model: Any = build_actor(spec)

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Compute outputs ``[..., num_actions]`` from observations ``[..., num_obs]``."""
        dtype = next(chain(self.parameters(), self.buffers())).dtype
        rows = obs.to(dtype).reshape(-1, obs.shape[-1])
        return self.model({OBS_GROUP: rows}).reshape((*obs.shape[:-1], self.num_actions))

    def random_obs(self, rows: int, generator: torch.Generator) -> torch.Tensor:
        """Draw observations ``[rows, num_obs]`` of random bodies or at random times."""
        if isinstance(self.model, VoxelModel):
            return self.model.layout.random_obs(rows, generator)
        return torch.randint(0, 1000, (rows, self.num_obs), generator=generator).float()


class Policy(nn.Module):
    """A trained policy without exploration: maps observations to an environment's actions.

    Normalises the observations as in training, and gives target lengths of the actuators in [0.6, 1.6]. A plain module
    for ``torch.jit.script``, ``torch.jit.trace`` and ``torch.onnx``; its parameters ask for no gradients until
    ``requires_grad_()`` is called.

    Runs are played in float64 (:meth:`in_float64`): how the sums of a network are rounded depends on the size of the
    batch and the CPU, and contacts would magnify that. An evaluation during training and a later one thus give the same
    actions, whatever else is in their batches.

    Args:
        spec: sizes and kind of the network.
        state: of the network, as the actor of a checkpoint; the values are copied.
        metadata: facts about the training, by name.

    Attributes:
        num_obs, num_actions: sizes.
        metadata: for instance ``task``, ``rules``, ``obs`` and ``design`` of the run.
    """

    # TorchScript would compile these properties and read their values.
    __jit_unused_properties__: ClassVar = ["actor", "design"]
    __jit_ignored_attributes__: ClassVar = ["actor", "design"]

    def __init__(
        self, spec: PolicySpec, state: Mapping[str, torch.Tensor], metadata: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__()
        self.spec = spec
        self.metadata = dict(metadata or {})
        self.num_obs = spec.num_obs
        self.num_actions = spec.num_actions
        self.center = float(spec.action_center)
        self.scale = float(spec.action_scale)
        self.step = float(spec.action_step)
        self.low = ACTION_LOW
        self.high = ACTION_HIGH
        if self.step > 0.0:  # round the limits to multiples of the step inside the range
            self.low = math.ceil(ACTION_LOW / self.step) * self.step
            self.high = math.floor(ACTION_HIGH / self.step) * self.step
        with own_torch(), Generators(0):
            self.network = Layers(spec) if spec.is_mlp else Actor(spec)
        without_exploration = {name: value for name, value in state.items() if not name.startswith("distribution.")}
        self.actor.load_state_dict(without_exploration if spec.is_mlp else state)
        self.eval().requires_grad_(False)

    def __repr__(self) -> str:
        task = f"{self.metadata['task']}, " if "task" in self.metadata else ""
        return f"Policy({task}{self.num_obs} observations, {self.num_actions} actions)"

    def __call__(self, obs: torch.Tensor | np.ndarray, *more: Any) -> Any:
        """Compute actions: by :meth:`forward` for a tensor, by :meth:`act` for an array.

        Raises:
            ConfigError: observations of another width.
        """
        traced = torch.jit.is_tracing()  # pyright: ignore[reportPrivateImportUsage]  # documented, but not in __all__
        if not traced and not self.fits(obs.shape[-1] if obs.ndim else 0):
            raise ConfigError(f"The policy takes observations [..., {self.num_obs}], got shape {list(obs.shape)}.")
        return self.act(obs) if isinstance(obs, np.ndarray) else super().__call__(obs, *more)

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Map observations ``[..., num_obs]`` to actions ``[..., num_actions]``, float32.

        In float64 a policy whose actions are multiples of a step gives float64.
        """
        outputs = self.network(obs)
        if self.step > 0.0 and outputs.dtype == torch.float64:
            steps = torch.round((self.center + self.scale * outputs) / self.step)
            return (steps * self.step).clamp(self.low, self.high)
        return (self.center + self.scale * outputs.float()).clamp(self.low, self.high)

    @property
    def actor(self) -> Any:
        """Network with the state of a checkpoint's actor."""
        return self.network if isinstance(self.network, Layers) else self.network.model

    @property
    def design(self) -> Design | dict[str, Design] | None:
        """Body that the policy was trained for, or bodies by robot name; None: many bodies or unknown.

        It never raises, as TorchScript reads all properties.
        """
        body = self.metadata.get("design")
        if body is None or self.metadata.get("connections") is not None:
            return None
        if isinstance(body, Mapping):
            return {str(name): load_design(cells) for name, cells in body.items()}
        return load_design(body)

    def in_float64(self) -> "Policy":
        """Copy the policy with its network in float64 and recurrent layers reset."""
        if self.spec.rnn is None:
            return copy.deepcopy(self).double()
        memory = self.actor.get_hidden_state()
        self.reset()  # hidden states may have an autograd history, which cannot be copied
        copied = copy.deepcopy(self).double()
        self.actor.reset(None, memory)
        return copied

    def reset(self, done: torch.Tensor | None = None) -> None:
        """Clear the memory of recurrent layers, everywhere or where ``done`` (bool ``[n]``) is True."""
        if self.spec.rnn is not None:
            self.actor.reset(done)

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Compute actions as a NumPy array from NumPy observations, as for Gymnasium's environments."""
        with torch.no_grad():
            device = next(chain(self.parameters(), self.buffers())).device
            return self(torch.as_tensor(np.asarray(obs), device=device)).cpu().numpy()

    def fits(self, num_obs: int) -> bool:
        """Return whether the policy accepts ``num_obs`` observations; a gait of the time alone accepts any number."""
        return self.num_obs == num_obs or (self.spec.gait is not None and self.num_obs == 1)

    def check_sizes(self, num_obs: int, num_actions: int) -> None:
        """Raise RunError unless the policy fits environments with these sizes."""
        if not self.fits(num_obs) or self.num_actions != num_actions:
            raise RunError(
                f"The policy has {self.num_obs} observations and {self.num_actions} actions; the task and design have"
                f" {num_obs} and {num_actions}."
            )


def read_policy(
    path: Path, device: str = "cpu", network: str | None = None, metadata: Mapping[str, Any] | None = None
) -> Policy:
    """Read the policy in a checkpoint, or in a file made of :func:`policy_bytes`.

    Args:
        network: ``FILE.py:Class`` or ``module:Class`` of a network that is not warpvox's own; a checkpoint that needs
            one does not say where code is imported from.
        metadata: of the policy; None: what the file says.

    Raises:
        RunError: no such file, or it holds no policy that can be read.
    """
    return policy_of(load_checkpoint(path, device), path, network, metadata)


def policy_of(
    content: Mapping[str, Any], source: object, network: str | None = None, metadata: Mapping[str, Any] | None = None
) -> Policy:
    """Build the policy from a checkpoint's content; ``source`` names the file in errors."""
    try:
        spec = spec_of(content["policy"])
        known = content.get("metadata", {}) if metadata is None else metadata
        if not isinstance(known, Mapping):
            raise TypeError(f"its metadata are {known!r:.40}")
    except TypeError as error:
        raise RunError(f"{source} holds a policy of another kind ({first_line(error):.120}).") from None
    spec = with_code(spec, network)
    try:
        state = content["actor_state_dict"]
        check_spec(spec, state)
        return Policy(spec, state, known).to(next(iter(state.values())).device)
    except (TypeError, ValueError, RuntimeError, LookupError, AttributeError) as error:
        raise RunError(f"{source} holds a policy of another kind ({first_line(error):.120}).") from None


def policy_bytes(policy: Policy) -> bytes:
    """Serialise a policy for :func:`read_policy`."""
    whole = io.BytesIO()
    state = {name: value.detach().cpu() for name, value in policy.actor.state_dict().items()}
    content = {"policy": spec_dict(policy.spec), "actor_state_dict": state, "metadata": policy.metadata}
    torch.save(content, whole)
    return whole.getvalue()
