"""Contact forces between voxels and with terrain against plain numpy (paper section A.3)."""

import dataclasses

import numpy as np
import pytest

from warpvox.kernels import step
from warpvox.types import Physics

LAWS = {
    "as released": Physics(),
    "no friction": dataclasses.replace(Physics(), friction=0.0),
    "no damping": dataclasses.replace(Physics(), contact_damping=0.0),
}


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def inside(point, quad):
    """In the triangle 0-1-2 or 0-2-3, boundary included."""
    r = quad - point
    middle = cross(r[2], r[0])
    return any(
        middle * cross(r[0], r[k]) * way >= 0 and middle * cross(r[k], r[2]) * way >= 0 for k, way in ((1, 1), (3, 1))
    )


def segments_cross(a, b, c, d):
    u, v, w = b - a, d - c, c - a
    det = cross(u, v)
    return abs(det) >= 1e-4 and 0 <= cross(w, v) / det <= 1 and 0 <= cross(w, u) / det <= 1


def nearest_side(quad, c, other, sides):
    """The surface side of ``other`` that an edge at corner c crosses and that is nearest, and its depth."""
    found = []
    for e in range(4):
        a, b = other[e], other[(e + 1) % 4]
        edges = ((quad[c], quad[(c + 1) % 4]), (quad[(c + 3) % 4], quad[c]))
        if sides >> e & 1 and any(segments_cross(*edge, a, b) for edge in edges):
            found.append((abs(cross(b - a, quad[c] - a)) / np.linalg.norm(b - a), e))
    return min(found) if found else None


def voxels(scene, pos):
    """Quad, points, surface sides, object and whether it stands still, of surface voxels and of terrain cells."""
    model = scene.model
    for v in range(int(model.voxels)):
        corners = model.corner[v]
        yield (
            pos[corners],
            corners,
            int((model.side_lanes[v] & 1) @ [1, 2, 4, 8]),
            int(model.body[v]),
            bool(model.fixed_voxel[v]),
        )
    for side, (left, right, bottom, top) in zip(model.terrain_side, model.terrain_box, strict=True):
        if side:
            quad = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
            yield quad, np.full(4, -1), int(side), None, True


def expected_forces(scene, pos, vel, law):
    """``[points, 2]``, and how many contacts there were."""
    out, count = np.zeros((scene.points, 2)), 0

    def speed(point):
        return vel[point] if point >= 0 else np.zeros(2)

    def push(point, force):
        if point >= 0:
            out[point] += force

    everything = list(voxels(scene, pos))
    for quad, points, _, body, still in everything:
        for other, others, sides, theirs, fixed in everything:
            if other is quad or (still and fixed) or (quad.min(0) > other.max(0)).any():
                continue
            for c in range(4):
                shared = points[c] >= 0 and points[c] in others
                if shared or not inside(quad[c], other) or not (side := nearest_side(quad, c, other, sides)):
                    continue
                depth, e = side
                ends = others[e], others[(e + 1) % 4]
                along = other[(e + 1) % 4] - other[e]
                normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
                tangent = np.array([-normal[1], normal[0]])
                size = law.contact_stiffness * (law.contact_depth + depth)
                slip = speed(points[c]) @ tangent
                grip = law.friction * size
                drag = -law.friction_multiplier * grip * np.tanh(slip / grip) if grip else 0.0
                times = 2 if body is not None and body == theirs else 1
                force = times * (size * normal + drag * tangent)
                push(points[c], force - times * law.contact_damping * (speed(points[c]) @ normal) * normal)
                for end in ends:
                    push(end, -(force + times * law.contact_damping * (speed(end) @ normal) * normal) / 2)
                count += 1
    return out, count


@pytest.mark.parametrize("speed", [0.0, 3.0])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_forces_are_those_of_the_plain_formulas(scenes, dtype, law, speed):
    scene = scenes(dtype, LAWS[law])
    scene.scatter(5, squeeze=0.8, noise=0.02, speed=speed)
    step.launch(scene.sim._state, "boxes", "collect", "contacts")
    pos, vel, found = (scene.read(name)[:, : scene.points] for name in ("pos", "true_vel", "contact"))
    for lane in (0, 3, 7):
        expected, count = expected_forces(scene, pos[lane], vel[lane], LAWS[law])
        assert count > 20
        scene.close(found[lane, scene.active], expected[scene.active])
        assert np.isfinite(found[lane]).all()
