"""A crowded world for the tests of contacts."""

import numpy as np
import pytest
from worlds import world

from warpvox.design import sample_design


def crowded_world(seed):
    """A robot between boxes on a bumpy ground."""
    ground = np.full((2, 24), 5)
    ground[0, ::3] = 0
    places = enumerate([(1, 2), (8, 2), (2, 8), (5, 8)])
    boxes = {f"box{n}": (np.full((1 + n % 2, 2), 1 + n % 2), *place) for n, place in places}
    robot = sample_design((5, 5), seed=seed), 3, 2
    return world(24, 16, ground=(ground, 0, 0), **boxes, bridge=([[5, 2, 2, 5]], 14, 4), robot=robot)


@pytest.fixture(name="crowded_world", scope="session")
def fixture_of_crowded_world():
    """``crowded_world(seed)``: a world with the robot of that seed."""
    return crowded_world
