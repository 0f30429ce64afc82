"""Designs trained one after another, each by the runner of a single policy: what the batch of many must equal."""

import math
from collections.abc import Sequence
from typing import Any

from warpvox.algos.candidate import Candidate, Outcome, candidate_seed
from warpvox.algos.checkpoints.files import spec_dict
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.evaluate import EpisodeReturns, evaluator
from warpvox.algos.generators import Generators
from warpvox.algos.settings import DesignTraining
from warpvox.algos.training.runner import Runner, Schedule, adapt


def outcomes_one_by_one(
    factory: EnvFactory, settings: DesignTraining, seed: int, candidates: Sequence[Candidate]
) -> list[Outcome]:
    """The outcomes of the candidates of an experiment with ``seed``."""
    return [_train(factory, settings, seed, candidate) for candidate in candidates]


def _train(factory: EnvFactory, settings: DesignTraining, seed: int, candidate: Candidate) -> Outcome:
    own_seed = candidate_seed(seed, candidate.id)
    outcome = Outcome(-math.inf)
    env = adapt(factory.make([candidate.body], settings.envs, [own_seed], auto_reset=True), settings.ppo)
    judged = factory.make([candidate.body], factory.episodes(settings.eval_envs), [own_seed], auto_reset=False)
    judge = evaluator(judged, [seed], factory.fitness)

    def evaluate(policy: Any) -> EpisodeReturns:
        result = judge(policy)
        value = float(result.fitness[0])
        outcome.curve.append((runner.steps, value))
        if value > outcome.fitness:
            outcome.fitness = value
            outcome.spec = spec_dict(policy.spec)
            state = runner.alg.actor.state_dict()
            outcome.policy = {name: tensor.detach().clone() for name, tensor in state.items()}
        return result

    schedule = Schedule(settings.iterations, evaluate=settings.eval_interval)
    runner = Runner(env, settings.ppo, schedule, evaluator=evaluate, generators=Generators(own_seed))
    runner.run()
    outcome.steps = runner.steps
    return outcome
