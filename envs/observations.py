"""Layout of observations whose size differs between designs."""

import numpy as np
import torch

from warpvox.envs.snapshot import Snapshot
from warpvox.envs.spec import Observation
from warpvox.simulation import Simulation


class ObservationLayout:
    """Concatenates observation terms, with each design's real entries first and zeros behind.

    Terms with a value for every point (x and y apart) or for every action are padded by the simulator to the largest
    body. A term has a value for every action if it reads ``actions(name)`` and has ``num_actions`` columns. A gather
    closes the gaps in smaller bodies; it is left out where all designs are of one size.

    Attributes:
        num_obs: columns of an observation.
        mask: bool ``[sim.num_designs, num_obs]``: the columns that are real, not padding.
        columns: for every distinct design of the simulation, where each term lies: ``{term name: slice}``.
        possible_columns: all columns in which a term may lie, ``{term name: slice}``: over the present designs and,
            if bodies may be exchanged (``sim.grid``), over all designs that may come.
        num_never_padded: number of first columns that are real in all those designs.
    """

    def __init__(self, terms: tuple[Observation, ...], sim: Simulation, state: Snapshot) -> None:
        self._terms = terms
        self._sim = sim
        self._values = [term(state) for term in terms]
        self._robots = [self._robot_of(term, value, state) for term, value in zip(terms, self._values, strict=True)]
        self._width = sum(value[0].numel() for value in self._values)
        self._gather: torch.Tensor | None = None
        counts = self.refresh()

        # The fewest and the most columns that each term has in any design
        fewest: list[int] = counts.min(0).tolist()
        most: list[int] = counts.max(0).tolist()
        if sim.grid is not None:  # bodies may be exchanged: in any design that may come
            most = [value[0].numel() for value in self._values]
            for k, (term, value, robot) in enumerate(zip(terms, self._values, self._robots, strict=True)):
                if robot:
                    fewest[k] = 0
                elif value.ndim == 3 and dict(term.params).get("name") in sim.action_columns[0]:
                    fewest[k] = 2 * 4  # x and y of a single voxel's points

        # The first column that a term may have follows the fewest columns of the terms before it; the last one ends the
        # most columns of these terms and itself.
        self.possible_columns: dict[str, slice] = {}
        start = stop = 0
        for k, term in enumerate(terms):
            stop += most[k]
            self.possible_columns[term.name] = slice(start, stop)
            start += fewest[k]
        self.num_never_padded = start

    def _robot_of(self, term: Observation, value: torch.Tensor, state: Snapshot) -> str:
        """Return the robot whose actions a term observes, else ""."""
        if value.shape[1:] != (self._sim.num_actions,):
            return ""
        own = Snapshot(self._sim, state.memory_values, copies=True)
        term(own)
        robots = [name for what, name, *_ in own.quantities if what == "robot_actions"]
        return robots[0] if len(robots) == 1 else ""

    def refresh(self) -> np.ndarray:
        """Recompute the layout for the present designs; return columns by term, int ``[designs, terms]``."""
        sim = self._sim

        # Which of a term's flattened columns each design has, bool [designs, k]
        real: list[torch.Tensor] = []
        for term, value, robot in zip(self._terms, self._values, self._robots, strict=True):
            if value.ndim == 3:
                real.append(sim.point_mask(dict(term.params)["name"]).cpu().repeat(1, 2))
            else:
                width = value.shape[1]
                sizes: list[list[int]] = []
                for columns in sim.action_columns:
                    own = columns.get(robot)
                    sizes.append([width if own is None else own.stop - own.start])
                real.append(torch.arange(width) < torch.tensor(sizes))
        full = torch.cat(real, dim=1)
        counts = np.stack([mask.numpy().sum(1) for mask in real], axis=1)  # [designs, terms]

        # Where bodies may be exchanged, there is room for the largest.
        totals = torch.as_tensor(counts.sum(1))
        self.num_obs = int(totals.max()) if sim.grid is None else full.shape[1]
        self.mask = (torch.arange(self.num_obs) < totals[:, None]).to(sim.device)

        # Where each term lies; designs of one size have one entry
        by_size: dict[tuple[int, ...], dict[str, slice]] = {}
        self.columns: list[dict[str, slice]] = []
        for row in counts.tolist():
            size = tuple(row)
            if size not in by_size:
                by_size[size] = {}
                start = 0
                for term, count in zip(self._terms, size, strict=True):
                    by_size[size][term.name] = slice(start, start + count)
                    start += count
            self.columns.append(by_size[size])

        # Gaps are closed by a gather. Column full.shape[1] is an extra one of zeros, which feeds the padding.
        if sim.grid is not None or not bool(full.all()):
            source = torch.argsort((~full).to(torch.uint8), dim=1, stable=True)[:, : self.num_obs]
            source = source.masked_fill(~self.mask.cpu(), full.shape[1]).to(sim.device)[sim.design_index]
            if self._gather is None:
                self._gather = source
                self._padded = torch.zeros((sim.num_envs, self._width + 1), dtype=sim.dtype, device=sim.device)
            else:
                self._gather.copy_(source)  # in place: a captured step may read it
        return counts

    def observe(self, state: Snapshot) -> torch.Tensor:
        """Compute observations ``[num_envs, num_obs]`` from all terms, a new tensor in the simulation's dtype."""
        if self._gather is None:
            shape = (self._sim.num_envs, self._width)
            obs = torch.empty(shape, dtype=self._sim.dtype, device=self._sim.device)
        else:
            obs = self._padded
        start = 0
        for term in self._terms:
            value = term(state)
            stop = start + value[0].numel()
            place = torch.unflatten(obs[:, start:stop], 1, value.shape[1:])
            place.copy_(value)  # converts and transposes on the way
            start = stop
        if self._gather is None:
            return obs
        return obs.gather(1, self._gather)
