"""The linear response of bodies: against a recursion in plain numpy, and against the simulator."""

import math

import numpy as np
import pytest
import torch

from warpvox import make_vec
from warpvox.algos.policies.cpg import CpgNetwork, _moved
from warpvox.algos.policies.layout import VoxelInputs, VoxelLayout, layout_of
from warpvox.algos.policies.response import LinearResponse
from warpvox.design import sample_design
from warpvox.errors import ConfigError
from warpvox.types import DT, SUBSTEPS, Physics

BODY = np.array([[3, 1, 4], [0, 2, 3], [4, 3, 1]])
PERIOD = 10.0


def one_hot(bodies: np.ndarray) -> torch.Tensor:
    """``[bodies, cells, 4]`` of ``[bodies, rows, columns]``."""
    return torch.nn.functional.one_hot(torch.as_tensor(bodies).long().flatten(1), 5)[..., 1:].float()


def springs_of(body: np.ndarray) -> dict[tuple[int, int], tuple[float, list[int]]]:
    """Springs by their ends: stiffness, the largest of the voxels', and the actuators that drive it."""
    found: dict[tuple[int, int], tuple[float, list[int]]] = {}
    physics, width = Physics(), body.shape[1]
    for (row, column), kind in np.ndenumerate(body):
        if not kind:
            continue
        left_top = row * (width + 1) + column
        right_top, left, right = left_top + 1, left_top + width + 1, left_top + width + 2
        main, structural = physics.stiffness(int(kind))
        sides = {(left_top, right_top): 3, (left, right): 3, (left_top, left): 4, (right_top, right): 4}
        for ends, driver in sides.items():
            before, drivers = found.get(ends, (0.0, []))
            found[ends] = max(before, main), drivers + [row * width + column] * int(kind == driver)
        found[left_top, right] = found[right_top, left] = structural, []
    return found


def oscillation(body: np.ndarray, actuator: int) -> np.ndarray:
    """Complex displacement ``[points, 2]``, in voxels, by an action of 1 of one actuator: the dynamics, solved."""
    width, count = body.shape[1] + 1, (body.shape[0] + 1) * (body.shape[1] + 1)
    stiffness, force = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    for (one, other), (spring, drivers) in springs_of(body).items():
        along = np.array([other % width - one % width, one // width - other // width], dtype=float)
        longer = np.zeros(2 * count)
        longer[2 * other : 2 * other + 2] = along / np.linalg.norm(along)
        longer[2 * one : 2 * one + 2] = -along / np.linalg.norm(along)
        stiffness += spring * np.outer(longer, longer)
        force += spring * longer * (drivers.count(actuator) / max(len(drivers), 1))
    values, modes = np.linalg.eigh(stiffness)
    root = np.sqrt(np.maximum(values, 1e-3))
    cosine, sine, identity = np.cos(root * DT), np.sin(root * DT), np.eye(2 * count)
    # x' = x + s v + rate (f - K x) (1 - cos) / K, v' = cos v + rate (f - K x) s; both are multiplied by z
    rate, z = Physics().actuation_rate, np.exp(2j * math.pi / (PERIOD * SUBSTEPS))
    of = lambda diagonal: modes @ np.diag(diagonal) @ modes.T  # noqa: E731
    kick, reach = of(sine / root), of((1 - cosine) / root**2)
    system = np.block(
        [[(z - 1) * identity + rate * reach @ stiffness, -kick], [rate * kick @ stiffness, z * identity - of(cosine)]]
    )
    return np.linalg.solve(system, rate * np.concatenate([reach @ force, kick @ force]))[: 2 * count].reshape(count, 2)


@pytest.mark.parametrize("actuator", [0, 2, 5, 6, 7])
def test_it_solves_the_linear_dynamics(actuator: int) -> None:
    points = oscillation(BODY, actuator)
    found = LinearResponse(3, 3, [PERIOD])(one_hot(BODY[None]))[0, 0, :, :, actuator].numpy()
    for cell in np.flatnonzero(BODY):
        corners = cell // 3 * 4 + cell % 3 + np.array([0, 1, 4, 5])
        centre = points[corners].mean(0)
        assert np.abs(found[0, 2 * cell : 2 * cell + 2] - centre.real).max() < 0.015 * np.abs(points).max()
        assert np.abs(found[1, 2 * cell : 2 * cell + 2] - centre.imag).max() < 0.015 * np.abs(points).max()
    assert np.abs(found).max() > 0.02
    assert not found[:, 6:8].any(), "there is no voxel"


def test_bodies_on_the_ground_move_much_like_it() -> None:
    """Random bodies under random waves of amplitude 0.4: the first harmonic of the voxels' motion about the centre."""
    bodies = [sample_design((5, 5), seed=k) for k in range(16)]
    env = make_vec("Walker-v0", designs=bodies, num_envs=16, device="cpu", obs="voxel", grid=(5, 5), auto_reset=False)
    layout, draw = layout_of(env), np.random.default_rng(0)
    cells, present, actions, _ = VoxelInputs(layout)(env.reset()[0])
    phase = torch.from_numpy(draw.uniform(0, 2 * math.pi, (16, 25)))
    swing = 0.4 * torch.stack([phase.sin(), phase.cos()], -1) * (actions < layout.actions)[..., None]
    moves = []
    for step in range(60):
        angle = 2 * math.pi * step / PERIOD
        of_cells = 1.0 + swing @ torch.tensor([math.sin(angle), math.cos(angle)]).double()
        goals = torch.ones(16, layout.actions + 1).double().scatter(1, actions, of_cells)[:, :-1]
        cells = VoxelInputs(layout)(env.step(goals)[0])[0]
        moves.append(10 * cells[..., :2].double())
    angle = 2 * math.pi * torch.arange(41, 61).double() / PERIOD
    both = torch.stack([angle.sin(), angle.cos()], -1)
    seen = torch.einsum("tncx,tk->ncxk", torch.stack(moves[40:]), both) / 10
    types = one_hot(np.stack(bodies))
    told = _moved(LinearResponse(5, 5, [PERIOD])(types), swing[:, None])[:, 0].unflatten(1, (25, 2))
    told = (told - told.sum(1, keepdim=True) / present.sum(1)[:, None, :, None]) * present[..., None]
    assert float((seen * told).sum() / (seen.norm() * told.norm())) > 0.7


def test_large_grids_are_refused() -> None:
    with pytest.raises(ConfigError, match="its grid may have 100 cells, got 11x10"):
        CpgNetwork(VoxelLayout(11, 10, 4, 110, timed=True, periods=CpgNetwork.periods), critic=False)


def test_known_bodies_are_not_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    response = LinearResponse(3, 3, CpgNetwork.periods)
    bodies = one_hot(np.stack([BODY, BODY[::-1], BODY, BODY.T]))
    first = response.known(bodies)
    assert torch.equal(first, response(bodies).float())
    monkeypatch.setattr(LinearResponse, "forward", lambda *_: pytest.fail("computed again"))
    assert torch.equal(response.known(bodies[[3, 1]]), first[[3, 1]])
