"""torch's Adam for stacked networks, with a row of one matrix for each design."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import torch
from torch import nn

from warpvox.kernels.ppo import FIRST, SECOND


class VectorAdam:
    """torch's Adam for stacked networks: one matrix holds the parameters, a row for each design.

    A step is few operations. The parameters become views of that matrix.

    Args:
        networks: whose parameters learn; the first of three axes counts designs. The gradients of each network are
            clipped separately.
    """

    def __init__(self, networks: Sequence[nn.Module], eps: float) -> None:
        self._groups = [list(network.parameters()) for network in networks]
        self.parameters = [parameter for group in self._groups for parameter in group]
        self.steps = 0
        self.eps = eps
        self._bind()
        self._means = torch.zeros_like(self._values)
        self._squares = torch.zeros_like(self._values)
        self._corrections = self._values.new_zeros((0, 2), dtype=torch.float64)

    def finite(self) -> torch.Tensor:
        """Return a mask ``[designs]`` (bool) of the designs whose parameters are all finite."""
        return torch.isfinite(self._values).all(1)

    def moments(self) -> tuple[dict[torch.Tensor, torch.Tensor], dict[torch.Tensor, torch.Tensor]]:
        """Return views of the first and second moments by parameter, in the parameters' shapes."""
        shapes = [parameter.shape for parameter in self.parameters]
        return dict(self._parts(self._means, shapes)), dict(self._parts(self._squares, shapes))

    def flat(self, tensors: Sequence[torch.Tensor]) -> torch.Tensor:
        """Concatenate tensors with the shapes of :attr:`parameters` to a matrix with a row for each design."""
        return torch.cat([tensor.flatten(1) for tensor in tensors], dim=-1)

    def _bind(self) -> None:
        """Copy the parameters into one matrix, and make them views of it."""
        self._values = self.flat([parameter.detach() for parameter in self.parameters])
        self._sizes = [sum(parameter[0].numel() for parameter in group) for group in self._groups]
        for parameter, part in self._parts(self._values, [parameter.shape for parameter in self.parameters]):
            parameter.data = part

    def _parts(self, matrix: torch.Tensor, shapes: Sequence[torch.Size]) -> Iterator[tuple[nn.Parameter, torch.Tensor]]:
        """Yield each parameter with the part of ``matrix`` that belongs to it, in the shape given."""
        parts = matrix.split([shape[1:].numel() for shape in shapes], dim=-1)
        return ((p, part.view(shape)) for p, part, shape in zip(self.parameters, parts, shapes, strict=True))

    def prepare(self, count: int) -> None:
        """Compute the bias corrections of the next ``count`` steps, for :meth:`descend`."""
        numbers = range(self.steps + 1, self.steps + count + 1)
        corrections = torch.tensor([[-(1 - FIRST**n), math.sqrt(1 - SECOND**n)] for n in numbers], dtype=torch.float64)
        if len(self._corrections) != count:
            self._corrections = self._corrections.new_zeros((count, 2))
        self._corrections.copy_(corrections)
        self.steps += count

    @torch.no_grad()
    def descend(self, gradient: torch.Tensor, limit: float, rate: torch.Tensor, number: int, rows: slice) -> None:
        """Do a step of Adam for the designs ``rows``, with the gradient of each network clipped to a norm of ``limit``.

        Args:
            gradient: :meth:`flat`; overwritten.
            rate: learning rates, float64, one for each row.
            number: index of the step among those prepared, from 0.
            rows: the designs that the gradients are of. Threads may step different rows at the same time.
        """
        values = self._values[rows]
        means = self._means[rows]
        squares = self._squares[rows]
        for part in gradient.split(self._sizes, dim=-1):
            part.mul_((limit / (torch.linalg.vector_norm(part, dim=-1, keepdim=True) + 1e-6)).clamp_(max=1.0))
        means.lerp_(gradient, 1 - FIRST)
        squares.mul_(SECOND).addcmul_(gradient, gradient, value=1 - SECOND)
        # m / (sqrt(v / c) + eps) with both sides multiplied by the root of c, which saves a pass over the parameters
        first, second = self._corrections[number]
        factor = (first / (second * rate)).to(values.dtype)
        values.addcdiv_(means, squares.sqrt().add_((self.eps * second).to(values.dtype)).mul_(factor[..., None]))

    def keep(self, index: Sequence[int], shapes: Sequence[torch.Size]) -> None:
        """Keep the designs with the indices ``index``; ``shapes``: of the parameters before they were cut."""
        for name in ("_means", "_squares"):
            parts = self._parts(getattr(self, name), shapes)
            setattr(self, name, self.flat([part[list(index), : p.shape[1], : p.shape[2]] for p, part in parts]))
        self._bind()
