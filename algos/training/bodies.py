"""Bodies of a training: loading, random sampling, and exchange during training."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warpvox.algos.expected import AnyTensor, check_like
from warpvox.algos.settings import REFRESH
from warpvox.algos.training.settings import Training
from warpvox.batch.options import lanes_for
from warpvox.design import DESIGN_SUFFIXES, Design, design_paths, load_design, sample_design
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.errors import ConfigError, DesignError, RunError
from warpvox.keys import plain
from warpvox.runs import CONFIG

RANDOM = re.compile(r"random:(\d+)(?::(\d+)x(\d+))?")
SHAPE = (5, 5)
"""Default rows and columns of random bodies."""
HELD_OUT_SEED = 1_000_003
"""Seed of random held-out bodies, the same for all trainings."""
HELD_OUT = 32
"""Default number of random held-out bodies."""
MOST = 1_000_000


def load_bodies(spec: Any, seed: int) -> list[Design | dict[str, Design]]:
    """Load the bodies given by the key ``design``: one, or a list of names, files or bodies.

    A mapping ``{robot name: body}`` is a design for a task with several robots.
    """
    spec = plain(spec, "design")
    if isinstance(spec, dict):
        return [{name: load_design(body, seed=seed + number) for number, (name, body) in enumerate(spec.items())}]
    if isinstance(spec, str):
        return [load_design(spec, seed=seed)]
    if not isinstance(spec, list) or not spec:
        raise DesignError(f"design must be a name, a file or rows of cells such as [[3,3],[4,4]]; got {spec!r}.")
    if all(isinstance(item, dict) for item in spec):
        return [body for number, item in enumerate(spec) for body in load_bodies(item, seed + number)]
    several = all(isinstance(one, str) or (isinstance(one, list) and one and isinstance(one[0], list)) for one in spec)
    bodies = spec if several else [spec]
    return [load_design(body, seed=seed + number) for number, body in enumerate(bodies)]


def read_bodies(spec: Any, seed: int, key: str, without: Sequence[Design] = ()) -> list[Design]:
    """Load or sample the bodies given by the key named ``key``.

    Args:
        spec: ``random:64`` or ``random:64:5x7`` (drawn with ``seed``), a folder of designs, the folder of a design
            search (all its bodies, the best first), or whatever the key ``design`` takes.
    """
    if isinstance(spec, str):
        found = RANDOM.fullmatch(spec.strip())
        if found is not None:
            count = int(found[1])
            shape = (int(found[2]), int(found[3])) if found[2] else SHAPE
            if not 1 <= count <= MOST:
                raise ConfigError(f"{key} can be 1 to {MOST:,} random bodies, got {count:,}.")
            return draw_bodies(count, shape, np.random.default_rng(seed), without)
        if spec.startswith("random:") and spec.count(":") > 1:
            raise ConfigError(f"{key}: random bodies are random:64 or random:64:5x7, got {spec!r:.80}.")
        folder = Path(spec).expanduser()
        if folder.is_dir():
            return _bodies_in(folder, key)
    loaded = load_bodies(spec, seed)
    bodies = [body for body in loaded if not isinstance(body, dict)]
    if len(bodies) < len(loaded):
        raise ConfigError(f"{key} are bodies of one robot; for several robots use design.")
    return bodies


def _bodies_in(folder: Path, key: str) -> list[Design]:
    """Load the bodies in ``folder``: of a design search (best first), of a run, or all design files."""
    from warpvox.algos.archive import FILE, Archive

    if (folder / FILE).is_file():
        with Archive.read(folder / FILE) as archive:
            best = [record.candidate.body for record in archive.best(MOST)]
        if not best:
            raise DesignError(f"{key}: the search in {folder} has evaluated no body yet.")
        return best
    if (folder / CONFIG).is_file():
        return [load_design(folder)]
    paths = design_paths(folder)
    if not paths:
        suffixes = ", ".join(DESIGN_SUFFIXES)
        raise DesignError(
            f"{key}: {folder} is neither a design search nor a folder of designs ({suffixes}, folders with body.npy)."
        )
    return [load_design(path) for path in paths]


def has_designs(folder: Path) -> bool:
    """Return True if ``folder`` contains design files and is not a run's folder."""
    return bool(design_paths(folder)) and not (folder / CONFIG).is_file()


@dataclass(frozen=True)
class TrainingBodies:
    """Bodies of one training: to train on, and to evaluate on.

    Attributes:
        trained: bodies that the policy is trained on.
        judged: bodies that the policy is evaluated on.
        grid: rows and columns that there is room for, where one policy is trained on many bodies; else None.
        own: True if a policy for many bodies is evaluated on its training bodies, because the user has named them.
    """

    trained: list[Any]
    judged: list[Any]
    grid: tuple[int, int] | None = None
    own: bool = False

    def lanes(self, settings: Training, device: str) -> int | None:
        """Return the lane width of the training, so that evaluations reuse its kernels; None: not on the CPU."""
        return lanes_of(settings, len(self.trained)) if device == "cpu" else None


def lanes_of(settings: Training, bodies: int) -> int | None:
    """Return the lane width for training on ``bodies`` bodies on the CPU; None: let the environments choose."""
    if settings.lanes is not None or settings.is_many:
        return settings.lanes
    return lanes_for(settings.num_envs // bodies)


def training_bodies(settings: Training) -> TrainingBodies:
    """Load the bodies to train on and to evaluate on from the settings."""
    designs = settings.designs
    seed = settings.seed
    if designs.bodies is None:
        bodies = load_bodies(settings.design, seed)
        return TrainingBodies(bodies, bodies)
    trained = judged = read_bodies(designs.bodies, seed, "designs")
    shape = _shape(trained)
    drawn = designs.refresh == "new" or (isinstance(designs.bodies, str) and designs.bodies.startswith("random:"))
    own = designs.held_out is None and not drawn
    if not own:
        spec = f"random:{HELD_OUT}:{shape[0]}x{shape[1]}" if designs.held_out is None else designs.held_out
        judged = read_bodies(spec, HELD_OUT_SEED, "designs.held_out")
        trained = read_bodies(designs.bodies, seed, "designs", without=judged)
    largest = _shape([*trained, *judged])
    rows, columns = designs.grid or largest
    if largest[0] > rows or largest[1] > columns:
        raise DesignError(f"There are bodies of {largest[0]}x{largest[1]}, and designs.grid is {rows}x{columns}.")
    return TrainingBodies(trained, judged, (rows, columns), own)


def _shape(bodies: Sequence[Design]) -> tuple[int, int]:
    """Return the largest row count and the largest column count among ``bodies``."""
    return max(body.shape[0] for body in bodies), max(body.shape[1] for body in bodies)


def draw_bodies(
    count: int, shape: tuple[int, int], rng: np.random.Generator, without: Sequence[Design] = ()
) -> list[Design]:
    """Sample ``count`` distinct random bodies, excluding those in ``without``.

    Bodies that differ only by their position in the grid count as equal.

    Raises:
        ConfigError: fewer than ``count`` were found.
    """
    found: list[Design] = []
    _append_random(found, count, shape, rng, {_digest(body) for body in without})
    if len(found) < count:
        raise ConfigError(f"There are no {count} different bodies of {shape[0]}x{shape[1]} to be found; ask for fewer.")
    return found


def _append_random(
    found: list[Design], count: int, shape: tuple[int, int], rng: np.random.Generator, seen: set[int]
) -> None:
    """Append new random bodies to ``found`` until it has ``count``, or sampling finds no more."""
    for _ in range(100 * count + 1000):
        if len(found) == count:
            return
        body = sample_design(shape, rng)
        digest = _digest(body)
        if digest not in seen:
            seen.add(digest)
            found.append(body)


def _digest(body: Design) -> int:
    """Return a 64-bit hash of a body, independent of its position in the grid."""
    rows, columns = (np.flatnonzero(body.any(axis)) for axis in (1, 0))
    cells = np.ascontiguousarray(body[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], np.int8)
    text = bytes(cells.shape) + cells.tobytes()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little", signed=True)


class Bodies:
    """Exchanges the bodies of environments when their episodes end.

    Bodies are exchanged between two rollouts, so that no rollout holds a jump from one body to another; an episode
    that has begun in the meantime is discarded.

    Args:
        refresh: one of :data:`warpvox.algos.settings.REFRESH`. ``new``: random bodies that were not used yet, as long
            as there are any; ``random``: any of ``bodies``; ``performance``: any of ``bodies``, first those without an
            episode, then a body whose mean return is one standard deviation lower is e times as likely; ``none``:
            environments keep their bodies.
        without: bodies that ``new`` does not draw.
    """

    def __init__(
        self, bodies: Sequence[Design], refresh: str, rng: np.random.Generator, without: Sequence[Design] = ()
    ) -> None:
        self.bodies = list(bodies)
        self.refresh = refresh
        self.without = list(without)
        self._rng = rng
        self._returns = np.full(len(self.bodies), np.nan)
        self.seen = 0  # number of bodies given to environments so far, repeats included
        self._digests = {_digest(body) for body in [*self.bodies, *self.without]}
        self._which = np.zeros(0, np.int64)  # index of each environment's body in `bodies`; -1: a new one
        self.shape = _shape(self.bodies)

    @classmethod
    def of(cls, bodies: TrainingBodies, settings: Training, seed: int) -> Bodies:
        """Create the exchange of a training; ``seed`` differs between processes."""
        count = len(bodies.trained)
        refresh = settings.designs.refresh
        if refresh not in REFRESH[:2] and count < 2:
            raise ConfigError(f"designs.refresh={refresh} chooses among bodies, and there is only one.")
        if refresh == "none" and count > settings.num_envs:
            raise ConfigError(
                f"{count} bodies need as many environments, or others take their place while the policy learns:"
                f" num_envs={count}, or designs.refresh=random."
            )
        return cls(bodies.trained, refresh, np.random.default_rng([seed, 1]), bodies.judged)

    def first(self, num_envs: int) -> list[Design]:
        """Choose each environment's first body, at random if there are more bodies than environments."""
        which = np.arange(num_envs) % len(self.bodies)
        if len(self.bodies) > num_envs:
            which = self._rng.choice(len(self.bodies), num_envs, replace=False)
        self._which = np.sort(which)
        self.seen = len(np.unique(which))
        return [self.bodies[body] for body in self._which]

    def record(self, ended: torch.Tensor, returns: torch.Tensor) -> None:
        """Update the running mean returns of bodies from ``returns`` ``[num_envs]`` where ``ended`` (bool) is True."""
        for env in ended.nonzero()[:, 0].tolist():
            body = self._which[env]
            value = float(returns[env])
            if body >= 0:
                old = self._returns[body]
                # A running mean, in which the newest episode has a weight of 0.3
                self._returns[body] = value if np.isnan(old) else old + 0.3 * (value - old)

    def exchange(self, env: RslRlVecEnv, ended: torch.Tensor) -> None:
        """Give environments in the mask ``ended`` (bool ``[num_envs]``) other bodies, according to ``refresh``."""
        count = int(ended.sum())
        if self.refresh == "none" or not count:
            return
        if self.refresh == "new":
            bodies = self._draw_new(count)
            which = np.full(count, -1)
        else:
            which = self._rng.choice(len(self.bodies), count, p=self._probabilities())
            bodies = [self.bodies[body] for body in which]
        self._which[ended.cpu().numpy()] = which
        self.seen += count
        env.set_designs(bodies, ended)

    def _draw_new(self, count: int) -> list[Design]:
        """Sample ``count`` unused random bodies; if there are none left, used ones repeat."""
        found: list[Design] = []
        _append_random(found, count, self.shape, self._rng, self._digests)
        while len(found) < count:
            before = len(found)
            self._digests = {_digest(body) for body in self.without}
            _append_random(found, count, self.shape, self._rng, self._digests)
            if len(found) == before:
                raise ConfigError("designs.refresh=new: there are no bodies of this shape beside those held out.")
        return found

    def _probabilities(self) -> np.ndarray | None:
        """Return the sampling probability of each body, ``[bodies]``; None: uniform."""
        if self.refresh != "performance":
            return None
        fresh = np.isnan(self._returns)
        if fresh.any():
            return fresh / fresh.sum()
        low = np.exp(-(self._returns - self._returns.mean()) / (self._returns.std() + 1e-8))
        return low / low.sum()

    def state(self, env: RslRlVecEnv) -> dict[str, Any]:
        """Return bodies, mean returns and random state, for :meth:`set_state`."""
        bodies = [env.env.designs[design] for design in env.env.design_index.tolist()]
        grids = np.zeros((env.num_envs, *self.shape), np.int8)
        shapes = [list(body.shape) for body in bodies]
        for grid, body in zip(grids, bodies, strict=True):
            grid[: body.shape[0], : body.shape[1]] = body
        arrays = {"grids": grids, "which": self._which.copy(), "returns": self._returns.copy()}
        return {name: torch.from_numpy(array) for name, array in arrays.items()} | {
            "shapes": shapes,
            "seen": self.seen,
            "digests": torch.tensor(sorted(self._digests)),
            "random": json.dumps(self._rng.bit_generator.state),
        }

    def set_state(self, state: dict[str, Any], env: RslRlVecEnv) -> None:
        """Restore a :meth:`state` and put its bodies into ``env``, without the simulation's state.

        Raises:
            RunError: the state is of other bodies or environments. DesignError: a body in it is not valid.
        """
        like = self.state(env) | {"seen": int, "random": str}
        like["returns"] = AnyTensor(torch.float64, (len(self.bodies),), is_finite=False)
        like["digests"] = AnyTensor(torch.int64, (None,))
        like["shapes"] = [[int, int]] * env.num_envs
        check_like(state, like, "bodies")
        which = state["which"]
        sizes = torch.tensor(state["shapes"])
        if not bool(((which >= -1) & (which < len(self.bodies))).all()):
            raise RunError(f"Its bodies.which has numbers that are none of {len(self.bodies)} bodies.")
        if not bool(((sizes >= 1) & (sizes <= torch.tensor(self.shape))).all()):
            raise RunError(f"Its bodies.shapes are not within {self.shape[0]}x{self.shape[1]}.")
        pairs = zip(state["grids"].cpu().numpy(), state["shapes"], strict=True)
        bodies = [grid[:rows, :columns] for grid, (rows, columns) in pairs]
        env.set_designs(bodies, torch.ones(env.num_envs, dtype=torch.bool, device=env.device))
        self._which = state["which"].cpu().numpy().copy()
        self.seen = state["seen"]
        self._returns = state["returns"].cpu().numpy().copy()
        self._digests = set(state["digests"].tolist())
        self._rng.bit_generator.state = json.loads(state["random"])
