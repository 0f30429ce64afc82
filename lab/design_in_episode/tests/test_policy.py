"""Tests of the policy for both stages: masking of the other stage, and training with rsl-rl's PPO."""

import numpy as np
import pytest
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch.distributions import Categorical, Normal

from lab.design_in_episode.episodes import RslRlDesignEnv, design_episodes
from lab.design_in_episode.policy import DesignModel, design_models
from warpvox import make_vec, record

ENVS, SHAPE, LIMIT = 8, (3, 3), 4
OPTIONS = dict(device="cpu", threads=1, lanes=8, max_episode_steps=LIMIT)


def make(revise: str = "all", **options: object) -> RslRlDesignEnv:
    steps = 1 if revise == "all" else 2
    return RslRlDesignEnv(design_episodes("Walker-v0", ENVS, SHAPE, steps, revise, **OPTIONS, **options))


def settings(env: RslRlDesignEnv) -> dict:
    return {
        "num_steps_per_env": LIMIT + 3,
        "save_interval": 1000,
        "algorithm": {"class_name": "PPO", "num_learning_epochs": 2, "num_mini_batches": 2, "schedule": "adaptive"},
        **design_models(env, settings={"width": 4, "summary": 8, "heads": 4}, channels=4),
    }


def mixed_stages(env: RslRlDesignEnv) -> TensorDict:
    """Build observations, half of the design stage and half of the control stage."""
    generator = torch.Generator().manual_seed(1)
    for _ in range(3):
        actions = torch.rand(ENVS, env.num_actions, generator=generator)
        actions[:, env.env.layout.control :] *= 4
        env.step(actions)
    obs = env.env.reset(mask=torch.arange(ENVS) % 2 == 0)[0]
    if env.env.design_steps > 1:  # not of a complete design
        obs = env.step(actions)[0]["policy"]
    assert env.env.designing.tolist() == [k % 2 == 0 for k in range(ENVS)]
    return TensorDict({"policy": obs}, batch_size=[ENVS])


def construct(env: RslRlDesignEnv) -> PPO:
    torch.manual_seed(0)
    return PPO.construct_algorithm(env.get_observations(), env, settings(env) | {"multi_gpu": None}, "cpu")


def learned(alg: PPO, obs: TensorDict, actions: torch.Tensor) -> list[torch.Tensor]:
    """Compute likelihood, entropy, divergence, values and gradients from observations and actions."""
    for model in (alg.actor, alg.critic):
        model.update_normalization(obs)
    alg.actor(obs, stochastic_output=True)
    likelihood, entropy = alg.actor.get_output_log_prob(actions), alg.actor.output_entropy
    params = alg.actor.output_distribution_params
    divergence = alg.actor.get_kl_divergence(tuple(value.detach() for value in params), params)
    loss = likelihood.sum() + entropy.sum() + alg.critic(obs).sum()
    gradients = torch.autograd.grad(loss, [*alg.actor.parameters(), *alg.critic.parameters()])
    return [likelihood, entropy, divergence, *gradients]


@pytest.mark.parametrize("revise", ["all", "one"])
def test_what_belongs_to_the_other_stage_takes_no_part(revise: str) -> None:
    env = make(revise)
    obs = mixed_stages(env)
    layout, mask = env.env.layout, env.env.action_mask
    alg = construct(env)
    torch.manual_seed(1)
    actions = alg.actor(obs, stochastic_output=True)
    assert not actions[~mask].any()
    results = [learned(construct(env), obs, torch.where(mask, actions, idle)) for idle in (0.0, -7e5)]
    for one, other in zip(*results, strict=True):
        assert torch.equal(one, other)
    alg.actor.update_normalization(obs)
    assert int(alg.actor.control.obs_normalizer.count) == ENVS // 2  # the others show nothing of a body that moves

    # the same by torch's own distributions, row by row
    out = construct(env).actor._outputs(obs["policy"])
    fresh = construct(env).actor  # without what the other has learnt of its inputs
    fresh(obs, stochastic_output=True)
    found = fresh.get_output_log_prob(actions), fresh.output_entropy
    for row in range(ENVS):
        if env.env.designing[row]:
            parts = Categorical(logits=out[row, layout.control :].unflatten(0, (-1, 5)))
            chosen = actions[row, layout.control :].long()
        else:
            count = int(mask[row].sum())
            parts = Normal(out[row, :count], 0.5)
            chosen = actions[row, :count]
        torch.testing.assert_close(found[0][row], parts.log_prob(chosen).sum(), rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(found[1][row], parts.entropy().sum(), rtol=1e-5, atol=1e-5)


def test_the_divergence_is_that_of_the_parts_that_count() -> None:
    env = make()
    obs = mixed_stages(env)
    actor = construct(env).actor
    params = []
    for _ in range(2):
        actor(obs, stochastic_output=True)
        params.append(tuple(value.detach() for value in actor.output_distribution_params))
        with torch.no_grad():
            for value in actor.parameters():
                value.add_(0.3)
    found = actor.get_kl_divergence(*params)
    for row in range(ENVS):
        (mean, std, log_p), (new_mean, new_std, new_log_p) = ([value[row] for value in one] for one in params)
        if env.env.designing[row]:
            wanted = torch.distributions.kl_divergence(Categorical(logits=log_p), Categorical(logits=new_log_p)).sum()
        else:
            count = int(env.env.action_mask[row].sum())
            pair = Normal(mean[:count], std[:count]), Normal(new_mean[:count], new_std[:count])
            wanted = torch.distributions.kl_divergence(*pair).sum()
        torch.testing.assert_close(found[row], wanted, rtol=1e-4, atol=1e-5)


def test_types_are_drawn_as_often_as_they_are_likely() -> None:
    env = make("one")
    actor = construct(env).actor
    rows = 4000
    logits = torch.tensor([0.0, 1.0, -1.0, 0.5, 2.0])
    actor.distribution.look(torch.ones(rows, dtype=torch.bool))
    actor.distribution.gaussian.look(torch.zeros(rows, env.env.layout.control))
    actor.distribution.update(torch.cat([torch.zeros(env.env.layout.control), logits]).expand(rows, -1))
    torch.manual_seed(0)
    drawn = torch.bincount(actor.distribution.sample()[:, -1].long(), minlength=5) / rows
    assert (drawn - logits.softmax(0)).abs().max() < 4 * (0.25 / rows) ** 0.5  # four standard errors


@pytest.mark.parametrize("revise", ["all", "one"])
def test_rsl_rls_own_runner_trains_both_stages(revise: str) -> None:
    env = make(revise)
    chosen = settings(env)
    if revise == "all":  # with intrinsic rewards
        chosen["obs_groups"]["rnd_state"] = ["policy"]
        layers = {"num_outputs": 3, "predictor_hidden_dims": [4], "target_hidden_dims": [4]}
        chosen["algorithm"]["rnd_cfg"] = {"weight": 1.0, **layers}
    with torch.random.fork_rng():
        torch.manual_seed(0)
        runner = OnPolicyRunner(env, chosen, log_dir=None, device="cpu")
        actor = runner.alg.get_policy()
        before = {name: value.clone() for name, value in actor.named_parameters()}
        runner.learn(2, init_at_random_ep_len=True)
    assert isinstance(actor, DesignModel)
    for name, value in actor.named_parameters():
        assert bool(torch.isfinite(value).all()), name
        assert not torch.equal(value, before[name]), name

    policy = runner.get_inference_policy()
    other = make(revise)
    obs = other.reset()
    with torch.no_grad():
        for _ in range(other.env.design_steps):
            obs = other.step(policy(obs))[0]
        bodies = other.env.cells.numpy().copy()
        for _ in range(LIMIT):
            obs, _, done, extras = other.step(policy(obs))
    assert done.all()
    # the same bodies in plain environments, for pictures and comparisons
    plain = make_vec("Walker-v0", list(bodies), ENVS, obs="voxel", grid=SHAPE, auto_reset=False, **OPTIONS)
    rollout = record(plain, env.controller(policy, bodies))
    np.testing.assert_allclose(rollout.returns[-1], extras["returns"], atol=1e-6)
