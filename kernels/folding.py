"""Self-folding (paper section A.4): a step is undone if too many pairs of distant voxels of a robot overlap.

Uses the boxes of the sub-step's start; a pair counts in both orders.
"""

from warpvox.kernels.broadphase import boxes_overlap
from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.lanes import first_lane, without_first
from warpvox.kernels.state import DISTANT, UNSTABLE


@builder
def check(kit: Kit):
    """Build the stage that sets UNSTABLE in the status of environments with a folded robot."""
    width = kit.width
    overlap = boxes_overlap(kit)

    @kit.func
    def clear(data, pack, lane, robots):
        """Reset the counts of folded pairs to 0."""
        for robot in range(robots):
            for k in range(lane, lane + int(width)):
                data.folds[pack, robot, k] = 0

    @kit.func
    def apply_limits(model, data, mesh, pack, lane):
        """Set UNSTABLE where a robot exceeds its limit of folded pairs."""
        for robot in range(model.robots[mesh]):
            for k in range(lane, lane + int(width)):
                if data.folds[pack, robot, k] > model.fold_limit[mesh, robot, k]:
                    data.status[pack, k] = data.status[pack, k] | UNSTABLE

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        """Count the folded pairs of each robot of the unit, and set UNSTABLE above the limit."""
        found = int(0)
        for n in range(data.pair_count[unit]):
            pair = data.pairs[unit, n]
            if (pair[2] & DISTANT) != 0:
                lanes = overlap(data.box, pair[0], data.box, pair[1], pack, lane)
                if lanes != 0 and found == 0:
                    clear(data, pack, lane, model.robots[mesh])
                    found = 1
                while lanes != 0:
                    k = lane + first_lane(lanes)
                    robot = model.robot[mesh, pair[0]]
                    data.folds[pack, robot, k] = data.folds[pack, robot, k] + 2
                    lanes = without_first(lanes)
        if found == 1:
            apply_limits(model, data, mesh, pack, lane)

    return stage
