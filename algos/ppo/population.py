"""PPO for many designs at once: separate trainings whose matrix products are batched."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import torch
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import nn

from warpvox.algos.policies.network import observations
from warpvox.algos.ppo.adam import VectorAdam
from warpvox.algos.ppo.networks import Normalizer, PopulationActor, PopulationModel, StackedGaussian
from warpvox.algos.ppo.stock import PPO
from warpvox.kernels.ppo import FASTEST, SLOWEST

BLOCK = 16
"""Most designs in one block of learning: smaller blocks add overhead, larger ones leave threads idle."""


class Samples(NamedTuple):
    """Rollouts or minibatches: the first three ``[designs, samples, entries]``, the others ``[designs, samples]``."""

    inputs: torch.Tensor
    actions: torch.Tensor
    mean: torch.Tensor
    log_prob: torch.Tensor
    values: torch.Tensor
    returns: torch.Tensor
    advantages: torch.Tensor


class PopulationPPO(PPO):
    """PPO with an axis for designs: losses, gradient norms, learning rates and random numbers are per design.

    Rows of the storage are sorted by design. Each design learns what :class:`warpvox.algos.ppo.stock.PPO` would
    teach it alone, up to rounding, in fewer operations: values and log-probabilities are computed for the whole rollout
    at once, and gradients of the losses by hand. The same batch gives the same bits.

    Args:
        storage: for ``designs * envs`` environments; actions as wide as the actor's outputs.
        settings: further arguments of :class:`warpvox.algos.ppo.stock.PPO`.

    Attributes:
        rates: float64 ``[designs]``, learning rates.
    """

    adam: type[VectorAdam] = VectorAdam  # class of the optimiser
    actor: PopulationActor
    critic: PopulationModel
    optimizer: VectorAdam
    _noise: torch.Tensor  # of the actions of this rollout

    def __init__(
        self,
        actor: PopulationActor,
        critic: PopulationModel,
        storage: RolloutStorage,
        streams: Streams,
        threads: int = 1,
        **settings: Any,
    ) -> None:
        # rsl-rl would normalise advantages over all rows: `_shuffled` does it for each design
        super().__init__(actor, critic, storage, normalize_advantage_per_mini_batch=True, **settings)
        self.optimizer = self.adam([actor, critic], self.adam_eps)
        self.rates = torch.full((self.num_designs,), self.learning_rate, dtype=torch.float64, device=self.device)
        self.streams = streams
        self._pool = None
        self._use_storage(storage)
        if threads > 1:  # torch's own number of threads is a setting of every thread
            own = {"initializer": torch.set_num_threads, "initargs": (torch.get_num_threads(),)}
            self._pool = ThreadPoolExecutor(threads, **own)

    @classmethod
    def in_place_of(cls, stock: PPO, generator: torch.Generator, **settings: Any) -> PopulationPPO:
        """Make a population of one design that continues from a stock algorithm, in its storage.

        Args:
            generator: of its random numbers, on its device.
            settings: those of ``stock``.
        """
        actor = PopulationActor([stock.actor])
        critic = PopulationModel([stock.critic])
        streams = Streams([generator], stock.device)
        made = cls(actor, critic, stock.storage, streams, device=stock.device, **settings)
        made.rates.fill_(stock.learning_rate)
        made.updates = stock.updates
        for parameter, _, mean, square in made._pairs(stock):
            if state := stock.optimizer.state.get(parameter):
                mean.copy_(state["exp_avg"])
                square.copy_(state["exp_avg_sq"])
                made.optimizer.steps = int(state["step"])
        return made

    @torch.no_grad()
    def copy_to(self, stock: PPO) -> None:
        """Copy parameters, optimiser state and moments to a stock algorithm of one design."""
        for name, moments in self.actor.moments(0).items():
            stock.actor.get_buffer(name).copy_(moments)
        steps = float(self.optimizer.steps)
        for parameter, value, mean, square in self._pairs(stock):
            parameter.copy_(value)
            stock.optimizer.state[parameter] = {
                "step": torch.full((), steps, dtype=torch.float32, device=self.device),
                "exp_avg": mean.clone(memory_format=torch.contiguous_format),
                "exp_avg_sq": square.clone(memory_format=torch.contiguous_format),
            }
        stock.set_learning_rate(float(self.rates[0]))
        stock.updates = self.updates

    def _pairs(self, stock: PPO) -> Iterator[tuple[nn.Parameter, torch.Tensor, torch.Tensor, torch.Tensor]]:
        """Yield each parameter of a stock algorithm of one design with its value and both Adam moments here."""
        means, squares = self.optimizer.moments()
        for ours, theirs in ((self.actor, stock.actor), (self.critic, stock.critic)):
            values = ours.of_parameters(0, lambda parameter: parameter.detach())
            firsts = ours.of_parameters(0, lambda parameter: means[parameter])
            seconds = ours.of_parameters(0, lambda parameter: squares[parameter])
            for name, parameter in theirs.named_parameters():
                yield parameter, values[name], firsts[name], seconds[name]

    def _use_storage(self, storage: RolloutStorage) -> None:
        """Use ``storage`` for rollouts from now on, and allocate scaled inputs and action means beside it."""
        self.storage = storage
        self._means = torch.zeros_like(storage.actions)
        self._inputs = torch.empty_like(observations(self.actor, storage.observations))

    @property
    def num_designs(self) -> int:
        return self.actor.num_designs

    @torch.no_grad()
    def act(self, obs: TensorDict) -> torch.Tensor:
        """Draw actions; values and log-probabilities are computed later for the whole rollout at once."""
        storage = self.storage
        step = self.storage.step
        policy = self.actor.distribution
        inputs = self.actor.scaled(observations(self.actor, obs))
        # the normaliser learns after the update only: scaled once, the inputs serve all epochs
        self._inputs[step] = inputs.flatten(0, 1)
        for name, values in obs.items():
            storage.observations[name][step] = values
        policy.update(self.actor.run(inputs))
        if step == 0:
            self._noise = self.streams.normal(storage.num_transitions_per_env, inputs.shape[1], self.actor.outputs)
        storage.actions[step] = (self._noise[step] * policy.std + policy.mean).flatten(0, 1)
        self._means[step] = policy.mean.flatten(0, 1)
        return storage.actions[step]

    @torch.no_grad()
    def process_env_step(
        self, obs: TensorDict, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, Any]
    ) -> None:
        """Record a step; where only the time limit has ended an episode, add the value of its final state."""
        storage = self.storage
        if "time_outs" in extras:
            rewards = self._bootstrap_time_limit(rewards, extras["time_outs"], extras["final_obs"])
        storage.rewards[storage.step, :, 0] = rewards
        storage.dones[storage.step, :, 0] = dones
        storage.step += 1

    def _bootstrap_time_limit(
        self, rewards: torch.Tensor, time_outs: torch.Tensor, final_obs: TensorDict
    ) -> torch.Tensor:
        """Return the rewards plus the discounted values of final states where a time limit struck."""
        if not bool(time_outs.any()):  # saves the forward pass of nearly all steps
            return rewards
        return rewards + self.gamma * self.critic(final_obs)[:, 0] * time_outs

    @torch.no_grad()
    def compute_returns(self, obs: TensorDict) -> None:
        """Compute values and log-probabilities of the rollout, then returns and advantages."""
        st = self.storage
        policy = self.actor.distribution
        parts = []
        rows = [self._samples(values) for values in (self._inputs, self._means, st.actions)]
        size = -(-rows[0].shape[1] // self.num_mini_batches)  # no more memory than learning takes
        for inputs, mean, actions in zip(*(values.split(size, dim=1) for values in rows), strict=True):
            policy.update(mean)
            parts.append((self.critic.run(inputs), policy.log_prob(actions)[..., None]))
        for target, part in zip((st.values, st.actions_log_prob), zip(*parts, strict=True), strict=True):
            by_step = torch.cat(part, dim=1).unflatten(1, (st.num_transitions_per_env, -1)).transpose(0, 1)
            target.copy_(by_step.flatten(1, 2))
        self._estimate_advantages(self.critic(obs))

    def _estimate_advantages(self, last_values: torch.Tensor) -> None:
        """Write returns and generalised advantages to the storage, as rsl-rl computes them.

        Args:
            last_values: ``[rows, 1]``, of the observations after the rollout.
        """
        st = self.storage
        discount = (1.0 - st.dones.float()) * self.gamma  # 0 where an episode has ended
        next_values = torch.cat([st.values[1:], last_values[None]])
        errors = st.rewards + discount * next_values - st.values
        decay = discount * self.lam
        advantage = torch.zeros_like(last_values)
        for step in reversed(range(st.num_transitions_per_env)):
            advantage = errors[step] + decay[step] * advantage
            st.returns[step] = advantage
        st.returns += st.values
        st.advantages = st.returns - st.values

    def _samples(self, values: torch.Tensor) -> torch.Tensor:
        """Reshape ``[steps, rows, ...]`` of the storage to ``[designs, steps * envs, ...]``."""
        return values.unflatten(1, (self.num_designs, -1)).transpose(0, 1).flatten(1, 2)

    def prepare(self) -> None:
        """Set learning rates and Adam's corrections for the next iteration, which the device only reads."""
        if self.decays:
            self.rates.fill_(self.decayed_rate)
        self.optimizer.prepare(self.num_learning_epochs * self.num_mini_batches)
        self.updates += 1

    def update(self) -> dict[str, torch.Tensor]:
        """Run all epochs of an iteration; return the mean losses ``[designs]``."""
        losses = self._run_epochs(self._shuffled())
        if isinstance(self.actor.obs_normalizer, Normalizer):
            self.actor.obs_normalizer.update(self._samples(observations(self.actor, self.storage.observations)))
        self.storage.clear()
        return dict(zip(("value", "surrogate", "entropy"), losses, strict=True))

    @torch.no_grad()
    def _shuffled(self) -> Samples:
        """Return each design's rollout in a random order of its own, with normalised advantages.

        Advantages are normalised to mean 0 and deviation 1. All epochs use the same order.
        """
        st = self.storage
        rows = Samples(
            self._samples(self._inputs),
            self._samples(st.actions),
            self._samples(self._means),
            *(self._samples(values)[..., 0] for values in (st.actions_log_prob, st.values, st.returns, st.advantages)),
        )
        centred = rows.advantages - rows.advantages.mean(1, keepdim=True)
        rows = rows._replace(advantages=centred / (rows.advantages.std(1, keepdim=True) + 1e-8))
        count = rows.returns.shape[1] // self.num_mini_batches * self.num_mini_batches
        order = self.streams.permutations(count)
        designs = torch.arange(self.num_designs, device=self.device)
        return Samples(*(values[designs[:, None], order] for values in rows))

    def _run_epochs(self, data: Samples) -> torch.Tensor:
        """Run all epochs; return the means of value loss, surrogate loss and entropy, ``[3, designs]``.

        Threads share the work block by block, so that their number changes no result.
        """
        count = -(-self.num_designs // BLOCK)
        ends = [self.num_designs * k // count for k in range(count + 1)]
        blocks = [slice(*pair) for pair in itertools.pairwise(ends)]
        run = self._pool.map if self._pool else map
        return torch.cat(list(run(lambda block: self._learn(block, data), blocks)), dim=1)

    def _learn(self, block: slice, data: Samples) -> torch.Tensor:
        """Run all epochs of the designs in ``block``; return what :meth:`_run_epochs` returns for them."""
        actor = self.actor.part(block)
        critic = self.critic.part(block)
        size = data.returns.shape[1] // self.num_mini_batches
        times = self.num_learning_epochs * self.num_mini_batches
        policy = self.actor.distribution.part(block)
        rate = self.rates[block]
        layers = [*actor.weights, *actor.biases], [*critic.weights, *critic.biases]
        policy.update(data.mean[block])
        old_std = policy.std.detach()
        sums = data.mean.new_zeros(3, len(rate))
        for k in range(times):
            first = k % self.num_mini_batches * size
            part = Samples(*(values[block, first : first + size] for values in data))
            mean = actor.run(part.inputs)
            values = critic.run(part.inputs)[..., 0]
            with torch.no_grad():
                policy.update(mean)
                if self.schedule == "adaptive":
                    self._adapt(rate, policy.mean_divergence(part.mean, old_std))
                surrogate, of_mean, of_log_std = self._surrogate(policy, part)
                value, of_values = self._value_loss(values, part)
                entropy = policy.entropy
            gradients = torch.autograd.grad([mean, values], [*layers[0], *layers[1]], [of_mean, of_values])
            count = len(layers[0])
            gradient = self.optimizer.flat([*gradients[:count], of_log_std, *gradients[count:]])
            self.optimizer.descend(gradient, self.max_grad_norm, rate, k, block)
            sums += torch.stack([value, surrogate, entropy])
        return sums / times

    def _surrogate(self, policy: StackedGaussian, part: Samples) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return PPO's clipped loss, and the gradients of loss and entropy term by mean and log-deviation."""
        noise = (part.actions - policy.mean).div_(policy.std)
        squares = noise.square()
        ratio = policy.log_prob_of(squares).sub_(part.log_prob).exp_()
        free = -part.advantages * ratio
        bounded = -part.advantages * ratio.clamp(1 - self.clip_param, 1 + self.clip_param)
        # gradient of the larger of both losses; where they are equal, within the bounds, both gradients are equal
        of_log_prob = free.mul(free >= bounded).div_(free.shape[-1])
        of_mean = noise.mul_(of_log_prob[..., None]).div_(policy.std)
        of_log_std = policy.gradient(squares.sub_(1).mul_(of_log_prob[..., None]), self.entropy_coef)
        return torch.max(free, bounded).mean(-1), of_mean, of_log_std

    def _value_loss(self, values: torch.Tensor, part: Samples) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the mean squared error of the values, and the gradient of the value loss by them."""
        error = values - part.returns
        squares = error.square()
        slope = error * (2 * self.value_loss_coef / error.shape[-1])
        if self.use_clipped_value_loss:
            moved = values - part.values
            clipped = (part.values + moved.clamp(-self.clip_param, self.clip_param) - part.returns).square()
            # beyond the bounds the clipped error does not depend on the value; within them both errors are the same
            slope *= (squares >= clipped) | (moved.abs() <= self.clip_param)
            squares = torch.max(squares, clipped)
        return squares.mean(-1), slope

    def _adapt(self, rate: torch.Tensor, kl: torch.Tensor) -> None:
        """Change the learning rates ``rate`` by rsl-rl's adaptive schedule from the divergences ``kl``."""
        lower = (rate / 1.5).clamp_(min=SLOWEST)
        higher = (rate * 1.5).clamp_(max=FASTEST)
        far = kl > 2 * self.desired_kl
        near = (kl < self.desired_kl / 2) & (kl > 0)
        rate.copy_(torch.where(far, lower, torch.where(near, higher, rate)))

    def healthy(self) -> torch.Tensor:
        """Return a mask ``[designs]`` (bool) of the designs whose networks have only finite numbers."""
        return self.optimizer.finite()

    def keep(self, index: Sequence[int], obs: TensorDict) -> None:
        """Keep the designs with the indices ``index``, for observations like ``obs``; between updates only."""
        envs = self.storage.num_envs // self.num_designs
        steps = self.storage.num_transitions_per_env
        shapes = [parameter.shape for parameter in self.optimizer.parameters]
        self.critic.obs_normalizer = nn.Identity()  # the actor owns it, and cuts it once
        for part in (self.actor, self.critic, self.streams):
            part.keep(index)
        self.critic.obs_normalizer = self.actor.obs_normalizer
        self.optimizer.keep(index, shapes)
        self.rates = self.rates[list(index)]
        self._use_storage(RolloutStorage("rl", envs * len(index), steps, obs, [max(self.actor.outputs)], self.device))


class Streams:
    """Random number generators, one for each design, used as a separate training would use torch's own.

    torch fills a tensor of another size with other numbers: everything is drawn for one design at a time, in its true
    size.

    Args:
        generators: on ``device``, in the order of the designs.
    """

    def __init__(self, generators: Sequence[torch.Generator], device: str) -> None:
        self.generators = list(generators)
        self.device = device

    def normal(self, steps: int, rows: int, columns: Sequence[int]) -> torch.Tensor:
        """Draw ``[steps, designs, rows, max(columns)]`` standard normal numbers; 0 beyond a design's ``columns``.

        On the CPU step by step, on CUDA at once, where launches are what takes time.
        """
        numbers = torch.zeros((steps, len(columns), rows, max(columns)), device=self.device)
        parts = numbers if torch.device(self.device).type == "cpu" else numbers[None]
        for part in parts:
            for d, (generator, count) in enumerate(zip(self.generators, columns, strict=True)):
                drawn = part[..., d, :, :count]
                drawn.copy_(torch.randn(drawn.shape, generator=generator, device=self.device))
        return numbers

    def permutations(self, count: int) -> torch.Tensor:
        """Draw a random permutation of ``count`` indices for each design, int64 ``[designs, count]``."""
        return torch.stack([torch.randperm(count, generator=one, device=self.device) for one in self.generators])

    def integers(self, high: int, count: int) -> torch.Tensor:
        """Draw integers in [0, ``high``), int64 ``[designs, count]``."""
        size = (count,)
        return torch.stack([torch.randint(high, size, generator=g, device=self.device) for g in self.generators])

    def keep(self, index: Sequence[int]) -> None:
        """Keep the generators of the designs with the indices ``index``."""
        self.generators = [self.generators[d] for d in index]
