"""Fully connected layers of many networks side by side with tanh between them, forward and backward."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch.autograd.function import once_differentiable


def tanh_layers(inputs: torch.Tensor, weights: Sequence[torch.Tensor], biases: Sequence[torch.Tensor]) -> torch.Tensor:
    """Outputs ``[networks, rows, outputs]`` of layers with tanh after each but the last.

    One autograd node in place of one for each operation, which overwrites what is not needed any more: small networks
    are limited by memory on a CPU. In float32 tanh is within 2e-7 of torch's.

    Args:
        inputs: ``[networks, rows, inputs]``.
        weights: ``[networks, inputs, outputs]`` of each layer.
        biases: ``[networks, 1, outputs]``.
    """
    return _TanhLayers.apply(inputs, *weights, *biases)


class _TanhLayers(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, inputs: torch.Tensor, *parameters: torch.Tensor) -> torch.Tensor:
        count = len(parameters) // 2
        weights, biases = parameters[:count], parameters[count:]
        one, values = inputs.new_ones(()), [inputs]
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            # tanh x = 1 - 2 sigmoid(-2 x), of which the sigmoid takes a tenth of the time of torch's tanh
            out = torch.baddbmm(bias, values[-1], weight, beta=-2, alpha=-2).sigmoid_()
            values.append(torch.sub(one, out, alpha=2, out=out))
        ctx.save_for_backward(*values, *weights)
        return torch.baddbmm(biases[-1], values[-1], weights[-1])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        count = len(ctx.saved_tensors) // 2
        values, weights = ctx.saved_tensors[:count], ctx.saved_tensors[count:]
        of_weights, of_biases = [], []
        for k in reversed(range(count)):
            of_weights.append(values[k].mT @ gradient)
            of_biases.append(gradient.sum(-2, keepdim=True))
            if k:
                gradient = gradient @ weights[k].mT
                torch.ops.aten.tanh_backward.grad_input(gradient, values[k], grad_input=gradient)
        return None, *reversed(of_weights), *reversed(of_biases)
