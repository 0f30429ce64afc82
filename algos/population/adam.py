"""Adam and the clipping of gradients, for parameters whose first axis counts designs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import nn

__all__ = ["PopulationAdam", "clip_gradients"]


class PopulationAdam:
    """torch's Adam with a learning rate for each design.

    Args:
        parameters: ``[designs, ...]``, three axes each.
        eps: Adam's epsilon.
    """

    BETAS = (0.9, 0.999)

    def __init__(self, parameters: Iterable[nn.Parameter], eps: float) -> None:
        self.parameters, self.eps, self.steps = list(parameters), eps, 0
        self.means = [torch.zeros_like(parameter) for parameter in self.parameters]
        self.squares = [torch.zeros_like(parameter) for parameter in self.parameters]

    def zero_grad(self) -> None:
        """Forget the gradients."""
        for parameter in self.parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self, rates: torch.Tensor) -> None:
        """Move along the gradients; ``rates`` float64 ``[designs]``."""
        self.steps += 1
        gradients = [parameter.grad for parameter in self.parameters]
        first, second = self.BETAS
        torch._foreach_lerp_(self.means, gradients, 1 - first)
        torch._foreach_mul_(self.squares, second)
        torch._foreach_addcmul_(self.squares, gradients, gradients, 1 - second)
        # m / (sqrt(v / c) + eps) with both sides multiplied by the root of c, which saves a pass over the parameters
        correction = math.sqrt(1 - second**self.steps)
        divisors = torch._foreach_sqrt(self.squares)
        torch._foreach_add_(divisors, self.eps * correction)
        sizes = (-(1 - first**self.steps) / (correction * rates)).to(divisors[0].dtype)[:, None, None]
        for parameter, mean, divisor in zip(self.parameters, self.means, divisors, strict=True):
            parameter.addcdiv_(mean, divisor.mul_(sizes))

    def part(self, share: slice, parameters: Iterable[nn.Parameter]) -> PopulationAdam:
        """The optimiser of some neighbouring designs' ``parameters``, which keeps its moments in this one's memory."""
        part = object.__new__(PopulationAdam)
        part.parameters, part.eps, part.steps = list(parameters), self.eps, self.steps
        part.means = [moment[share] for moment in self.means]
        part.squares = [moment[share] for moment in self.squares]
        return part

    def keep(self, index: Sequence[int]) -> None:
        """Only these designs go on; to be called after the parameters have been cut alike."""
        for moments in (self.means, self.squares):
            for k, (moment, parameter) in enumerate(zip(moments, self.parameters, strict=True)):
                moments[k] = moment[list(index), : parameter.shape[1]].contiguous()

    def state_dict(self) -> dict[str, Any]:
        """What :meth:`load_state_dict` takes back."""
        return {"steps": self.steps, "means": self.means, "squares": self.squares}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state of as many designs."""
        self.steps = state["steps"]
        for own, given in ((self.means, state["means"]), (self.squares, state["squares"])):
            for moment, value in zip(own, given, strict=True):
                moment.copy_(value)


def clip_gradients(parameters: Iterable[nn.Parameter], limit: float) -> None:
    """Scale each design's gradients down so that their norm over all ``parameters`` is at most ``limit``."""
    gradients = [parameter.grad for parameter in parameters]
    # one after the other: a sum over a stack of them would be done in another order for a single design
    squares = sum(torch.linalg.vector_norm(gradient.flatten(1), dim=1).square() for gradient in gradients)
    scale = (limit / (squares.sqrt() + 1e-6)).clamp(max=1.0)[:, None, None]
    for gradient in gradients:
        gradient.mul_(scale)
