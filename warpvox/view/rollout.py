"""Rollouts: recorded positions, actions and rewards of environments, in memory and in one file.

Pictures, USD and the page of the browser player are all made from a :class:`Rollout`, so that an episode is
simulated once and can be looked at anywhere later.

``docs/formats.md`` describes the file: its arrays with their shapes and units, and the header with ``metadata``.
"""

from __future__ import annotations

import html
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.checks import check_choice, check_integer, is_integer
from warpvox.devices.startup import ambient
from warpvox.errors import ActionError, ConfigError, RolloutError, counted
from warpvox.io.reading import ArrayFile, Missing, Unreadable, parse_json
from warpvox.io.writing import atomic_path, check_suffix
from warpvox.types import ACTION_CENTER, ACTION_HIGH, ACTION_LOW, ACTION_SCALE, FRAME_SECONDS, VOXEL
from warpvox.view.scene import Scene, check_scene, scene_from_json, scene_of, scene_to_json, stretch

_FORMAT, _VERSION = "warpvox-rollout", 1
LARGEST = 1 << 32
"""Maximum size of a rollout file's arrays in bytes (4 GiB)."""
LARGEST_HEADER = 1 << 26
"""Maximum size of a rollout file's header in bytes (64 MiB)."""
AGENTS = ("zero", "random", "sine")
"""Agents without training: all actuators at rest, uniformly random actions, or sine waves."""
_ARRAYS = {
    "positions": np.float32,
    "design_index": np.int32,
    "actions": np.float32,
    "rewards": np.float64,
    "terminated": np.bool_,
    "truncated": np.bool_,
}


@dataclass(eq=False)
class Rollout:
    """Recorded episodes of environments: arrays, metadata, and the distinct worlds as ``scenes``.

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
        """Convert the arrays to their file types; RolloutError if parts do not fit together."""
        for name, dtype in _ARRAYS.items():
            setattr(self, name, np.ascontiguousarray(getattr(self, name), dtype=dtype))
        self.scenes = tuple(self.scenes)
        _check_shapes(self)
        for number, scene in enumerate(self.scenes):
            check_scene(scene, number, self.positions.shape[2])

    def __repr__(self) -> str:
        low = f"{self.returns[-1].min():.3f}"
        high = f"{self.returns[-1].max():.3f}"
        returns = f"return {low}" if low == high else f"returns {low} to {high}"
        size = f"{counted(self.num_envs, 'environments')}, {counted(self.num_steps, 'steps')}"
        return f"Rollout({self.title}, {size}, {returns})"

    def _repr_html_(self) -> str:
        """Build the browser player for notebooks; shows the first 16 of many environments."""
        from warpvox.view.player import page_of

        page = html.escape(page_of(self, range(min(self.num_envs, 16))))
        return f'<iframe srcdoc="{page}" width="100%" height="420" style="border:0"></iframe>'

    @property
    def num_frames(self) -> int:
        """Number of recorded states: one more than control steps."""
        return self.positions.shape[0]

    @property
    def num_steps(self) -> int:
        """Number of recorded control steps."""
        return self.positions.shape[0] - 1

    @property
    def num_envs(self) -> int:
        """Number of recorded environments."""
        return self.positions.shape[1]

    @property
    def title(self) -> str:
        """Id of the task, or "rollout" if unknown."""
        return str(self.metadata.get("task") or "rollout")

    @property
    def done(self) -> np.ndarray:
        """Mask of steps in or after which the episode has ended, bool ``[T, E]``."""
        return self.terminated | self.truncated

    @property
    def lengths(self) -> np.ndarray:
        """Control steps up to the end of each episode or of the recording, int ``[E]``."""
        over = np.concatenate([self.done, np.ones((1, self.num_envs), bool)])
        return np.minimum(over.argmax(axis=0) + 1, self.num_steps)

    @cached_property
    def returns(self) -> np.ndarray:
        """Sum of the rewards up to each entry of ``positions``, float64 ``[T + 1, E]``."""
        return np.pad(self.rewards.cumsum(axis=0), ((1, 0), (0, 0)))

    @property
    def names(self) -> list[str]:
        """Names of the environments in pictures: ``metadata["names"]``, or their indices without these."""
        names: Any = self.metadata.get("names")
        known = isinstance(names, list) and len(names) == self.num_envs
        return [str(name) for name in (names if known else range(self.num_envs))]

    def best_first(self) -> Rollout:
        """Sort the environments by return, the highest first; each keeps its name."""
        order = np.argsort(-self.returns[-1], kind="stable")
        arrays = {}
        for name in _ARRAYS:
            axis = 0 if name == "design_index" else 1  # the axis of environments
            arrays[name] = getattr(self, name).take(order, axis=axis)
        names = [self.names[env] for env in order]
        return Rollout(scenes=self.scenes, metadata=self.metadata | {"names": names}, **arrays)

    def scene(self, env: int) -> Scene:
        """Return the scene of an environment."""
        return self.scenes[self.design_index[env]]

    def check_envs(self, envs: int | Iterable[int] | None) -> list[int]:
        """Return ``envs`` as a list of valid indices; None means all environments.

        Raises:
            RolloutError: there is no such environment, or none was chosen.
        """
        chosen = range(self.num_envs) if envs is None else list(envs) if isinstance(envs, Iterable) else [envs]
        for env in chosen:
            if not is_integer(env) or not 0 <= env < self.num_envs:
                raise RolloutError(f"No environment {env!r}: the rollout has {self.num_envs}, counted from 0.")
        if not chosen:
            raise RolloutError("No environment was chosen.")
        return [int(env) for env in chosen]

    def check_frame(self, frame: int) -> int:
        """Return a frame's index; negative numbers count from the end.

        Raises:
            RolloutError: there is no such frame.
        """
        count = self.num_frames
        if not is_integer(frame) or not -count <= frame < count:
            raise RolloutError(f"No frame {frame!r}: the rollout has {count}, 0 to {count - 1} (-1: the last).")
        return int(frame) % count

    def stretch(self, frame: int | slice, env: int) -> np.ndarray:
        """Return each cell's length along its axis of actuation, relative to rest length.

        Cells that are no actuators have the mean of both axes.

        Args:
            frame: an index, which gives float32 ``[cells]``, or a slice, which gives ``[frames, cells]``.
            env: environment; the cells are those of ``scene(env).cells``.
        """
        scene = self.scene(env)
        return stretch(scene.cells, self.positions[frame, env][..., scene.corners, :])

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the rollout to ``path`` (``.npz``) atomically; return the path.

        Raises:
            RolloutError: another suffix than .npz, metadata that JSON cannot hold, or more than a file may have
                (4 GiB).
        """
        check_suffix("The file of a rollout", path, (".npz",), RolloutError)
        header = {
            "format": _FORMAT,
            "version": _VERSION,
            "units": {"voxel": VOXEL, "dt": FRAME_SECONDS},
            "metadata": self.metadata,
            "scenes": [scene_to_json(scene) for scene in self.scenes],
        }
        try:
            text = json.dumps(header, allow_nan=False, ensure_ascii=False).encode()  # no halves of characters
            parse_json(text.decode())  # the names 1 and "1" would be one
        except (TypeError, ValueError, RecursionError) as error:
            raise RolloutError(f"The rollout's metadata must consist of JSON values: {error}.") from None
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        total = len(text) + sum(array.nbytes for array in arrays.values())
        for what, size, limit in (("header", len(text), LARGEST_HEADER), ("arrays", total, LARGEST)):
            if size > limit - 4096:  # shapes and types of arrays need room, too
                raise RolloutError(f"The rollout's {what} would have {size:,} bytes, and {limit:,} are the limit.")
        with atomic_path(path, follow=True) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, header=np.frombuffer(text, np.uint8), **arrays)
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Rollout:
        """Read a rollout written by :meth:`save`.

        Raises:
            RolloutError: no such file, a file that is truncated, damaged or no rollout, or a newer version.
        """
        header, arrays = _read(Path(path))
        try:
            scenes = tuple(scene_from_json(scene) for scene in header["scenes"])
            return cls(scenes=scenes, metadata=dict(header["metadata"]), **arrays)
        except RolloutError as error:
            raise RolloutError(f"{path} is damaged: {error}") from None
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            reason = f"'{error.args[0]}' is missing" if isinstance(error, KeyError) else error
            raise RolloutError(f"{path} is damaged: its header does not describe scenes ({reason}).") from None


def record(
    env: Any,
    policy: str | Callable[[Any], Any] = "sine",
    num_steps: int | None = None,
    *,
    metadata: Mapping[str, Any] | None = None,
) -> Rollout:
    """Record one episode in every environment; ``policy`` is a function of observations or one of :data:`AGENTS`.

    Arguments are those of :func:`warpvox.record`.
    """
    import torch

    if not hasattr(env, "sim") or not hasattr(env, "max_episode_steps"):
        inner = getattr(env, "unwrapped", env)
        hint = " Here it is env.unwrapped.vec." if hasattr(inner, "vec") and hasattr(inner, "num_envs") else ""
        raise ConfigError(f"record needs what warpvox.make_vec makes, got {type(env).__name__}.{hint}")
    if num_steps is not None:
        check_integer("num_steps (or None)", num_steps, 1)
    if not isinstance(metadata, Mapping | None):
        raise ConfigError(f"metadata must be JSON values by name, got {metadata!r:.80}.")
    act = agent_of(policy, env) if isinstance(policy, str) else policy
    if not callable(act):
        raise ConfigError(f"policy must be a function of observations or the name of an agent, got {policy!r:.80}.")
    if hasattr(act, "in_float64"):
        act = act.in_float64()
    scenes, gather = scenes_of(env.sim)
    limit = env.max_episode_steps if num_steps is None else min(int(num_steps), env.max_episode_steps)
    resets_itself = env.auto_reset
    env.auto_reset = False
    try:
        if hasattr(act, "reset"):  # it remembers episodes
            act.reset()
        with ambient(), torch.no_grad():
            columns = _run(env, act, limit, gather)
    finally:
        env.auto_reset = resets_itself
        if resets_itself:
            env.reset()
    about = facts_of(env) | {"agent": policy if isinstance(policy, str) else "policy"} | dict(metadata or {})
    return Rollout(design_index=env.sim.design_index.cpu().numpy(), scenes=scenes, metadata=about, **columns)


def facts_of(env: Any) -> dict[str, Any]:
    """Collect task, rules, physics and seed of environments for a rollout's metadata."""
    return {
        "task": getattr(getattr(env, "spec", None), "id", None),
        "rules": getattr(env, "rules", None),
        "physics": env.sim.physics.label,
        "seed": _plain_seed(getattr(env, "seed", None)),
        "dtype": env.sim.options.dtype,
        "arithmetic": env.sim.arithmetic,
    }


def _run(env: Any, act: Callable[[Any], Any], limit: int, gather: Callable[[], Any]) -> dict[str, np.ndarray]:
    """Step until all episodes have ended; return stacked positions, actions, rewards and ends, steps first."""
    import torch

    obs, _ = env.reset()
    seen: dict[str, list] = {name: [] for name in ("actions", "rewards", "terminated", "truncated")}
    positions = [gather().cpu().numpy()]
    for _ in range(limit):
        given = act(obs)
        try:
            actions = torch.as_tensor(given)
        except Exception:  # `as_tensor` may raise anything for what is no array
            raise ActionError(f"A policy must give actions, got {type(given).__name__} {given!r:.60}.") from None
        obs, reward, terminated, truncated, _ = env.step(actions)
        row = (actions.clamp(ACTION_LOW, ACTION_HIGH), reward, terminated, truncated)
        for name, value in zip(seen, row, strict=True):
            seen[name].append(value.cpu().numpy())
        positions.append(gather().cpu().numpy())
        if bool((terminated | truncated).all()):
            break
    return {"positions": np.stack(positions), **{name: np.stack(rows) for name, rows in seen.items()}}


def scenes_of(sim: Any) -> tuple[tuple[Scene, ...], Callable[[], Any]]:
    """Return a scene for each distinct world of a simulation, and a function that returns all points.

    The points are float32 ``[E, P, 2]``, a tensor on the simulation's device, which nothing waits for.
    """
    import torch

    scenes = tuple(scene_of(design) for design in sim.designs)
    names = [name for name in sim.object_names if any(o.name == name for scene in scenes for o in scene.moving)]
    # The simulation gives every object the room of its widest design; here the points of an environment are contiguous.
    starts = dict(zip(names, np.cumsum([0, *(sim.num_points(name) for name in names)]).tolist(), strict=False))
    table = np.full((len(scenes), max(scene.num_points for scene in scenes)), -1)
    for row, scene in zip(table, scenes, strict=True):
        for obj in scene.moving:
            row[obj.first_point : obj.first_point + obj.num_points] = starts[obj.name] + np.arange(obj.num_points)
    index = torch.from_numpy(table).to(sim.device)[sim.design_index][:, :, None].expand(-1, -1, 2)

    def points() -> Any:
        every = torch.cat([sim.object_positions(name) for name in names], dim=1)
        return torch.gather(every, 1, index.clamp(min=0)).masked_fill(index < 0, 0.0).to(torch.float32)

    return scenes, points


def agent_of(name: str, env: Any) -> Callable[[Any], Any]:
    """Return one of :data:`AGENTS` as a policy for ``env``; ConfigError: unknown agent."""
    import torch

    check_choice("agent", name, AGENTS)
    draw = _make_generator(env)
    if name == "zero":
        return lambda obs: torch.ones((env.num_envs, env.num_actions))
    if name == "random":
        return lambda obs: ACTION_LOW + (ACTION_HIGH - ACTION_LOW) * draw()
    # A sine of one second for each actuator, with a random phase: most bodies move with it.
    phase = 2 * torch.pi * draw()
    steps = count()
    return lambda obs: ACTION_CENTER + ACTION_SCALE * torch.sin(2 * torch.pi * FRAME_SECONDS * next(steps) + phase)


def _make_generator(env: Any) -> Callable[[], Any]:
    """Return a random number generator for ``env``: a function that returns ``[num_envs, num_actions]`` in [0, 1).

    With several seeds, each for an equal block of environments, a block draws as if it were alone.
    """
    import torch

    seed = _plain_seed(getattr(env, "seed", None))
    if not isinstance(seed, list):
        generator = torch.Generator().manual_seed((seed or 0) % 2**64)
        return lambda: torch.rand((env.num_envs, env.num_actions), generator=generator)
    generators = [torch.Generator().manual_seed(one % 2**64) for one in seed]
    block = env.num_envs // len(seed)
    widths = env.action_mask.sum(1)[env.design_index].view(-1, block).amax(1).tolist()

    def draw() -> Any:
        values = torch.zeros((env.num_envs, env.num_actions))
        for begin, generator, width in zip(range(0, env.num_envs, block), generators, widths, strict=True):
            values[begin : begin + block, :width] = torch.rand((block, width), generator=generator)
        return values

    return draw


def _plain_seed(seed: Any) -> int | list[int] | None:
    """Convert a seed, or a list of seeds, to Python integers; None stays None."""
    if isinstance(seed, Sequence | np.ndarray):
        return [int(one) for one in seed]
    return None if seed is None else int(seed)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read header and arrays of a rollout file; RolloutError: another kind of file, or a damaged one."""
    try:
        with ArrayFile(path, LARGEST) as archive:
            if "header" not in archive.names:
                raise RolloutError(f"{path} is no rollout: it is an archive without a header of warpvox.")
            text = archive.read("header", LARGEST_HEADER)
            if text.dtype != np.uint8:
                raise RolloutError(f"{path} is damaged: its header is {text.dtype}, expected uint8.")
            header = parse_json(text.tobytes().decode())
            if not isinstance(header, dict) or header.get("format") != _FORMAT:
                raise RolloutError(f"{path} is no rollout: its header is not one of {_FORMAT}.")
            version = header.get("version")
            if not isinstance(version, int) or version < 1:
                raise RolloutError(f"{path} is damaged: version {version!r} does not exist.")
            if version > _VERSION:
                raise RolloutError(
                    f"{path} has version {version}; this warpvox reads up to {_VERSION}. Update warpvox."
                )
            arrays = {name: archive.read(name) for name in _ARRAYS}
    except Missing:
        raise RolloutError(f"There is no rollout at {path}: no such file.") from None
    except UnicodeDecodeError:
        raise RolloutError(f"{path} is damaged: its header is no text.") from None
    except Unreadable as error:
        raise RolloutError(f"{path} is truncated, damaged or no rollout that warpvox has written: {error}.") from None
    for name, dtype in _ARRAYS.items():
        if arrays[name].dtype != dtype:
            raise RolloutError(f"{path} is damaged: {name} is {arrays[name].dtype}, expected {np.dtype(dtype)}.")
    return header, arrays


def _check_shapes(rollout: Rollout) -> None:
    """Raise RolloutError unless a rollout's arrays have matching shapes and finite values."""
    shape = rollout.positions.shape
    if len(shape) != 4 or shape[0] < 1 or shape[1] < 1 or shape[3] != 2:
        raise RolloutError(f"positions must be [frames, envs, points, 2] with a frame or more, got {list(shape)}.")
    steps = shape[0] - 1
    envs = shape[1]
    expected = dict.fromkeys(("rewards", "terminated", "truncated"), (steps, envs))
    expected |= {"design_index": (envs,), "actions": (steps, envs, *rollout.actions.shape[-1:])}
    for name, want in expected.items():
        got = getattr(rollout, name).shape
        if got != want:
            raise RolloutError(
                f"{name} must have the shape {list(want)} to fit positions {list(shape)}, got {list(got)}."
            )
    for name in ("positions", "actions", "rewards"):
        if not np.isfinite(getattr(rollout, name)).all():
            raise RolloutError(f"{name} must be finite numbers.")
    index = rollout.design_index
    count = len(rollout.scenes)
    if index.min() < 0 or index.max() >= count:
        raise RolloutError(f"design_index must lie in 0 to {count - 1}, got {index.min()} to {index.max()}.")
