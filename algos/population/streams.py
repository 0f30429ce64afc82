"""Random numbers of designs that are trained side by side: a stream for each, as if it were trained alone."""

from __future__ import annotations

from collections.abc import Sequence

import torch


class Streams:
    """One generator for each design, used call by call as a separate training uses torch's own.

    torch fills a tensor of another size with other numbers: everything is drawn for one design at a time, in its true
    size.

    Args:
        states: of torch's generator on the CPU, where each design's stream goes on (after its networks were made); on
            another device streams begin with the seeds.
    """

    def __init__(self, seeds: Sequence[int], states: Sequence[torch.Tensor], device: str) -> None:
        self.device = device
        self._generators = [torch.Generator(device).manual_seed(seed) for seed in seeds]
        if torch.device(device).type == "cpu":
            self.set_state(states)

    def normal(self, rows: int, columns: Sequence[int]) -> torch.Tensor:
        """``[designs, rows, max(columns)]``: standard normal in the first ``columns`` of each design, else 0."""
        numbers = torch.zeros((len(columns), rows, max(columns)), device=self.device)
        for number, generator, count in zip(numbers, self._generators, columns, strict=True):
            number[:, :count] = torch.randn((rows, count), generator=generator, device=self.device)
        return numbers

    def permutations(self, count: int) -> torch.Tensor:
        """long ``[designs, count]``: an order of ``count`` things for each design."""
        return torch.stack([torch.randperm(count, generator=one, device=self.device) for one in self._generators])

    def integers(self, high: int, count: int) -> torch.Tensor:
        """long ``[designs, count]`` in [0, high)."""
        size = (count,)
        return torch.stack([torch.randint(high, size, generator=g, device=self.device) for g in self._generators])

    def keep(self, index: Sequence[int]) -> None:
        """Keep these designs, in this order."""
        self._generators = [self._generators[d] for d in index]

    def state(self) -> list[torch.Tensor]:
        """The state of every generator, for :meth:`set_state`."""
        return [generator.get_state() for generator in self._generators]

    def set_state(self, state: Sequence[torch.Tensor]) -> None:
        """Restore :meth:`state` of as many designs."""
        for generator, value in zip(self._generators, state, strict=True):
            generator.set_state(value.cpu())
