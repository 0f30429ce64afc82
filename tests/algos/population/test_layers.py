"""Layers that are one autograd node against torch's own."""

from __future__ import annotations

import itertools

import pytest
import torch
from torch import nn

from warpvox.algos.training.layers import tanh_layers, tanh_products

SIZES = (5, 7, 6, 3)
SHAPES = pytest.mark.parametrize("designs", [None, 4], ids=["one", "side by side"])
ROUNDING = {torch.float32: 1e-5, torch.float64: 1e-12}
"""Of sums of a few dozen products; in float32 tanh itself is within 2e-7."""


def network(designs: int | None, dtype: torch.dtype) -> tuple[torch.Tensor, list[torch.Tensor], list[torch.Tensor]]:
    torch_random = torch.Generator().manual_seed(3)
    lead = () if designs is None else (designs,)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*lead, *shape, generator=torch_random, dtype=dtype).requires_grad_()

    weights = [draw(before, after) for before, after in itertools.pairwise(SIZES)]
    biases = [draw(after) if designs is None else draw(1, after) for after in SIZES[1:]]
    return draw(9, SIZES[0]), weights, biases


def by_torch(inputs: torch.Tensor, weights: list[torch.Tensor], biases: list[torch.Tensor]) -> torch.Tensor:
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        inputs = inputs @ weight + bias
        inputs = inputs.tanh() if k < len(weights) - 1 else inputs
    return inputs


@SHAPES
@pytest.mark.parametrize("dtype", ROUNDING)
def test_outputs_and_gradients_are_torchs(designs: int | None, dtype: torch.dtype) -> None:
    inputs, weights, biases = network(designs, dtype)
    results = []
    for way in (tanh_layers, by_torch):
        out = way(inputs, weights, biases)
        results.append((out, *torch.autograd.grad(out.square().sum(), [inputs, *weights, *biases])))
    for ours, theirs in zip(*results, strict=True):
        close = ROUNDING[dtype] * theirs.detach().abs().max().item()
        torch.testing.assert_close(ours, theirs, rtol=ROUNDING[dtype], atol=close)


@SHAPES
def test_inputs_that_ask_for_no_gradient_get_none(designs: int | None) -> None:
    inputs, weights, biases = network(designs, torch.float64)
    before = inputs.detach().clone()
    tanh_layers(inputs.detach(), weights, biases).sum().backward()
    assert inputs.grad is None
    assert all(value.grad is not None for value in [*weights, *biases])
    assert torch.equal(inputs, before)


def test_tanh_is_close_far_from_zero_and_near_it() -> None:
    values = torch.linspace(-30, 30, 100_001)[:, None]
    one, zero = torch.ones(1, 1), torch.zeros(1)
    ours = tanh_layers(values, [one, one], [zero, zero])
    torch.testing.assert_close(ours.double(), nn.Tanh()(values.double()), rtol=0, atol=2e-7)
    assert tanh_layers(torch.tensor([[float("nan")]]), [one, one], [zero, zero]).isnan().all()


@pytest.mark.parametrize("dtype", ROUNDING)
def test_products_with_tanh_and_their_gradients_are_torchs(dtype: torch.dtype) -> None:
    torch_random = torch.Generator().manual_seed(4)
    shapes = (7, 5, 3), (4, 3), (5, 4), (7, 4), (7, 5)
    inputs, *tensors = (torch.randn(*shape, generator=torch_random, dtype=dtype) for shape in shapes)
    weight, bias, vectors, upstream = tensors
    learned = [tensor.requires_grad_() for tensor in (inputs, weight, bias, vectors)]
    ours = tanh_products(inputs.flatten(0, 1), weight, bias, vectors)
    theirs = (torch.tanh(inputs @ weight.t() + bias) * vectors[:, None]).sum(-1)
    gradients = (torch.autograd.grad(out, learned, upstream) for out in (ours, theirs))
    for got, wanted in [(ours, theirs), *zip(*gradients, strict=True)]:
        close = ROUNDING[dtype] * wanted.detach().abs().max().item()
        torch.testing.assert_close(got, wanted, rtol=ROUNDING[dtype], atol=close)
    with torch.no_grad():
        assert torch.equal(tanh_products(inputs.flatten(0, 1), weight, bias, vectors), ours)
