"""State of episodes (lengths, returns, flags) and outcomes of steps, in tensors that are allocated once."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch

from warpvox.envs.snapshot import Quantity, Snapshot
from warpvox.envs.spec import TaskSpec
from warpvox.kernels import episodes as kernels
from warpvox.sensors import Recorded
from warpvox.simulation import Simulation


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
            if mask is None:
                tensor.copy_(value)
            else:
                torch.where(rows_of(mask, value), value, tensor, out=tensor)

    def set_before(
        self,
        state: Snapshot,
        first: Mapping[Any, torch.Tensor] | None = None,
        begins: torch.Tensor | None = None,
    ) -> None:
        """Store the quantities of ``state`` that rewards compare with after the next step.

        With ``first``, those in it are stored where ``begins`` (bool ``[num_envs]``) is True.
        """
        self.times_set += 1
        state.fetch(self.before)
        for quantity, held in self.before.items():
            value = state.value(quantity)
            if first is None or begins is None:
                held.copy_(value)
            else:
                torch.where(rows_of(begins, held), first[quantity], value, out=held)

    def state(self) -> dict[str, torch.Tensor]:
        """Copy counters and flags by name."""
        return {name: tensor.clone() for name, tensor in self._counts.items()}

    def set_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Restore counters and flags from a :meth:`state`."""
        for name, tensor in self._counts.items():
            tensor.copy_(state[name])


def rows_of(mask: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    """Return a mask ``[num_envs]`` as ``[num_envs, 1, ...]``, with as many dimensions as ``like``."""
    return mask.reshape(-1, *[1] * (like.ndim - 1))


class Outcomes:
    """The outcome of the present control step in each environment, and the episodes that it has ended.

    A few kernels do what would take dozens of torch operations, each of which costs a launch.

    Attributes:
        is_counted: bool ``[num_envs]``, where an episode is running and the simulation has not diverged.
        nonfinite: bool ``[num_envs]``, where a number of such an episode was not finite; observations are entered
            before :meth:`score`.
        nonfinite_rewards: long ``[rewards]``, in how many of them each reward was not finite so far.
    """

    flags: tuple[str, ...] = ("unstable", "diverged", "terminated", "truncated", "done")
    numbers: tuple[str, ...] = ("reward", "episode_return", "episode_length")

    def __init__(self, spec: TaskSpec, sim: Simulation, episodes: Episodes) -> None:
        self._sim = sim
        self._episodes = episodes
        names = [term.name for term in spec.rewards]
        factors = [term.weight for term in spec.rewards]
        self._num_rewards = len(names)
        self._names = [*names, "unstable", *(term.name for term in spec.terminations)]
        factors += [spec.unstable_penalty, *(term.bonus for term in spec.terminations)]
        self._factors = torch.tensor(factors, dtype=torch.float64, device=sim.device)

        def zeros(*shape: int, dtype: torch.dtype) -> torch.Tensor:
            return torch.zeros(shape, dtype=dtype, device=sim.device)

        count = sim.num_envs
        self.is_counted = zeros(count, dtype=torch.bool)
        self.nonfinite = zeros(count, dtype=torch.bool)
        self.nonfinite_rewards = zeros(self._num_rewards, dtype=torch.long)
        self._hits = zeros(len(spec.terminations), count, dtype=torch.bool)
        self._terms = zeros(len(self._names), count, dtype=torch.float64)
        self._flags = zeros(len(self.flags), count, dtype=torch.bool)
        self._numbers = zeros(len(self.numbers), count, dtype=torch.float64)
        self._launches: dict[tuple[Any, ...], Recorded] = {}

    def _launch(self, name: str, *inputs: Any) -> None:
        """Launch a kernel; it is recorded at the first call."""
        key = (name, *inputs)
        if key not in self._launches:
            self._launches[key] = kernels.record(self._sim.buffers, name, self._tensors(), *inputs)
        self._launches[key].launch()

    def _tensors(self) -> dict[str, torch.Tensor]:
        """Return the fields of :class:`warpvox.kernels.episodes.EpisodeArrays` that are not the simulation's."""
        episodes = self._episodes
        return {
            "length": episodes.length,
            "limit": episodes.limit,
            "returns": episodes.returns,
            "was_terminated": episodes.terminated,
            "was_truncated": episodes.truncated,
            "is_counted": self.is_counted,
            "nonfinite": self.nonfinite,
            "nonfinite_rewards": self.nonfinite_rewards,
            "factors": self._factors,
            "hits": self._hits,
            "terms": self._terms,
            **dict(zip(self.flags, self._flags, strict=True)),
            **dict(zip(self.numbers, self._numbers, strict=True)),
        }

    def count(self) -> None:
        """Count the step in the length of running episodes, and note where the simulation has stopped it."""
        self._launch("count_step")

    def score(
        self, rewards: Iterable[torch.Tensor], hits: Iterable[torch.Tensor], auto_reset: bool
    ) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """Add up the rewards, find which episodes end, and bring these up to date.

        An episode that ends has length and return 0 afterwards with ``auto_reset``; else it is marked as ended and its
        environment frozen.

        Args:
            rewards: of each reward term ``[num_envs]``, without its weight.
            hits: of each termination bool ``[num_envs]``.

        Returns:
            New tensors ``[num_envs]`` by name: :attr:`flags` (bool) and :attr:`numbers` (in the simulation's
            precision); and what each term adds to the reward (float64).
        """
        if self._num_rewards:
            torch.stack(list(rewards), out=self._terms[: self._num_rewards])
        if len(self._hits):
            torch.stack(list(hits), out=self._hits)
        self._launch("score_step", auto_reset)
        flags = self._flags.clone()
        numbers = self._numbers.to(self._sim.dtype, copy=True)
        terms = self._terms.clone()
        found = dict(zip((*self.flags, *self.numbers), (*flags, *numbers), strict=True))
        return found, dict(zip(self._names, terms, strict=True))


def state_rows(state: torch.Tensor | dict[str, Any] | None, rows: torch.Tensor) -> Any:
    """Select rows of a saved state of environments.

    Args:
        state: tensors in dictionaries of dictionaries; None stays None.
        rows: long ``[n]``.
    """
    if isinstance(state, dict):
        return {name: state_rows(value, rows) for name, value in state.items()}
    return None if state is None else state[rows]
