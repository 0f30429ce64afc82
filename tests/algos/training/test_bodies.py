"""Training over many bodies: who takes whose place, nothing of a body in another's rollout, and exact resumption."""

from pathlib import Path

import numpy as np
import pytest
import torch
from learning import ENVS, assert_same_weights, ppo_settings, small_env

from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.evaluate import evaluator
from warpvox.algos.metrics import read_metrics
from warpvox.algos.policies.layout import layout_of
from warpvox.algos.training.bodies import Bodies, draw_bodies
from warpvox.algos.training.held_out import HeldOut
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.errors import ConfigError
from warpvox.runs import STATE

LIMIT, SHAPE = 8, (3, 3)
HELD_OUT = draw_bodies(3, SHAPE, np.random.default_rng(9))

pytestmark = pytest.mark.usefixtures("one_thread")


def make_runner(refresh: str, total: int, folder: Path | None = None, seed: int = 0) -> Runner:
    torch.manual_seed(seed)
    pool = draw_bodies(12, SHAPE, np.random.default_rng(0), HELD_OUT)
    bodies = Bodies(pool, refresh, np.random.default_rng(seed), HELD_OUT)
    options = dict(max_episode_steps=LIMIT, obs="voxel", grid=SHAPE)
    env = small_env(designs=bodies.first(ENVS), **options)
    judge = HeldOut(evaluator(small_env(len(HELD_OUT), designs=HELD_OUT, auto_reset=False, **options)), HELD_OUT)
    voxels = {"network": "grid", "settings": {"width": 4, "summary": 4, "heads": 2}, "layout": layout_of(env).dict()}
    ppo, about = ppo_settings(epochs=1, normalize_reward=True), {"designs": "random:12"}
    return Runner(
        adapt(env, ppo), ppo, Schedule(total, 100, 2), folder, judge, voxels=voxels, bodies=bodies, trained_on=about
    )


def in_use(runner: Runner) -> list[bytes]:
    env = runner.env.env
    return [env.designs[design].tobytes() for design in env.design_index.tolist()]


@pytest.mark.parametrize("refresh", ["new", "random", "performance"])
def test_a_resumed_run_is_the_run_that_was_not_interrupted(tmp_path: Path, refresh: str) -> None:
    for name in "whole", "cut":
        (tmp_path / name).mkdir()
    whole = make_runner(refresh, 4)
    whole.evaluator.folder = tmp_path / "whole"
    whole.run()
    first = make_runner(refresh, 2, tmp_path / "cut")
    first.evaluator.folder = tmp_path / "cut"
    first.run()
    second = make_runner(refresh, 4, seed=5)
    second.evaluator.folder = tmp_path / "cut"
    second.resume(tmp_path / "cut" / STATE)
    second.run()
    tables = [(tmp_path / name / "held_out.csv").read_text() for name in ("whole", "cut")]
    assert tables[0] == tables[1]  # the best return of each held-out body
    assert in_use(whole) == in_use(second)
    assert_same_weights(whole, second)
    assert whole.last_return == second.last_return
    assert whole.bodies.seen == second.bodies.seen > ENVS


def test_new_bodies_take_the_place_of_those_whose_episode_has_ended(tmp_path: Path) -> None:
    runner = make_runner("new", 6, tmp_path)
    before, pool = in_use(runner), {body.tobytes() for body in runner.bodies.bodies}
    runner.run()
    after = in_use(runner)
    assert all(one != other for one, other in zip(before, after, strict=True))
    assert not {body.tobytes() for body in HELD_OUT} & {*before, *after}
    assert len(set(after) - pool) > ENVS // 2
    assert load_checkpoint(tmp_path / "model_best.pt")["trained_on"] == {"designs": "random:12"}
    rows = [row for row in read_metrics(tmp_path) if row["eval_return"] == row["eval_return"]]
    assert len(rows) == 3
    assert all(row["eval_q10"] <= row["eval_q50"] <= row["eval_q90"] for row in rows)


def test_a_rollout_is_of_one_body_and_episodes_begin_with_it() -> None:
    runner = make_runner("random", 9)
    bodies, exchange = [in_use(runner)], runner.bodies.exchange

    def watched(env: RslRlVecEnv, ended: torch.Tensor) -> None:
        assert in_use(runner) == bodies[-1]
        exchange(env, ended)
        lengths = env.episode_length_buf
        assert bool((lengths[ended] == 0).all())
        assert bool((lengths[~ended] > 0).all())
        assert torch.equal(env.get_observations()["policy"][ended], env.env.reset(mask=ended)[0][ended].float())
        bodies.append(in_use(runner))

    runner.bodies.exchange = watched
    runner.learn(3)
    assert len(bodies) == 4


def test_a_recurrent_policy_forgets_the_body_that_has_left() -> None:
    pool = draw_bodies(12, SHAPE, np.random.default_rng(0))
    bodies = Bodies(pool, "random", np.random.default_rng(0))
    env = small_env(designs=bodies.first(ENVS), max_episode_steps=LIMIT, obs="voxel", grid=SHAPE)
    ppo = ppo_settings(epochs=1, rnn={"rnn_type": "gru", "rnn_hidden_dim": 4})
    runner = Runner(adapt(env, ppo), ppo, Schedule(9, 100, 100), bodies=bodies)
    # half of the episodes end in the first of six steps, and have five more with the body that is exchanged then
    runner.env.episode_length_buf = torch.arange(ENVS) % 2 * (LIMIT - 1)
    runner.learn(1)
    ended = runner.logger.ended
    assert ended.sum() == ENVS // 2
    for model in (runner.alg.actor, runner.alg.critic):
        memory = model.get_hidden_state()[0]
        assert bool((memory[ended] == 0).all())
        assert bool((memory[~ended] != 0).any())


def test_bodies_on_which_the_policy_does_worse_come_more_often() -> None:
    pool = draw_bodies(4, SHAPE, np.random.default_rng(0))
    bodies = Bodies(pool, "performance", np.random.default_rng(0))
    bodies._which = np.arange(3)
    bodies.record(torch.ones(3, dtype=torch.bool), torch.tensor([1.0, 2.0, 3.0]))
    assert bodies._probabilities().tolist() == [0, 0, 0, 1]  # that which has had no episode
    bodies._which = np.array([3])
    bodies.record(torch.ones(1, dtype=torch.bool), torch.tensor([2.0]))
    shares = bodies._probabilities()
    assert shares[0] > shares[1] == shares[3] > shares[2]
    assert shares.sum() == pytest.approx(1)
    bodies.record(torch.ones(1, dtype=torch.bool), torch.tensor([4.0]))
    assert bodies._returns[3] == pytest.approx(0.7 * 2.0 + 0.3 * 4.0)


def test_a_new_body_is_one_that_was_not_there_until_there_are_no_others() -> None:
    pool = draw_bodies(4, (1, 3), np.random.default_rng(0))
    held_out = draw_bodies(6, (1, 3), np.random.default_rng(1), pool)
    bodies = Bodies(pool, "new", np.random.default_rng(0), held_out)
    drawn = [cropped(body) for _ in range(6) for body in bodies._draw_new(5)]
    assert len(set(drawn)) == 30
    assert not set(drawn) & {cropped(body) for body in [*pool, *held_out]}
    every = {cropped(body) for body in bodies._draw_new(100)}  # more than there are
    assert {*drawn, *map(cropped, pool)} < every
    assert not every & {cropped(body) for body in held_out}


def test_a_resumed_run_knows_that_bodies_may_come_again() -> None:
    first, second = make_runner("new", 1), make_runner("new", 1)
    first.bodies.shape = (1, 3)
    first.bodies._draw_new(100)  # more than there are
    first.bodies.shape = SHAPE
    second.bodies.set_state(first.bodies.state(first.env), second.env)
    assert second.bodies._digests == first.bodies._digests


def cropped(body: np.ndarray) -> tuple:
    """A body wherever it lies in its grid."""
    rows, columns = (np.flatnonzero(body.any(axis)) for axis in (1, 0))
    part = body[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return part.shape, part.tobytes()


def test_episodes_that_a_random_start_has_shortened_say_nothing_of_a_body() -> None:
    runner = make_runner("performance", 1)
    runner.run()  # 6 of 8 steps, from random steps on
    assert runner.bodies.seen > ENVS  # episodes have ended
    assert np.isnan(runner.bodies._returns).all()


def test_random_bodies_differ_and_are_refused_where_there_are_too_few() -> None:
    rng = np.random.default_rng(0)
    bodies = draw_bodies(50, SHAPE, rng, HELD_OUT)
    assert len({body.tobytes() for body in [*bodies, *HELD_OUT]}) == 53
    with pytest.raises(ConfigError):
        draw_bodies(50, (1, 1), rng)
