"""Terms against values worked out by hand."""

from __future__ import annotations

import torch

from warpvox.envs.terms import observations


class Moment:
    """A state with the values that a test gives it."""

    def __init__(self, **values: object) -> None:
        self._values = {name: torch.as_tensor(value, dtype=torch.float64) for name, value in values.items()}

    def __getattr__(self, name: str):
        return lambda what, *_: self._values[f"{name}_{what}"]


def elevation(x: float, y: float, points: list[tuple[float, float]], reach: int = 1) -> list[float]:
    state = Moment(com_robot=[[x, y]], positions_ground=[points])
    return observations.elevation(state, "robot", reach, ("ground",))[0].tolist()


def test_elevation_counts_a_point_on_a_border_on_both_sides() -> None:
    assert elevation(0.5, 0.7, [(0.5, 0.25)]) == [0.25, 0.25, 0.0]


def test_elevation_takes_the_higher_of_several_objects() -> None:
    state = Moment(com_robot=[[0.5, 0.7]], positions_a=[[(0.55, 0.2)]], positions_b=[[(0.55, 0.3), (0.45, 0.1)]])
    assert observations.elevation(state, "robot", 1, ("a", "b"))[0].tolist() == [0.1, 0.3, 0.0]
