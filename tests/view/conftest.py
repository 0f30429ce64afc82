"""Made-up rollouts for everything that shows or stores one: no simulation is needed."""

from collections.abc import Callable

import numpy as np
import pytest

from warpvox.view.rollout import Rollout
from warpvox.view.scene import Scene, SceneObject


def _corners(grid: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Corner indices of a fully connected grid, and where its points lie (in cells, from its lower left)."""
    rows = grid.shape[0]
    numbers: dict[tuple[int, int], int] = {}
    quads = []
    for r, c in np.argwhere(grid):
        ends = [(r, c), (r, c + 1), (r + 1, c + 1), (r + 1, c)]
        quads.append([numbers.setdefault(end, len(numbers)) + first for end in ends])
    places = np.array([(c, rows - r) for r, c in numbers], float)
    return np.array(quads, np.int32), places


def make_scene(bodies: list[np.ndarray], width: int = 24, height: int = 10) -> tuple[Scene, np.ndarray]:
    """Bodies side by side on a floor with a step; the scene and its points at the start, [points, 2]."""
    objects, places, x = [], [], 1
    for number, grid in enumerate(bodies):
        first = sum(len(part) for part in places)
        quads, points = _corners(grid, first)
        name = "robot" if number == 0 else f"box_{number}"
        objects.append(SceneObject(name, grid, x, 1, first, len(points), quads))
        places.append(points + np.array([x, 1]))
        x += grid.shape[1] + 1
    floor = np.zeros((2, width), np.int8)
    floor[1], floor[0, -4:] = 5, 5
    objects.append(SceneObject("ground", floor, 0, 0, 0, 0, np.zeros((0, 4), np.int32)))
    return Scene(width, height, tuple(objects)), np.concatenate(places) * 0.1


def make_rollout(
    frames: int = 40, envs: int = 2, designs: int = 1, seed: int = 0, noise: float = 0.004, ends: tuple[int, ...] = ()
) -> Rollout:
    """Bodies that wobble to the right. ends: steps at which the first environments' episodes end."""
    rng = np.random.default_rng(seed)
    scenes, starts = [], []
    for number in range(designs):
        body = rng.integers(1, 5, (2 + number % 3, 3)).astype(np.int8)
        body[0, 0], body[0, 1] = 3, 4
        scene, start = make_scene([body, np.full((2, 2), 2, np.int8)])
        scenes.append(scene)
        starts.append(start)
    index = np.arange(envs) % designs
    positions = np.zeros((frames, envs, max(len(start) for start in starts), 2), np.float32)
    when = np.arange(frames)
    for env in range(envs):
        stop = np.minimum(when, ends[env] if env < len(ends) else frames)
        start = starts[index[env]]
        wave = 0.02 * np.sin(0.3 * stop[:, None, None] + 9 * start + env)
        move = np.stack([0.01 * stop, 0 * stop], axis=1)[:, None]
        shake = noise * rng.standard_normal((frames, *start.shape))[stop - 1]
        positions[:, env, : len(start)] = start + wave - wave[:1] + move + shake * (when > 0)[:, None, None]
    done = np.zeros((frames - 1, envs), bool)
    for env, end in enumerate(ends):
        done[end - 1 :, env] = True
    rewards = rng.normal(0.02, 0.01, (frames - 1, envs)) * ~np.roll(done, 1, axis=0)
    return Rollout(
        positions=positions,
        design_index=index,
        scenes=tuple(scenes),
        actions=rng.uniform(0.6, 1.6, (frames - 1, envs, 5)),
        rewards=rewards,
        terminated=done,
        truncated=np.zeros_like(done),
        metadata={"task": "Walker-v0", "rules": "evogym", "seed": seed, "agent": "sine"},
    )


@pytest.fixture(scope="session")
def rollouts() -> Callable[..., Rollout]:
    """``make_rollout`` for tests."""
    return make_rollout
