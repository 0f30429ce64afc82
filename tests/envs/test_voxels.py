"""Observations voxel by voxel, compared with what plain numpy makes of the points of the simulator."""

import numpy as np
import pytest
import torch

from warpvox.design import example_design, full_connections, sample_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.terms.observations import shape
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.envs.voxels import FEATURES, NUM_FEATURES

EXACT = 1e-12
SIDES = {(-1, 0): 0, (0, 1): 1, (1, 0): 2, (0, -1): 3}


def make(task: str, designs: list, num_envs: int, **options) -> VoxelVecEnv:
    defaults = {"device": "cpu", "dtype": "float64", "threads": 1, "obs": "voxel"}
    return make_vec(task, designs, num_envs, **(defaults | options))


def expected(env: VoxelVecEnv, number: int, name: str = "robot", links: np.ndarray | None = None) -> np.ndarray:
    """``[rows, columns, 25]`` of one environment, cell by cell.

    Corners are found by where they were at the beginning: no table of the simulator is used.
    """
    grid = env.designs[env.design_index[number]]
    grid = grid[name] if isinstance(grid, dict) else grid
    links = full_connections(grid) if links is None else links
    count = int(env.sim.point_mask(name)[env.sim.design_index[number]].sum())
    points = env.sim.object_positions(name)[number, :count].numpy()
    speeds = env.sim.object_velocities(name)[number, :count].numpy()
    start = env.home[name][number, :count].numpy() / 0.1
    left, top = start[:, 0].min(), start[:, 1].max()  # none of the bodies has an empty border
    rows, columns = env.voxels[name].rows, env.voxels[name].columns
    out = np.zeros((rows, columns, NUM_FEATURES))
    out[..., 16] = 1
    for (row, column), kind in np.ndenumerate(grid):
        if not kind:
            continue
        for k, (down, right) in enumerate([(0, 0), (0, 1), (1, 1), (1, 0)]):
            away = np.abs(start - [left + column + right, top - row - down]).sum(1)
            assert np.sort(away)[0] < 0.01 < np.sort(away)[1]
            out[row, column, 2 * k : 2 * k + 2] = points[away.argmin()] - points.mean(0)
            out[row, column, 8 + 2 * k : 10 + 2 * k] = speeds[away.argmin()]
        out[row, column, 16:21] = np.arange(5) == kind
    width = grid.shape[1]
    for a, b in links.tolist():
        one, other = divmod(a, width), divmod(b, width)
        for here, there in ((one, other), (other, one)):
            out[here][21 + SIDES[there[0] - here[0], there[1] - here[1]]] = 1
    return out


def wave(env: VoxelVecEnv, step: int) -> torch.Tensor:
    return 1.1 + 0.5 * torch.sin(0.4 * step + torch.arange(env.num_envs * env.num_actions)).reshape(env.num_envs, -1)


def begin(env: VoxelVecEnv) -> torch.Tensor:
    obs, _ = env.reset()
    env.home = {name: env.sim.object_positions(name) for name in env.voxels}
    return obs


def test_cells_are_what_the_points_say() -> None:
    designs = [example_design("walker"), sample_design((3, 4), seed=2), np.array([[3], [1], [4]])]
    env = make("Walker-v0", designs, 6, auto_reset=False)
    layout = env.voxels["robot"]
    obs = begin(env)
    assert (layout.rows, layout.columns) == (5, 5)
    for step in range(25):
        cells = layout.cells(obs)
        assert tuple(cells.shape) == (6, 25, NUM_FEATURES)
        for number in range(6):
            np.testing.assert_allclose(cells[number].reshape(5, 5, -1), expected(env, number), rtol=0, atol=EXACT)
        obs = env.step(wave(env, step))[0]


def test_cut_connections_show_in_the_mask_and_in_the_corners() -> None:
    body = np.array([[3, 3], [4, 4]])
    env = make("Walker-v0", [body], 1, connections=[np.array([[0, 0, 1], [1, 2, 3]])])
    cells = env.voxels["robot"].cells(env.reset()[0])[0]
    assert cells[:, FEATURES["neighbours"]].tolist() == [[0, 1, 1, 0], [0, 0, 1, 1], [1, 0, 0, 0], [1, 0, 0, 0]]
    for step in range(10):
        cells = env.voxels["robot"].cells(env.step(wave(env, step))[0])[0]
    inner = cells[2, 2:4], cells[3, 0:2]  # top right of the lower left cell, top left of the lower right one
    assert torch.equal(*inner)  # joined through the upper cells
    assert not torch.equal(cells[2, 4:6], cells[3, 6:8])  # their lower corners are not


@pytest.mark.parametrize(
    ("task", "rules"),
    [
        pytest.param(task, rules, marks=() if (number + which) % 6 == 0 else pytest.mark.slow)
        for number, task in enumerate(task_ids())
        for which, rules in enumerate(("evogym", "paper"))
    ],
)
def test_the_rest_of_what_a_task_observes_follows(task: str, rules: str) -> None:
    designs = [example_design("walker"), sample_design((3, 3), seed=1)]
    env = make(task, designs, 2, rules=rules)
    plain = make(task, designs, 2, rules=rules, obs="task")
    terms = [term.name for term in get_task(task).under(rules).observations if term.function is not shape]
    assert list(env.obs_columns[0]) == ["voxels_robot", *terms]
    assert env.obs_columns[0] == env.obs_columns[1]  # bodies of all sizes have one layout
    assert bool(env.obs_mask.all())
    places, others = env.obs_columns[0], plain.obs_columns
    pairs = [(env.reset()[0], plain.reset()[0])]
    for step in range(3):
        pairs.append((env.step(wave(env, step))[0], plain.step(wave(plain, step))[0]))
    for ours, theirs in pairs:
        assert torch.isfinite(ours).all()
        for number in range(2):
            for name in terms:
                assert torch.equal(ours[number, places[name]], theirs[number, others[number][name]]), name


def test_a_value_for_every_cell_becomes_actions() -> None:
    designs = [example_design("walker"), sample_design((3, 4), seed=2)]
    env = make("Walker-v0", designs, 4)
    layout = env.voxels["robot"]
    values = torch.rand(4, 25)
    actions = layout.actions(values)
    assert tuple(actions.shape) == (4, env.num_actions)
    for number in range(4):
        grid = np.zeros((5, 5), int)
        body = designs[env.design_index[number]]
        grid[: body.shape[0], : body.shape[1]] = body
        own = values[number].reshape(5, 5)[torch.as_tensor(grid >= 3)]
        assert actions[number, : len(own)].tolist() == own.tolist()
        assert not actions[number, len(own) :].any()
