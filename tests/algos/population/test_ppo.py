"""Population PPO against stock rsl-rl trainings, one for each design."""

import pytest
import torch
from population_cases import bodies, factory, training_preset

from warpvox.algos.population.training import PopulationTraining
from warpvox.algos.settings import DesignTraining
from warpvox.algos.training.runner import Runner, Schedule, adapt

SEEDS = [11, 22, 33, 44]
UPDATES = 5
SAME = 1e-6  # the promise: after five updates, whatever is only rounding differs by less


pytestmark = pytest.mark.usefixtures("one_thread")


class Stock:
    """A stock training of one design, with torch's random numbers to itself."""

    def __init__(self, task: str, dtype: str, design: int, how: DesignTraining) -> None:
        body, seed = bodies(len(SEEDS))[design], SEEDS[design]
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            env = adapt(factory(task, dtype).make([body], how.envs, [seed], auto_reset=True), how.ppo)
            self.runner = Runner(env, how.ppo, Schedule(how.iterations, evaluate=10**6))
            self.random = torch.get_rng_state()
        self.random_start = how.ppo.random_start

    def iterate(self) -> None:
        with torch.random.fork_rng():
            torch.set_rng_state(self.random)
            self.runner.learn(1, init_at_random_ep_len=self.random_start)
            self.random = torch.get_rng_state()


def differences(training: PopulationTraining, stocks: list[Stock]) -> dict[str, float]:
    """The largest difference of every parameter and moment, by name."""
    worst: dict[str, float] = {}
    for design, stock in enumerate(stocks):
        pairs = (
            (training.algorithm.actor, stock.runner.alg.actor),
            (training.algorithm.critic, stock.runner.alg.critic),
        )
        for ours, theirs in pairs:
            mine, other = ours.member(design), theirs.state_dict()
            assert mine.keys() == other.keys()
            for name, value in mine.items():
                assert value.shape == other[name].shape
                gap = float((value.double() - other[name].double()).abs().max())
                worst[name] = max(worst.get(name, 0.0), gap)
    return worst


def make(task: str, dtype: str, how: DesignTraining) -> tuple[PopulationTraining, list[Stock]]:
    stocks = [Stock(task, dtype, design, how) for design in range(len(SEEDS))]
    return PopulationTraining(factory(task, dtype), bodies(len(SEEDS)), SEEDS, how), stocks


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize(
    ("preset", "task"),
    [
        *(("paper", "Walker-v0"), ("fast", "Catcher-v0")),
        *(pytest.param(*pair, marks=pytest.mark.slow) for pair in (("paper", "Catcher-v0"), ("fast", "Walker-v0"))),
    ],
)
def test_whole_trainings_equal_separate_stock_ones(preset: str, task: str) -> None:
    """From the first weights on: noise, episodes, orders, losses, schedules. In float64, and with short rollouts:
    contacts make what is rounding at first grow by an order of magnitude every few control steps."""
    how = training_preset(preset, {"steps": 4}, envs=4)
    training, stocks = make(task, "float64", how)
    assert min(len({*training.algorithm.actor.inputs}), len({*training.algorithm.actor.outputs})) > 1  # padded
    assert max(differences(training, stocks).values()) == 0.0
    for _ in range(UPDATES):
        training.iterate()
        for stock in stocks:
            stock.iterate()
    assert max(differences(training, stocks).values()) < SAME
    assert training.algorithm.rates.tolist() == pytest.approx([stock.runner.alg.learning_rate for stock in stocks])


@pytest.mark.parametrize("threads", [2, 3])
def test_learning_is_the_same_bit_for_bit_with_any_number_of_threads(threads: int) -> None:
    how = training_preset("fast", {"steps": 4, "epochs": 2}, envs=8)
    designs = 17  # in two blocks
    one, many = (
        PopulationTraining(factory().computed(threads=count), bodies(designs), list(range(designs)), how)
        for count in (1, threads)
    )
    for training in (one, many):
        for _ in range(2):
            training.iterate()
    for design in range(designs):
        for name, value in one.policy(design).items():
            assert torch.equal(many.policy(design)[name], value)
