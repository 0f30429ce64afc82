"""Random numbers of designs that are trained side by side: a stream for each, as if it were trained alone."""

from __future__ import annotations

from collections.abc import Sequence

import torch

__all__ = ["Streams"]


class Streams:
    """One generator for each design, drawn from call by call as a separate training draws from torch's own.

    Shapes matter: torch fills a tensor of another size with other numbers, so everything is drawn for one design
    at a time and in its true size, and only then laid side by side.

    Args:
        seeds: of the designs.
        states: of torch's generator on the CPU, where each design's stream goes on (after its networks were made).
        device: where numbers are drawn while training.
    """

    def __init__(self, seeds: Sequence[int], states: Sequence[torch.Tensor], device: str) -> None:
        self.device = device
        self._host = [torch.Generator() for _ in seeds]
        for generator, state in zip(self._host, states, strict=True):
            generator.set_state(state)
        self._here = self._host
        if torch.device(device).type != "cpu":
            self._here = [torch.Generator(device).manual_seed(seed) for seed in seeds]

    def normal(self, rows: int, columns: Sequence[int], width: int) -> torch.Tensor:
        """``[designs, rows, width]``: standard normal in the first ``columns`` of each design, else 0."""
        numbers = torch.zeros((len(columns), rows, width), device=self.device)
        for number, generator, count in zip(numbers, self._here, columns, strict=True):
            number[:, :count] = torch.empty((rows, count), device=self.device).normal_(generator=generator)
        return numbers

    def permutations(self, count: int) -> torch.Tensor:
        """long ``[designs, count]``: an order of ``count`` things for each design."""
        orders = [torch.randperm(count, generator=generator, device=self.device) for generator in self._here]
        return torch.stack(orders)

    def integers(self, high: int, count: int) -> torch.Tensor:
        """long ``[designs, count]`` in [0, high), on the CPU."""
        return torch.stack([torch.randint(high, (count,), generator=generator) for generator in self._host])

    def keep(self, index: Sequence[int]) -> None:
        """Only these designs go on, in this order."""
        separate = self._here is not self._host
        self._host = [self._host[d] for d in index]
        self._here = [self._here[d] for d in index] if separate else self._host

    def state(self) -> list[list[torch.Tensor]]:
        """The state of every generator: what :meth:`set_state` takes back."""
        pairs = zip(self._host, self._here, strict=True)
        return [[host.get_state(), here.get_state()] for host, here in pairs]

    def set_state(self, state: Sequence[Sequence[torch.Tensor]]) -> None:
        """Go on from :meth:`state` of as many designs."""
        for host, here, (on_host, on_device) in zip(self._host, self._here, state, strict=True):
            host.set_state(on_host.cpu())
            here.set_state(on_device.cpu())
