"""Policies for voxels: what a body has not takes no part, rsl-rl's PPO learns the same, and files bring them back."""

import copy
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from learning import ENVS, ppo_settings, small_env
from tensordict import TensorDict

from warpvox.algos.checkpoints.export import read_exported, write_onnx, write_script
from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.checkpoints.policy import read_policy
from warpvox.algos.evaluate import evaluate, evaluator
from warpvox.algos.policies.layout import FEATURES, INPUTS, VoxelInputs, VoxelLayout, layout_of
from warpvox.algos.policies.model import VoxelNormalizer
from warpvox.algos.policies.registry import check_network, check_policy, layout_for, make_network
from warpvox.algos.ppo.stock import PPO, rsl_rl_config
from warpvox.algos.training.playing import SampledPolicy
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.code import Code
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.envs.voxels import NUM_FEATURES
from warpvox.errors import ConfigError, RunError

BODIES = ([[3, 3, 3], [4, 1, 4]], [[2, 3], [4, 0]])
STEPS, LIMIT = 6, 12
NETWORKS = {
    "grid": {"width": 6, "summary": 8, "heads": 4},
    "transformer": {"width": 8},
}
OWN = """
import torch

class Own(torch.nn.Module):
    def __init__(self, layout, critic, units=3):
        super().__init__()
        self.critic, self.one, self.two = critic, torch.nn.Linear(26, units), torch.nn.Linear(units, 1)

    def forward(self, cells, rest):
        values = self.two(torch.tanh(self.one(cells)))[..., 0]
        return values.mean(1) if self.critic else values
"""

pytestmark = [
    pytest.mark.usefixtures("one_thread"),
    pytest.mark.filterwarnings("ignore:.*torch.jit.* is deprecated:DeprecationWarning"),
]


def make_env(num_envs: int = ENVS, auto_reset: bool = True, obs: str = "voxel") -> VoxelVecEnv:
    return small_env(num_envs, designs=BODIES, max_episode_steps=LIMIT, obs=obs, auto_reset=auto_reset)


def voxels(env: VoxelVecEnv, name: str) -> dict:
    return {"network": name, "settings": NETWORKS.get(name, {}), "layout": layout_for(name, env).dict()}


def make_runner(name: str, folder: Path | None = None, total: int = 2, seed: int = 0, obs: str = "voxel") -> Runner:
    torch.manual_seed(seed)
    env, judge = make_env(obs=obs), evaluator(make_env(2, auto_reset=False, obs=obs))
    ppo = ppo_settings()
    return Runner(adapt(env, ppo), ppo, Schedule(total, 100, 1), folder, judge, voxels=voxels(env, name))


def some_obs(env: VoxelVecEnv, steps: int = 3) -> torch.Tensor:
    """Observations of bodies that have moved."""
    generator = torch.Generator().manual_seed(1)
    obs, _ = env.reset()
    for _ in range(steps):
        obs = env.step(0.6 + torch.rand((env.num_envs, 32), generator=generator)[:, : env.num_actions])[0]
    return obs


@pytest.fixture(scope="module")
def env() -> VoxelVecEnv:
    return make_env()


def test_a_voxel_looks_the_same_in_every_grid() -> None:
    body = BODIES[0]
    features = []
    for grid in (None, (4, 4)):
        alone = small_env(1, designs=[body], obs="voxel", grid=grid)
        found, present, _, _ = VoxelInputs(layout_of(alone))(some_obs(alone))
        features.append(found[0, present[0, :, 0] > 0])
        assert bool((found[0, present[0, :, 0] == 0] == 0).all())
    torch.testing.assert_close(features[0], features[1], rtol=0, atol=1e-5)
    assert features[0].shape == (6, INPUTS["neighbours"].stop)


def test_inputs_at_rest_say_where_a_voxel_is(env: VoxelVecEnv) -> None:
    layout = layout_of(env)
    found, present, actions, kinds = VoxelInputs(layout)(env.reset()[0])
    assert float(found[..., INPUTS["shift"]].abs().max()) < 1e-5
    assert float(found[..., INPUTS["shape_velocity"]].abs().max()) == 0
    rows = found[0, :, INPUTS["place"]]
    assert torch.equal(rows, torch.tensor([[-1, 0.5], [0, 0.5], [1, 0.5], [-1, -0.5], [0, -0.5], [1, -0.5]]))
    assert kinds[0].tolist() == [1, 1, 1, 2, 2]
    assert kinds[-1].tolist() == [1, 2, 0, 0, 0]
    # as the environment has it
    cells = env.voxels["robot"].action_cell
    for row in (0, ENVS - 1):
        ours = {int(action): cell for cell, action in enumerate(actions[row].tolist()) if action < layout.actions}
        assert ours == {action: cell for action, cell in enumerate(cells[row].tolist()) if cell >= 0}
    assert int(present[-1].sum()) == 3


def test_the_time_is_seen_as_a_clock_that_nothing_scales() -> None:
    plain, timed = (small_env(4, designs=BODIES, obs=obs) for obs in ("voxel", "timed_voxel"))
    layout, obs = layout_of(timed), some_obs(timed)
    assert layout == dataclasses.replace(layout_of(plain), rest=layout_of(plain).rest + 6, timed=True)
    obs[:, -1] = torch.tensor([0.0, 3.0, 250.0, 499.0])
    ours, theirs = VoxelNormalizer(layout), VoxelNormalizer(layout_of(plain))
    ours.update(obs)
    theirs.update(obs[:, :-1])
    turns = 2 * np.pi * np.array([0.0, 3.0, 250.0, 499.0])[:, None] / [7.0, 14.0, 28.0]
    begin = layout.cells * FEATURES + layout.scaled
    clock = ours(obs)[:, begin : begin + 6]
    np.testing.assert_allclose(clock, np.concatenate([np.sin(turns), np.cos(turns)], 1), rtol=0, atol=1e-6)
    without = torch.cat([ours(obs)[:, :begin], ours(obs)[:, begin + 6 :]], dim=1)
    assert torch.equal(without, theirs(obs[:, :-1]))


def learned(name: str, obs: torch.Tensor, actions: torch.Tensor, env: VoxelVecEnv) -> list[torch.Tensor]:
    """All that learning makes of observations and actions: means, likelihood, entropy, values and gradients."""
    torch.manual_seed(0)
    groups = TensorDict({"policy": obs}, batch_size=[len(obs)])
    alg = PPO.construct_algorithm(groups, adapt(env, ppo_settings()), config(env, name), "cpu")
    for model in (alg.actor, alg.critic):
        model.update_normalization(groups)
    mean = alg.actor(groups)
    alg.actor(groups, stochastic_output=True)
    likelihood, entropy = alg.actor.get_output_log_prob(actions), alg.actor.output_entropy
    loss = likelihood.sum() + entropy.sum() + alg.critic(groups).sum()
    gradients = torch.autograd.grad(loss, [*alg.actor.parameters(), *alg.critic.parameters()], allow_unused=True)
    assert all(gradient is not None for gradient in gradients)
    return [mean, likelihood, entropy, *gradients]


def config(env: VoxelVecEnv, name: str) -> dict:
    return rsl_rl_config(ppo_settings(), 10, voxels(env, name)) | {"multi_gpu": None}


@pytest.mark.parametrize("name", NETWORKS)
def test_what_a_body_has_not_changes_no_bit(name: str) -> None:
    env = make_env()
    obs, layout = some_obs(env), layout_for(name, env)
    actions = torch.rand((ENVS, env.num_actions))
    before = learned(name, obs, actions, env)
    other = obs.clone()
    cells = other[:, : layout.cells * NUM_FEATURES].view(ENVS, layout.cells, NUM_FEATURES)
    absent = cells[..., 16] == 1
    assert bool(absent.any())
    for feature in (*range(16), *range(21, 25)):
        cells[..., feature] = torch.where(absent, math.nan, cells[..., feature])
    masked = actions.masked_fill(~env.action_mask[env.design_index], 1e9)
    assert not torch.equal(masked, actions)
    for one, two in zip(before, learned(name, other, masked, env), strict=True):
        assert torch.equal(one, two)


def test_likelihood_and_entropy_are_those_of_the_actions_there_are(env: VoxelVecEnv) -> None:
    runner = make_runner("grid")
    model, obs = runner.alg.actor, TensorDict({"policy": some_obs(env)}, batch_size=[ENVS])
    with torch.no_grad():
        model.distribution.log_std_param.copy_(torch.tensor([-0.5, 0.25]))
        drawn = model(obs, stochastic_output=True)
        kinds = model.get_latent(obs)[:, -env.num_actions :]
        normal = torch.distributions.Normal(model.output_mean, torch.where(kinds == 1, -0.5, 0.25).exp())
        mask = env.action_mask[env.design_index]
        torch.testing.assert_close(model.get_output_log_prob(drawn), (normal.log_prob(drawn) * mask).sum(1))
        torch.testing.assert_close(model.output_entropy, (normal.entropy() * mask).sum(1))
        params = model.output_distribution_params
        assert bool((model.get_kl_divergence(params, params) == 0).all())
    assert bool((drawn[~mask] == 0).all())
    assert bool((drawn[mask] != 0).all())


@pytest.mark.parametrize("name", NETWORKS)
def test_environments_may_change_places(name: str) -> None:
    env = make_env()
    policy, obs = make_runner(name).policy.double(), some_obs(env)
    order = torch.randperm(ENVS, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(policy(obs[order]), policy(obs)[order], rtol=0, atol=1e-6)
    assert float(policy(obs).std()) > 0


@pytest.mark.parametrize(
    ("name", "formats"),
    [
        ("grid", {"policy.pt": write_script}),
        pytest.param("grid", {"policy.onnx": write_onnx}, marks=pytest.mark.slow),
        ("transformer", {"policy.pt": write_script}),
        pytest.param("transformer", {"policy.onnx": write_onnx}, marks=pytest.mark.slow),
    ],
)
def test_a_policy_trains_and_comes_back_from_files(tmp_path: Path, name: str, formats: dict) -> None:
    env = make_env()
    runner, obs = make_runner(name, tmp_path, total=1), some_obs(env)
    before = copy.deepcopy(runner.alg.actor.state_dict())
    runner.run()
    assert all(not torch.equal(value, before[key]) for key, value in runner.alg.actor.named_parameters())
    runner.alg.eval_mode()
    runner.alg.actor.distribution.log_std_param.data.fill_(math.log(0.2))
    policy = read_policy(tmp_path / "model_1.pt")
    exact = policy.in_float64()
    assert torch.equal(exact(obs), runner.policy.double()(obs))
    torch.testing.assert_close(policy(obs), exact(obs), rtol=0, atol=1e-6)
    for file, write in formats.items():
        write(policy, tmp_path / file)
        again = read_exported(tmp_path / file)
        assert torch.equal(again(obs), policy(obs))
    assert evaluate(make_env(2, auto_reset=False), exact).returns.isfinite().all()
    sampled = SampledPolicy(exact, load_checkpoint(tmp_path / "model_1.pt")["actor_state_dict"])(obs)
    assert bool((sampled != exact(obs))[env.action_mask[env.design_index]].any())


def test_a_network_of_ones_own_is_imported_only_if_it_is_named(tmp_path: Path) -> None:
    (tmp_path / "nets.py").write_text(OWN, encoding="utf-8")
    name = Code(f"{tmp_path / 'nets.py'}:Own")
    make_runner(name, tmp_path, total=1).run()
    file = tmp_path / "model_1.pt"
    with pytest.raises(RunError, match=r"name it, policy=FILE\.py:Class"):
        read_policy(file)
    policy = read_policy(file, network=name)
    write_script(policy, tmp_path / "policy.pt")
    assert read_exported(tmp_path / "policy.pt", name).state_dict().keys() == policy.state_dict().keys()
    with pytest.raises(ConfigError, match=r"has the settings units .*Did you mean 'units'"):
        make_network(name, VoxelLayout(2, 3, 2, 5), False, {"unit": 3})
    with pytest.raises(ConfigError, match=r"does not exist.*Did you mean 'Own'"):
        make_network(Code(f"{tmp_path / 'nets.py'}:Owm"), VoxelLayout(2, 3, 2, 5), False)
    (tmp_path / "narrow.py").write_text(OWN.replace("26", "25"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"must make \[2, 6\] of cells \[2, 6, 26\] .*shapes cannot be multiplied"):
        check_network(make_env(), Code(f"{tmp_path / 'narrow.py'}:Own"), None)


def test_mistakes_are_explained(env: VoxelVecEnv) -> None:
    with pytest.raises(ConfigError, match="Did you mean 'transformer'"):
        check_policy("tranformer")
    with pytest.raises(ConfigError, match=r"has the settings width, summary, heads.*Did you mean 'width'"):
        make_network("grid", layout_of(env), False, {"widht": 8})
    with pytest.raises(ConfigError, match="multiple of its heads"):
        make_network("transformer", layout_of(env), False, {"width": 7})
    with pytest.raises(ConfigError, match="obs=voxel"):
        layout_of(small_env())
