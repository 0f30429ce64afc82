"""Trained policies as plain torch modules, and as one text that holds all of a policy."""

import base64
import binascii
import copy
import json
from collections.abc import Mapping
from dataclasses import asdict
from itertools import chain
from typing import Any, ClassVar, cast

import numpy as np
import torch
from rsl_rl.modules import MLP, EmpiricalNormalization
from torch import nn

from warpvox.algos.checkpoints.files import (
    Controller,
    PolicySpec,
    build_actor,
    check_sizes,
    check_spec,
    spec_of,
    with_code,
)
from warpvox.algos.generators import Generators
from warpvox.algos.policies.model import VoxelModel
from warpvox.checks import is_number
from warpvox.design import Design, load_design
from warpvox.devices.startup import own_torch
from warpvox.envs.adapters.rsl_rl import OBS_GROUP
from warpvox.errors import ConfigError, RunError, first_line
from warpvox.io.reading import Unreadable, parse_json
from warpvox.robots.network import HIGH, LOW
from warpvox.types import ACTION_CENTER, ACTION_HIGH, ACTION_LOW

FORMAT, VERSION = "warpvox policy", 2
LARGEST = 1 << 28
"""Bytes that the text of a policy may have."""


class Layers(nn.Module):
    """Fully connected layers behind normalised observations; TorchScript compiles them."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__()
        self.mlp = nn.Sequential(*MLP(spec.num_obs, spec.num_actions, list(spec.hidden), spec.activation))
        self.register_buffer("mean", torch.zeros(spec.num_obs))
        self.register_buffer("deviation", torch.ones(spec.num_obs))
        # added where it is used, so that in float64 the sum is that of training
        self.eps = EmpiricalNormalization(1).eps if spec.normalize_obs else 0.0

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Outputs ``[..., num_actions]`` of observations ``[..., num_obs]``."""
        return self.mlp((obs.to(self.mean.dtype) - self.mean) / (self.deviation + self.eps))

    def random_obs(self, rows: int, generator: torch.Generator) -> torch.Tensor:
        """Observations ``[rows, num_obs]`` farther apart than those of training."""
        return self.mean + 3 * (self.deviation + self.eps) * torch.randn((rows, len(self.mean)), generator=generator)


class Actor(nn.Module):
    """The very model of a checkpoint: a network for voxels, an open-loop gait or recurrent layers."""

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__()
        self.num_obs, self.num_actions = spec.num_obs, spec.num_actions
        self.model: Any = build_actor(spec)

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Outputs ``[..., num_actions]`` of observations ``[..., num_obs]``."""
        rows = obs.to(next(chain(self.parameters(), self.buffers())).dtype).reshape(-1, self.num_obs)
        return self.model({OBS_GROUP: rows}).reshape((*obs.shape[:-1], self.num_actions))

    def random_obs(self, rows: int, generator: torch.Generator) -> torch.Tensor:
        """Observations ``[rows, num_obs]`` of random bodies or at random times."""
        if isinstance(self.model, VoxelModel):
            return self.model.layout.random_obs(rows, generator)
        return torch.randint(0, 1000, (rows, self.num_obs), generator=generator).float()


class Policy(nn.Module):
    """A trained policy without exploration: observations as an environment gives them to actions that it takes.

    Normalises the observations as in training, and gives target lengths of the actuators in [0.6, 1.6]. A plain module
    for ``torch.jit.script``, ``torch.jit.trace`` and ``torch.onnx``; its parameters ask for no gradients until
    ``requires_grad_()`` is called.

    Args:
        spec: sizes and kind of the network.
        metadata: what is known about the training, by name.

    Attributes:
        num_obs, num_actions: sizes.
        metadata: for instance ``task``, ``rules``, ``obs`` and ``design`` of the run.
    """

    # TorchScript would compile the one, and read the other
    __jit_unused_properties__: ClassVar = ["design"]
    __jit_ignored_attributes__: ClassVar = ["design"]

    def __init__(self, spec: PolicySpec, metadata: Mapping[str, Any] | None = None) -> None:
        super().__init__()
        self.spec, self.metadata = spec, dict(metadata or {})
        self.num_obs, self.num_actions = spec.num_obs, spec.num_actions
        self.center, self.scale = ACTION_CENTER, float(spec.action_scale)
        self.low, self.high = ACTION_LOW, ACTION_HIGH
        step = self.metadata.get("action_step")
        self.step = float(step) if is_number(step) else 0.0
        self.lowest, self.highest = LOW, HIGH
        self.network = Layers(spec) if spec.is_mlp else Actor(spec)
        self.eval().requires_grad_(False)

    def __call__(self, obs: torch.Tensor | np.ndarray, *more: Any) -> Any:
        """:meth:`forward` of a tensor, :meth:`act` of an array.

        Raises:
            ConfigError: observations of another width.
        """
        traced = torch.jit.is_tracing()  # pyright: ignore[reportPrivateImportUsage]  # documented, but not in __all__
        if not traced and obs.shape[-1:] != (self.num_obs,):
            raise ConfigError(f"The policy takes observations [..., {self.num_obs}], got shape {list(obs.shape)}.")
        return self.act(obs) if isinstance(obs, np.ndarray) else super().__call__(obs, *more)

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Observations ``[..., num_obs]`` to actions ``[..., num_actions]``, float32.

        In float64 the policy of a stored robot gives float64: the very actions of the robot.
        """
        outputs = self.network(obs)
        if self.step > 0.0 and outputs.dtype == torch.float64:
            steps = torch.round((self.center + self.scale * outputs) / self.step)
            return (steps * self.step).clamp(self.lowest, self.highest)
        return (self.center + self.scale * outputs.float()).clamp(self.low, self.high)

    @property
    def design(self) -> Design | dict[str, Design] | None:
        """The body that it was trained for, or bodies by the names of robots; None: no single one is known.

        It never raises, as TorchScript reads all properties.
        """
        body = self.metadata.get("design")
        if body is None or self.metadata.get("connections") is not None:
            return None
        if isinstance(body, Mapping):
            return {str(name): load_design(cells) for name, cells in body.items()}
        return load_design(body)

    def in_float64(self) -> "Policy":
        """A copy whose network runs in float64, as runs are played: actions do not depend on what is in a batch.

        See :class:`warpvox.algos.checkpoints.files.Controller`, which gives the same actions.
        """
        if self.spec.rnn is None:
            return copy.deepcopy(self).double()
        model: Any = self.network.model
        memory = model.get_hidden_state()
        self.reset()  # it may have a history of derivatives, which cannot be copied
        copied = copy.deepcopy(self).double()
        model.reset(None, memory)
        return copied

    def reset(self, done: torch.Tensor | None = None) -> None:
        """Begin new episodes, where ``done`` (bool ``[n]``) says so or everywhere; only recurrent layers remember."""
        if self.spec.rnn is not None:
            cast(Any, self.network.model).reset(done)

    def act(self, obs: np.ndarray) -> np.ndarray:
        """:meth:`forward` for numpy arrays, as gymnasium's environments have them."""
        with torch.no_grad():
            device = next(iter(self.state_dict().values())).device
            return self(torch.as_tensor(np.asarray(obs), device=device)).cpu().numpy()


def make_policy(spec: PolicySpec, metadata: Mapping[str, Any] | None = None) -> Policy:
    """A policy of the kind that ``spec`` describes, with weights that are to be replaced."""
    with own_torch(), Generators(0):
        return Policy(spec, metadata)


def policy_of(controller: Controller, metadata: Mapping[str, Any] | None = None) -> Policy:
    """The policy of a checkpoint's controller; its numbers are copies."""
    policy, state = make_policy(controller.spec, metadata), controller.actor.state_dict()
    if isinstance(policy.network, Actor):
        policy.network.model.load_state_dict(state)
    else:
        weights = {name: value for name, value in state.items() if name.startswith("mlp.")}
        normalizer = controller.actor.obs_normalizer
        if isinstance(normalizer, EmpiricalNormalization):
            weights |= {"mean": normalizer.mean, "deviation": normalizer.std}
        policy.network.load_state_dict(policy.network.state_dict() | weights)
    return policy.to(next(iter(state.values())).device)


def policy_text(policy: Policy) -> str:
    """A policy as one line of JSON; its numbers are float32, little-endian, in base64."""
    weights = {
        name: base64.b64encode(value.detach().cpu().numpy().astype("<f4").tobytes()).decode()
        for name, value in getattr(policy.network, "model", policy.network).state_dict().items()
    }
    content = {"format": FORMAT, "version": VERSION, "policy": asdict(policy.spec), "metadata": policy.metadata}
    return json.dumps(content | {"weights": weights})


def parse_policy(text: str, source: object, network: str | None = None) -> Policy:
    """The policy that :func:`policy_text` has written; ``source`` names the file in errors.

    ``network``: as for :func:`warpvox.algos.checkpoints.files.load_controller`.
    """
    try:
        content = parse_json(text)
        version = content.get("version") if isinstance(content, dict) and content.get("format") == FORMAT else None
        if version != VERSION:
            raise ValueError(f"it is not a '{FORMAT}' of version {VERSION}")
        given, metadata = content.get("policy"), content.get("metadata")
        if not isinstance(given, dict) or not isinstance(metadata, dict):
            raise ValueError("it has no description of the network")
        spec = with_code(spec_of(given), network)
        check_sizes(spec)
        with torch.device("meta"):  # without memory for the weights
            model = Layers(spec) if spec.is_mlp else build_actor(spec, "meta")
        weights = _weights(model.state_dict(), content.get("weights"))
        check_spec(spec, weights, model)
        policy = make_policy(spec, metadata)
        getattr(policy.network, "model", policy.network).load_state_dict(weights)
    except (Unreadable, TypeError, ValueError, RuntimeError, LookupError, AttributeError) as error:
        raise RunError(f"{source} holds no policy that can be read ({first_line(error):.200}).") from None
    return policy


def _weights(known: Mapping[str, torch.Tensor], given: Any) -> dict[str, torch.Tensor]:
    """The tensors of a policy's text; ``known`` has their names, shapes and types."""
    if not isinstance(given, dict) or not all(isinstance(value, str) for value in given.values()):
        raise ValueError("it has no weights")
    weights: dict[str, torch.Tensor] = {}
    for name, value in given.items():
        try:
            numbers = np.frombuffer(base64.b64decode(value, validate=True), "<f4").astype(np.float32)
        except (binascii.Error, ValueError):
            raise ValueError(f"the numbers of '{name:.40}' are damaged") from None
        like = known[name]
        if numbers.size != like.numel():
            raise ValueError(f"'{name:.40}' has {numbers.size} numbers, not {like.numel()}")
        weights[name] = torch.from_numpy(numbers.reshape(like.shape)).to(like.dtype)
    return weights
