"""Learning: schedules, time limits, and that a resumed run is the run that was not interrupted."""

import math
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from learning import ENVS, assert_same_weights, ppo_settings, rows, small_env, weights

from warpvox.algos import metrics
from warpvox.algos.checkpoints.files import load_checkpoint, save_checkpoint
from warpvox.algos.evaluate import evaluate, evaluator
from warpvox.algos.metrics import Metrics, check_logger, read_metrics
from warpvox.algos.settings import Ppo
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.errors import ConfigError, DivergenceError, RunError
from warpvox.runs import STATE, Run

STEPS, LIMIT = 6, 14


pytestmark = pytest.mark.usefixtures("one_thread")


def make_env(num_envs: int = ENVS, **changes: object):
    return small_env(num_envs, **{"max_episode_steps": LIMIT, **changes})


def make_runner(
    total: int, ppo: Ppo | None = None, folder: Path | None = None, task: str = "Walker-v0", **schedule: int
) -> Runner:
    ppo = ppo or ppo_settings()
    torch.manual_seed(0)
    judge = evaluator(make_env(2, task=task, auto_reset=False), seed=0)
    timing = {"evaluate": 2, "save": 100} | schedule
    return Runner(adapt(make_env(task=task), ppo), ppo, Schedule(total, **timing), folder, judge)


@pytest.mark.parametrize(("schedule", "expected"), [("linear", [0.004, 0.003, 0.002, 0.001]), ("fixed", [0.004] * 4)])
def test_the_rate_is_fixed_or_ends_one_step_above_zero(schedule: str, expected: list[float]) -> None:
    rates = []
    runner = make_runner(4, ppo_settings(schedule=schedule, learning_rate=0.004, adam_eps=1e-5))
    runner.report = lambda row: rates.append(row["learning_rate"])
    runner.run()
    assert rates == pytest.approx(expected)
    assert {(group["lr"], group["eps"]) for group in runner.alg.optimizer.param_groups} == {(rates[-1], 1e-5)}


@pytest.mark.parametrize(("schedule", "rate"), [("linear", 0.004), ("fixed", 0.004), ("adaptive", 0.01)])
def test_who_begins_with_moments_keeps_the_rate_that_an_adaptive_schedule_has_found(schedule: str, rate: float) -> None:
    before = make_runner(4, ppo_settings(learning_rate=0.01))
    runner = make_runner(4, ppo_settings(schedule=schedule, learning_rate=0.004))
    runner.begin_with(before.state(), optimizer=True)
    assert [group["lr"] for group in runner.alg.optimizer.param_groups] == [rate]
    assert runner.alg.learning_rate == rate


def test_divergence_is_one_clear_error() -> None:
    runner = make_runner(3)
    for parameter in runner.alg.get_policy().mlp.parameters():
        parameter.data.fill_(float("nan"))
    with pytest.raises(DivergenceError):
        runner.run()


@pytest.mark.parametrize("part", ["weights", "moments"])
def test_weights_that_are_not_finite_are_never_saved(tmp_path: Path, part: str, monkeypatch) -> None:
    runner = make_runner(6, folder=tmp_path, save=1, evaluate=100)
    learn = runner.alg.update

    def update() -> dict[str, float]:
        losses = learn()  # which stay finite: the last step of the optimiser has gone wrong
        if runner.current_learning_iteration == 3:
            policy = runner.alg.get_policy()
            broken = next(policy.mlp.parameters()) if part == "weights" else next(iter(policy.buffers()))
            broken.data.fill_(float("nan"))
        return losses

    monkeypatch.setattr(runner.alg, "update", update)
    with pytest.raises(DivergenceError):
        runner.run()
    assert {path.name for path in tmp_path.glob("*.pt")} == {"state.pt", "model_1.pt", "model_2.pt", "model_3.pt"}
    again = make_runner(6)
    again.resume(tmp_path / "state.pt")
    assert again.current_learning_iteration == 3
    assert all(torch.isfinite(value).all() for value in weights(again).values())


@pytest.mark.parametrize(
    ("task", "changes"),
    [
        ("Walker-v0", {}),
        ("Walker-v0", {"schedule": "linear", "random_start": False}),
        ("Walker-v0", {"normalize_reward": True, "bootstrap_time_limit": False}),
        ("Catcher-v0", {}),  # which draws something in every episode
    ],
)
def test_resumed_learning_is_the_same_bit_for_bit(tmp_path: Path, task: str, changes: dict) -> None:
    def runner(name: str) -> Runner:
        (tmp_path / name).mkdir(exist_ok=True)
        return make_runner(4, ppo_settings(**changes), tmp_path / name, task)

    whole = runner("whole")
    whole.run()
    first = runner("parts")
    first.learn(2, init_at_random_ep_len=first.ppo.random_start)
    torch.manual_seed(99)  # whatever happens between
    second = runner("parts")
    second.resume(first.folder / STATE)
    assert second.current_learning_iteration == 2
    second.run()
    assert_same_weights(whole, second)
    assert rows(whole.folder) == rows(second.folder)
    assert [row["iteration"] for row in read_metrics(whole.folder)] == [1, 2, 3, 4]


def test_a_resumed_checkpoint_writes_later_rows_again_and_keeps_the_best_policy(tmp_path: Path) -> None:
    first = make_runner(3, folder=tmp_path, save=1)
    first.run()
    (tmp_path / "metrics.csv").open("a").write("4,19")  # cut short by a crash
    best = load_checkpoint(tmp_path / "model_best.pt") | {"eval_return": 1e9}  # which nothing will reach
    save_checkpoint(tmp_path / "model_best.pt", best)
    second = make_runner(4, folder=tmp_path)
    second.resume(tmp_path / "model_2.pt")
    saved: list[tuple[list[int], int]] = []
    second.report = lambda _: saved.append((Run(tmp_path, {}).iterations, load_checkpoint(tmp_path / STATE)["iter"]))
    second.run()
    assert saved[0] == ([1, 2], 2)  # what was later is gone, and a kill before the next checkpoint does no harm
    table = read_metrics(tmp_path)
    assert [row["iteration"] for row in table] == [1, 2, 3, 4]
    assert sorted(row["elapsed"] for row in table) == [row["elapsed"] for row in table]
    assert load_checkpoint(tmp_path / "model_best.pt")["eval_return"] == 1e9
    assert (second.best_return, second.best_iteration) == (1e9, best["iter"])
    save_checkpoint(tmp_path / "model_best.pt", best | {"iter": 5})  # of an evaluation after the last save
    third = make_runner(6, folder=tmp_path)
    third.resume(tmp_path / STATE)
    third.best_return = -math.inf
    third.run()
    assert third.best_iteration > 4
    assert load_checkpoint(tmp_path / "model_best.pt")["eval_return"] == 1e9


def test_a_checkpoint_of_another_network_is_refused(tmp_path: Path) -> None:
    make_runner(1, folder=tmp_path).run()
    with pytest.raises(RunError):
        make_runner(2, ppo_settings(hidden=[4, 4])).resume(tmp_path / STATE)


def test_the_best_evaluation_is_kept(tmp_path: Path) -> None:
    runner = make_runner(6, folder=tmp_path)
    runner.run()
    found = {row["iteration"]: row["eval_return"] for row in read_metrics(tmp_path)}
    returns = {iteration: value for iteration, value in found.items() if value == value}
    assert sorted(returns) == [2, 4, 6]
    best = max(returns, key=returns.get)
    content = load_checkpoint(tmp_path / "model_best.pt")
    assert content["iter"] == best == runner.best_iteration
    assert content["eval_return"] == pytest.approx(returns[best])


def test_actions_are_centred_and_scaled() -> None:
    env = adapt(make_env(), ppo_settings(action_scale=0.25))
    seen = []
    inner = env.env.step
    env.env.step = lambda actions: seen.append(actions) or inner(actions)
    env.step(torch.ones(ENVS, env.num_actions))
    env.step(-torch.ones(ENVS, env.num_actions))
    torch.testing.assert_close(seen[0], torch.full_like(seen[0], 1.35))
    torch.testing.assert_close(seen[1], torch.full_like(seen[1], 0.85))


def test_time_limits_are_told_from_ends_and_rewards_are_scaled() -> None:
    plain, scaled = (adapt(make_env(), ppo_settings(reward_scale=scale)) for scale in (1.0, 10.0))
    for step in range(LIMIT):
        actions = torch.full((ENVS, plain.num_actions), 0.3 if step % 2 else -0.3)
        if step == LIMIT - 1:
            for env in (plain, scaled):
                state = env.env.sim.state()
                state["vel"][0] = float("inf")  # its end and its limit are the same step
                env.env.sim.set_state(state)
        _, reward, done, extras = plain.step(actions)
        _, reward_scaled, _, _ = scaled.step(actions)
        torch.testing.assert_close(reward_scaled, 10 * reward)
        assert bool(done.all()) == (step == LIMIT - 1)
        assert torch.equal(extras["time_outs"], done & (torch.arange(ENVS) > 0))
    episodes, again = plain.pop_episodes(), plain.pop_episodes()
    assert episodes["episodes"] == ENVS
    assert episodes["length"] == LIMIT
    assert again["episodes"] == 0
    assert scaled.pop_episodes()["return"] == pytest.approx(episodes["return"])


def test_values_beyond_a_time_limit_are_those_of_the_final_state() -> None:
    runner = make_runner(1)
    env = runner.env
    obs = env.get_observations()
    for _ in range(LIMIT):
        with torch.no_grad():
            actions = runner.alg.act(obs)
            obs, rewards, dones, extras = env.step(actions)
            runner.alg.storage.clear()
            runner.alg.process_env_step(obs, rewards, dones, extras)
            expected = rewards + 0.99 * runner.alg.critic(extras["final_obs"]).squeeze(-1) * dones
    assert bool(dones.all())
    torch.testing.assert_close(runner.alg.storage.rewards[0].squeeze(-1), expected)


def test_episodes_of_a_random_start_do_not_count() -> None:
    env = adapt(make_env(), ppo_settings(bootstrap_time_limit=False))
    assert "time_outs" not in env.step(torch.zeros(ENVS, env.num_actions))[3]
    env.episode_length_buf = torch.arange(ENVS)
    ended = 0
    for _ in range(LIMIT):
        ended += int(env.step(torch.zeros(ENVS, env.num_actions))[2].sum())
    assert ended == ENVS
    assert env.pop_episodes()["episodes"] == 0


def test_normalised_rewards_follow_the_spread_of_discounted_returns() -> None:
    gamma = 0.9
    env, twin = RslRlVecEnv(make_env(), reward_gamma=gamma), RslRlVecEnv(make_env())
    total, seen = torch.zeros(ENVS, dtype=torch.float64), []
    generator = torch.Generator().manual_seed(1)
    for _ in range(40):
        actions = torch.randn(ENVS, env.num_actions, generator=generator)
        _, normalised, _, _ = env.step(actions)
        _, reward, done, _ = twin.step(actions)
        total = total * gamma + reward
        seen.append(total)
        total = total.masked_fill(done, 0.0)
    returns = torch.cat(seen)
    variance = (returns.var(unbiased=False) * len(returns) + 1e-4) / len(returns)  # 1e-4: what it starts from
    expected = (reward / (variance + 1e-8).sqrt()).clamp(-10, 10).float()
    assert expected.abs().max() > 0.1
    torch.testing.assert_close(normalised, expected, rtol=1e-5, atol=1e-6)
    env.reset()["policy"].zero_()
    assert env.get_observations()["policy"].any(), "what is given is fresh"
    assert not env.state()["reward_norm"]["return"].any(), "returns begin again"


def test_training_wants_environments_that_reset_themselves_and_an_evaluation_others() -> None:
    with pytest.raises(ConfigError):
        adapt(make_env(auto_reset=False), ppo_settings())
    with pytest.raises(ConfigError):
        evaluate(make_env(), lambda obs: obs)


def test_more_observations_than_are_read_from_a_checkpoint_are_refused() -> None:
    env: Any = SimpleNamespace(num_obs=65_537, auto_reset=True)
    with pytest.raises(ConfigError):
        adapt(env, ppo_settings())


def test_an_evaluation_is_the_sum_of_rewards_of_one_episode() -> None:
    env = make_env(auto_reset=False)
    policy = lambda obs: 1.1 + 0.4 * torch.sin(obs[:, :1] * 50 + torch.arange(env.num_actions))  # noqa: E731
    result = evaluate(env, policy)
    obs, _ = env.reset()
    total = torch.zeros(ENVS, dtype=torch.float64)
    for _ in range(LIMIT):
        obs, reward, _, _, _ = env.step(policy(obs))
        total += reward.double()
    torch.testing.assert_close(result.returns, total, rtol=1e-5, atol=1e-6)
    assert result.lengths.tolist() == [LIMIT] * ENVS
    assert evaluate(env, policy).mean_return == result.mean_return


def test_fitness_is_per_design() -> None:
    env = make_env(4, designs=["mini", "worm"], max_episode_steps=6, auto_reset=False)
    policy = lambda obs: torch.full((4, env.num_actions), 0.8)  # noqa: E731
    result = evaluate(env, policy)
    assert result.fitness.tolist() == pytest.approx(
        [result.returns[:2].mean().item(), result.returns[2:].mean().item()]
    )
    assert result.fitness[0] != result.fitness[1]


ROW = {"iteration": 1, "steps": 8, "eval_return": 2.5, "elapsed": 0.1, "return_mean": float("nan")}


def test_a_table_that_was_moved_away_begins_again_with_its_heading(tmp_path: Path) -> None:
    written = Metrics(tmp_path, 0, "none")
    written.write(ROW)
    (tmp_path / "metrics.csv").unlink()
    for iteration in (2, 3):
        written.write(ROW | {"iteration": iteration})
    assert [row["iteration"] for row in read_metrics(tmp_path)] == [2, 3]


def test_a_logger_that_is_not_installed_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics, "find_spec", lambda name: None)
    with pytest.raises(ConfigError):
        check_logger("wandb")
    check_logger("tensorboard")
    monkeypatch.setattr(metrics, "find_spec", lambda name: ModuleSpec(name, None))
    check_logger("neptune")
