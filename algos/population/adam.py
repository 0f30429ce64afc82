"""Adam on all parameters of many networks at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import nn

FIRST, SECOND = 0.9, 0.999
"""How much of the moments stays in a step: torch's defaults."""


class VectorAdam:
    """torch's Adam for stacked networks: parameters and moments are a vector for each design, the rows of a matrix.

    A step is few operations. The parameters become views of that matrix.

    Args:
        networks: whose parameters learn; the first of three axes counts designs. The gradients of each network are
            clipped separately.
    """

    def __init__(self, networks: Sequence[nn.Module], eps: float) -> None:
        self._groups = [list(network.parameters()) for network in networks]
        self.parameters = [parameter for group in self._groups for parameter in group]
        self.steps, self.eps = 0, eps
        self._bind()
        self._means, self._squares = torch.zeros_like(self._values), torch.zeros_like(self._values)

    @staticmethod
    def flat(tensors: Sequence[torch.Tensor]) -> torch.Tensor:
        """Tensors with the shapes of :attr:`parameters` as a row for each design."""
        return torch.cat([tensor.flatten(1) for tensor in tensors], dim=-1)

    def _bind(self) -> None:
        """Make the parameters views of one matrix."""
        self._values = self.flat([parameter.detach() for parameter in self.parameters])
        self._sizes = [sum(parameter[0].numel() for parameter in group) for group in self._groups]
        for parameter, part in self._parts(self._values, [parameter.shape for parameter in self.parameters]):
            parameter.data = part

    def _parts(self, matrix: torch.Tensor, shapes: Sequence[torch.Size]) -> Iterator[tuple[nn.Parameter, torch.Tensor]]:
        """The parameters, each with its part of a matrix."""
        parts = matrix.split([shape[1:].numel() for shape in shapes], dim=-1)
        return ((p, part.view(shape)) for p, part, shape in zip(self.parameters, parts, shapes, strict=True))

    @torch.no_grad()
    def descend(self, gradient: torch.Tensor, limit: float, rate: torch.Tensor, step: int, rows: slice) -> None:
        """A step along the gradients, which are scaled down to a norm of ``limit`` for each network.

        Args:
            gradient: :meth:`flat`; overwritten.
            rate: learning rates, float64, one for each row.
            step: its number, from 1; :attr:`steps` stays as it is.
            rows: the designs that the gradients are of. Threads may step different rows at the same time.
        """
        values, means, squares = (matrix[rows] for matrix in (self._values, self._means, self._squares))
        for part in gradient.split(self._sizes, dim=-1):
            part.mul_((limit / (torch.linalg.vector_norm(part, dim=-1, keepdim=True) + 1e-6)).clamp_(max=1.0))
        means.lerp_(gradient, 1 - FIRST)
        squares.mul_(SECOND).addcmul_(gradient, gradient, value=1 - SECOND)
        # m / (sqrt(v / c) + eps) with both sides multiplied by the root of c, which saves a pass over the parameters
        correction = math.sqrt(1 - SECOND**step)
        factor = (-(1 - FIRST**step) / (correction * rate)).to(values.dtype)
        values.addcdiv_(means, squares.sqrt().add_(self.eps * correction).mul_(factor[..., None]))

    def keep(self, index: Sequence[int], shapes: Sequence[torch.Size]) -> None:
        """Keep these designs; ``shapes`` are those of the parameters before the networks were cut."""
        for name in ("_means", "_squares"):
            parts = self._parts(getattr(self, name), shapes)
            setattr(self, name, self.flat([part[list(index), : p.shape[1], : p.shape[2]] for p, part in parts]))
        self._bind()

    def state(self) -> dict[str, Any]:
        """Steps and moments, for :meth:`set_state`."""
        return {"steps": self.steps, "means": self._means, "squares": self._squares}

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on from :meth:`state` of the same networks."""
        self.steps = state["steps"]
        self._means.copy_(state["means"])
        self._squares.copy_(state["squares"])
