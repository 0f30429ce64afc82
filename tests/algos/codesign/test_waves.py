"""Designs compared by travelling waves: the formula, and that no design depends on its company."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from population_cases import LIMIT, candidates, factory

from warpvox.algos.candidate import candidate_seed
from warpvox.algos.codesign.waves import WaveEvaluator, draw_waves
from warpvox.types import Cell

COUNT = 8


def test_fitness_is_that_of_the_best_wave() -> None:
    (candidate,) = candidates(1)
    env = factory().make([candidate.body], COUNT, [candidate_seed(0, 0)], auto_reset=False)
    env.reset()
    waves = draw_waves(COUNT, 0)
    cells = [(row, column) for row, column in np.ndindex(3, 3) if candidate.body[row, column]]
    x0, y0 = np.mean([column for _, column in cells]), np.mean([-row for row, _ in cells])
    returns, over = np.zeros(COUNT), np.zeros(COUNT, bool)
    for step in range(env.max_episode_steps):
        actions = np.ones((COUNT, env.num_actions), np.float32)
        for k, (period, turn_x, turn_y, lead, gain, *rest) in enumerate(zip(*waves, strict=True)):
            driving = [cell for cell in cells if candidate.body[cell] in (Cell.H_ACT, Cell.V_ACT)]
            for action, (row, column) in enumerate(driving):
                phase = 2 * math.pi * step / period + turn_x * (column - x0) + turn_y * (-row - y0)
                vertical = int(candidate.body[row, column] == Cell.V_ACT)
                value = gain * math.sin(phase + lead * vertical) + rest[vertical]
                actions[k, action] = 1.1 + 0.5 * min(1.0, max(-1.0, value))
        _, rewards, terminated, truncated, _ = env.step(torch.as_tensor(actions))
        returns += np.where(over, 0.0, rewards.numpy())
        over |= (terminated | truncated).numpy()
    (outcome,) = WaveEvaluator(factory(), COUNT).evaluate([candidate], {})
    assert outcome.fitness == pytest.approx(returns.max(), abs=1e-5)
    assert returns.max() > np.median(returns)
    assert (outcome.steps, outcome.policy) == (COUNT * env.max_episode_steps, None)


def test_a_design_does_not_depend_on_its_company() -> None:
    found, evaluator = candidates(3), WaveEvaluator(factory(), COUNT, seed=1)
    told = []
    together = [outcome.fitness for outcome in evaluator.evaluate(found, {}, told.append)]
    assert together == [evaluator.evaluate([candidate], {})[0].fitness for candidate in found]
    assert len(set(together)) == 3
    assert [event["steps"] for event in told] == [0, 3 * COUNT * LIMIT]
    assert (told[1]["best"], told[1]["training"]) == (together, [False] * 3)
    other = dataclasses.replace(evaluator, seed=2).evaluate(found, {})
    assert [outcome.fitness for outcome in other] != together


def test_more_waves_are_more_of_the_same() -> None:
    few, many = draw_waves(4, 3), draw_waves(16, 3)
    for one, other in zip(few, many, strict=True):
        np.testing.assert_array_equal(one, other[:4])
    assert not np.array_equal(few.period, draw_waves(4, 4).period)
    poses = {(x, y) for x, y, gain in zip(many.rest_x, many.rest_y, many.gain, strict=True) if gain == 0}
    assert poses == {(1, 1), (-1, -1), (1, -1), (-1, 1)}
    assert many.period.min() >= 5
    assert many.period.max() <= 40
