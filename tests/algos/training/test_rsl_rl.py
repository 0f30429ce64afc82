"""What rsl-rl has besides PPO of a feedforward policy: recurrent networks, random network distillation, symmetry."""

from pathlib import Path

import pytest
import torch
from learning import ENVS, assert_same_weights, ppo_settings, rows, small_env
from rsl_rl.models import RNNModel
from tensordict import TensorDict

from warpvox.algos.checkpoints.export import write_script
from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.checkpoints.policy import policy_bytes, read_policy
from warpvox.algos.evaluate import evaluate, evaluator
from warpvox.algos.training.playing import SampledPolicy
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.code import Code
from warpvox.errors import ConfigError, RunError
from warpvox.runs import STATE

LIMIT = 14
GRU = {"rnn_type": "gru", "rnn_hidden_dim": 6}
RND = {"rnd_cfg": {"weight": 5.0, "num_outputs": 3, "predictor_hidden_dims": [4], "target_hidden_dims": [4]}}

pytestmark = pytest.mark.usefixtures("one_thread")


def make_runner(total: int = 4, folder: Path | None = None, seed: int = 0, **changes: object) -> Runner:
    torch.manual_seed(seed)
    ppo = ppo_settings(**changes)
    judge = evaluator(small_env(2, max_episode_steps=LIMIT, auto_reset=False), seed=0)
    env = adapt(small_env(max_episode_steps=LIMIT), ppo)
    return Runner(env, ppo, Schedule(total, evaluate=2), folder, judge)


@pytest.mark.parametrize(
    "changes",
    [
        {"rnn": GRU},
        {"rnn": {"rnn_hidden_dim": 4, "rnn_num_layers": 2}, "schedule": "linear"},
        {"extra": {"rnd_cfg": RND["rnd_cfg"] | {"reward_normalization": True, "state_normalization": True}}},
    ],
    ids=["gru", "lstm", "rnd"],
)
def test_a_resumed_run_is_the_run_that_was_not_interrupted(tmp_path: Path, changes: dict) -> None:
    for name in ("whole", "parts"):
        (tmp_path / name).mkdir()
    whole = make_runner(4, tmp_path / "whole", **changes)
    before = {name: value.clone() for name, value in whole.alg.actor.named_parameters()}
    whole.run()
    assert all(not torch.equal(value, before[name]) for name, value in whole.alg.actor.named_parameters())
    first = make_runner(4, tmp_path / "parts", **changes)
    first.learn(2, init_at_random_ep_len=True)
    second = make_runner(4, tmp_path / "parts", seed=5, **changes)
    second.resume(tmp_path / "parts" / STATE)
    second.run()
    assert_same_weights(whole, second)
    assert rows(tmp_path / "whole") == rows(tmp_path / "parts")


def test_a_recurrent_policy_comes_back_from_its_file_and_forgets_where_episodes_begin(tmp_path: Path) -> None:
    runner = make_runner(2, tmp_path, rnn=GRU)
    runner.run()
    file = tmp_path / "model_2.pt"
    policy = read_policy(file)
    exact = policy.in_float64()
    assert type(policy.actor) is RNNModel
    judge = small_env(2, max_episode_steps=LIMIT, auto_reset=False)
    hidden = runner.alg.actor.get_hidden_state().clone()
    sampled = SampledPolicy(exact, load_checkpoint(file)["actor_state_dict"])
    for acting in (exact, exact, runner.policy.double(), sampled):
        result = evaluate(judge, acting, seed=0)
        assert (result.mean_return == runner.last_return) == (acting is not sampled)
    assert torch.equal(runner.alg.actor.get_hidden_state(), hidden), "an evaluation leaves training alone"
    obs = torch.randn(5, 3, policy.num_obs)
    exact.reset()
    given = [(policy(one), exact(one)) for one in obs]
    for ours, theirs in given:
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-5)
    assert not torch.equal(policy(obs[0]), given[0][0])
    exact = policy.in_float64()  # a copy at the beginning of episodes
    torch.testing.assert_close(exact(obs[0]), given[0][0], rtol=0, atol=1e-5)
    assert not torch.equal(policy(obs[0]), given[0][0]), "the original remembers what it has seen"
    policy.reset()
    assert torch.equal(policy(obs[0]), given[0][0])
    (tmp_path / "again.pt").write_bytes(policy_bytes(policy))
    assert torch.equal(read_policy(tmp_path / "again.pt")(obs[0]), given[0][0])
    with pytest.raises(RunError):
        write_script(policy, tmp_path / "policy.pt")
    assert not (tmp_path / "policy.pt").exists()


def test_values_beyond_a_time_limit_follow_from_what_the_critic_has_seen() -> None:
    runner = make_runner(rnn=GRU)
    env, algorithm = runner.env, runner.alg
    for _ in range(LIMIT):
        with torch.no_grad():
            algorithm.storage.clear()
            obs, rewards, dones, extras = env.step(algorithm.act(env.get_observations()))
            hidden = algorithm.critic.get_hidden_state().clone()
            beyond = algorithm.critic(extras["final_obs"]).squeeze(-1) * extras["time_outs"]
            algorithm.critic.reset(hidden_state=hidden)
            algorithm.process_env_step(obs, rewards, dones, extras)
        wanted = rewards + algorithm.gamma * beyond
        torch.testing.assert_close(algorithm.storage.rewards[0].squeeze(-1), wanted, rtol=0, atol=1e-6)
    assert bool(dones.all())
    assert not bool(algorithm.critic.get_hidden_state().any())


def test_intrinsic_rewards_are_learned_from() -> None:
    plain, curious = make_runner(1), make_runner(1, extra=RND)
    for runner in (plain, curious):
        runner.run()
    assert curious.logger.losses["rnd"] > 0
    assert curious.alg.rnd.initial_weight == pytest.approx(5.0 * 30 * 1e-4)  # times the seconds of a control step
    assert not torch.equal(plain.alg.storage.rewards, curious.alg.storage.rewards)


SYMMETRIES = """
import torch

def mirrored(env, obs, actions):
    if obs is not None:
        obs = torch.cat([obs, obs.clone().apply(lambda values: -values)])
    return obs, None if actions is None else torch.cat([actions, -actions])
"""


def test_symmetric_samples_are_learned_from(tmp_path: Path) -> None:
    (tmp_path / "symmetries.py").write_text(SYMMETRIES)
    function = Code(f"{tmp_path / 'symmetries.py'}:mirrored")
    settings = {"data_augmentation_func": function, "use_data_augmentation": True, "use_mirror_loss": True}
    settings |= {"mirror_loss_coeff": 100.0}
    runner = make_runner(30, extra={"symmetry_cfg": settings}, normalize_obs=False, schedule="fixed")
    obs = TensorDict({"policy": torch.randn(4, runner.spec.num_obs)}, [4])
    apart = []
    runner.report = lambda row: apart.append(runner.logger.losses["symmetry"])
    runner.run()
    assert apart[-1] < 0.2 * apart[0]
    assert torch.isfinite(runner.alg.actor(obs)).all()
    stored = {"symmetry_cfg": settings | {"data_augmentation_func": str(function)}}
    with pytest.raises(ConfigError):
        make_runner(extra=stored)


@pytest.mark.parametrize(
    "changes",
    [
        {"rnn": {"rnn_typ": "gru"}},
        {"rnn": GRU, "steps": 1},
        {"rnn": GRU | {"rnn_type": "GRU"}},
        {"rnn": GRU | {"rnn_num_layers": True}},
        {"rnn": 3},
        {"extra": []},
        {"extra": {"symmetry_cfg": 1}},
        {"extra": {"symmetry_cfg": {}}},
        {"extra": {"rnd_confg": {}}},
        {"extra": {"gamma": 0.9}},
        {"extra": {"normalize_advantage_per_mini_batch": "no"}},
        {"extra": {"use_mixed_precision": 1}},
        {"extra": {"rnd_cfg": {"weight": 1.0, "outputs": 3}}},
        {"rnn": GRU, "minibatches": ENVS + 1, "steps": 20},
    ],
    ids=str,
)
def test_settings_that_rsl_rl_does_not_take_are_refused(changes: dict) -> None:
    with pytest.raises(ConfigError):
        make_runner(**changes)
