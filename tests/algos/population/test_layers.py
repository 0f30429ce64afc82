"""Layers that are one autograd node against torch's own."""

import itertools

import pytest
import torch
from torch import nn

from warpvox.algos.population.model import tanh_layers

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


def test_inputs_that_ask_for_no_gradient_get_none() -> None:
    inputs, weights, biases = network(torch.float64)
    before = inputs.detach().clone()
    tanh_layers(inputs.detach(), weights, biases).sum().backward()
    assert inputs.grad is None
    assert all(value.grad is not None for value in [*weights, *biases])
    assert torch.equal(inputs, before)


def test_tanh_is_close_far_from_zero_and_near_it() -> None:
    values = torch.linspace(-30, 30, 100_001)[None, :, None]
    one, zero = torch.ones(1, 1, 1), torch.zeros(1, 1, 1)
    ours = tanh_layers(values, [one, one], [zero, zero])
    torch.testing.assert_close(ours.double(), nn.Tanh()(values.double()), rtol=0, atol=2e-7)
    assert tanh_layers(torch.tensor([[[float("nan")]]]), [one, one], [zero, zero]).isnan().all()
