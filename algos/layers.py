"""Fully connected layers with tanh between them, forward and backward, of one network or of many side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from warpvox.algos import native_layers

__all__ = ["tanh_layers"]


def tanh_layers(inputs: torch.Tensor, weights: Sequence[torch.Tensor], biases: Sequence[torch.Tensor]) -> torch.Tensor:
    """Outputs ``[rows, outputs]`` of layers with tanh after each but the last.

    One autograd node in place of one for each operation: by :mod:`warpvox.algos.native_layers` where that can be, else
    by torch, overwriting what is not needed any more. In float32 tanh is within 2e-7 of torch's.

    Args:
        inputs: ``[rows, inputs]``, or ``[networks, rows, inputs]``.
        weights: ``[inputs, outputs]`` of each layer, or ``[networks, inputs, outputs]``.
        biases: ``[outputs]``, or ``[networks, 1, outputs]``.
    """
    return _TanhLayers.apply(inputs, *weights, *biases)


class _TanhLayers(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, inputs: torch.Tensor, *parameters: torch.Tensor) -> torch.Tensor:
        count = len(parameters) // 2
        ctx.native = not ctx.needs_input_grad[0] and native_layers.suits(inputs, parameters[:count])
        if ctx.native:
            return _native_forward(ctx, inputs, parameters[:count], parameters[count:])
        affine = torch.addmm if inputs.ndim == 2 else torch.baddbmm
        weights, biases = parameters[:count], parameters[count:]
        one, values = inputs.new_ones(()), [inputs]
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            # tanh x = 1 - 2 sigmoid(-2 x), of which the sigmoid takes a tenth of the time of torch's tanh
            out = affine(bias, values[-1], weight, beta=-2, alpha=-2).sigmoid_()
            values.append(torch.sub(one, out, alpha=2, out=out))
        ctx.save_for_backward(*values, *weights)
        return affine(biases[-1], values[-1], weights[-1])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        count = len(ctx.saved_tensors) // 2
        values, weights = ctx.saved_tensors[:count], ctx.saved_tensors[count:]
        if ctx.native:
            return None, *_native_backward(values, weights, gradient)
        of_weights, of_biases = [], []
        for k in reversed(range(count)):
            of_weights.append(values[k].mT @ gradient)
            of_biases.append(gradient.sum(-2, keepdim=gradient.ndim == 3))
            if k or ctx.needs_input_grad[0]:
                gradient = gradient @ weights[k].mT
            if k:
                torch.ops.aten.tanh_backward.grad_input(gradient, values[k], grad_input=gradient)
        of_inputs = gradient if ctx.needs_input_grad[0] else None
        return of_inputs, *reversed(of_weights), *reversed(of_biases)


def _native_forward(
    ctx: Any, inputs: torch.Tensor, weights: Sequence[torch.Tensor], biases: Sequence[torch.Tensor]
) -> torch.Tensor:
    alone = inputs.ndim == 2
    if alone:
        inputs, weights, biases = inputs[None], [weight[None] for weight in weights], [bias[None] for bias in biases]
    values = native_layers.forward(inputs, weights, biases)
    ctx.save_for_backward(inputs, *values[:-1], *weights)
    result = values[-1][..., : weights[-1].shape[-1]]
    return result[0] if alone else result


def _native_backward(
    values: Sequence[torch.Tensor], weights: Sequence[torch.Tensor], gradient: torch.Tensor
) -> list[torch.Tensor]:
    alone = gradient.ndim == 2
    of_weights, of_biases = native_layers.backward(
        values[0], values[1:], weights, gradient[None] if alone else gradient
    )
    if alone:
        of_weights, of_biases = [part[0] for part in of_weights], [part[0, 0] for part in of_biases]
    return [*of_weights, *of_biases]
