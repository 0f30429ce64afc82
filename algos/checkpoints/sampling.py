"""A trained policy with the exploration that it was trained with."""

from __future__ import annotations

import torch

from warpvox.algos.checkpoints.files import Controller, actions_of
from warpvox.errors import ConfigError

__all__ = ["SampledController"]


class SampledController:
    """Draws actions from the Gaussian distribution of a policy, instead of taking its mean.

    Args:
        controller: the policy.
        seed: of the draws; equal seeds give equal actions for equal observations on the same device.

    Raises:
        ConfigError: the policy is an open-loop gait, which was found without exploration.
    """

    def __init__(self, controller: Controller, seed: int = 0) -> None:
        self.controller, self.spec, self.reset = controller, controller.spec, controller.reset
        if self.spec.gait is not None:
            raise ConfigError("stochastic=true goes with a trained policy; this one is an open-loop gait.")
        distribution = controller.actor.distribution
        low, high = distribution.log_std_range
        self._std = distribution.log_std_param.detach().clamp(low, high).exp()
        self._generator = torch.Generator(self._std.device).manual_seed(seed)

    @torch.no_grad()
    def __call__(self, obs: torch.Tensor) -> torch.Tensor:
        """``obs`` ``[n, num_obs]`` to actions ``[n, num_actions]`` in [0.6, 1.6]."""
        mean = self.controller.outputs(obs)
        noise = torch.randn(mean.shape, generator=self._generator, device=mean.device)
        return actions_of(mean + self._deviation() * noise, self.spec.action_scale)

    def _deviation(self) -> torch.Tensor:
        """Of each action; that of a policy for voxels belongs to the type of an actuator."""
        if self.spec.voxels is None:
            return self._std
        return self.controller.actor.distribution.by_kind(self._std, 0.0).to(self._std.dtype)
