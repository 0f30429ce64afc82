"""Fully connected layers in float32 on CPUs with AVX-512, by the kernels of :mod:`warpvox.kernels.layers`.

Networks of a few thousand weights fit into the cache. Torch's libraries spend most of their time on the way of every
operation's result to memory and back, and on some CPUs they do not use AVX-512.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch.nn.functional import pad

from warpvox.kernels.layers import LANES, TILE, run_backward, run_forward

__all__ = ["LARGEST", "backward", "forward", "suits"]

LARGEST = 256
"""Inputs and outputs of a layer, up to which its weights stay in the cache."""
WIDE = torch.backends.cpu.get_cpu_capability() == "AVX512"

Tensors = Sequence[torch.Tensor]


def suits(inputs: torch.Tensor, weights: Tensors) -> bool:
    """Whether layers can be computed here: float32 on a CPU with AVX-512, one thread of torch, none too large.

    Weights are ``[..., inputs, outputs]``.
    """
    return (
        WIDE
        and inputs.dtype == weights[0].dtype == torch.float32
        and inputs.device.type == "cpu"
        and max(inputs.shape[-1], *(weight.shape[-1] for weight in weights)) <= LARGEST
        and torch.get_num_threads() == 1
    )


def forward(inputs: torch.Tensor, weights: Tensors, biases: Tensors) -> list[torch.Tensor]:
    """Outputs of each layer ``[networks, rows, width]``, width being a multiple of 16.

    Args:
        inputs: ``[networks, rows, inputs]``.
        weights: ``[networks, inputs, outputs]`` of each layer; biases: ``[networks, 1, outputs]``.
    """
    inputs = _rows(inputs)
    networks, rows, count = inputs.shape
    widths = [_width(weight) for weight in weights]
    values = [inputs.new_empty(networks, rows, width) for width in widths]
    scratch = inputs.new_empty(
        sum((weight.shape[1] + 1) * width for weight, width in zip(weights, widths, strict=True))
    )
    table = [len(weights), rows, count, TILE, inputs.data_ptr(), inputs.stride(0), inputs.stride(1), scratch.data_ptr()]
    for weight, bias, width, out in zip(weights, biases, widths, values, strict=True):
        table += [*_of_weight(weight, width), bias.data_ptr(), bias.stride(0), out.data_ptr(), 0, 0]
    run_forward(networks, table)
    return values


def backward(
    inputs: torch.Tensor, values: Tensors, weights: Tensors, gradient: torch.Tensor
) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Gradients of weights and biases.

    Args:
        inputs, weights: as of :func:`forward`; values: what that has returned, but for the last.
        gradient: of the outputs, ``[networks, rows, outputs]``.
    """
    inputs = _rows(inputs)
    networks, rows, count = inputs.shape
    widths = [_width(weight) for weight in weights]
    values = [*values, pad(gradient, (0, widths[-1] - gradient.shape[-1])).contiguous()]
    shapes = [weight.shape for weight in weights]
    of_weights = [inputs.new_empty(networks, shape[1], width) for shape, width in zip(shapes, widths, strict=True)]
    of_biases = [inputs.new_empty(networks, 1, width) for width in widths]
    panels = sum(shape[2] * width for shape, width in zip(shapes[1:], widths, strict=False))
    scratch = inputs.new_empty(panels + 2 * TILE * max(widths))
    table = [len(weights), rows, count, TILE, inputs.data_ptr(), inputs.stride(0), inputs.stride(1), scratch.data_ptr()]
    for weight, width, *rest in zip(weights, widths, values, of_weights, of_biases, strict=True):
        table += [*_of_weight(weight, width), 0, 0, *(tensor.data_ptr() for tensor in rest)]
    run_backward(networks, table)
    sizes = [shape[2] for shape in shapes]
    of_weights = [part[..., :size] for part, size in zip(of_weights, sizes, strict=True)]
    return of_weights, [part[..., :size] for part, size in zip(of_biases, sizes, strict=True)]


def _width(weight: torch.Tensor) -> int:
    return -(-weight.shape[-1] // LANES) * LANES


def _of_weight(weight: torch.Tensor, width: int) -> list[int]:
    return [weight.shape[-1], width, weight.data_ptr(), *weight.stride()]


def _rows(inputs: torch.Tensor) -> torch.Tensor:
    """The same with the entries of a row one after the other."""
    return inputs if inputs.stride(2) == 1 else inputs.contiguous()
