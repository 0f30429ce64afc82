"""Bayesian optimisation is the paper's: Table 4's process and its acquisitions, computed here a second time."""

import math

import numpy as np
import pytest
import torch
from botorch.acquisition import LogExpectedImprovement

from warpvox.algos.search import BO, make_search
from warpvox.algos.search.bo_acquire import (
    ascend,
    climb,
    fit_model,
    log_improvement,
    one_hot,
    seeded_torch,
    thompson_starts,
)
from warpvox.algos.search.bodies import body_key, neighbours
from warpvox.design import are_valid, draw_bodies
from warpvox.errors import ConfigError

TOLERANCE = 1e-6
"""The process is in double precision; BoTorch adds up to this much to a diagonal for the sake of Cholesky."""


def some_bodies(count: int, shape: tuple[int, int] = (4, 4), seed: int = 0) -> np.ndarray:
    bodies = draw_bodies(np.random.default_rng(seed), 40 * count, shape)
    return np.unique(bodies[are_valid(bodies)], axis=0)[:count]


def some_fitness(bodies: np.ndarray) -> list[float]:
    """Actuators are good, the more so further down: something that a process can learn."""
    return [float(((body >= 3) * np.arange(1, len(body) + 1)[:, None]).sum() + 10) for body in bodies]


def searched(settings: BO, shape: tuple[int, int] = (4, 4), seed: int = 0) -> list[list]:
    """The generations of a search that is told :func:`some_fitness`."""
    search, generations = make_search(settings, shape, seed), []
    while asked := search.ask():
        generations.append(asked)
        search.tell(some_fitness(np.stack([candidate.body for candidate in asked])))
    return generations


def hasty(**changes: object) -> BO:
    return BO(**({"optimizer_restarts": 1, "optimizer_iterations": 10, "candidates": 60} | changes))


def matern(one: np.ndarray, other: np.ndarray, variance: float, length: float) -> np.ndarray:
    """Matern 5/2 on one-hot voxels: bodies that differ in k voxels are the root of 2 k apart."""
    differences = (one[:, None] != other[None]).sum((-1, -2))
    r = np.sqrt(2.0 * differences) * math.sqrt(5) / length
    return variance * (1 + r + r**2 / 3) * np.exp(-r)


def test_the_posterior_is_that_of_the_text_book() -> None:
    bodies, others = some_bodies(20), some_bodies(15, seed=1)
    fitness = np.array(some_fitness(bodies))
    with seeded_torch(0):
        model = fit_model(bodies, fitness, BO(optimizer_restarts=1))
        posterior = model.posterior(one_hot(others))
    kernel, mean = model.covar_module, model.mean_module.constant.item()
    shape = (kernel.outputscale.item(), kernel.base_kernel.lengthscale.item())
    targets = (fitness - fitness.mean()) / fitness.std(ddof=1)
    covariance = matern(bodies, bodies, *shape) + model.likelihood.noise.item() * np.eye(20)
    cross = matern(others, bodies, *shape)
    expected = mean + cross @ np.linalg.solve(covariance, targets - mean)
    assert posterior.mean.detach().numpy()[:, 0] == pytest.approx(
        fitness.mean() + fitness.std(ddof=1) * expected, abs=1e-4
    )
    variance = shape[0] - np.einsum("ij,ji->i", cross, np.linalg.solve(covariance, cross.T))
    assert posterior.variance.detach().numpy()[:, 0] == pytest.approx(variance * fitness.var(ddof=1), rel=1e-3)


@pytest.fixture(scope="module")
def model():
    bodies = some_bodies(30)
    with seeded_torch(0):
        return fit_model(bodies, some_fitness(bodies), BO(optimizer_restarts=2))


@pytest.mark.parametrize("above", [-30.0, -1.0, 0.0, 1.0, 10.0, 300.0])
def test_expected_improvement_of_many_bodies_is_botorchs(model, above: float) -> None:
    """From hardly any chance of an improvement (300 above the best that is known) to a certain one."""
    others = some_bodies(40, seed=2)
    best = max(some_fitness(some_bodies(30))) + above
    with torch.no_grad():
        expected = LogExpectedImprovement(model, best_f=best)(one_hot(others)[:, None]).numpy()
    assert log_improvement(model, best)(others) == pytest.approx(expected, rel=1e-5, abs=1e-6)


def cell_sums(table: np.ndarray):
    """A function of bodies 4 x 4: the sum over voxels of what ``table [16, 5]`` says of their types."""
    return lambda bodies: table[np.arange(16), bodies.reshape(-1, 16)].sum(-1)


def test_an_ascent_stays_on_free_bodies_and_ends_where_none_beside_it_is_higher() -> None:
    values = cell_sums(np.random.default_rng(1).normal(size=(16, 5)))
    taken: set[bytes] = set()

    def free(bodies: np.ndarray) -> np.ndarray:
        return are_valid(bodies) & np.array([body_key(body) not in taken for body in bodies])

    starts, summits = some_bodies(12), []
    for start in starts:
        begins_free = bool(free(start[None])[0])
        summit = ascend(values, start[None], free)
        assert free(summit[None])[0]
        if begins_free:
            assert values(summit[None])[0] >= values(start[None])[0]
        around = neighbours(summit[None])[0]
        assert (values(around[free(around)]) <= values(summit[None])[0] + TOLERANCE).all()
        summits.append(summit)
        taken.add(body_key(summit))
    # additive values have hardly more than one summit, and yet every start has found a body of its own
    assert len(taken) == len(starts)


def test_thompson_sampling_follows_the_posterior(model) -> None:
    """Each place is the best of one sample: over many draws, as often as the posterior says it is the best."""
    pool = some_bodies(6, seed=4)
    with seeded_torch(0), torch.no_grad():
        samples = model.posterior(one_hot(pool)).sample(torch.Size([4000]))[..., 0]
        expected = np.bincount(samples.argmax(-1).numpy(), minlength=6) / 4000
        first = [thompson_starts(model, pool, 1)[0] for _ in range(300)]
        several = thompson_starts(model, pool, 5)
    found = np.bincount(first, minlength=6) / 300
    assert found == pytest.approx(expected, abs=5 * 0.5 * (1 / 300 + 1 / 4000) ** 0.5)
    assert len(set(several.tolist())) == 5


def test_climbing_ends_where_no_valid_neighbour_is_higher() -> None:
    rng = np.random.default_rng(0)
    table = rng.normal(size=(3, 16, 5))

    def values(bodies: np.ndarray) -> np.ndarray:
        flat = bodies.reshape(*bodies.shape[:-2], 16).astype(int)
        flat = np.broadcast_to(flat, (3, *flat.shape[-2:]))
        return np.take_along_axis(table[:, None], flat[..., None], -1)[..., 0].sum(-1)

    pool = some_bodies(20)
    result = climb(values, pool)
    at_pool = values(pool)
    assert np.array_equal(result.start, at_pool.argmax(1))
    assert np.array_equal(result.at_pool, at_pool)
    assert are_valid(result.summit).all()
    around = neighbours(result.summit)
    heights = values(result.summit[:, None])[:, 0]
    assert (heights >= at_pool.max(1)).all()
    usable = are_valid(around.reshape(-1, 4, 4)).reshape(3, -1)
    assert (np.where(usable, values(around), -np.inf).max(1) <= heights + TOLERANCE).all()
    # additive values: without the demand for validity, the best type of each voxel would be the summit
    assert (heights <= table.max(-1).sum(-1) + TOLERANCE).all()


@pytest.mark.parametrize("acquisition", ["paper", "lbfgs", "pathwise"])
def test_a_fitness_whose_square_overflows_can_be_learned_from(acquisition: str) -> None:
    search = make_search(hasty(acquisition=acquisition, population=6, max_designs=12), (4, 4))
    search.tell([(-1) ** k * k * 1e300 for k, _ in enumerate(search.ask())])
    assert len({body_key(candidate.body) for candidate in search.ask()}) == 6


@pytest.mark.parametrize("name", ["kernel_variance", "kernel_length_scale"])
@pytest.mark.parametrize("value", [1e-300, 1e-4, 0.025, 0.05, 1e6, 1e300])
def test_a_kernel_from_which_no_fit_can_begin_is_refused_before_a_design_is_tried(name: str, value: float) -> None:
    try:
        settings = hasty(population=3, max_designs=6, **{name: value})
    except ConfigError as error:
        assert str(error).startswith(f"search.{name} must be at")  # noqa: PT017  (some values are valid)
        return
    search = make_search(settings, (3, 3))
    search.tell([0.0 for _ in search.ask()])
    assert len(search.ask()) == 3


@pytest.mark.parametrize("acquisition", ["paper", "pathwise"])
def test_proposals_do_not_depend_on_the_threads_of_torch(acquisition: str) -> None:
    settings = hasty(acquisition=acquisition, population=6, max_designs=12)
    found = []
    before = torch.get_num_threads()
    for threads in (1, 2):
        torch.set_num_threads(threads)
        found.append([body_key(candidate.body) for asked in searched(settings, (5, 5), 4) for candidate in asked])
    torch.set_num_threads(before)
    assert found[0] == found[1]


def test_mutants_are_those_of_the_best_bodies() -> None:
    bodies = some_bodies(40)
    search = make_search(hasty(population=40, max_designs=60), (4, 4), 0)
    search.bodies, search.fitness = list(bodies), list(map(float, np.random.default_rng(0).permutation(40)))
    pool, parents = search.pool(np.random.default_rng(0), 0, 200)
    assert len(pool) == len(parents) == 200
    assert {search.fitness[parent] for (parent,) in parents} == set(map(float, range(15, 40)))  # the best 25 of 40


@pytest.mark.parametrize("acquisition", ["paper", "lbfgs"])
def test_each_start_leads_to_a_body_and_says_whether_it_is_another(acquisition: str, monkeypatch) -> None:
    from warpvox.algos.search import bo

    starts: list[np.ndarray] = []

    def watched(model, bodies: np.ndarray, count: int) -> np.ndarray:
        chosen = thompson_starts(model, bodies, count)
        starts.append(bodies[chosen])
        return chosen

    monkeypatch.setattr(bo, "thompson_starts", watched)
    generations = searched(hasty(acquisition=acquisition, population=6, max_designs=18))
    assert len(starts) == len(generations) - 1 == 2
    for begun, generation in zip(starts, generations[1:], strict=True):
        for start, candidate in zip(begun, generation, strict=True):
            assert candidate.origin == ("thompson" if np.array_equal(candidate.body, start) else "improvement")
