"""Levels of rigid sides: at once in a level, and in the released order where sides share a point."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from warpvox.batch.levels import by_level

POINTS = 9


@given(
    arrays(np.int32, (3, 12), elements=st.integers(0, POINTS - 1)),
    arrays(np.int32, (3, 12), elements=st.integers(1, POINTS - 1)),
    arrays(np.int32, (3, 20), elements=st.integers(0, 11)),
    arrays(np.int32, 3, elements=st.integers(0, 20)),
)
def test_sides_of_a_level_share_no_point_and_others_keep_their_order(first, ahead, sides, rigids):
    ends = np.stack([first, (first + ahead) % POINTS], axis=-1)
    lanes = np.arange(sides.size, dtype=np.int32).reshape(sides.shape)  # tells sides apart that stand twice
    rest_pos = np.zeros((3, 2 * POINTS, 1))
    found = by_level(dict(spring_ends=ends, rigid_spring=sides, rigids=rigids, rigid_lanes=lanes, rest_pos=rest_pos))
    for pack, count in enumerate(rigids):
        order = found["rigid_lanes"][pack, :count] - lanes[pack, 0]
        marked = found["rigid_spring"][pack, :count]
        assert sorted(order) == list(range(count))
        assert (np.where(marked < 0, -1 - marked, marked) == sides[pack, order]).all()
        assert not count or marked[-1] < 0

        level = np.concatenate([[0], np.cumsum(marked < 0)])[:count]  # of each, in the new order
        for n in range(count):
            for m in range(n):
                shared = set(ends[pack, sides[pack, order[n]]]) & set(ends[pack, sides[pack, order[m]]])
                assert not shared or (level[m] < level[n] and order[m] < order[n])
