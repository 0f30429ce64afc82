"""Adam on all parameters at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import nn

__all__ = ["VectorAdam"]


class VectorAdam(torch.optim.Adam):
    """torch's Adam for small networks: parameters, gradients and moments are a vector each, and a step few operations.

    The parameters become views of one vector. Saved states are torch's own, and the other way round.

    Args:
        networks: whose parameters learn; the gradients of each are clipped by themselves.
        lr, eps: as of torch's Adam; the learning rate is that of ``param_groups`` as ever.
    """

    def __init__(self, networks: Sequence[nn.Module], lr: float, eps: float) -> None:
        groups = [list(network.parameters()) for network in networks]
        self.parameters = [parameter for group in groups for parameter in group]
        super().__init__(self.parameters, lr=lr, eps=eps)
        self._sizes = [sum(parameter.numel() for parameter in group) for group in groups]
        self._values = torch.cat([parameter.detach().flatten() for parameter in self.parameters])
        for parameter, part in self._parts(self._values):
            parameter.data = part
        self._means, self._squares = torch.zeros_like(self._values), torch.zeros_like(self._values)
        self._steps = 0

    def _parts(self, vector: torch.Tensor) -> Iterator[tuple[nn.Parameter, torch.Tensor]]:
        """The parameters, each with its part of a vector."""
        parts = vector.split([parameter.numel() for parameter in self.parameters])
        return ((p, part.view_as(p)) for p, part in zip(self.parameters, parts, strict=True))

    @torch.no_grad()
    def descend(self, gradient: torch.Tensor, limit: float) -> None:
        """A step along the gradients of :attr:`parameters`, one after the other in a vector that is overwritten.

        Those of a network are scaled down first, if need be, to a norm of ``limit`` over all of them.
        """
        for part in gradient.split(self._sizes):
            part.mul_((limit / (torch.linalg.vector_norm(part) + 1e-6)).clamp(max=1.0))
        group = self.param_groups[0]
        first, second = group["betas"]
        self._steps += 1
        self._means.lerp_(gradient, 1 - first)
        self._squares.mul_(second).addcmul_(gradient, gradient, value=1 - second)
        divisor = self._squares.sqrt().div_(math.sqrt(1 - second**self._steps)).add_(group["eps"])
        self._values.addcdiv_(self._means, divisor, value=-group["lr"] / (1 - first**self._steps))

    def step(self, closure: Any = None) -> None:
        """Not for this optimiser: :meth:`descend` takes the gradients."""
        raise NotImplementedError("VectorAdam is given its gradients: descend(gradient, limit).")

    def state_dict(self) -> dict[str, Any]:
        """As torch's Adam has it: a step, a mean and a mean square for each parameter."""
        moments = zip(self._parts(self._means), self._parts(self._squares), strict=True)
        for (parameter, mean), (_, square) in moments:
            self.state[parameter] = {"step": torch.tensor(float(self._steps)), "exp_avg": mean, "exp_avg_sq": square}
        return super().state_dict()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from the state of an Adam of the same parameters, this one or torch's."""
        super().load_state_dict(state_dict)
        for moments, name in ((self._means, "exp_avg"), (self._squares, "exp_avg_sq")):
            for parameter, part in self._parts(moments):
                part.copy_(self.state[parameter][name]) if parameter in self.state else part.zero_()
        self._steps = max((int(state["step"]) for state in self.state.values()), default=0)
        self.state.clear()
