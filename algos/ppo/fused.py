"""PPO for many designs on CUDA: the formulas of :mod:`warpvox.algos.ppo.population` in few, large launches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import torch
import warp as wp
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import nn

from warpvox.algos.policies.network import observations
from warpvox.algos.ppo.adam import VectorAdam
from warpvox.algos.ppo.networks import Normalizer
from warpvox.algos.ppo.population import PopulationPPO, Samples
from warpvox.kernels import device, ppo


class StackedAdam(VectorAdam):
    """Adam for policies and value functions of equal depth: a row for each network, those of policies first.

    Value functions have as many outputs as policies; all but the first are 0 and stay 0. So all networks are one stack,
    and a layer of all of them is one matrix product.
    """

    def finite(self) -> torch.Tensor:
        return torch.isfinite(self._values).all(1).view(2, -1).all(0)

    def layers(self) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Return weights and biases of each layer, ``[2 * designs, ...]``: leaves of autograd that share the matrix."""
        *parts, _ = self._columns(self._values, [parameter.shape for parameter in self._groups[0]])
        leaves = [part.detach().requires_grad_() for part in parts]
        return leaves[: len(leaves) // 2], leaves[len(leaves) // 2 :]

    def flat(self, tensors: Sequence[torch.Tensor]) -> torch.Tensor:
        """Copy tensors with the shapes of :attr:`parameters` to a matrix with a row for each network."""
        shapes = [tensor.shape for tensor in tensors]
        size = sum(shape[1:].numel() for shape in shapes[: len(self._groups[0])])
        matrix = tensors[0].new_zeros(2 * len(tensors[0]), size)
        for tensor, (_, part) in zip(tensors, self._parts(matrix, shapes), strict=True):
            part.copy_(tensor)
        return matrix

    def _parts(self, matrix: torch.Tensor, shapes: Sequence[torch.Size]) -> Iterator[tuple[nn.Parameter, torch.Tensor]]:
        """Yield each parameter with the part of ``matrix`` that belongs to it, in the shape given."""
        count = len(self._groups[0])
        columns = self._columns(matrix, shapes[:count])
        for k, (parameter, shape) in enumerate(zip(self.parameters, shapes, strict=True)):
            network, column = divmod(k, count)
            both = columns[column].unflatten(0, (2, -1))
            yield parameter, both[network, ..., : shape[2]]

    @staticmethod
    def _columns(matrix: torch.Tensor, shapes: Sequence[torch.Size]) -> list[torch.Tensor]:
        """Return the parts of a matrix that belong to parameters of policies with these shapes: all of its columns."""
        parts = matrix.split([shape[1:].numel() for shape in shapes], dim=1)
        return [part.unflatten(1, tuple(shape[1:])) for part, shape in zip(parts, shapes, strict=True)]

    @torch.no_grad()
    def descend_all(self, gradient: torch.Tensor, limit: float, rates: torch.Tensor, number: int) -> None:
        """Do a step of Adam for all networks, with the gradient of each clipped to a norm of ``limit``.

        Args:
            gradient: float32 ``[2 * designs, parameters]``.
            rates: learning rates, float64 ``[designs]``.
            number: index of the step among those prepared, from 0.
        """
        norms = torch.linalg.vector_norm(gradient, dim=1)
        inputs = (gradient, norms, limit, rates, self._corrections[number], self.eps)
        _launch(ppo.descend, gradient.shape, *inputs, self._values, self._means, self._squares)


class FusedPPO(PopulationPPO):
    """:class:`PopulationPPO` in few launches, for CUDA: its results up to rounding, without waiting for the device.

    Policies and value functions are batched in one matrix product a layer, and what lies between the products is done
    by the kernels of :mod:`warpvox.kernels.ppo`. Networks must be in float32.
    """

    adam = StackedAdam
    optimizer: StackedAdam

    def _use_storage(self, storage: RolloutStorage) -> None:
        """Use ``storage`` for rollouts from now on, and prepare what kernels take beside it."""
        super()._use_storage(storage)
        self._widths = torch.tensor(self.actor.outputs, dtype=torch.int32, device=self.device)
        self._log_std = self.actor.distribution.log_std_param.detach()[:, 0]
        # Moments by which inputs are scaled: without a normaliser those that change nothing
        normalizer = self.actor.obs_normalizer
        if isinstance(normalizer, Normalizer):
            self._moments = (normalizer._mean[:, 0], normalizer._std[:, 0], normalizer.eps)
        else:
            one = torch.ones((self.num_designs, self._inputs.shape[-1]), device=self.device)
            self._moments = (torch.zeros_like(one), one, 0.0)
        self._losses = ppo.Losses()
        self._losses.clip = self.clip_param
        self._losses.value_coef = self.value_loss_coef
        self._losses.clip_values = int(self.use_clipped_value_loss)
        self._losses.entropy_coef = self.entropy_coef
        self._losses.limits = wp.vec2(*self.actor.distribution.limits)

    def _scaled(self, obs: TensorDict, scaled: torch.Tensor) -> torch.Tensor:
        """Write the inputs of networks for observations to ``scaled`` ``[rows, num_obs]``; return them by design."""
        _launch(ppo.normalize, scaled.shape, observations(self.actor, obs), *self._moments, scaled)
        return scaled.unflatten(0, (self.num_designs, -1))

    @torch.no_grad()
    def act(self, obs: TensorDict) -> torch.Tensor:
        """Draw actions; record them with observations, inputs, means and log-probabilities."""
        storage = self.storage
        step = storage.step
        for name, values in obs.items():
            storage.observations[name][step] = values
        mean = self.actor.run(self._scaled(obs, self._inputs[step])).flatten(0, 1)
        if step == 0:
            envs = len(mean) // self.num_designs
            self._noise = self.streams.normal(storage.num_transitions_per_env, envs, self.actor.outputs)
        noise = self._noise[step].flatten(0, 1)
        policy = (self._log_std, self._losses.limits, self._widths)
        actions = storage.actions[step]
        log_prob = storage.actions_log_prob[step, :, 0]
        _launch(ppo.draw_actions, len(mean), mean, noise, *policy, self._means[step], actions, log_prob)
        return actions

    @torch.no_grad()
    def process_env_step(
        self, obs: TensorDict, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, Any]
    ) -> None:
        """Record a step; where only the time limit has ended an episode, add the value of its final state."""
        storage = self.storage
        time_outs = dones[:0]
        values = rewards[:0]
        if "time_outs" in extras:
            time_outs = extras["time_outs"]
            values = self._values_of(extras["final_obs"])
        reward = storage.rewards[storage.step, :, 0]
        done = storage.dones[storage.step, :, 0]
        _launch(ppo.record_step, len(rewards), rewards, dones, time_outs, values, self.gamma, reward, done)
        storage.step += 1

    def _values_of(self, obs: TensorDict) -> torch.Tensor:
        """Return the values ``[rows]`` of states."""
        scaled = torch.empty_like(self._inputs[0])
        return self.critic.run(self._scaled(obs, scaled)).flatten()

    @torch.no_grad()
    def compute_returns(self, obs: TensorDict) -> None:
        """Compute the values of the rollout, then returns and advantages."""
        storage = self.storage
        inputs = self._samples(self._inputs)
        size = -(-inputs.shape[1] // self.num_mini_batches)  # no more memory than learning takes
        values = torch.cat([self.critic.run(part) for part in inputs.split(size, dim=1)], dim=1)
        by_step = values.unflatten(1, (storage.num_transitions_per_env, -1)).transpose(0, 1)
        storage.values.copy_(by_step.flatten(1, 2))
        rollout = (storage.rewards[..., 0], storage.dones[..., 0], storage.values[..., 0])
        results = (storage.returns[..., 0], storage.advantages[..., 0])
        rows = storage.num_envs
        _launch(ppo.estimate_advantages, rows, *rollout, self._values_of(obs), self.gamma, self.lam, *results)

    def _run_epochs(self, data: Samples) -> torch.Tensor:
        """Run all epochs; return the means of value loss, surrogate loss and entropy, ``[3, designs]``."""
        designs = self.num_designs
        columns = data.actions.shape[2]
        size = data.returns.shape[1] // self.num_mini_batches
        times = self.num_learning_epochs * self.num_mini_batches
        log_std = self._log_std
        policy = (log_std, self._widths)
        desired_kl = self.desired_kl if self.schedule == "adaptive" else 0.0

        # What minibatches are slices of, and what is written for each of them
        samples = ppo.Minibatches()
        for name in ("actions", "mean", "log_prob", "values", "returns", "advantages"):
            setattr(samples, name, wp.from_torch(getattr(data, name)))
        samples.old_log_std = wp.from_torch(log_std.clone())
        of_outputs = log_std.new_empty(2 * designs, size, columns)
        terms = log_std.new_empty(designs, size, columns + ppo.SUMS)
        of_log_std = log_std.new_zeros(2 * designs, columns)  # value functions have no deviations
        losses = log_std.new_zeros(3, designs)

        weights, biases = self.optimizer.layers()
        for k in range(times):
            # Outputs of policies and value functions, which have the same inputs
            first = k % self.num_mini_batches * size
            part = data.inputs[:, first : first + size]
            inputs = part.expand(2, *part.shape).reshape(2 * designs, size, -1)
            outputs = self.actor.run_layers(inputs, weights, biases)

            # Losses and their gradients
            minibatch = (samples, self._losses, first, outputs.detach())
            _launch(ppo.differentiate_losses, (designs, size), *minibatch, *policy, of_outputs, terms)
            sums = (terms.sum(1), self._losses, desired_kl)
            _launch(ppo.conclude_losses, designs, *sums, *policy, of_log_std, self.rates, losses)

            # A step of Adam
            gradients = torch.autograd.grad(outputs, [*weights, *biases], of_outputs)
            gradient = torch.cat([*(one.flatten(1) for one in gradients), of_log_std], dim=1)
            self.optimizer.descend_all(gradient, self.max_grad_norm, self.rates, k)
        return losses / times


def _launch(kernel: wp.Kernel, dim: Any, *inputs: Any) -> None:
    """Launch a kernel over ``dim`` threads, on the device of its tensors."""
    place = next(value.device for value in inputs if isinstance(value, torch.Tensor))
    arrays = [wp.from_torch(value) if isinstance(value, torch.Tensor) else value for value in inputs]
    device.launch(kernel, dim, arrays, str(place))
