"""Terms against values worked out by hand."""

from __future__ import annotations

from math import radians

import pytest
import torch

from warpvox.envs.terms import observations, rewards, terminations


class Moment:
    """A state with the values that a test gives it."""

    def __init__(self, **values: object) -> None:
        self._values = {name: torch.as_tensor(value, dtype=torch.float64) for name, value in values.items()}

    def __getattr__(self, name: str):
        return lambda what, *_: self._values[f"{name}_{what}"]


def moment(x: float = 0.0, y: float = 0.0) -> Moment:
    return Moment(com_robot=[[x, y]])


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [(0.5, 0.4, 0.0), (0.5, 0.3, 0.0), (0.5, 0.25, -0.25), (0.125, 0.25, 0.125), (0.25, 0.5, 0.0)],
)
def test_drop_counts_only_where_it_ends_below(start: float, end: float, expected: float) -> None:
    assert rewards.drop(moment(y=start), moment(y=end), "robot", below=0.3).tolist() == [expected]


@pytest.mark.parametrize(("x", "expected"), [(9.899, False), (9.9, False), (9.901, True)])
def test_beyond_is_strict(x: float, expected: bool) -> None:
    assert terminations.beyond(moment(x=x), "robot", "x", 9.9).tolist() == [expected]


@pytest.mark.parametrize(
    ("degrees", "expected"), [(0, False), (75, False), (76, True), (180, True), (284, True), (285, False), (359, False)]
)
def test_tilted_is_an_open_interval(degrees: float, expected: bool) -> None:
    state = Moment(orientation_robot=[radians(degrees)])
    assert terminations.tilted(state, "robot", radians(75), radians(285)).tolist() == [expected]


def elevation(x: float, y: float, points: list[tuple[float, float]], reach: int = 1) -> list[float]:
    state = Moment(com_robot=[[x, y]], positions_ground=[points])
    return observations.elevation(state, "robot", reach, ("ground",))[0].tolist()


def test_elevation_is_the_highest_point_below_in_windows_that_begin_at_the_centre() -> None:
    points = [(0.45, 0.1), (0.55, 0.2), (0.56, 0.3), (0.65, 0.4), (0.57, 0.9)]
    # windows from 0.5: [0.4, 0.5], [0.5, 0.6], [0.6, 0.7]; 0.9 lies above the centre of mass
    assert elevation(0.5, 0.7, points) == [0.1, 0.3, 0.4]


def test_elevation_is_the_floor_where_there_is_no_terrain() -> None:
    assert elevation(5.0, 0.7, [(0.0, 0.1), (4.95, 0.8), (9.0, 0.5)]) == [0.0, 0.0, 0.0]


def test_elevation_counts_a_point_on_a_border_on_both_sides() -> None:
    assert elevation(0.5, 0.7, [(0.5, 0.25)]) == [0.25, 0.25, 0.0]


def test_elevation_takes_the_higher_of_several_objects() -> None:
    state = Moment(com_robot=[[0.5, 0.7]], positions_a=[[(0.55, 0.2)]], positions_b=[[(0.55, 0.3), (0.45, 0.1)]])
    assert observations.elevation(state, "robot", 1, ("a", "b"))[0].tolist() == [0.1, 0.3, 0.0]


def test_overhang_is_the_lowest_point_above_and_five_voxels_up_where_there_is_none() -> None:
    points = [(0.45, 0.9), (0.55, 0.8), (0.56, 0.75), (0.57, 0.1)]
    state = Moment(com_robot=[[0.5, 0.7]], positions_ground=[points])
    heights = observations.overhang(state, "robot", 1, ("ground",))[0].tolist()
    assert heights == pytest.approx([0.9, 0.75, 1.2], abs=1e-12)


def test_overhang_and_elevation_reach_any_distance() -> None:
    points = [(0.55, 3.0), (0.56, 2.5), (0.45, -0.25), (0.55, -0.5)]
    state = Moment(com_robot=[[0.5, 0.7]], positions_ground=[points])
    assert observations.overhang(state, "robot", 1, ("ground",))[0].tolist() == [1.2, 2.5, 1.2]
    assert observations.elevation(state, "robot", 1, ("ground",))[0].tolist() == [-0.25, -0.5, 0.0]


@pytest.mark.parametrize(
    ("x", "start", "end", "expected"),
    [(2.0, 0.7, 0.59, -0.11), (2.0, 0.7, 0.6, 0.0), (2.01, 0.5, 0.45, 0.0), (2.01, 0.5, 0.39, -0.11)],
)
def test_staged_drop_changes_its_height_beyond_a_place(x, start, end, expected) -> None:
    fallen = rewards.staged_drop(moment(x, start), moment(x, end), "robot", below=0.6, x=2.0, below_beyond=0.4)
    assert fallen.tolist() == pytest.approx([expected], abs=1e-12)
