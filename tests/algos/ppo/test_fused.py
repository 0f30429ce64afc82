"""PPO in few launches against the same formulas operation by operation, on rollouts of random numbers."""

from functools import partial
from typing import Any

import pytest
import torch
from learning import ppo_settings
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from warpvox.algos.population.training import Networks, fresh_networks
from warpvox.algos.ppo.fused import FusedPPO
from warpvox.algos.ppo.networks import PopulationActor, PopulationModel
from warpvox.algos.ppo.population import PopulationPPO, Streams
from warpvox.algos.ppo.stock import rsl_rl_config
from warpvox.algos.settings import Ppo
from warpvox.devices.startup import start_warp

SIZES = ((9, 3), (6, 1), (8, 5))
"""Observations and actions of each design: those of smaller ones are padded."""
ENVS, STEPS, ITERATIONS = 8, 5, 4
SAME = 2e-5
"""Largest difference of a number after four iterations, of which each moves parameters by about 1e-2."""
CASES: dict[str, dict[str, Any]] = {
    "adaptive": {"schedule": "adaptive", "desired_kl": 0.004, "hidden": [8, 7]},
    "linear, clipped values": {"schedule": "linear", "clip_values": True, "activation": "elu"},
    "neither normaliser nor bootstrap": {"normalize_obs": False, "entropy_coef": 0.02, "max_grad_norm": 0.05},
}

pytestmark = pytest.mark.usefixtures("one_thread")
start_warp()


def padded(random: torch.Generator, sizes: list[int], *shape: int) -> torch.Tensor:
    """Random numbers ``[*shape, designs * ENVS, max(sizes)]``; 0 beyond the size of a design."""
    values = torch.randn(*shape, len(sizes), ENVS, max(sizes), generator=random)
    mask = torch.arange(max(sizes)) < torch.tensor(sizes)[:, None, None]
    return (values * mask).flatten(-3, -2)


def make(kind: type[PopulationPPO], settings: Ppo, networks: list[Networks]) -> PopulationPPO:
    actor = PopulationActor([one.actor for one in networks])
    critic = PopulationModel([one.critic for one in networks])
    rows = ENVS * len(networks)
    obs = TensorDict({"policy": torch.zeros(rows, max(actor.inputs))}, [rows])
    storage = RolloutStorage("rl", rows, STEPS, obs, [max(actor.outputs)])
    streams = Streams([torch.Generator().manual_seed(seed) for seed in range(len(networks))], "cpu")
    algorithm = {k: v for k, v in rsl_rl_config(settings, 100)["algorithm"].items() if k != "class_name"}
    return kind(actor, critic, storage, streams, **algorithm)


def iterate(algorithm: PopulationPPO, number: int, time_limits: bool) -> dict[str, torch.Tensor]:
    """Learn from one rollout of random observations, rewards and ends; return all that came of it."""
    random = torch.Generator().manual_seed(number)
    inputs = algorithm.actor.inputs
    rows = ENVS * len(inputs)

    def drawn() -> TensorDict:
        return TensorDict({"policy": padded(random, inputs)}, [rows])

    found = {}
    algorithm.prepare()
    for step in range(STEPS):
        found[f"actions {step}"] = algorithm.act(drawn()).clone()
        dones = torch.rand(rows, generator=random) < 0.2
        extras: dict[str, Any] = {}
        if time_limits:
            extras = {"time_outs": dones & (torch.rand(rows, generator=random) < 0.5), "final_obs": drawn()}
        algorithm.process_env_step(drawn(), torch.randn(rows, generator=random), dones, extras)
    algorithm.compute_returns(drawn())
    for name in ("rewards", "dones", "values", "actions_log_prob", "returns", "advantages"):
        found[name] = getattr(algorithm.storage, name).clone()
    found |= algorithm.update()
    for design in range(len(inputs)):
        for name, network in (("actor", algorithm.actor), ("critic", algorithm.critic)):
            found |= {f"{design} {name} {key}": value for key, value in network.member(design).items()}
    means, squares = algorithm.optimizer.moments()
    for k, parameter in enumerate(algorithm.optimizer.parameters):
        found |= {f"first moment {k}": means[parameter].clone(), f"second moment {k}": squares[parameter].clone()}
    return found | {"rates": algorithm.rates.clone(), "healthy": algorithm.healthy()}


@pytest.mark.parametrize("case", CASES)
def test_few_launches_compute_what_many_operations_do(case: str) -> None:
    """Losses, rates, parameters and moments of three designs, of which one is dropped halfway."""
    settings = ppo_settings(steps=STEPS, **CASES[case])
    networks = [fresh_networks(settings, *size, seed) for seed, size in enumerate(SIZES)]
    pair = [make(kind, settings, networks) for kind in (PopulationPPO, FusedPPO)]
    rates = set()
    for number in range(ITERATIONS):
        if number == ITERATIONS // 2:
            like = TensorDict({"policy": torch.zeros(2 * ENVS, SIZES[0][0])}, [2 * ENVS])
            for algorithm in pair:
                algorithm.keep([2, 0], like)
        plain, fused = (iterate(algorithm, number, "bootstrap" not in case) for algorithm in pair)
        assert plain.keys() == fused.keys()
        for name, value in plain.items():
            named = partial("{}: {}".format, name)
            torch.testing.assert_close(fused[name], value, rtol=SAME, atol=SAME, msg=named)
        rates |= set(plain["rates"].tolist())
    assert plain["healthy"].all()
    assert (len(rates) > 1) == (settings.schedule != "fixed")


@pytest.mark.parametrize("name", ["weight", "deviation"])
def test_a_design_with_nan_is_unhealthy_and_the_others_go_on(name: str) -> None:
    settings = ppo_settings(steps=STEPS)
    networks = [fresh_networks(settings, *size, seed) for seed, size in enumerate(SIZES)]
    algorithm = make(FusedPPO, settings, networks)
    actor = algorithm.actor
    (actor.weights[0] if name == "weight" else actor.distribution.log_std_param).data[1, 0, 0] = float("nan")
    found = iterate(algorithm, 0, True)
    assert found["healthy"].tolist() == [True, False, True]
