"""MAP-Elites with pyribs: keeps and mutates the best body in each cell of a descriptor grid."""

from collections.abc import Sequence

import numpy as np

from warpvox.algos.candidate import Candidate
from warpvox.algos.search.base import BaseSearch, Proposal
from warpvox.algos.search.settings import MapElites
from warpvox.errors import ConfigError
from warpvox.types import ACTUATORS, Cell

try:
    from ribs.archives import GridArchive
except ImportError as error:
    raise ConfigError("search=map_elites needs the package ribs: pip install 'warpvox[search]'") from error


class MapElitesSearch(BaseSearch):
    """MAP-Elites: mutates designs drawn from a grid with the best design of every kind.

    Attributes:
        archive: of pyribs; its field ``id`` holds the candidate of each cell.
    """

    settings: MapElites

    def __init__(self, settings: MapElites, shape: tuple[int, int] = (5, 5), seed: int = 0) -> None:
        super().__init__(settings, shape, seed)
        axes = len(settings.descriptors)
        self.archive = GridArchive(
            solution_dim=self.shape[0] * self.shape[1],
            dims=[settings.bins] * axes,
            ranges=[(0.0, 1.0)] * axes,
            extra_fields={"id": ((), np.int64)},
        )

    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        """Return random bodies in the first generation, later mutants of uniformly drawn elites."""
        if self.generation == 0:
            return [self.random_proposal(rng) for _ in range(count)]
        elites = self.elites()
        return [self.mutant(rng, elites, self.settings.mutation_rate) for _ in range(count)]

    def elites(self) -> list[int]:
        """Return the ids of the elites, the best designs of each kind, ascending."""
        return sorted(int(number) for number in self.archive.data("id"))

    def learn(self, candidates: Sequence[Candidate], fitness: Sequence[float]) -> None:
        """Insert each design into its cell of the grid, unless the cell has a better one."""
        bodies = np.stack([candidate.body for candidate in candidates])
        kinds = describe(bodies, self.settings.descriptors)
        ids = np.array([candidate.id for candidate in candidates])
        self.archive.add(bodies.reshape(len(bodies), -1), np.asarray(fitness), kinds, id=ids)


def describe(bodies: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Compute the descriptors of bodies ``[n, rows, columns]`` as float64 ``[n, descriptors]``.

    ``actuators``, ``empty``, ``rigid``, ``soft``, ``horizontal`` and ``vertical`` are shares of the grid's cells;
    ``height`` and ``width`` what the body spans of the grid; ``symmetry`` is the share of cells that equal their
    mirror image from left to right.
    """
    return np.stack([_descriptor(bodies, name) for name in names], 1)


def _descriptor(bodies: np.ndarray, name: str) -> np.ndarray:
    """Compute one descriptor of bodies, float64 ``[n]``."""
    # Descriptors that are fractions of the grid's cells
    shares = {
        "actuators": ACTUATORS,
        "empty": (Cell.EMPTY,),
        "rigid": (Cell.RIGID,),
        "soft": (Cell.SOFT,),
        "horizontal": (Cell.H_ACT,),
        "vertical": (Cell.V_ACT,),
    }
    if name in shares:
        return np.isin(bodies, shares[name]).mean((1, 2))
    if name == "symmetry":
        return (bodies == bodies[:, :, ::-1]).mean((1, 2))
    # A body is connected, so that it touches every row and column between its ends.
    touched = (bodies != Cell.EMPTY).any(axis={"height": 2, "width": 1}[name])
    return touched.mean(1)
