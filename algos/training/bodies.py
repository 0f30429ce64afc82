"""Bodies that a policy is trained over, and how others take their place while it is trained."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from warpvox.design import Design, sample_design
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.errors import ConfigError

__all__ = ["Bodies", "draw_bodies"]

RECENT = 0.3
"""Weight of an episode's return in the mean return of its body."""


def draw_bodies(
    count: int, shape: tuple[int, int], rng: np.random.Generator, without: Sequence[Design] = ()
) -> list[Design]:
    """Different random bodies, none of ``without``; one that lies elsewhere in the grid is not different.

    Raises:
        ConfigError: there are not so many different ones of this shape to be found.
    """
    found: list[Design] = []
    _draw(found, count, shape, rng, {_digest(body) for body in without})
    if len(found) < count:
        raise ConfigError(f"There are no {count} different bodies of {shape[0]}x{shape[1]} to be found; ask for fewer.")
    return found


def _draw(found: list[Design], count: int, shape: tuple[int, int], rng: np.random.Generator, seen: set[int]) -> None:
    """Add random bodies that are not ``seen`` to ``found`` until it has ``count``, or no more are to be found."""
    for _ in range(100 * count + 1000):
        if len(found) == count:
            return
        body = sample_design(shape, rng)
        digest = _digest(body)
        if digest not in seen:
            seen.add(digest)
            found.append(body)


def _digest(body: Design) -> int:
    """64 bits that are the same for bodies that differ by their place in the grid alone."""
    rows, columns = (np.flatnonzero(body.any(axis)) for axis in (1, 0))
    cells = np.ascontiguousarray(body[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], np.int8)
    text = bytes(cells.shape) + cells.tobytes()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little", signed=True)


class Bodies:
    """Gives another body to environments whose episode has ended.

    Bodies are exchanged between two rollouts, so that no rollout holds a jump from one body to another; an episode
    that has begun in the meantime is discarded.

    Args:
        bodies: of the training.
        refresh: of :data:`warpvox.algos.settings.REFRESH`. ``new``: random bodies that were never there, until there
            are no others; ``random``: any of ``bodies``; ``performance``: any of ``bodies``, those on which the mean
            return is one deviation lower e times as often, and first of all those that have had no episode yet;
            ``none``: bodies stay.
        rng: draws bodies.
        without: bodies that ``new`` does not draw.
    """

    def __init__(
        self, bodies: Sequence[Design], refresh: str, rng: np.random.Generator, without: Sequence[Design] = ()
    ) -> None:
        self.bodies, self.refresh, self.without = list(bodies), refresh, list(without)
        self._rng = rng
        self._returns = np.full(len(self.bodies), np.nan)
        self._seen = 0
        self._digests = {_digest(body) for body in [*self.bodies, *self.without]}
        self._which = np.zeros(0, np.int64)
        self.shape = tuple(max(body.shape[axis] for body in self.bodies) for axis in (0, 1))

    def first(self, num_envs: int) -> list[Design]:
        """The body of each environment at the beginning."""
        order = np.arange(num_envs) % len(self.bodies)
        if len(self.bodies) > num_envs:
            order = self._rng.choice(len(self.bodies), num_envs, replace=False)
        self._which, self._seen = np.sort(order), len(np.unique(order))
        return [self.bodies[k] for k in self._which]

    @property
    def seen(self) -> int:
        """Bodies that environments were given so far, those that came again included."""
        return self._seen

    def record(self, ended: torch.Tensor, returns: torch.Tensor) -> None:
        """Record the returns ``[num_envs]`` of whole episodes that have ended (bool)."""
        for env in ended.nonzero()[:, 0].tolist():
            body, value = self._which[env], float(returns[env])
            if body >= 0:
                old = self._returns[body]
                self._returns[body] = value if np.isnan(old) else old + RECENT * (value - old)

    def exchange(self, env: RslRlVecEnv, ended: torch.Tensor) -> None:
        """Give environments ``ended`` (bool) other bodies."""
        count = int(ended.sum())
        if self.refresh == "none" or not count:
            return
        if self.refresh == "new":
            bodies, which = self._new(count), np.full(count, -1)
        else:
            which = self._rng.choice(len(self.bodies), count, p=self._shares())
            bodies = [self.bodies[k] for k in which]
        self._which[ended.cpu().numpy()] = which
        self._seen += count
        env.set_designs(bodies, ended)

    def _new(self, count: int) -> list[Design]:
        """Random bodies that were not there, as long as there are any; then they come again."""
        found: list[Design] = []
        _draw(found, count, self.shape, self._rng, self._digests)
        while len(found) < count:
            before, self._digests = len(found), {_digest(body) for body in self.without}
            _draw(found, count, self.shape, self._rng, self._digests)
            if len(found) == before:
                raise ConfigError("designs.refresh=new: there are no bodies of this shape beside those held out.")
        return found

    def _shares(self) -> np.ndarray | None:
        """How often each body is drawn; None: equally often."""
        if self.refresh != "performance":
            return None
        fresh = np.isnan(self._returns)
        if fresh.any():
            return fresh / fresh.sum()
        low = np.exp(-(self._returns - self._returns.mean()) / (self._returns.std() + 1e-8))
        return low / low.sum()

    def state(self, env: RslRlVecEnv) -> dict[str, Any]:
        """Bodies of the environments, returns and random numbers: what :meth:`set_state` takes back."""
        inner = env.env
        grids = np.zeros((env.num_envs, *self.shape), np.int8)
        for number, design in enumerate(inner.design_index.tolist()):
            body = inner.designs[design]
            grids[number, : body.shape[0], : body.shape[1]] = body
        shapes = [list(inner.designs[design].shape) for design in inner.design_index.tolist()]
        return {
            "grids": torch.from_numpy(grids),
            "shapes": shapes,
            "which": torch.from_numpy(self._which.copy()),
            "returns": torch.from_numpy(self._returns.copy()),
            "seen": self._seen,
            "digests": torch.tensor(sorted(self._digests)),
            "random": json.dumps(self._rng.bit_generator.state),
        }

    def set_state(self, state: dict[str, Any], env: RslRlVecEnv) -> None:
        """Go on from :meth:`state`; the environments get their bodies back, their own state is to follow."""
        pairs = zip(state["grids"].cpu().numpy(), state["shapes"], strict=True)
        bodies = [grid[:rows, :columns] for grid, (rows, columns) in pairs]
        env.set_designs(bodies, torch.ones(env.num_envs, dtype=torch.bool, device=env.device))
        self._which, self._seen = state["which"].cpu().numpy().copy(), state["seen"]
        self._returns = state["returns"].cpu().numpy().copy()
        self._digests |= set(state["digests"].tolist()) if "digests" in state else set()
        self._rng.bit_generator.state = json.loads(state["random"])
