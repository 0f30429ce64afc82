"""Self-folding (paper section A.4): more overlapping pairs of distant voxels than surface voxels stop the step.

Uses the boxes of the sub-step's start; a pair counts in both orders.
"""

import functools

import warp as wp

from warpvox.kernels.broadphase import DISTANT, box_overlap
from warpvox.kernels.lanes import inline, lane_ops
from warpvox.kernels.state import UNSTABLE, structs


@functools.cache
def check(precision: str, width: int):
    """Stage: set UNSTABLE in the status of environments with a folded robot."""
    ops, types = lane_ops(precision, width), structs(precision)
    first, drop = ops.first, ops.drop
    overlap = box_overlap(precision, width)

    @inline
    def clear(data: types.Data, pack: int, lane: int, robots: int):
        for robot in range(robots):
            for k in range(lane, lane + int(width)):
                data.folds[pack, robot, k] = 0

    @inline
    def judge(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        for robot in range(model.robots[design]):
            for k in range(lane, lane + int(width)):
                if data.folds[pack, robot, k] > model.fold_limit[design, robot]:
                    data.status[pack, k] = data.status[pack, k] | UNSTABLE

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        found = int(0)
        for n in range(data.pair_count[unit]):
            pair = data.pairs[unit, n]
            if (pair[2] & DISTANT) != 0:
                lanes = overlap(data, pack, lane, pair[0], pair[1], wp.float64(0.0))
                if lanes != 0 and found == 0:
                    clear(data, pack, lane, model.robots[design])
                    found = 1
                while lanes != 0:
                    k = lane + first(lanes)
                    robot = model.robot[design, pair[0]]
                    data.folds[pack, robot, k] = data.folds[pack, robot, k] + 2
                    lanes = drop(lanes)
        if found == 1:
            judge(model, data, design, pack, lane)

    return stage
