"""Non-finite terms: they terminate the episode, and a warning names the term."""

from __future__ import annotations

import math
import warnings
from typing import Any

import torch

from warpvox.envs.observations import ObservationLayout
from warpvox.envs.spec import TaskSpec
from warpvox.simulation import Simulation


class FiniteGuard:
    """Replaces non-finite values in observations and rewards, and counts them by term.

    On the CPU :func:`all_finite` decides whether there is anything to do. Elsewhere reading it would wait for the
    device: masks are applied in every step, and counts stay on the device until :meth:`report` reads them.

    Methods take ``on_cpu``: whether results can be read without waiting for a device.
    """

    def __init__(self, spec: TaskSpec, sim: Simulation, layout: ObservationLayout) -> None:
        self._task = spec.id
        self._rewards = [term.name for term in spec.rewards]
        self._layout, self._columns, self._design = layout, layout.columns, sim.design_index
        rows = sim.num_designs if sim.grid is None else sim.num_envs  # as many designs as there may be
        self._of_rewards = torch.zeros(len(self._rewards), dtype=torch.long, device=sim.device)
        self._of_columns = torch.zeros((rows, layout.num_obs), dtype=torch.int32, device=sim.device)
        self._earlier: dict[str, int] = {}  # counted under columns of earlier designs
        self._named: set[str] = set()

    def observation(self, obs: torch.Tensor, where: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        """An observation ``[num_envs, num_obs]`` with 0 for what is not finite, and bool ``[num_envs]``: where it was.

        Args:
            where: bool ``[num_envs]``: environments that count; None: all.
        """
        odd = ~torch.isfinite(obs)
        counted = odd if where is None else odd & where[:, None]
        # in place: a captured graph adds to the same memory
        if len(self._of_columns) == 1:  # on CUDA all environments would add to one row, by atomics
            self._of_columns += counted.sum(0, dtype=torch.int32)
        else:
            self._of_columns.index_add_(0, self._design, counted.int())
        return obs.masked_fill(odd, 0.0), counted.any(1)

    def first(self, obs: torch.Tensor, where: torch.Tensor | None, on_cpu: bool) -> torch.Tensor:
        """The observation of a beginning, with 0 for what is not finite; ``where`` as for :meth:`observation`."""
        if on_cpu and all_finite(obs):
            return obs
        obs, _ = self.observation(obs, where)
        if on_cpu:
            self.report()
        return obs

    def step(
        self, obs: torch.Tensor, terms: dict[str, torch.Tensor], where: torch.Tensor, on_cpu: bool
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """As :meth:`observation` of a step with these parts of the reward, ``[num_envs]`` each, also not finite."""
        obs, odd = self.observation(obs, where)
        if self._rewards:
            bad = torch.stack([~torch.isfinite(terms[name]) for name in self._rewards]) & where
            self._of_rewards += bad.sum(1)
            odd = odd | bad.any(0)
        if on_cpu and bool(odd.any()):
            self.report()
        return obs, odd

    def refresh(self) -> None:
        """Begin new counts after designs have changed; waits for the device."""
        self._earlier = self._counts()
        self._of_rewards.zero_()
        self._of_columns.zero_()
        self._columns = self._layout.columns

    def _counts(self) -> dict[str, int]:
        """In how many environments each term was not finite so far, all terms."""
        found = dict(zip((f"reward {name}" for name in self._rewards), self._of_rewards.tolist(), strict=True))
        found |= {f"observation {name}": 0 for name in self._columns[0]}
        every = self._of_columns.cpu()
        for row in every.any(1).nonzero()[:, 0].tolist():
            for name, place in self._columns[row].items():
                found[f"observation {name}"] += int(every[row, place].max()) if place.stop > place.start else 0
        return {name: count + self._earlier.get(name, 0) for name, count in found.items()}

    def report(self) -> dict[str, int]:
        """:meth:`_counts` above 0, with a warning of terms that were not named before; waits for the device."""
        found = {name: count for name, count in self._counts().items() if count}
        for name in [name for name in found if name not in self._named]:
            self._named.add(name)
            kind, _, term = name.partition(" ")
            environments = "1 environment" if found[name] == 1 else f"{found[name]} environments"
            warnings.warn(
                f"The {kind} '{term}' of the task '{self._task}' was NaN or infinite in {environments}, which ended as"
                " diverged; this is said once, info['diverged'] says where it happens again.",
                RuntimeWarning,
                stacklevel=2,
            )
        return found


def all_finite(*values: torch.Tensor) -> bool:
    """Whether the sum of all values is finite; False also if it overflows."""
    total: Any = sum(value.sum() for value in values)
    return math.isfinite(total.item())
