"""CPPN-NEAT (paper section C.3, Table 5) with neat-python: evolved networks paint bodies."""

# neat-python has no types.
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false
# pyright: reportUnknownArgumentType=false, reportUnknownMemberType=false, reportUnknownVariableType=false

import random
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path

import neat
import numpy as np

from warpvox.algos.candidate import Candidate
from warpvox.algos.search.base import BaseSearch, Proposal
from warpvox.algos.search.bodies import CELL_TYPES
from warpvox.algos.search.settings import CppnNeat
from warpvox.design import are_valid
from warpvox.errors import ConfigError, SearchError


@contextmanager
def own_random(seed: int) -> Generator[None]:
    """Seed Python's global random generator within the block, for neat-python; then restore its state."""
    state = random.getstate()
    random.seed(seed)
    try:
        yield
    finally:
        random.setstate(state)


def neat_config(settings: CppnNeat) -> neat.Config:
    """Read neat-python's configuration, Table 5 or ``settings.neat_config``, and set the population.

    ConfigError: no such file, or one that neat-python cannot read or that has another number of inputs or outputs.
    """
    kinds = (neat.DefaultGenome, neat.DefaultReproduction, neat.DefaultSpeciesSet, neat.DefaultStagnation)
    if settings.neat_config is None:
        with as_file(files("warpvox.algos.search") / "cppn_neat.cfg") as path:
            config = neat.Config(*kinds, str(path))
    else:
        if not Path(settings.neat_config).is_file():
            raise ConfigError(f"There is no configuration file of neat-python '{settings.neat_config}'.")
        try:
            config = neat.Config(*kinds, settings.neat_config)
        except Exception as error:  # neat-python raises whatever its parser stumbles on
            raise ConfigError(f"neat-python cannot read '{settings.neat_config}': {error}") from error
    genome = config.genome_config
    inputs = 3  # x, y and the distance from the middle
    if (genome.num_inputs, genome.num_outputs) != (inputs, CELL_TYPES) or not genome.feed_forward:
        raise ConfigError(
            f"The networks must be feed_forward with num_inputs = {inputs} (x, y, distance) and num_outputs ="
            f" {CELL_TYPES} (one per type of voxel); '{settings.neat_config}' has {genome.num_inputs} and"
            f" {genome.num_outputs}."
        )
    config.pop_size = settings.population
    return config


def inputs(shape: tuple[int, int]) -> np.ndarray:
    """Return the network's inputs for each voxel, row by row: ``[cells, 3]``, x right and y down from the middle."""
    rows, columns = shape
    y, x = np.mgrid[:rows, :columns].reshape(2, -1) - np.array([[(rows - 1) / 2], [(columns - 1) / 2]])
    return np.stack([x, y, np.hypot(x, y)], 1)


def paint(genome: neat.DefaultGenome, config: neat.Config, shape: tuple[int, int]) -> np.ndarray:
    """Paint a body int8 ``[rows, columns]``: each voxel gets the type with the network's largest output."""
    network = neat.nn.FeedForwardNetwork.create(genome, config)
    types = [int(np.argmax(network.activate(seen))) for seen in inputs(shape).tolist()]
    return np.array(types, np.int8).reshape(shape)


class CppnNeatSearch(BaseSearch):
    """CPPN-NEAT; networks that paint no valid new body are replaced by new ones, as in the paper's code.

    Attributes:
        population: genomes of the last generation, by neat-python's key.
        ids: of the candidates that they painted, by the same key.
    """

    settings: CppnNeat
    takes_start = False  # no network is known that paints a given body

    def __init__(self, settings: CppnNeat, shape: tuple[int, int] = (5, 5), seed: int = 0) -> None:
        super().__init__(settings, shape, seed)
        self.config = neat_config(settings)
        self.reporters = neat.reporting.ReporterSet()
        stagnation = neat.DefaultStagnation(self.config.stagnation_config, self.reporters)
        self.reproduction = neat.DefaultReproduction(self.config.reproduction_config, self.reporters, stagnation)
        self.species = neat.DefaultSpeciesSet(self.config.species_set_config, self.reporters)
        self.population: dict[int, neat.DefaultGenome] = {}
        self.ids: dict[int, int] = {}

    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        """Return bodies painted by children of the last generation; new networks replace useless ones."""
        with own_random(int(rng.integers(2**63))):
            bred = self._breed()
            elites = {key: genome for key, genome in bred.items() if key in self.ids}
            children = {key: genome for key, genome in bred.items() if key not in self.ids}
            count = min(count, self.settings.population - len(elites))
            if not count:
                raise SearchError("neat_config keeps the whole population as its elite: nothing new is ever tried.")
            proposals = self._new_bodies(children, count)
            self.population = elites | {key: genome for key, (genome, _) in proposals.items()}
        ancestors = self.reproduction.ancestors
        origins = ("random", "mutation", "crossover")
        parents = {key: tuple(sorted({self.ids[parent] for parent in ancestors[key]})) for key in proposals}
        return [Proposal(body, parents[key], origins[len(parents[key])]) for key, (_, body) in proposals.items()]

    def learn(self, candidates: Sequence[Candidate], fitness: Sequence[float]) -> None:
        """Assign fitness to the networks and sort them into species."""
        fresh = [key for key in self.population if key not in self.ids]
        self.ids |= {key: candidate.id for key, candidate in zip(fresh, candidates, strict=True)}
        for key, genome in self.population.items():
            genome.fitness = self.fitness[self.ids[key]]
        if len(self.bodies) < self.settings.max_designs:  # not needed after the last generation, which may be too small
            self.species.speciate(self.config, self.population, self.generation)

    def _breed(self) -> dict[int, neat.DefaultGenome]:
        """Create the next networks by key: children, or new ones at the start and after an extinction."""
        if self.generation:
            size = self.settings.population
            try:
                bred = self.reproduction.reproduce(self.config, self.species, size, self.generation - 1)
            except RuntimeError as error:
                raise SearchError(
                    f"neat-python cannot breed {size} networks ({str(error).rstrip('.')}): lower elitism or"
                    " min_species_size in neat_config, or raise its compatibility_threshold or search.population."
                ) from error
            if bred:
                return bred
            # All species have stagnated (reset_on_extinction): start again with new networks.
            self.species = neat.DefaultSpeciesSet(self.config.species_set_config, self.reporters)
        return self._create(self.settings.population)

    def _create(self, count: int) -> dict[int, neat.DefaultGenome]:
        """Create ``count`` new networks, by key."""
        return self.reproduction.create_new(self.config.genome_type, self.config.genome_config, count)

    def _new_bodies(
        self, genomes: dict[int, neat.DefaultGenome], count: int
    ) -> dict[int, tuple[neat.DefaultGenome, np.ndarray]]:
        """Create ``count`` networks that paint valid new bodies; return keys, networks and bodies."""
        chosen: dict[int, tuple[neat.DefaultGenome, np.ndarray]] = {}
        # Try new networks this many times before giving up.
        for _ in range(2000):
            bodies = np.stack([paint(genome, self.config, self.shape) for genome in genomes.values()])
            for (key, genome), body, good in zip(genomes.items(), bodies, are_valid(bodies), strict=True):
                if good and len(chosen) < count and self.claim(body):
                    chosen[key] = (genome, body)
            if len(chosen) == count:
                return chosen
            genomes = self._create(count - len(chosen))
        raise SearchError(
            f"The networks paint no new {self.shape[0]}x{self.shape[1]} body after {len(self._seen)} have been"
            f" proposed. Ask for fewer evaluations than max_designs={self.settings.max_designs}."
        )
