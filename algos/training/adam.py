"""Adam on all parameters at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from types import EllipsisType
from typing import Any

import torch
from torch import nn

__all__ = ["VectorAdam"]


class VectorAdam(torch.optim.Adam):
    """torch's Adam for small networks: parameters and moments are one vector each, so a step is few operations.

    The parameters become views of that vector. Stacked networks have a vector for each design, the rows of a matrix.
    Saved states have the format of torch's Adam, which can load them and the other way round.

    Args:
        networks: whose parameters learn; the gradients of each are clipped separately.
        lr, eps: as of torch's Adam.
        stacked: the first axis of all parameters counts designs; parameters have three axes then.

    Attributes:
        steps: taken so far.
    """

    def __init__(self, networks: Sequence[nn.Module], lr: float, eps: float, stacked: bool = False) -> None:
        groups = [list(network.parameters()) for network in networks]
        self.parameters = [parameter for group in groups for parameter in group]
        super().__init__(self.parameters, lr=lr, eps=eps)
        self.steps, self._axes = 0, int(stacked)
        self._groups = groups
        self._values = self.flat([parameter.detach() for parameter in self.parameters])
        self._means, self._squares = torch.zeros_like(self._values), torch.zeros_like(self._values)
        self._bind()

    def flat(self, tensors: Sequence[torch.Tensor]) -> torch.Tensor:
        """Tensors with the shapes of :attr:`parameters` as a vector, or as a row for each design."""
        return torch.cat([tensor.flatten(self._axes) for tensor in tensors], dim=-1)

    def _bind(self) -> None:
        """Make the parameters views of the vector."""
        self._sizes = [sum(self._size(parameter) for parameter in group) for group in self._groups]
        for parameter, part in self._parts(self._values):
            parameter.data = part

    def _size(self, parameter: nn.Parameter) -> int:
        return parameter.shape[self._axes :].numel()

    def _parts(self, vector: torch.Tensor) -> Iterator[tuple[nn.Parameter, torch.Tensor]]:
        """The parameters, each with its part of a vector."""
        parts = vector.split([self._size(parameter) for parameter in self.parameters], dim=-1)
        return ((p, part.view_as(p)) for p, part in zip(self.parameters, parts, strict=True))

    @torch.no_grad()
    def descend(
        self,
        gradient: torch.Tensor,
        limit: float,
        rate: torch.Tensor,
        step: int,
        rows: slice | EllipsisType = ...,
    ) -> None:
        """A step along the gradients, which are scaled down to a norm of ``limit`` for each network.

        Args:
            gradient: :meth:`flat`; overwritten.
            rate: learning rate, float64; one for each row.
            step: its number, from 1; :attr:`steps` stays as it is.
            rows: the designs that the gradients are of. Threads may step different rows at the same time.
        """
        values, means, squares = (vector[rows] for vector in (self._values, self._means, self._squares))
        for part in gradient.split(self._sizes, dim=-1):
            part.mul_((limit / (torch.linalg.vector_norm(part, dim=-1, keepdim=True) + 1e-6)).clamp_(max=1.0))
        first, second = self.defaults["betas"]
        means.lerp_(gradient, 1 - first)
        squares.mul_(second).addcmul_(gradient, gradient, value=1 - second)
        # m / (sqrt(v / c) + eps) with both sides multiplied by the root of c, which saves a pass over the parameters
        correction = math.sqrt(1 - second**step)
        factor = (-(1 - first**step) / (correction * rate)).to(values.dtype)
        divisor = squares.sqrt().add_(self.param_groups[0]["eps"] * correction).mul_(factor[..., None])
        values.addcdiv_(means, divisor)

    def step(self, closure: Any = None) -> None:
        """Not supported: :meth:`descend` takes the gradients."""
        raise NotImplementedError("VectorAdam takes gradients as an argument: descend(gradient, limit, rate, step).")

    def keep(self, index: Sequence[int], shapes: Sequence[torch.Size]) -> None:
        """Keep these designs; ``shapes`` are those of the parameters before the networks were cut."""
        sizes = [shape[1:].numel() for shape in shapes]
        for name in ("_means", "_squares"):
            parts = zip(getattr(self, name).split(sizes, dim=-1), shapes, self.parameters, strict=True)
            cut = [part.view(old)[list(index), : p.shape[1], : p.shape[2]] for part, old, p in parts]
            setattr(self, name, self.flat(cut))
        self._values = self.flat([parameter.detach() for parameter in self.parameters])
        self._bind()

    def state_dict(self) -> dict[str, Any]:
        """In the format of torch's Adam: a step, a mean and a mean square for each parameter."""
        moments = zip(self._parts(self._means), self._parts(self._squares), strict=True)
        for (parameter, mean), (_, square) in moments:
            self.state[parameter] = {"step": torch.tensor(float(self.steps)), "exp_avg": mean, "exp_avg_sq": square}
        return super().state_dict()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from the state of an Adam of the same parameters, this one or torch's."""
        super().load_state_dict(state_dict)
        for moments, name in ((self._means, "exp_avg"), (self._squares, "exp_avg_sq")):
            for parameter, part in self._parts(moments):
                part.copy_(self.state[parameter][name]) if parameter in self.state else part.zero_()
        self.steps = max((int(state["step"]) for state in self.state.values()), default=0)
        self.state.clear()
