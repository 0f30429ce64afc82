"""Layers and optimiser of populations against torch's own."""

import itertools
from types import SimpleNamespace

import pytest
import torch
from rsl_rl.algorithms import PPO as StockPPO
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import nn

from warpvox.algos.ppo.adam import VectorAdam
from warpvox.algos.ppo.networks import tanh_layers
from warpvox.algos.ppo.population import PopulationPPO

SIZES = (5, 7, 6, 3)
DESIGNS = 4
ROUNDING = {torch.float32: 1e-5, torch.float64: 1e-12}
"""Of sums of a few dozen products; in float32 tanh itself is within 2e-7."""


def network(dtype: torch.dtype) -> tuple[torch.Tensor, list[torch.Tensor], list[torch.Tensor]]:
    torch_random = torch.Generator().manual_seed(3)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(DESIGNS, *shape, generator=torch_random, dtype=dtype).requires_grad_()

    weights = [draw(before, after) for before, after in itertools.pairwise(SIZES)]
    biases = [draw(1, after) for after in SIZES[1:]]
    return draw(9, SIZES[0]), weights, biases


def by_torch(inputs: torch.Tensor, weights: list[torch.Tensor], biases: list[torch.Tensor]) -> torch.Tensor:
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        inputs = inputs @ weight + bias
        inputs = inputs.tanh() if k < len(weights) - 1 else inputs
    return inputs


@pytest.mark.parametrize("dtype", ROUNDING)
def test_outputs_and_gradients_are_torchs(dtype: torch.dtype) -> None:
    inputs, weights, biases = network(dtype)
    results = []
    for way in (tanh_layers, by_torch):
        out = way(inputs, weights, biases)
        results.append((out, *torch.autograd.grad(out.square().sum(), [*weights, *biases])))
    for ours, theirs in zip(*results, strict=True):
        close = ROUNDING[dtype] * theirs.detach().abs().max().item()
        torch.testing.assert_close(ours, theirs, rtol=ROUNDING[dtype], atol=close)


def test_tanh_is_close_far_from_zero_and_near_it() -> None:
    values = torch.linspace(-30, 30, 100_001)[None, :, None]
    one, zero = torch.ones(1, 1, 1), torch.zeros(1, 1, 1)
    ours = tanh_layers(values, [one, one], [zero, zero])
    torch.testing.assert_close(ours.double(), nn.Tanh()(values.double()), rtol=0, atol=2e-7)
    assert tanh_layers(torch.tensor([[[float("nan")]]]), [one, one], [zero, zero]).isnan().all()


EPS, LIMIT = 1e-5, 0.5


def test_each_row_of_stacked_networks_is_an_adam_of_its_own() -> None:
    """Three designs with different learning rates, gradients that are clipped and not, stepped in two shares."""
    random, rates = torch.Generator().manual_seed(0), torch.tensor([1e-3, 3e-4, 1e-2], dtype=torch.float64)
    scales = torch.tensor([0.01, 1.0, 100.0], dtype=torch.float64)[:, None, None]
    stacks = [nn.ParameterList(torch.randn(3, 4, columns, generator=random).double() for columns in (5, 1))]
    stacks.append(nn.ParameterList([torch.randn(3, 2, 2, generator=random).double()]))
    parts = [[[nn.Parameter(p[d].detach().clone()) for p in stack] for stack in stacks] for d in range(3)]
    ours = VectorAdam(stacks, EPS)
    theirs = [
        torch.optim.Adam([p for group in groups for p in group], lr=float(rate), eps=EPS)
        for groups, rate in zip(parts, rates, strict=True)
    ]
    for _ in range(20):
        ours.prepare(1)
        gradients = [torch.randn(p.shape, generator=random).double() * scales for p in ours.parameters]
        for rows in (slice(2), slice(2, 3)):
            ours.descend(ours.flat([g[rows] for g in gradients]), LIMIT, rates[rows], 0, rows)
        for d, optimizer in enumerate(theirs):
            for parameter, gradient in zip(optimizer.param_groups[0]["params"], gradients, strict=True):
                parameter.grad = gradient[d].clone()
            for group in parts[d]:
                nn.utils.clip_grad_norm_(group, LIMIT)
            optimizer.step()
    for k, parameter in enumerate(ours.parameters):
        stock = torch.stack([optimizer.param_groups[0]["params"][k].detach() for optimizer in theirs])
        torch.testing.assert_close(parameter.detach(), stock, rtol=0, atol=1e-12)


class Values:
    """A critic that gives these values."""

    def __init__(self, values: torch.Tensor) -> None:
        self.values = values

    def __call__(self, obs: TensorDict) -> torch.Tensor:
        return self.values

    def get_hidden_state(self) -> None:
        return None

    def reset(self, hidden_state: None) -> None:
        pass


def test_returns_and_advantages_are_rsl_rls_bit_for_bit() -> None:
    random = torch.Generator().manual_seed(0)
    rows = 11
    obs = TensorDict({"policy": torch.zeros(rows, 3)}, [rows])
    last = torch.randn(rows, 1, generator=random)
    found = []
    for compute in (PopulationPPO._estimate_advantages, StockPPO.compute_returns):
        draw = torch.Generator().manual_seed(1)
        storage = RolloutStorage("rl", rows, 9, obs, [2])
        storage.rewards.normal_(generator=draw)
        storage.values.normal_(generator=draw)
        storage.dones.copy_(torch.rand(storage.dones.shape, generator=draw) < 0.2)
        algorithm = SimpleNamespace(storage=storage, gamma=0.99, lam=0.95, normalize_advantage_per_mini_batch=True)
        algorithm.critic = Values(last)
        compute(algorithm, last if compute is PopulationPPO._estimate_advantages else obs)
        found.append((storage.returns, storage.advantages))
    for ours, theirs in zip(*found, strict=True):
        assert torch.equal(ours, theirs)
