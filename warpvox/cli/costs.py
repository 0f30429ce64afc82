"""Control steps that the designs of a search take, by its configuration."""

from __future__ import annotations

import math

from warpvox.algos.settings import TrainingConfig
from warpvox.cli.evaluations import episodes_of, has_common_policy, is_screened
from warpvox.configs.schema import CodesignConfig
from warpvox.envs.spec import TaskSpec

__all__ = ["costs_of", "steps_of_design"]


def costs_of(member: CodesignConfig, task: TaskSpec) -> tuple[float, float]:
    """Control steps that a design takes at most, and those of all finalists; for few_shot and shared about as many."""
    training, how, count = member.training, member.screening, member.finalists
    if not is_screened(member):
        return steps_of_design(training, member.search.population), 0
    if has_common_policy(member):
        each = (how.ppo or {}).get("steps", training.ppo.steps) * how.iterations * how.envs
        return each + how.eval_envs * task.max_episode_steps, count * steps_of_design(training, count)
    of_gait = episodes_of(member.task) * task.max_episode_steps
    first = how.passes * how.beam + how.rounds * how.gaits
    last = how.final_passes * how.final_beam + how.final_rounds * how.gaits_of_finalist
    return first * of_gait, count * (last * of_gait + steps_of_design(training, count))


def steps_of_design(training: TrainingConfig, population: int) -> float:
    """Control steps of training that a design takes, the mean of a generation where successive halving stops some."""
    ends = sorted({max(1, round(share * training.iterations)) for share in training.rungs} - {training.iterations})
    left, before, iterations = population, 0, 0
    for end in [*ends, training.iterations]:
        iterations += left * (end - before)
        left, before = math.ceil(training.keep * left), end
    return iterations * training.envs * training.ppo.steps / population
