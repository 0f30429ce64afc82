"""Tests of the linear response against a numpy recursion and the simulator."""

import math

import numpy as np
import pytest
import torch

from lab.gradients.ascent import Motion
from lab.gradients.cpg import PERIODS, TYPE, CpgNetwork, describe_bodies
from lab.gradients.response import LinearResponse
from warpvox import Physics, make_vec, sample_design

DT, SUBSTEPS = Physics().dt, Physics().substeps

BODY = np.array([[3, 1, 4], [0, 2, 3], [4, 3, 1]])
PERIOD = 10.0


def one_hot(bodies: np.ndarray) -> torch.Tensor:
    """Convert bodies ``[bodies, rows, columns]`` to one-hot types ``[bodies, cells, 4]``."""
    return torch.nn.functional.one_hot(torch.as_tensor(bodies).long().flatten(1), 5)[..., 1:].float()


def springs_of(body: np.ndarray) -> dict[tuple[int, int], tuple[float, list[int]]]:
    """Collect springs by their ends: largest stiffness of the voxels, and driving actuators."""
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
    """Solve the dynamics for one actuator with action 1: complex displacement ``[points, 2]`` in voxels."""
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
    """Random bodies under waves of amplitude 0.4: the first harmonic of the motion of the centres of their halves."""
    bodies = [sample_design((5, 5), seed=k) for k in range(16)]
    env = make_vec("Walker-v0", bodies, 16, device="cpu", obs="voxel", grid=(5, 5), auto_reset=False)
    described = describe_bodies(np.stack(bodies))
    present = described[..., TYPE].sum(-1)
    phase = torch.from_numpy(np.random.default_rng(0).uniform(0, 2 * math.pi, (16, 25))).float()
    driven = described[..., 4:6].sum(-1)
    swing = 0.4 * torch.stack([phase.sin(), phase.cos()], -1) * driven[..., None]
    grid = env.voxels["robot"]
    obs, _ = env.reset()
    moves = []
    for step in range(60):
        angle = 2 * math.pi * step / PERIOD
        of_cells = 1.0 + swing @ torch.tensor([math.sin(angle), math.cos(angle)])
        obs = env.step(grid.actions(of_cells))[0]
        corners = grid.cells(obs)[..., :8].unflatten(-1, (4, 2)).mean(2)
        moves.append(10 * corners.double())
    angle = 2 * math.pi * torch.arange(41, 61).double() / PERIOD
    both = torch.stack([angle.sin(), angle.cos()], -1)
    seen = torch.einsum("tncx,tk->ncxk", torch.stack(moves[40:]), both) / 10
    real, imaginary = LinearResponse(5, 5, [PERIOD])(one_hot(np.stack(bodies)))[:, 0].unbind(1)
    quarter = torch.stack([-swing[..., 1], swing[..., 0]], dim=-1).double()
    told = (real @ swing.double() + imaginary @ quarter).unflatten(1, (25, 2))
    weight = present[..., None, None]
    told, seen = ((v - (v * weight).sum(1, keepdim=True) / weight.sum(1, keepdim=True)) * weight for v in (told, seen))
    assert float((seen * told).sum() / (seen.norm() * told.norm())) > 0.7


def test_known_bodies_are_not_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    response = LinearResponse(3, 3, PERIODS)
    bodies = one_hot(np.stack([BODY, BODY[::-1], BODY, BODY.T]))
    first = response.known(bodies)
    assert torch.equal(first, response(bodies).float())
    monkeypatch.setattr(LinearResponse, "forward", lambda *_: pytest.fail("computed again"))
    assert torch.equal(response.known(bodies[[3, 1]]), first[[3, 1]])


def test_motions_are_those_of_the_actuators_in_order() -> None:
    bodies = describe_bodies(np.stack([BODY, BODY[::-1].copy()]))
    torch.manual_seed(0)
    weights = CpgNetwork(3, 3, width=8, heads=2, layers=1)(bodies)
    actions = Motion(weights, bodies).at(torch.zeros(1, 1))
    for row, body in enumerate((BODY, BODY[::-1])):
        cells = np.flatnonzero(body.ravel() >= 3)
        wanted = 1.1 + 0.5 * torch.tanh(weights[row, cells, 0] + weights[row, cells, 3:].sum(-1))
        torch.testing.assert_close(actions[row, : len(cells)], wanted)
