"""Evaluation of designs without any learning: each is tried with poses and travelling waves of actuation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from warpvox.algos.candidate import Candidate, Outcome, Parent, candidate_seed
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.evaluate import evaluate
from warpvox.design import Design
from warpvox.devices.out_of_memory import enough_memory
from warpvox.envs.rsl_rl import ACTION_CENTER
from warpvox.types import Cell

__all__ = ["WaveEvaluator", "Waves", "draw_waves"]

AMPLITUDE = 0.5
"""Of the actions, about :data:`ACTION_CENTER`: from the shortest to the longest."""
PERIODS = (5.0, 40.0)
"""Control steps."""
MOST_TURN = 1.6
"""Radians from a voxel to the next: waves of four voxels and longer."""
GAINS = (1.0, 4.5)
"""From a sine to nearly a square wave."""


POSES = ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0))
"""Horizontal and vertical actuators at their longest (1) or shortest (-1): what tasks of shape and balance ask for."""


class Waves(NamedTuple):
    """``count`` ways to move without feedback, all float64 ``[count]``: the four :data:`POSES`, then travelling waves.

    The action of an actuator at (x, y), voxels from the mean of the body's, in control step t is
    ``1.1 + 0.5 * clip(gain * sin(2 pi t / period + turn_x x + turn_y y + lead v) + rest, -1, 1)``. For horizontal
    actuators v is 0 and rest ``rest_x``, for vertical ones v is 1 and rest ``rest_y``. Waves rest at 0, poses have no
    gain.
    """

    period: np.ndarray
    turn_x: np.ndarray
    turn_y: np.ndarray
    lead: np.ndarray
    gain: np.ndarray
    rest_x: np.ndarray
    rest_y: np.ndarray


def draw_waves(count: int, seed: int) -> Waves:
    """Poses and random waves; the first of them are the same for any ``count``."""
    rng = np.random.default_rng(seed)
    low = np.array([np.log(PERIODS[0]), -MOST_TURN, -MOST_TURN, 0.0, np.log(GAINS[0])])
    high = np.array([np.log(PERIODS[1]), MOST_TURN, MOST_TURN, 2 * np.pi, np.log(GAINS[1])])
    period, turn_x, turn_y, lead, gain = rng.uniform(low, high, (count, 5)).T
    period, gain, rests = np.exp(period), np.exp(gain), np.zeros((2, count))
    held = min(count, len(POSES))
    gain[:held], rests[:, :held] = 0.0, np.transpose(POSES[:held])
    return Waves(period, turn_x, turn_y, lead, gain, *rests)


def phases(body: Design, waves: Waves) -> tuple[np.ndarray, np.ndarray]:
    """``[waves, actuators]``: where in its period each actuator begins, in radians, and what it rests at."""
    rows, columns = np.nonzero(body)
    at = np.argwhere(body >= Cell.H_ACT)  # row by row, the order of actions
    x, y = at[:, 1] - columns.mean(), rows.mean() - at[:, 0]
    vertical = body[tuple(at.T)] == Cell.V_ACT
    phase = waves.turn_x[:, None] * x + waves.turn_y[:, None] * y + waves.lead[:, None] * vertical
    return phase, np.where(vertical, waves.rest_y[:, None], waves.rest_x[:, None])


@dataclass(frozen=True)
class WaveEvaluator:
    """The fitness of a design is the best return among some poses and travelling waves, the same for all designs.

    No policy is kept: designs are compared by what their bodies make of simple gaits. It takes ``count`` episodes for a
    design, where a training of 512,000 control steps has a thousand.

    Attributes:
        factory: makes environments.
        count: poses and waves that each design is tried with.
        seed: of the experiment.
    """

    factory: EnvFactory
    count: int
    seed: int = 0

    def evaluate(
        self,
        candidates: Sequence[Candidate],
        parents: Mapping[int, Parent],
        report: Callable[[dict[str, Any]], None] | None = None,
        checkpoint: Path | None = None,
    ) -> list[Outcome]:
        """See :class:`warpvox.algos.candidate.DesignEvaluator`; it takes seconds, and keeps no checkpoint.

        Raises:
            DeviceError: memory has run out.
        """
        if not candidates:
            return []
        bodies = [candidate.body for candidate in candidates]
        seeds = [candidate_seed(self.seed, candidate.id) for candidate in candidates]
        hint = f"Take less at once: screening.waves is {self.count} for each of {len(candidates)} designs (batch)."
        if report is not None:
            report(_progress(0, 0, [math.nan] * len(bodies)))
        with enough_memory(hint):
            env = self.factory.make(bodies, self.count, seeds, auto_reset=False)
            result = evaluate(env, self._controller(bodies, env.num_actions, env.device), seed=seeds)
        returns = result.returns.view(len(bodies), self.count).max(1).values.tolist()
        steps = result.lengths.view(len(bodies), self.count).sum(1).tolist()
        if report is not None:
            report(_progress(1, sum(steps), returns))
        return [Outcome(value, [(spent, value)], spent) for value, spent in zip(returns, steps, strict=True)]

    def _controller(self, bodies: Sequence[Design], num_actions: int, device: str) -> Callable:
        """Actions of all environments, those of a design one after another, by the number of calls."""
        waves = draw_waves(self.count, self.seed)
        begin, rest = np.zeros((2, len(bodies), self.count, num_actions))
        for place, body in enumerate(bodies):
            found = phases(body, waves)
            begin[place, :, : found[0].shape[1]], rest[place, :, : found[0].shape[1]] = found
        phase, rest, turn, gain = (
            torch.as_tensor(values, device=device)
            for values in (
                begin.reshape(-1, num_actions),
                rest.reshape(-1, num_actions),
                np.tile(2 * np.pi / waves.period, len(bodies))[:, None],
                np.tile(waves.gain, len(bodies))[:, None],
            )
        )
        step = 0

        def act(obs: torch.Tensor) -> torch.Tensor:
            nonlocal step
            actions = ACTION_CENTER + AMPLITUDE * (gain * torch.sin(phase + step * turn) + rest).clamp(-1, 1)
            step += 1
            return actions.to(obs.dtype)

        return act


def _progress(iteration: int, steps: int, best: list[float]) -> dict[str, Any]:
    return {
        "iteration": iteration,
        "iterations": 1,
        "steps": steps,
        "best": best,
        "training": [not iteration] * len(best),
    }
