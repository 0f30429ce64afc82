"""What a policy without feedback is to learn: for each of the last bodies, weights that it should have."""

from __future__ import annotations

import torch

__all__ = ["Targets"]


class Targets:
    """The last targets, each with its body; a body that comes again has its newest one.

    Args:
        limit: how many are kept.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._keys: list[bytes] = []
        self._bodies, self._targets = torch.empty(0), torch.empty(0)

    def __len__(self) -> int:
        return len(self._keys)

    def add(self, bodies: torch.Tensor, targets: torch.Tensor) -> None:
        """Add ``[rows, ...]`` of both; of equal bodies the last row counts."""
        keys = _keys(bodies)
        newest = {key: row for row, key in enumerate(keys)}
        rows = torch.tensor(list(newest.values()), device=bodies.device)
        bodies, targets = bodies[rows], targets[rows]
        if self._keys:
            stay = torch.tensor([key not in newest for key in self._keys], device=bodies.device)
            bodies, targets = torch.cat([self._bodies[stay], bodies]), torch.cat([self._targets[stay], targets])
        kept = [key for key in self._keys if key not in newest] + list(newest)
        self._keys = kept[-self.limit :]
        self._bodies, self._targets = bodies[-self.limit :], targets[-self.limit :]

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """So many bodies and targets, drawn at random with torch's generator of the CPU."""
        rows = torch.randint(len(self), (count,)).to(self._bodies.device)
        return self._bodies[rows], self._targets[rows]

    def state(self) -> dict[str, torch.Tensor]:
        """For :meth:`set_state`."""
        return {"bodies": self._bodies, "targets": self._targets}

    def set_state(self, state: dict[str, torch.Tensor]) -> None:
        """Go on from :meth:`state`."""
        self._bodies, self._targets = state["bodies"], state["targets"]
        self._keys = _keys(self._bodies)


def _keys(bodies: torch.Tensor) -> list[bytes]:
    return [row.tobytes() for row in bodies.cpu().numpy()]
