"""What a child takes over from its parent: weights by their place in the body."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from population_cases import factory, small
from refusals import refused

from warpvox.algos.candidate import Candidate, Parent
from warpvox.algos.codesign.inheritance import BodyLayout
from warpvox.algos.codesign.population_evaluator import PopulationEvaluator, best_parent, inherit_policy
from warpvox.algos.population.training import Networks, fresh_networks
from warpvox.errors import RunError

PARENT = np.array([[0, 0, 0], [3, 1, 4], [3, 0, 4]], np.int8)
SHRUNK = np.array([[0, 0, 0], [3, 1, 0], [3, 0, 0]], np.int8)
GROWN = np.array([[3, 3, 3], [3, 1, 4], [3, 0, 4]], np.int8)
TURNED = np.array([[0, 0, 0], [4, 1, 4], [3, 0, 4]], np.int8)


pytestmark = pytest.mark.usefixtures("one_thread")


def env_of(body: np.ndarray, task: str = "Walker-v0"):
    return factory(task).make([body], 2, [0], auto_reset=False)


def networks_of(body: np.ndarray, seed: int) -> Networks:
    env = env_of(body)
    networks = fresh_networks(small().ppo, env.num_obs, env.num_actions, seed)
    with torch.no_grad():  # as after training: moments that are not those of the beginning
        normalizer = networks.actor.obs_normalizer
        generator = torch.Generator().manual_seed(seed)
        normalizer._mean.copy_(torch.randn(normalizer._mean.shape, generator=generator))
        normalizer._var.copy_(torch.rand(normalizer._var.shape, generator=generator) + 0.5)
        normalizer._std.copy_(normalizer._var.sqrt())
        normalizer.count.fill_(10**6)
    return networks


def parent_of(body: np.ndarray, fitness: float = 1.0) -> Parent:
    return Parent(body, networks_of(body, 1).actor.state_dict(), fitness)


def child_of(parent: Parent, body: np.ndarray) -> Networks:
    networks = networks_of(body, 2)
    inherit_policy(factory(), parent, env_of(body), 0, networks)
    return networks


def outputs(networks: Networks, obs: torch.Tensor) -> torch.Tensor:
    normalizer = networks.actor.obs_normalizer
    with torch.no_grad():
        return networks.actor.mlp(normalizer(obs))


def at_place(env: Any, place: tuple[float, float]) -> int:
    """The point of the robot at a place of the body's grid (in cells from its lower left corner)."""
    x, y = env.spec.robot_cell
    points = env.sim.object_positions("robot")[0] / 0.1
    return int((points - torch.tensor([x + place[0], y + place[1]])).abs().sum(1).argmin())


def test_the_same_body_starts_with_the_parents_policy() -> None:
    parent = parent_of(PARENT)
    child = child_of(parent, PARENT)
    for name, value in child.actor.state_dict().items():
        if name != "obs_normalizer.count":
            assert torch.equal(value, parent.policy[name]), name
    for model in (child.actor, child.critic):
        assert int(model.obs_normalizer.count) == 4096  # little, so that new ones are learned
    for name in ("_mean", "_var", "_std"):
        key = f"obs_normalizer.{name}"
        assert torch.equal(child.critic.state_dict()[key], parent.policy[key])


@pytest.mark.parametrize("body", [SHRUNK, GROWN, TURNED], ids=["shrunk", "grown", "turned"])
def test_weights_of_points_go_to_the_points_at_the_same_place(body: np.ndarray) -> None:
    parent, child = parent_of(PARENT), child_of(parent_of(PARENT), body)
    old, new = env_of(PARENT), env_of(body)
    slices = [env.obs_columns[0]["shape_robot"] for env in (old, new)]
    counts = [env.sim.num_points("robot") for env in (old, new)]
    # the bounding box of SHRUNK is narrower, that of GROWN higher: both begin at the lower left cell all the same
    for place in ((0, 0), (0, 2), (1, 1), (1, 0)):
        points = [at_place(env, place) for env in (old, new)]
        for axis in range(2):
            columns = [s.start + axis * n + p for s, n, p in zip(slices, counts, points, strict=True)]
            own, theirs = child.actor.mlp[0].weight[:, columns[1]], parent.policy["mlp.0.weight"][:, columns[0]]
            assert torch.equal(own, theirs)
            assert (
                child.actor.obs_normalizer._mean[0, columns[1]] == parent.policy["obs_normalizer._mean"][0, columns[0]]
            )


def test_what_is_new_in_the_body_has_no_influence_at_first() -> None:
    child, env = child_of(parent_of(PARENT), GROWN), env_of(GROWN)
    generator = torch.Generator().manual_seed(0)
    obs = torch.randn(3, env.num_obs, generator=generator)
    changed = obs.clone()
    shape, count = env.obs_columns[0]["shape_robot"], env.sim.num_points("robot")
    new = [at_place(env, place) for place in ((0, 3), (1, 3), (2, 3), (3, 3))]
    for axis in range(2):
        changed[:, [shape.start + axis * count + point for point in new]] += 100.0
    assert torch.equal(outputs(child, obs), outputs(child, changed))


def test_actuators_are_matched_by_place_and_kind() -> None:
    """GROWN has three actuators in a new top row; TURNED has another kind where the first one was."""
    parent = parent_of(PARENT)
    last = parent.policy["mlp.2.weight"]
    grown = child_of(parent, GROWN).actor.mlp[2].weight
    assert grown.shape[0] == 3 + last.shape[0] == 7
    assert torch.equal(grown[3:], last)
    turned, fresh = child_of(parent, TURNED).actor.mlp[2].weight, networks_of(TURNED, 2).actor.mlp[2].weight
    assert torch.equal(turned[0], fresh[0])
    assert torch.equal(turned[1:], last[1:])


@pytest.mark.parametrize("task", ["Catcher-v0", "Carrier-v0", "UpStepper-v0"])
def test_every_column_of_a_task_has_a_meaning_of_its_own(task: str) -> None:
    anatomy = BodyLayout.of(env_of(GROWN, task), 0)
    env = env_of(GROWN, task)
    assert len(anatomy.columns) == len(set(anatomy.columns)) == env.num_obs
    assert len(anatomy.actuators) == len(set(anatomy.actuators)) == env.num_actions


def test_the_time_is_one_column_in_all_bodies() -> None:
    timed = dataclasses.replace(factory(), obs="timed")
    old, new = (BodyLayout.of(timed.make([body], 2, [0], auto_reset=False), 0) for body in (PARENT, GROWN))
    assert old.columns[-1] == new.columns[-1]
    assert new.columns[:-1] == BodyLayout.of(env_of(GROWN), 0).columns


def test_of_several_parents_the_fittest_is_taken() -> None:
    parents = {3: parent_of(PARENT, 1.0), 5: parent_of(GROWN, 2.0), 7: parent_of(TURNED, 9.0)}
    assert best_parent(Candidate(9, PARENT, (3, 5)), parents) is parents[5]
    assert best_parent(Candidate(9, PARENT, (3, 4)), parents) is parents[3]
    assert best_parent(Candidate(9, PARENT, (4,)), parents) is None


def test_another_architecture_is_one_clear_error() -> None:
    parent = parent_of(PARENT)
    policy = {name: value for name, value in parent.policy.items() if name != "mlp.2.bias"}
    with refused(RunError, "mlp.2.bias is nothing"):
        child_of(Parent(PARENT, policy, 0.0), GROWN)
    policy = parent.policy | {"mlp.0.bias": torch.zeros(5)}
    with refused(RunError, "mlp.0.bias is [5], expected [32]"):
        child_of(Parent(PARENT, policy, 0.0), GROWN)


def test_inheritance_is_an_option_and_children_of_nobody_start_afresh() -> None:
    parents = {0: parent_of(PARENT)}
    child, orphan = Candidate(1, GROWN, (0,)), Candidate(2, GROWN)
    how = small(iterations=1, eval_interval=1)
    how.ppo.learning_rate, how.ppo.schedule = 1e-12, "fixed"  # what comes out is what went in
    plain = PopulationEvaluator(factory(), how, 0).evaluate([child, orphan], parents)
    how.inherit = True
    heirs = PopulationEvaluator(factory(), how, 0).evaluate([child, orphan], parents)
    expected = child_of(parents[0], GROWN).actor.state_dict()
    torch.testing.assert_close(heirs[0].policy["mlp.0.weight"], expected["mlp.0.weight"])
    assert not torch.equal(heirs[0].policy["mlp.0.weight"], plain[0].policy["mlp.0.weight"])
    assert heirs[1].curve == plain[1].curve
