"""Random integers for the memories of many environments, generated on the device."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from warpvox.devices.startup import start_warp
from warpvox.errors import TaskError
from warpvox.kernels.episodes import MOST_DRAWS, record_draw
from warpvox.sensors import Recorded


class RandomStream:
    """Independent streams of random integers, one per environment.

    Stream e begins at a key from numpy's ``SeedSequence(seed)`` spawned for environment e, so it does not depend
    on how many other environments there are. Within a stream numbers are counted (SplitMix64): number n of episode k
    is a function of the key, k and n alone. Nothing waits for the host.

    Args:
        seed: one for all environments; or several, each for an equal block of them that draws as if it were alone.
        num_envs: a multiple of the number of seeds.
        device: of the numbers.

    Attributes:
        keys: long ``[num_envs]``, the beginnings of the streams.
        episode: long ``[num_envs]``, the number of the episode.
    """

    def __init__(self, seed: int | Sequence[int], num_envs: int, device: torch.device | str) -> None:
        self.keys = _keys(seed, num_envs).to(device)
        self.episode = torch.zeros(num_envs, dtype=torch.long, device=device)
        self._count = 0
        self._launches: dict[tuple[int, ...], tuple[Recorded, torch.Tensor]] = {}

    def begin(self, seed: int | Sequence[int], mask: torch.Tensor | None = None) -> None:
        """Restart streams from new seeds, everywhere or where ``mask`` (bool ``[num_envs]``) is True."""
        keys = _keys(seed, self.num_envs).to(self.keys.device)
        mask = torch.ones_like(keys, dtype=torch.bool) if mask is None else mask
        self.keys.copy_(torch.where(mask, keys, self.keys))
        self.episode.masked_fill_(mask, 0)

    def rewind(self) -> RandomStream:
        """Return to the first number of the present episode; returns this object."""
        self._count = 0
        return self

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return len(self.episode)

    def zeros(self, count: int) -> torch.Tensor:
        """Return zeros, long ``[num_envs, count]``, for a memory without a random start."""
        return torch.zeros((self.num_envs, count), dtype=torch.long, device=self.episode.device)

    def integers(self, low: int, high: int, count: int) -> torch.Tensor:
        """Draw ``count`` uniform integers in [low, high) from each stream, long ``[num_envs, count]``.

        Raises:
            TaskError: no number lies there, or more are asked for than an episode may draw.
        """
        if high <= low:
            raise TaskError(f"There is no number from {low} to {high - 1} to draw: low must be less than high.")
        if not 0 <= count < MOST_DRAWS - self._count:
            raise TaskError(f"An episode may draw {MOST_DRAWS - 1} numbers, got {self._count} and {count} more.")
        if not count:
            return self.zeros(0)
        first = self._count + 1
        self._count += count
        key = (first, low, high, count)
        if key not in self._launches:
            start_warp()  # there may be no simulation yet
            out = torch.zeros((self.num_envs, count), dtype=torch.long, device=self.episode.device)
            self._launches[key] = record_draw(self.keys, self.episode, first, low, high, out), out
        launch, out = self._launches[key]
        launch.launch()
        return out.clone()

    def cells(self, x: tuple[int, int], y: tuple[int, int]) -> torch.Tensor:
        """Draw a uniform integer from each of two closed ranges, long ``[num_envs, 2]``."""
        return torch.cat([self.integers(low, high + 1, 1) for low, high in (x, y)], dim=1)


def _keys(seed: int | Sequence[int], num_envs: int) -> torch.Tensor:
    """Derive the streams' keys from a seed or a list of seeds, long ``[num_envs]``."""
    seeds = list(seed) if isinstance(seed, Sequence) else [seed]
    children = [child for one in seeds for child in np.random.SeedSequence(one).spawn(num_envs // len(seeds))]
    keys = np.array([child.generate_state(1, np.uint64)[0] for child in children], np.uint64)
    return torch.as_tensor(keys.view(np.int64))
