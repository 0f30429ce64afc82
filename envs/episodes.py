"""State of episodes (lengths, returns, flags) in tensors that are allocated once."""

from collections.abc import Mapping
from typing import Any

import torch

from warpvox.envs.snapshot import Quantity, Snapshot


class Episodes:
    """Lengths, returns and flags of the running episodes of all environments.

    Every tensor is made once and written to in place, never replaced, so that a captured step finds it again.

    Attributes:
        length: long ``[num_envs]``, control steps so far.
        returns: float64 ``[num_envs]``, sum of the rewards so far.
        terminated, truncated: bool ``[num_envs]``, how an environment ended that waits for its reset.
        memory: ``[num_envs, ...]`` by name: the task's episode state.
        before: the quantities (see :class:`Snapshot`) that rewards compare the next step with.
        limit: long ``[num_envs]``, the time limits.
        times_set: how often ``before`` was written; the fast steps of a single environment do not write it.
        drawn: whether the first episode has been drawn and no step taken, so that a reset keeps what was drawn.
    """

    def __init__(self, num_envs: int, device: str, limit: int) -> None:
        self.length = torch.zeros(num_envs, dtype=torch.long, device=device)
        self.returns = torch.zeros(num_envs, dtype=torch.float64, device=device)
        self.terminated = torch.zeros(num_envs, dtype=torch.bool, device=device)
        self.truncated = torch.zeros_like(self.terminated)
        self._counts = {"length": self.length, "return": self.returns}
        self._counts |= {"terminated": self.terminated, "truncated": self.truncated}
        self.limit = torch.full((num_envs,), limit, dtype=torch.long, device=device)
        self.memory: dict[str, torch.Tensor] = {}
        self.before: dict[Quantity, torch.Tensor] = {}
        self.drawn = True
        self.times_set = 0

    @property
    def active(self) -> torch.Tensor:
        """Mask of environments with a running episode, bool ``[num_envs]``; the others wait for a reset."""
        return ~(self.terminated | self.truncated)

    def clear(self, mask: torch.Tensor | None = None) -> None:
        """Reset counters and flags to 0, everywhere or where ``mask`` (bool ``[num_envs]``) is True."""
        for tensor in self._counts.values():
            if mask is None:
                tensor.zero_()
            else:
                tensor.masked_fill_(mask, 0)

    def end(self, terminated: torch.Tensor, truncated: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Mark episodes that end now; return all that have terminated and all that were truncated since their reset.

        All are bool ``[num_envs]``.
        """
        terminated = self.terminated | terminated
        truncated = self.truncated | truncated
        self.terminated.copy_(terminated)
        self.truncated.copy_(truncated)
        return terminated, truncated

    def set_memory(self, values: Mapping[str, torch.Tensor], mask: torch.Tensor | None = None) -> None:
        """Write the values of the task's memories, everywhere or where ``mask`` (bool ``[num_envs]``) is True."""
        if not self.memory:
            self.memory = {name: value.clone() for name, value in values.items()}
            return
        # The new value of one entry may be the tensor of another, which is written to here: copy it first.
        held = {id(tensor) for tensor in self.memory.values()}
        changed: dict[str, torch.Tensor] = {}
        for name, value in values.items():
            if value is not self.memory[name]:
                changed[name] = value.clone() if id(value) in held else value

        for name, value in changed.items():
            tensor = self.memory[name]
            if mask is not None:
                rows = mask.reshape(-1, *[1] * (value.ndim - 1))
                value = torch.where(rows, value, tensor)
            tensor.copy_(value)

    def set_before(self, state: Snapshot) -> None:
        """Store the quantities of ``state`` that rewards compare with after the next step."""
        self.times_set += 1
        state.fetch(self.before)
        for quantity, held in self.before.items():
            held.copy_(state.value(quantity))

    def state(self) -> dict[str, torch.Tensor]:
        """Copy counters and flags by name."""
        return {name: tensor.clone() for name, tensor in self._counts.items()}

    def set_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Restore counters and flags from a :meth:`state`."""
        for name, tensor in self._counts.items():
            tensor.copy_(state[name])


def state_rows(state: torch.Tensor | dict[str, Any] | None, rows: torch.Tensor) -> Any:
    """Select rows of a saved state of environments.

    Args:
        state: tensors in dictionaries of dictionaries; None stays None.
        rows: long ``[n]``.
    """
    if isinstance(state, dict):
        return {name: state_rows(value, rows) for name, value in state.items()}
    return None if state is None else state[rows]
