"""Rollouts: what environments did, step by step, in memory and in one file.

Pictures, USD and the page of the browser player are all made from a :class:`Rollout`, so that an episode is
simulated once and can be looked at anywhere later.

The file (version 1) is a compressed ``.npz`` that numpy reads without pickle. T is the number of control steps,
E of environments, P of points and A of actions (the largest over the designs; padded with 0)::

    header        uint8 [bytes]            JSON in UTF-8, see below
    positions     float32 [T + 1, E, P, 2] points of everything that can move; entry 0 is the state after reset
    design_index  int32 [E]                which scene an environment has
    actions       float32 [T, E, A]        as applied, in [0.6, 1.6]
    rewards       float64 [T, E]           0 after the end of an episode
    terminated    bool [T, E]              stays True after the end; the points then rest where they ended
    truncated     bool [T, E]

The header: ``format`` ("warpvox-rollout"), ``version``, ``units`` (``voxel``: side of a voxel in units of
``positions``; ``dt``: nominal seconds from one entry to the next), ``metadata`` (task, rules, seed and whatever
the recorder added) and ``scenes``, one for every distinct world: ``width``, ``height`` and ``objects``, each with
``name``, ``grid`` (cells, row 0 on top), ``x``, ``y`` (cell of its lower left corner), ``first_point``,
``num_points`` (0 for terrain, which its grid describes completely) and ``corners``, for every cell that is not
empty, row by row from the top left, its points at the top left, top right, bottom right and bottom left.
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.errors import ConfigError, RolloutError, did_you_mean, listing
from warpvox.files import atomic_path
from warpvox.types import ACTION_HIGH, ACTION_LOW, VOXEL, Cell

__all__ = ["AGENTS", "FRAME_SECONDS", "Rollout", "Scene", "SceneObject", "record"]

FORMAT, VERSION = "warpvox-rollout", 1
FRAME_SECONDS = 1 / 50
"""Nominal seconds of a control step (paper section A.2: 50 Hz)."""
AGENTS = ("zero", "random", "sine")
"""Agents that need no training: all actuators at rest, uniformly random actions, a steady gait."""
ARRAYS = {
    "positions": np.float32,
    "design_index": np.int32,
    "actions": np.float32,
    "rewards": np.float64,
    "terminated": np.bool_,
    "truncated": np.bool_,
}


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of a scene.

    Attributes:
        name: of the object; a robot is the object that has actuators.
        grid: int8 ``[rows, columns]``, row 0 on top.
        x, y: cell of the lower left corner of ``grid`` at the start.
        first_point, num_points: its share of the points of an environment; no points if it never moves.
        corners: int32 ``[cells, 4]``: points of every cell that is not empty at the top left, top right, bottom
            right and bottom left, counted over all points of the environment; ``[0, 4]`` if it never moves.
    """

    name: str
    grid: np.ndarray
    x: int
    y: int
    first_point: int
    num_points: int
    corners: np.ndarray

    @property
    def is_static(self) -> bool:
        """Whether the object is terrain, which never moves."""
        return self.num_points == 0

    @property
    def is_robot(self) -> bool:
        """Whether the object has actuators."""
        return bool(np.isin(self.grid, (int(Cell.H_ACT), int(Cell.V_ACT))).any())

    @property
    def cells(self) -> np.ndarray:
        """int8 ``[cells]``: types of the cells that are not empty, in the order of ``corners``."""
        return self.grid[self.grid != Cell.EMPTY]

    @property
    def places(self) -> np.ndarray:
        """int ``[cells, 2]``: row and column in ``grid`` of those cells."""
        return np.argwhere(self.grid != Cell.EMPTY)


@dataclass(frozen=True, eq=False)
class Scene:
    """One distinct world of a rollout: its objects and their meshes.

    Attributes:
        width, height: of the world in cells.
        objects: in the order of the simulator: robots, then the rest, each by name.
    """

    width: int
    height: int
    objects: tuple[SceneObject, ...]

    @property
    def moving(self) -> tuple[SceneObject, ...]:
        """Objects that have points."""
        return tuple(obj for obj in self.objects if not obj.is_static)

    @property
    def robots(self) -> tuple[SceneObject, ...]:
        """Objects with actuators; where there is none, everything that moves."""
        return tuple(obj for obj in self.moving if obj.is_robot) or self.moving

    @cached_property
    def corners(self) -> np.ndarray:
        """int32 ``[cells, 4]``: corners of all cells that move, object after object."""
        return np.concatenate([obj.corners for obj in self.moving])

    @cached_property
    def cells(self) -> np.ndarray:
        """int8 ``[cells]``: types of all cells that move, in the order of ``corners``."""
        return np.concatenate([obj.cells for obj in self.moving])

    @cached_property
    def robot_points(self) -> np.ndarray:
        """int ``[k]``: the points of the robots."""
        return np.concatenate([np.arange(o.first_point, o.first_point + o.num_points) for o in self.robots])

    @property
    def num_points(self) -> int:
        """Points of this scene; entries of a rollout's positions beyond them are padding."""
        return sum(obj.num_points for obj in self.moving)

    @cached_property
    def terrain(self) -> np.ndarray:
        """int8 ``[height, width]``, row 0 on top: all cells that never move."""
        cells = np.zeros((self.height, self.width), np.int8)
        for obj in self.objects:
            if obj.is_static:
                rows, columns = obj.grid.shape
                top = self.height - obj.y - rows
                view = cells[top : top + rows, obj.x : obj.x + columns]
                np.copyto(view, obj.grid, where=obj.grid != 0)
        return cells


@dataclass(eq=False)
class Rollout:
    """Recorded environments; see the module's text for shapes and units.

    Attributes:
        positions: float32 ``[T + 1, E, P, 2]`` in simulator units (0.1 a voxel); entry 0 follows the reset.
        design_index: int32 ``[E]``, index into ``scenes``.
        scenes: the distinct worlds.
        actions: float32 ``[T, E, A]`` in [0.6, 1.6].
        rewards: float64 ``[T, E]``.
        terminated, truncated: bool ``[T, E]``; they stay True after the end of an episode.
        metadata: JSON values: task, rules, seed, ...

    Raises:
        RolloutError: parts that do not fit together.
    """

    positions: np.ndarray
    design_index: np.ndarray
    scenes: tuple[Scene, ...]
    actions: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    metadata: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, dtype in ARRAYS.items():
            setattr(self, name, np.ascontiguousarray(getattr(self, name), dtype=dtype))
        self.scenes = tuple(self.scenes)
        _check_shapes(self)
        for number, scene in enumerate(self.scenes):
            _check_scene(scene, number, self.positions.shape[2])

    @property
    def num_frames(self) -> int:
        """States recorded: one more than there are steps."""
        return self.positions.shape[0]

    @property
    def num_steps(self) -> int:
        """Control steps recorded."""
        return self.positions.shape[0] - 1

    @property
    def num_envs(self) -> int:
        """Environments recorded."""
        return self.positions.shape[1]

    @property
    def title(self) -> str:
        """The task's id, or "rollout" where there is none."""
        return str(self.metadata.get("task") or "rollout")

    @property
    def done(self) -> np.ndarray:
        """bool ``[T, E]``: the episode has ended in this step or before."""
        return self.terminated | self.truncated

    @property
    def lengths(self) -> np.ndarray:
        """int ``[E]``: control steps up to the end of each episode (or of the recording)."""
        over = np.concatenate([self.done, np.ones((1, self.num_envs), bool)])
        return np.minimum(over.argmax(axis=0) + 1, self.num_steps)

    @cached_property
    def returns(self) -> np.ndarray:
        """float64 ``[T + 1, E]``: reward collected up to each entry of ``positions``."""
        start = np.zeros((1, self.num_envs))
        return np.concatenate([start, self.rewards.cumsum(axis=0)])

    def scene(self, env: int) -> Scene:
        """The scene of an environment."""
        return self.scenes[self.design_index[env]]

    def check_env(self, env: int) -> int:
        """Return ``env`` if there is such an environment.

        Raises:
            RolloutError: there is not.
        """
        if not isinstance(env, int | np.integer) or isinstance(env, bool) or not 0 <= env < self.num_envs:
            raise RolloutError(f"No environment {env!r}: the rollout has {self.num_envs}, counted from 0.")
        return int(env)

    def check_frame(self, frame: int) -> int:
        """Return ``frame`` with negative numbers counted from the end.

        Raises:
            RolloutError: there is no such frame.
        """
        count = self.num_frames
        if not isinstance(frame, int | np.integer) or isinstance(frame, bool) or not -count <= frame < count:
            raise RolloutError(
                f"No frame {frame!r}: the rollout has {count}, 0 to {count - 1} (-1: the last)."
            )
        return int(frame) % count

    def stretch(self, frame: int | slice, env: int) -> np.ndarray:
        """Length of cells against rest along the axis of actuation (of other cells: the mean of both axes).

        Args:
            frame: an index, which gives float32 ``[cells]``, or a slice, which gives ``[frames, cells]``.
            env: environment; the cells are those of ``scene(env).cells``.
        """
        scene = self.scene(env)
        corners = self.positions[frame, env][..., scene.corners, :]
        sides = np.linalg.norm(np.roll(corners, -1, axis=-2) - corners, axis=-1) / VOXEL
        across = (sides[..., 0] + sides[..., 2]) / 2
        upright = (sides[..., 1] + sides[..., 3]) / 2
        both = (across + upright) / 2
        return np.where(scene.cells == Cell.H_ACT, across, np.where(scene.cells == Cell.V_ACT, upright, both))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the rollout to ``path`` (``.npz``), whole or not at all; return the path.

        Raises:
            RolloutError: metadata that JSON cannot hold.
        """
        header = {
            "format": FORMAT,
            "version": VERSION,
            "units": {"voxel": VOXEL, "dt": FRAME_SECONDS},
            "metadata": self.metadata,
            "scenes": [_scene_to_json(scene) for scene in self.scenes],
        }
        try:
            text = json.dumps(header, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise RolloutError(f"The rollout's metadata must consist of JSON values: {error}.") from None
        arrays = {name: getattr(self, name) for name in ARRAYS}
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, header=np.frombuffer(text, np.uint8), **arrays)
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Rollout:
        """Read a rollout that :meth:`save` wrote.

        Raises:
            RolloutError: no such file, a file that is truncated, damaged or no rollout, or a newer version.
        """
        header, arrays = _read(Path(path))
        try:
            scenes = tuple(_scene_from_json(scene) for scene in header["scenes"])
            metadata = dict(header["metadata"])
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError):
            raise RolloutError(f"{path} is damaged: its header does not describe scenes.") from None
        try:
            return cls(scenes=scenes, metadata=metadata, **arrays)
        except RolloutError as error:
            raise RolloutError(f"{path} is damaged: {error}") from None


# -------------------------------------------------------------------------------------------------- recording


def record(
    env: Any,
    policy: str | Callable[[Any], Any] = "sine",
    num_steps: int | None = None,
    *,
    metadata: Mapping[str, Any] | None = None,
) -> Rollout:
    """Reset ``env``, let ``policy`` act for one episode everywhere and return what happened.

    An environment whose episode ends stays as it ended until the recording is over, whatever ``env.auto_reset``
    says (an environment that resets itself is left reset).

    Args:
        env: what :func:`warpvox.make_vec` makes.
        policy: ``function(obs)`` giving actions ``[num_envs, num_actions]`` in [0.6, 1.6], or one of
            :data:`AGENTS`, which follow ``env.seed``.
        num_steps: at most so many control steps; None: until all episodes have ended.
        metadata: JSON values to keep with the rollout, for instance the configuration of a run.

    Raises:
        ConfigError: an unknown agent or a number of steps below 1. ActionError: what the policy gives is refused.
    """
    import torch

    if num_steps is not None and (
        not isinstance(num_steps, int | np.integer) or isinstance(num_steps, bool) or num_steps < 1
    ):
        raise ConfigError(f"num_steps must be a whole number >= 1 or None, got {num_steps!r}.")
    act = _agent(policy, env) if isinstance(policy, str) else policy
    scenes, gather = _scenes(env.sim)
    limit = env.max_episode_steps if num_steps is None else min(int(num_steps), env.max_episode_steps)
    label = policy if isinstance(policy, str) else "policy"
    resets_itself, env.auto_reset = env.auto_reset, False
    try:
        with torch.no_grad():
            columns = _run(env, act, limit, gather)
    finally:
        env.auto_reset = resets_itself
        if resets_itself:
            env.reset()
    about = {
        "task": getattr(getattr(env, "spec", None), "id", None),
        "rules": getattr(env, "rules", None),
        "physics": env.sim.physics.name,
        "seed": getattr(env, "seed", None),
        "dtype": str(env.sim.dtype).removeprefix("torch."),
        "agent": label,
    }
    return Rollout(
        design_index=env.sim.design_index.cpu().numpy(),
        scenes=scenes,
        metadata=about | dict(metadata or {}),
        **columns,
    )


def _run(
    env: Any, act: Callable[[Any], Any], limit: int, gather: Callable[[], np.ndarray]
) -> dict[str, np.ndarray]:
    """Step until all episodes have ended; what happened, as arrays with the step first."""
    import torch

    obs, _ = env.reset()
    seen: dict[str, list] = {name: [] for name in ("actions", "rewards", "terminated", "truncated")}
    positions = [gather()]
    for _ in range(limit):
        actions = torch.as_tensor(act(obs))
        obs, reward, terminated, truncated, _ = env.step(actions)
        row = (actions.clamp(ACTION_LOW, ACTION_HIGH), reward, terminated, truncated)
        for name, value in zip(seen, row, strict=True):
            seen[name].append(value.cpu().numpy())
        positions.append(gather())
        if bool((terminated | truncated).all()):
            break
    return {"positions": np.stack(positions), **{name: np.stack(rows) for name, rows in seen.items()}}


def _scenes(sim: Any) -> tuple[tuple[Scene, ...], Callable[[], np.ndarray]]:
    """The scenes of a simulation, and a function that gives its points, float32 ``[E, P, 2]``."""
    import torch

    names = [
        name
        for name in sim.object_names
        if any(name in world and not world.objects[name].is_static for world in sim.worlds)
    ]
    starts = dict(
        zip(names, np.cumsum([0, *(sim.num_points(name) for name in names)]).tolist(), strict=False)
    )
    scenes, sources = [], []
    for design, world in enumerate(sim.worlds):
        objects, source = [], []
        for name in (name for name in sim.object_names if name in world):
            item = world.objects[name]
            corners, count, first = np.zeros((0, 4), np.int32), 0, len(source)
            if not item.is_static:
                corners = sim.voxel_corners(name, design=design)
                count = int(corners.max()) + 1
                source += range(starts[name], starts[name] + count)
            grid = np.asarray(item.grid, np.int8)
            objects.append(
                SceneObject(name, grid, item.x, item.y, first if count else 0, count, corners + first)
            )
        scenes.append(Scene(world.width, world.height, tuple(objects)))
        sources.append(source)
    longest = max(len(source) for source in sources)
    # Objects have their widest design's room in the simulation; here the points of an environment are contiguous.
    table = torch.tensor([source + [0] * (longest - len(source)) for source in sources], device=sim.device)
    index = table[sim.design_index]
    real = (
        torch.arange(longest, device=sim.device)
        < torch.tensor([len(source) for source in sources], device=sim.device)[sim.design_index][:, None]
    )

    def gather() -> np.ndarray:
        every = torch.cat([sim.object_positions(name) for name in names], dim=1)
        points = torch.gather(every, 1, index[:, :, None].expand(-1, -1, 2)) * real[:, :, None]
        return points.to(torch.float32).cpu().numpy()

    return tuple(scenes), gather


def _agent(name: str, env: Any) -> Callable[[Any], Any]:
    """One of :data:`AGENTS` as a policy."""
    if name not in AGENTS:
        raise ConfigError(f"Unknown agent {name!r}; valid are {listing(AGENTS)}.{did_you_mean(name, AGENTS)}")
    import torch

    shape = (env.num_envs, env.num_actions)
    draw = torch.Generator().manual_seed(int(getattr(env, "seed", 0) or 0))
    if name == "zero":
        return lambda obs: torch.ones(shape)
    if name == "random":
        return lambda obs: ACTION_LOW + (ACTION_HIGH - ACTION_LOW) * torch.rand(shape, generator=draw)
    # One second a cycle, each actuator with a phase of its own: enough for most bodies to get somewhere.
    phase = 2 * torch.pi * torch.rand(shape, generator=draw)
    steps = iter(range(2**62))

    def sine(obs: Any) -> Any:
        middle, swing = (ACTION_LOW + ACTION_HIGH) / 2, (ACTION_HIGH - ACTION_LOW) / 2
        return middle + swing * torch.sin(2 * torch.pi * FRAME_SECONDS * next(steps) + phase)

    return sine


# ------------------------------------------------------------------------------------------------------ files


def _scene_to_json(scene: Scene) -> dict[str, Any]:
    return {
        "width": scene.width,
        "height": scene.height,
        "objects": [
            {
                "name": obj.name,
                "x": obj.x,
                "y": obj.y,
                "grid": obj.grid.tolist(),
                "first_point": obj.first_point,
                "num_points": obj.num_points,
                "corners": obj.corners.tolist(),
            }
            for obj in scene.objects
        ],
    }


def _scene_from_json(scene: Mapping[str, Any]) -> Scene:
    objects = tuple(
        SceneObject(
            name=str(obj["name"]),
            grid=np.array(obj["grid"], np.int8),
            x=int(obj["x"]),
            y=int(obj["y"]),
            first_point=int(obj["first_point"]),
            num_points=int(obj["num_points"]),
            corners=np.array(obj["corners"], np.int32).reshape(-1, 4),
        )
        for obj in scene["objects"]
    )
    return Scene(int(scene["width"]), int(scene["height"]), objects)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file."""
    if not path.is_file():
        raise RolloutError(f"There is no rollout at {path}: no such file.")
    if not zipfile.is_zipfile(path):
        raise RolloutError(
            f"{path} is truncated or no rollout: expected a .npz file that warpvox has written."
        )
    try:
        with np.load(path, allow_pickle=False) as archive:
            if "header" not in archive.files:
                raise RolloutError(f"{path} is no rollout: it is an archive without a header of warpvox.")
            header = json.loads(archive["header"].tobytes().decode())
            _check_version(path, header)
            arrays = {name: archive[name] for name in ARRAYS}
    except RolloutError:
        raise
    except KeyError as error:
        raise RolloutError(f"{path} is damaged: {error.args[0]}.") from None
    except (
        OSError,
        ValueError,
        EOFError,
        MemoryError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise RolloutError(
            f"{path} is damaged or no rollout: {str(error) or type(error).__name__}."
        ) from None
    for name, dtype in ARRAYS.items():
        if arrays[name].dtype != dtype:
            raise RolloutError(
                f"{path} is damaged: {name} is {arrays[name].dtype}, expected {np.dtype(dtype)}."
            )
    return header, arrays


def _check_version(path: Path, header: Any) -> None:
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise RolloutError(f"{path} is no rollout: its header is not one of {FORMAT}.")
    version = header.get("version")
    if not isinstance(version, int) or version < 1:
        raise RolloutError(f"{path} is damaged: version {version!r} does not exist.")
    if version > VERSION:
        raise RolloutError(
            f"{path} has version {version} of the format; this warpvox reads up to {VERSION}. Update warpvox."
        )


def _check_shapes(rollout: Rollout) -> None:
    shape = rollout.positions.shape
    if len(shape) != 4 or shape[0] < 1 or shape[1] < 1 or shape[3] != 2:
        raise RolloutError(
            f"positions must be [frames, envs, points, 2] with a frame or more, got {list(shape)}."
        )
    frames, envs = shape[:2]
    expected = {
        "design_index": (envs,),
        "actions": (frames - 1, envs, rollout.actions.shape[-1] if rollout.actions.ndim else 0),
        "rewards": (frames - 1, envs),
        "terminated": (frames - 1, envs),
        "truncated": (frames - 1, envs),
    }
    for name, want in expected.items():
        got = getattr(rollout, name).shape
        if got != want:
            raise RolloutError(
                f"{name} must have the shape {list(want)} to fit positions {list(shape)}, got {list(got)}."
            )
    for name in ("positions", "actions", "rewards"):
        if not np.isfinite(getattr(rollout, name)).all():
            raise RolloutError(f"{name} must be finite numbers.")
    index, count = rollout.design_index, len(rollout.scenes)
    if index.min() < 0 or index.max() >= count:
        raise RolloutError(f"design_index must lie in 0 to {count - 1}, got {index.min()} to {index.max()}.")


def _check_scene(scene: Scene, number: int, points: int) -> None:
    if not scene.moving:
        raise RolloutError(f"Scene {number} has nothing that moves.")
    for obj in scene.objects:
        what = f"The object '{obj.name}' of scene {number}"
        if obj.grid.ndim != 2 or not np.isin(obj.grid, [int(cell) for cell in Cell]).all():
            raise RolloutError(f"{what} has a grid that is not made of cells.")
        if obj.x < 0 or obj.y < 0 or obj.x + obj.grid.shape[1] > scene.width:
            raise RolloutError(f"{what} sticks out of its world.")
        if obj.y + obj.grid.shape[0] > scene.height:
            raise RolloutError(f"{what} sticks out of its world.")
        if obj.is_static:
            continue
        first, end = obj.first_point, obj.first_point + obj.num_points
        if first < 0 or obj.num_points < 0 or end > points:
            raise RolloutError(f"{what} has points {first} to {end - 1}, but there are {points}.")
        if obj.corners.shape != (len(obj.cells), 4) or obj.corners.min() < first or obj.corners.max() >= end:
            raise RolloutError(f"{what} has corners that are not its points.")
