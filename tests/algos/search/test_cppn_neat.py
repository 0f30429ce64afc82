"""CPPN-NEAT is the paper's: Table 5, three inputs, five outputs; its randomness is its own."""

from pathlib import Path

import neat
import numpy as np
import pytest
from refusals import refused

from warpvox.algos.search import CppnNeat, make_search
from warpvox.algos.search.cppn_neat import CppnNeatSearch, inputs, neat_config, own_random, paint
from warpvox.errors import ConfigError, SearchError

TABLE_5 = {
    "num_inputs": 3, "num_hidden": 1, "num_outputs": 5, "initial_connection": "partial_direct",
    "connection_fraction": 0.5, "feed_forward": True, "compatibility_disjoint_coefficient": 1.0,
    "compatibility_weight_coefficient": 0.6, "conn_add_prob": 0.2, "conn_delete_prob": 0.2, "node_add_prob": 0.2,
    "node_delete_prob": 0.2, "activation_options": ["sigmoid"], "activation_mutate_rate": 0.0,
    "aggregation_options": ["sum"], "aggregation_mutate_rate": 0.0, "bias_init_mean": 0.0, "bias_init_stdev": 1.0,
    "bias_replace_rate": 0.1, "bias_mutate_rate": 0.7, "bias_mutate_power": 0.5, "bias_max_value": 30.0,
    "bias_min_value": -30.0, "response_init_mean": 1.0, "response_init_stdev": 0.0, "response_replace_rate": 0.0,
    "response_mutate_rate": 0.0, "response_mutate_power": 0.0, "response_max_value": 30.0,
    "response_min_value": -30.0, "weight_max_value": 30, "weight_min_value": -30, "weight_init_mean": 0.0,
    "weight_init_stdev": 1.0, "weight_mutate_rate": 0.8, "weight_replace_rate": 0.1, "weight_mutate_power": 0.5,
    "enabled_default": "True", "enabled_mutate_rate": 0.01,
}  # fmt: skip


def test_values_are_those_of_table_5_and_the_population_that_of_table_2() -> None:
    config = neat_config(CppnNeat())
    assert {name: getattr(config.genome_config, name) for name in TABLE_5} == TABLE_5
    assert config.species_set_config.compatibility_threshold == 3.0
    assert config.pop_size == 25


def test_what_table_5_does_not_say_is_the_librarys_default() -> None:
    config = neat_config(CppnNeat())
    reproduction, stagnation = config.reproduction_config, config.stagnation_config
    for part, kind in ((reproduction, neat.DefaultReproduction), (stagnation, neat.DefaultStagnation)):
        default = kind.parse_config({})
        assert {p.name: getattr(part, p.name) for p in part._params} == {
            p.name: getattr(default, p.name) for p in default._params
        }


@pytest.mark.parametrize("shape", [(5, 5), (5, 7), (2, 4)])
def test_inputs_are_x_y_and_distance_from_the_middle(shape: tuple[int, int]) -> None:
    seen = inputs(shape)
    for row in range(shape[0]):
        for column in range(shape[1]):
            x, y = column - (shape[1] - 1) / 2, row - (shape[0] - 1) / 2
            assert seen[row * shape[1] + column] == pytest.approx([x, y, (x * x + y * y) ** 0.5])


def test_a_voxel_is_of_the_type_with_the_largest_output() -> None:
    """A network made by hand: the weights of x and y to outputs 3 and 4 split the grid along a diagonal."""
    search = CppnNeatSearch(CppnNeat())
    with own_random(0):
        (genome,) = search.reproduction.create_new(neat.DefaultGenome, search.config.genome_config, 1).values()
    genome.connections.clear()
    for key, node in genome.nodes.items():
        node.bias = 0.0 if key in (3, 4) else -5.0
    for number, (place, weight) in enumerate([((-1, 3), 1.0), ((-2, 4), 1.0)]):
        gene = neat.genes.DefaultConnectionGene(place, innovation=number + 1)
        gene.weight, gene.enabled = weight, True
        genome.connections[place] = gene
    body = paint(genome, search.config, (3, 5))
    # x > y: type 3, y > x: type 4, and of equal outputs the first
    expected = [[3 if column - 2 >= row - 1 else 4 for column in range(5)] for row in range(3)]
    assert body.tolist() == expected


def test_children_descend_from_the_networks_that_bred_them() -> None:
    search = make_search(CppnNeat(), seed=2)
    assert isinstance(search, CppnNeatSearch)
    for _ in range(5):
        asked = search.ask()
        fresh = [key for key in search.population if key not in search.ids]
        for candidate, key in zip(asked, fresh, strict=True):
            parents = {search.ids[parent] for parent in search.reproduction.ancestors[key]}
            assert set(candidate.parents) == parents
            assert candidate.origin == ("random", "mutation", "crossover")[len(parents)]
            assert np.array_equal(paint(search.population[key], search.config, (5, 5)), candidate.body)
        search.tell([float((candidate.body == 4).mean()) for candidate in asked])
        assert all(genome.fitness is not None for genome in search.population.values())
        members = [key for species in search.species.species.values() for key in species.members]
        assert sorted(members) == sorted(search.population)


def own_config(repository: Path, folder: Path, old: str, new: str) -> CppnNeat:
    text = (repository / "algos" / "search" / "cppn_neat.cfg").read_text(encoding="utf-8")
    assert old in text
    file = folder / "own.cfg"
    file.write_text(text.replace(old, new), encoding="utf-8")
    return CppnNeat(neat_config=str(file), population=10, max_designs=60)


def test_an_elite_of_an_own_configuration_is_kept_and_not_proposed_again(repository: Path, tmp_path: Path) -> None:
    settings = own_config(repository, tmp_path, "elitism = 0\nsurvival", "elitism = 2\nsurvival")
    search = make_search(settings, seed=1)
    assert isinstance(search, CppnNeatSearch)
    sizes = []
    while asked := search.ask():
        sizes.append(len(asked))
        search.tell([float((candidate.body == 4).mean()) for candidate in asked])
    assert sizes[0] == 10
    assert max(sizes[1:]) <= 8
    assert sum(sizes) == 60


def test_extinction_is_a_new_beginning(repository: Path, tmp_path: Path) -> None:
    settings = own_config(repository, tmp_path, "max_stagnation = 15", "max_stagnation = 1")
    search = make_search(settings, seed=1)
    origins = []
    while asked := search.ask():
        origins.append({candidate.origin for candidate in asked})
        search.tell([1.0] * len(asked))
    assert {"random"} in origins[1:]


def test_mistakes_in_an_own_configuration(repository: Path, tmp_path: Path) -> None:
    with refused(ConfigError, "no configuration file of neat-python 'none.cfg'"):
        make_search(CppnNeat(neat_config="none.cfg"))
    with refused(ConfigError, "num_outputs = 5"):
        make_search(own_config(repository, tmp_path, "num_outputs = 5", "num_outputs = 4"))
    with refused(ConfigError, "neat-python cannot read '", "own.cfg':", "'conn_add_prob'"):
        make_search(own_config(repository, tmp_path, "conn_add_prob", "conn_ad_prob"))
    search = make_search(own_config(repository, tmp_path, "min_species_size = 1", "min_species_size = 11"))
    search.tell([0.0] * len(search.ask()))
    with refused(SearchError, "cannot breed 10 networks", "lower elitism", "search.population"):
        search.ask()
