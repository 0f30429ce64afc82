"""Sensing for tasks: centre of mass, velocity, orientation, relative positions, extent, hull, floor and ceiling (B.1).

One thread an environment, results in the order of the environments. Sums run in float64 in the order of the points.
"""

import warp as wp

from warpvox.kernels import device
from warpvox.kernels.device import kernel
from warpvox.types import VOXEL as SIDE

NEARLY_ONE = wp.constant(wp.float64(0.99999))  # the released simulator's guard of its arc cosine
TINY = wp.constant(wp.float64(1.0e-7))
TWO_PI = wp.constant(wp.float64(2.0 * 3.1415926))  # as released
VOXEL = wp.constant(wp.float64(SIDE))
HALF_PI, HALF_PI_LOW = wp.constant(wp.float64(1.5707963267948966)), wp.constant(wp.float64(6.123233995736766e-17))
NUMERATOR = wp.types.vector(6, wp.float64)(
    0.16666666666666666, -0.3255658186224009, 0.20121253213486293, -0.04005553450067941, 0.0007915349942898145,
    3.479331075960212e-05,
)  # fmt: skip
DENOMINATOR = wp.types.vector(5, wp.float64)(
    1.0, -2.403394911734414, 2.0209457602335057, -0.6882839716054533, 0.07703815055590194
)


@wp.struct
class SensingArrays:
    """Arrays read by all sensing kernels; fields as in :mod:`warpvox.kernels.state`."""

    pos: wp.array3d(dtype=wp.float64)
    vel: wp.array3d(dtype=wp.float64)
    rest_pos: wp.array3d(dtype=wp.float64)
    order: wp.array3d(dtype=int)
    object_range: wp.array3d(dtype=wp.vec2i)
    frame: wp.array(dtype=int)
    pack_mesh: wp.array(dtype=int)
    env_pack: wp.array(dtype=int)
    env_lane: wp.array(dtype=int)


@wp.func
def span_of(arrays: SensingArrays, pack: int, o: int, k: int):
    """Return the range of an object's points in the order of observations: begin and end."""
    return arrays.object_range[arrays.pack_mesh[pack], o, k]


@wp.func
def points_of(arrays: SensingArrays, env: int, o: int):
    """Return an environment's pack and lane, and the range of an object's points in the order of observations."""
    pack, k = arrays.env_pack[env], arrays.env_lane[env]
    span = span_of(arrays, pack, o, k)
    return pack, k, span[0], span[1]


@wp.func
def row(arrays: SensingArrays, pack: int, i: int, k: int):
    """Return the pack's row of the i-th point in the order of observations."""
    return arrays.order[arrays.pack_mesh[pack], i, k]


@wp.func
def centre(arrays: SensingArrays, pack: int, k: int, begin: int, end: int):
    """Return x and y of the centre of mass of the points from ``begin`` to ``end``."""
    x, y = wp.float64(0.0), wp.float64(0.0)
    for i in range(begin, end):
        p = row(arrays, pack, i, k)
        x += arrays.pos[pack, 2 * p, k]
        y += arrays.pos[pack, 2 * p + 1, k]
    n = wp.float64(end - begin)
    return x / n, y / n


@kernel
def centres(arrays: SensingArrays, com: wp.array2d(dtype=wp.vec2d), velocity: wp.array2d(dtype=wp.vec2d)):
    """Compute the centre of mass and its velocity for every object: [environment, object]."""
    env, o = wp.tid()
    pack, k, begin, end = points_of(arrays, env, o)
    if end <= begin:
        return
    x, y = centre(arrays, pack, k, begin, end)
    vx, vy = wp.float64(0.0), wp.float64(0.0)
    for i in range(begin, end):
        p = row(arrays, pack, i, k)
        vx += arrays.vel[pack, 2 * p, k]
        vy += arrays.vel[pack, 2 * p + 1, k]
    n = wp.float64(end - begin)
    com[env, o] = wp.vec2d(x, y)
    velocity[env, o] = wp.vec2d(vx / n, vy / n)


@wp.func
def place(arrays: SensingArrays, pack: int, i: int, k: int):
    """Return the position of the i-th point."""
    p = row(arrays, pack, i, k)
    return wp.vec2d(arrays.pos[pack, 2 * p, k], arrays.pos[pack, 2 * p + 1, k])


@wp.func
def rest(arrays: SensingArrays, pack: int, i: int, k: int):
    """Return the position of the i-th point at time 0."""
    p, mesh = row(arrays, pack, i, k), arrays.pack_mesh[pack]
    return wp.vec2d(arrays.rest_pos[mesh, 2 * p, k], arrays.rest_pos[mesh, 2 * p + 1, k])


@wp.func
def arc_cosine(c: wp.float64):
    """Compute the arc cosine of c, in [0, pi], with the same bits on every machine.

    Within two units in the last place. Method and constants: fdlibm (e_acos.c).
    """
    size, half = wp.abs(c), wp.float64(0.5)
    square = wp.where(size < half, c * c, half * (wp.float64(1.0) - size))
    p, q = NUMERATOR[5], DENOMINATOR[4]
    for n in range(5):
        p = p * square + NUMERATOR[4 - n]
    for n in range(4):
        q = q * square + DENOMINATOR[3 - n]
    share = square * p / q  # arcsin(x) = x + x share for x^2 = square
    if size < half:
        return HALF_PI - (c - (HALF_PI_LOW - c * share))
    root, two = wp.sqrt(square), wp.float64(2.0)
    if c < wp.float64(0.0):
        return two * (HALF_PI - (root + (root * share - HALF_PI_LOW)))
    return two * (root + root * share)


@wp.func
def turn(ax: wp.float64, ay: wp.float64, bx: wp.float64, by: wp.float64):
    """Return the angle between vectors a and b, the cross product of their directions, and the length of b.

    The cross product is NaN if a vector has length 0.
    """
    la, lb = wp.sqrt(ax * ax + ay * ay), wp.sqrt(bx * bx + by * by)
    ax, ay, bx, by = ax / la, ay / la, bx / lb, by / lb
    c = ax * bx + ay * by
    if la * lb < TINY or c > wp.float64(1.0):
        c = NEARLY_ONE
    if c < wp.float64(-1.0):
        c = -NEARLY_ONE
    return arc_cosine(c), ax * by - ay * bx, lb


@kernel
def orientations(arrays: SensingArrays, o: int, out: wp.array(dtype=wp.float64)):
    """Compute the orientation of one object, counter-clockwise in [0, 2 pi): [environment]."""
    env = wp.tid()
    pack, k, begin, end = points_of(arrays, env, o)
    if end <= begin:
        return
    # The released simulator sums the first point, then four at a time in two pairs, then the rest. At time 0, where
    # rounding decides what the guard does, only this order gives its value.
    pos_sum, rest_sum = place(arrays, pack, begin, k), rest(arrays, pack, begin, k)
    q = begin + 1
    while q + 3 < end:
        pos_sum += (place(arrays, pack, q, k) + place(arrays, pack, q + 1, k)) + (
            place(arrays, pack, q + 2, k) + place(arrays, pack, q + 3, k)
        )
        rest_sum += (rest(arrays, pack, q, k) + rest(arrays, pack, q + 1, k)) + (
            rest(arrays, pack, q + 2, k) + rest(arrays, pack, q + 3, k)
        )
        q += 4
    while q < end:
        pos_sum += place(arrays, pack, q, k)
        rest_sum += rest(arrays, pack, q, k)
        q += 1
    n = wp.float64(end - begin)
    x, y, hx, hy = pos_sum[0] / n, pos_sum[1] / n, rest_sum[0] / n, rest_sum[1] / n
    angle, weight, crosses = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
    for i in range(begin, end):
        point, origin = place(arrays, pack, i, k), rest(arrays, pack, i, k)
        a, c, w = turn(point[0] - x, point[1] - y, origin[0] - hx, origin[1] - hy)
        angle += a * w
        weight += w
        crosses += c
    angle = angle / weight
    if crosses > wp.float64(0.0):  # not where a point lies at the centre: NaN, as in the released simulator
        angle = TWO_PI - angle
    out[env] = angle


@kernel
def points(arrays: SensingArrays, o: int, what: int, out: wp.array3d(dtype=wp.float64)):
    """Copy positions (what 0), velocities (1) or positions minus centre of mass (2): [environment, point, axis]."""
    env = wp.tid()
    pack, k, begin, end = points_of(arrays, env, o)
    x, y = wp.float64(0.0), wp.float64(0.0)
    if what == 2:
        x, y = centre(arrays, pack, k, begin, end)
    for i in range(begin, end):
        n, p = i - begin, row(arrays, pack, i, k)
        if what == 1:
            out[env, n, 0] = arrays.vel[pack, 2 * p, k]
            out[env, n, 1] = arrays.vel[pack, 2 * p + 1, k]
        else:
            out[env, n, 0] = arrays.pos[pack, 2 * p, k] - x
            out[env, n, 1] = arrays.pos[pack, 2 * p + 1, k] - y


@wp.func
def later(a: wp.vec2d, b: wp.vec2d):
    """Return whether b sorts after a, from bottom to top and then from left to right."""
    return b[1] > a[1] or (b[1] == a[1] and b[0] > a[0])


@wp.func
def cross(a: wp.vec2d, b: wp.vec2d):
    """Return the cross product of two vectors."""
    return a[0] * b[1] - a[1] * b[0]


@kernel
def extents(arrays: SensingArrays, o: int, out: wp.array(dtype=wp.vec2d)):
    """Compute width and height of the bounding box of one object: [environment]."""
    env = wp.tid()
    pack, k, begin, end = points_of(arrays, env, o)
    if end <= begin:
        return
    low = place(arrays, pack, begin, k)
    high = low
    for p in range(begin + 1, end):
        point = place(arrays, pack, p, k)
        low, high = wp.min(low, point), wp.max(high, point)
    out[env] = high - low


@kernel
def hulls(arrays: SensingArrays, o: int, out: wp.array(dtype=wp.float64)):
    """Compute the area of the convex hull of one object: [environment].

    Wraps the hull in two chains, up from the lowest point along its right side and down along its left: each
    step goes strictly on in one order of the points, so that rounding cannot send it round in circles.
    """
    env = wp.tid()
    pack, k, begin, end = points_of(arrays, env, o)
    if end <= begin:
        return
    low = place(arrays, pack, begin, k)
    for p in range(begin + 1, end):
        point = place(arrays, pack, p, k)
        if later(point, low):
            low = point
    here = low  # the area is a fan of triangles about the lowest point
    area = wp.float64(0.0)
    up, steps = int(1), int(0)
    while up >= -1 and steps < 2 * (end - begin) + 2:
        found = int(0)
        best = here
        for p in range(begin, end):
            point = place(arrays, pack, p, k)
            ahead = later(here, point)
            if up == -1:
                ahead = later(point, here)
            # Strictly to the right of the line to the best so far.
            if ahead and (found == 0 or cross(best - here, point - here) < wp.float64(0.0)):
                found, best = 1, point
        if found == 0:
            up = up - 2
        else:
            area += cross(here - low, best - low)
            here = best
        steps += 1
    out[env] = area * wp.float64(0.5)


@wp.func
def seen(y: wp.float64, at: wp.float64, best: wp.float64, up: int):
    """Return the minimum of ``best`` and the distance from height ``at`` to a point at height y.

    Points on the other side do not count: ``up`` is 1 to look up from ``at``, -1 to look down.
    """
    if up == 1 and y > at:
        return wp.min(best, y - at)
    if up == -1 and y < at:
        return wp.min(best, at - y)
    return best


@wp.func
def edge(window: int, reach: int, side: int):
    """Return the left (side -1) or right (1) end of a window relative to the centre of mass, in voxels."""
    return wp.float64(window - reach) + wp.float64(side) * wp.float64(0.5)


@kernel
def scans(
    arrays: SensingArrays, o: int, reach: int, sight: wp.float64, up: int,
    column: wp.array2d(dtype=int), static_points: wp.array2d(dtype=wp.vec2d), moving: wp.array(dtype=int),
    out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Compute the distance to the nearest listed point in each window one voxel wide: [environment, window].

    ``static_points`` are fixed points in voxels sorted by lattice column, ``column`` where each column starts;
    ``moving`` lists objects that can move (-1: none). In voxels until the last line, as released.
    """
    env = wp.tid()
    pack, k, begin, end = points_of(arrays, env, o)
    frame = arrays.frame[arrays.pack_mesh[pack]]
    x, y = wp.float64(0.0), wp.float64(0.0)
    for i in range(begin, end):
        p = row(arrays, pack, i, k)
        x += arrays.pos[pack, 2 * p, k] / VOXEL
        y += arrays.pos[pack, 2 * p + 1, k] / VOXEL
    n = wp.float64(end - begin)
    x, y = x / n, y / n
    last = column.shape[1] - 2
    for window in range(2 * reach + 1):
        left, right = x + edge(window, reach, -1), x + edge(window, reach, 1)
        best = sight
        if left < wp.float64(last + 1) and right > wp.float64(-1.0):
            first = wp.clamp(int(wp.floor(left)), 0, last)
            stop = wp.clamp(int(wp.floor(right)) + 1, 0, last)
            for i in range(column[frame, first], column[frame, stop + 1]):
                if static_points[frame, i][0] > left and static_points[frame, i][0] < right:
                    best = seen(static_points[frame, i][1], y, best, up)
        out[env, window] = best
    for m in range(moving.shape[0]):
        listed = wp.vec2i(0, 0)
        if moving[m] >= 0:
            listed = span_of(arrays, pack, moving[m], k)
        for i in range(listed[0], listed[1]):
            p = row(arrays, pack, i, k)
            px = arrays.pos[pack, 2 * p, k] / VOXEL
            if wp.abs(px - x) < wp.float64(reach + 1):
                # Rounding may put it into a neighbour of the window that its distance says.
                about = int(wp.floor(px - x + wp.float64(0.5))) + reach
                for window in range(wp.max(about - 1, 0), wp.min(about + 1, 2 * reach) + 1):
                    if px > x + edge(window, reach, -1) and px < x + edge(window, reach, 1):
                        out[env, window] = seen(arrays.pos[pack, 2 * p + 1, k] / VOXEL, y, out[env, window], up)
    for window in range(2 * reach + 1):
        out[env, window] = out[env, window] * VOXEL


KERNELS = {k.func.__name__: k for k in (centres, orientations, points, extents, hulls, scans)}


def record(state, name: str, dim, *inputs) -> wp.Launch | device.Command:
    """Record the launch of one sensing kernel; ``inputs`` follow the arrays."""
    arrays = SensingArrays()
    for field in ("pos", "vel", "rest_pos", "order", "object_range", "frame", "pack_mesh"):
        setattr(arrays, field, state.arrays[field])
    for field in ("env_pack", "env_lane"):
        setattr(arrays, field, getattr(state, field))
    return device.record(KERNELS[name], dim, [arrays, *inputs], state.device)
