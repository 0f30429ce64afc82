"""A puppet in place of the simulator: objects are where the test puts them, so every threshold can be met."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch


class Puppet:
    """What environments ask of a :class:`warpvox.Simulation`, computed from points that tests move by hand.

    Each environment is one design; design d has ``points[d]`` robot points. Other objects have four points.
    ``push`` (per object, ``[num_envs, 2]``) is added to all points in each step, ``turn`` to the robot's
    angle; ``fold`` (bool ``[num_envs]``) makes the next steps unstable; it never diverges. Terrain is one point.
    """

    device = "cpu"
    num_actions = 3
    grid = None  # bodies cannot be exchanged

    def __init__(self, points: list[int], objects: tuple[str, ...] = (), dtype: torch.dtype = torch.float64):
        self.num_envs = self.num_designs = len(points)
        self.design_index = torch.arange(len(points))
        self.action_mask = torch.ones((len(points), self.num_actions), dtype=torch.bool)
        self.action_columns = [{"robot": slice(0, self.num_actions)}] * len(points)
        self.dtype = dtype
        self.counts = {"robot": points} | {name: [4] * len(points) for name in objects}
        generator = torch.Generator().manual_seed(1)
        self.home = {
            name: torch.rand((len(points), max(counts), 2), generator=generator, dtype=torch.float64)
            * self.point_mask(name)[:, :, None]
            for name, counts in self.counts.items()
        }
        self.points = {name: value.clone() for name, value in self.home.items()}
        self.angle = torch.zeros(self.num_envs, dtype=torch.float64)
        self.terrain = torch.zeros((1, 2), dtype=torch.float64)
        self.push = {name: torch.zeros((self.num_envs, 2), dtype=torch.float64) for name in self.counts}
        self.turn = torch.zeros(self.num_envs, dtype=torch.float64)
        self.fold = torch.zeros(self.num_envs, dtype=torch.bool)
        self.unstable = self.fold.clone()
        self.diverged = torch.zeros_like(self.fold)
        self.frozen = self.fold.clone()
        self.steps = 0

    def take(self, actions: torch.Tensor) -> None:
        assert tuple(actions.shape) == (self.num_envs, self.num_actions)

    def advance(self) -> None:
        self.steps += 1
        self.unstable = self.fold & ~self.frozen
        moves = ~(self.fold | self.frozen)
        for name, push in self.push.items():
            self.points[name] = self.points[name] + (push * moves[:, None])[:, None] * self.point_mask(name)[:, :, None]
        self.angle = (self.angle + self.turn * moves) % (2 * torch.pi)

    def reset(self, mask: torch.Tensor | None = None) -> None:
        mask = torch.ones(self.num_envs, dtype=torch.bool) if mask is None else mask
        for name, home in self.home.items():
            self.points[name] = torch.where(mask[:, None, None], home, self.points[name])
        self.angle = self.angle.masked_fill(mask, 0.0)
        self.frozen = self.frozen & ~mask

    def set_frozen(self, mask: torch.Tensor) -> None:
        self.frozen = mask.clone()

    @property
    def object_names(self) -> list[str]:
        return list(self.counts)

    def num_points(self, name: str) -> int:
        return max(self.counts[name])

    def point_mask(self, name: str) -> torch.Tensor:
        counts = torch.tensor(self.counts[name])
        return torch.arange(int(counts.max())) < counts[:, None]

    def com(self, name: str) -> torch.Tensor:
        return self.points[name].sum(1) / torch.tensor(self.counts[name])[:, None]

    def velocity(self, name: str) -> torch.Tensor:
        return self.push[name].clone()

    def orientation(self, name: str) -> torch.Tensor:
        return self.angle.clone()

    def relative_positions(self, name: str) -> torch.Tensor:
        about = (self.points[name] - self.com(name)[:, None]) * self.point_mask(name)[:, :, None]
        return about.transpose(1, 2).to(self.dtype)

    def object_positions(self, name: str) -> torch.Tensor:
        if name in self.points:
            return self.points[name].to(self.dtype)
        return self.terrain.expand(self.num_envs, -1, 2).to(self.dtype)

    def floor_scan(self, name: str, reach: int, objects: tuple[str, ...]) -> torch.Tensor:
        assert objects == ("ground",)
        return self.com(name)[:, :1] + torch.arange(2 * reach + 1)


@pytest.fixture(scope="session")
def puppet() -> type[Puppet]:
    """The class. Of session scope, because property tests want fixtures that outlive an example."""
    return Puppet


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Tensors here are tiny: a pool of threads only costs time on a busy machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
