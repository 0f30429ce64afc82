"""How observation terms lie in the rows of an observation, for designs of different sizes."""

from __future__ import annotations

import torch

from warpvox.envs.spec import Observation
from warpvox.envs.state import State
from warpvox.sim import Simulation

__all__ = ["Layout"]


class Layout:
    """Concatenates observation terms; each design's real entries come first, the rest of its row is 0.

    Terms with a value for every point are padded to the largest body by the simulator, x and y apart. A
    gather closes those gaps, and is left out where all designs are of one size.

    Attributes:
        num_obs: entries of a row.
        mask: bool ``[sim.num_designs, num_obs]``: the entries that are real.
        columns: for every distinct design of the simulation, where each term lies: ``{term name: slice}``.
    """

    def __init__(self, terms: tuple[Observation, ...], sim: Simulation, state: State) -> None:
        self._terms = terms
        self._dtype = sim.dtype
        real = [self._real_columns(term, sim, state) for term in terms]
        counts = torch.stack([mask.sum(1) for mask in real], dim=1)  # [designs, terms]
        full = torch.cat(real, dim=1)
        totals = counts.sum(1)
        self.num_obs = int(totals.max())
        self.mask = (torch.arange(self.num_obs) < totals[:, None]).to(sim.device)
        stops = counts.cumsum(1).tolist()
        names = [term.name for term in terms]
        self.columns = [
            {name: slice(begin, stop) for name, begin, stop in zip(names, [0, *row[:-1]], row, strict=True)}
            for row in stops
        ]
        self._gather = None
        if not bool(full.all()):
            # Column full.shape[1] is an extra one of zeros, which feeds the padding.
            source = torch.full(self.mask.shape, full.shape[1], dtype=torch.long)
            for design, mask in enumerate(full):
                source[design, : int(totals[design])] = mask.nonzero()[:, 0]
            self._gather = source.to(sim.device)[sim.design_index]
            self._zeros = torch.zeros((sim.num_envs, 1), dtype=sim.dtype, device=sim.device)

    @staticmethod
    def _real_columns(term: Observation, sim: Simulation, state: State) -> torch.Tensor:
        """bool ``[designs, k]``: which of a term's flattened columns each design has."""
        value = term(state)
        if value.ndim == 3:
            points = sim.point_mask(dict(term.params)["name"]).cpu()
            return torch.cat([points, points], dim=1)
        return torch.ones((sim.num_designs, value.shape[1]), dtype=torch.bool)

    def observe(self, state: State) -> torch.Tensor:
        """A fresh tensor ``[num_envs, num_obs]`` in the simulation's dtype."""
        parts = [term(state).flatten(1).to(self._dtype) for term in self._terms]
        if self._gather is None:
            return torch.cat(parts, dim=1)
        return torch.cat([*parts, self._zeros], dim=1).gather(1, self._gather)
