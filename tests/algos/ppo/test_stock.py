"""Our PPO against rsl-rl's own, step by step and update by update: the same numbers drawn, the same things learned."""

import pytest
import torch
from learning import ENVS, ppo_settings, small_env, stock_ppo
from rsl_rl.algorithms import PPO as StockPPO
from rsl_rl.models import MLPModel

from warpvox.algos.ppo.stock import PPO, rsl_rl_config
from warpvox.algos.settings import Ppo
from warpvox.algos.training.runner import adapt
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv

STEPS, LIMIT, UPDATES = 6, 10, 3
ROUNDING = 1e-9  # what rounding in float64 can grow to in three updates
CASES = {
    "parallel": {},
    "evogym": {"clip_values": True, "schedule": "fixed", "adam_eps": 1e-5, "clip": 0.1, "max_grad_norm": 0.5},
    "no normaliser": {"normalize_obs": False, "schedule": "adaptive", "desired_kl": 1e-4},
    "elu": {"activation": "elu"},
}

SIZES = {"hidden": [8, 8], "minibatches": 3}

pytestmark = pytest.mark.usefixtures("double", "one_thread")


def adapted(ppo: Ppo) -> RslRlVecEnv:
    return adapt(small_env(max_episode_steps=LIMIT), ppo)


def algorithms(env: RslRlVecEnv, ppo: Ppo) -> tuple[PPO, StockPPO]:
    config = rsl_rl_config(ppo, 100) | {"multi_gpu": None}
    torch.manual_seed(1)
    ours = PPO.construct_algorithm(env.get_observations(), env, config, "cpu")
    torch.manual_seed(1)
    stock = stock_ppo(env, ppo)
    assert type(stock) is StockPPO
    assert type(stock.actor) is MLPModel
    return ours, stock


def roll_out(env: RslRlVecEnv, ours: PPO, stock: StockPPO, seed: int) -> None:
    """Both act on the same observations; the storages must hold the same."""
    obs = env.get_observations()
    for step in range(STEPS):
        actions = []
        for algorithm in (ours, stock):
            torch.manual_seed(1000 * seed + step)
            actions.append(algorithm.act(obs))
        torch.testing.assert_close(*actions, rtol=0, atol=ROUNDING)
        obs, rewards, dones, extras = env.step(actions[1])
        ours.process_env_step(obs, rewards, dones, extras)
        stock.process_env_step(obs, ours.storage.rewards[step, :, 0], dones, {})
    for algorithm in (ours, stock):
        with torch.no_grad():
            algorithm.compute_returns(obs)
    for name in ("observations", "actions", "rewards", "dones", "values", "actions_log_prob", "returns", "advantages"):
        one, other = (getattr(algorithm.storage, name) for algorithm in (ours, stock))
        if name == "observations":
            one, other = one["policy"], other["policy"]
        torch.testing.assert_close(one, other, rtol=0, atol=ROUNDING, msg=name)


@pytest.mark.parametrize("case", CASES)
def test_rollouts_and_updates_are_rsl_rls(case: str) -> None:
    ppo = ppo_settings(**SIZES, **CASES[case])
    env = adapted(ppo)
    env.episode_length_buf = torch.arange(ENVS)  # so that episodes end in every rollout
    ours, stock = algorithms(env, ppo)
    rates = set()
    for update in range(UPDATES):
        roll_out(env, ours, stock, update)
        losses = []
        for algorithm in (ours, stock):
            torch.manual_seed(update)
            losses.append(algorithm.update())
        assert losses[0] == pytest.approx(losses[1], rel=0, abs=1e-8)
        rates.add(ours.learning_rate)
        assert ours.learning_rate == stock.learning_rate
        for mine, other in ((ours.actor, stock.actor), (ours.critic, stock.critic)):
            state = other.state_dict()
            assert mine.state_dict().keys() == state.keys()
            for name, value in mine.state_dict().items():
                torch.testing.assert_close(value, state[name], rtol=0, atol=ROUNDING, msg=name)
    assert (len(rates) > 1) == (ppo.schedule == "adaptive")


def test_checkpoints_are_exchanged_with_rsl_rls_ppo() -> None:
    ppo = ppo_settings(**SIZES)
    env = adapted(ppo)
    ours, stock = algorithms(env, ppo)
    roll_out(env, ours, stock, 0)
    for algorithm in (ours, stock):
        torch.manual_seed(0)
        algorithm.update()
    there, back = ours.save(), stock.save()
    fresh, fresh_stock = algorithms(env, ppo)
    fresh.load(back, None, True)
    fresh_stock.load(there, None, True)
    roll_out(env, fresh, fresh_stock, 1)
    for algorithm in (fresh, fresh_stock):
        torch.manual_seed(1)
        algorithm.update()
    for name, value in fresh.actor.state_dict().items():
        torch.testing.assert_close(value, fresh_stock.actor.state_dict()[name], rtol=0, atol=ROUNDING, msg=name)
