"""The winner of a design search in episodes of fresh seeds, where its task draws anything at random.

During training each design is judged by few episodes, always the same, and the best of many is chosen by them: that
return is too good for what else the task may draw.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from warpvox.algos.statistics import Interval, mean_interval

__all__ = ["EPISODES", "SEED", "evaluate_winner", "fresh_text"]

EPISODES, SEED = 64, 1000
"""The seed is that of `warpvox evaluate`, which finds the same returns with ``episodes=64``."""


def evaluate_winner(folder: Path, config: Any) -> dict[str, Any]:
    """Mean return of a search's best design over episodes that its training never met; empty if nothing is random.

    Args:
        folder: of a design search that has a result.
        config: its resolved configuration.

    Returns:
        ``mean``, ``low`` and ``high`` (95 % interval, Student's t), ``episodes``, ``seed``.
    """
    from warpvox.algos.evaluate import evaluate
    from warpvox.algos.training.loading import Playing, load_run
    from warpvox.code import is_code
    from warpvox.envs.registry import get_task
    from warpvox.runs import find_run

    if not get_task(config.task).under(config.rules).is_random:
        return {}
    named = {name: value for name in ("task", "policy") if is_code(value := getattr(config, name, None))}
    device = config.device if config.executor == "local" else "cpu"
    seed = SEED + (config.seed == SEED)  # which the search has compared its designs by
    play = Playing(num_envs=EPISODES, seed=seed, device=device, threads=config.threads, **named)
    env, policy = load_run(find_run(str(folder), config.output_dir), play)
    found = mean_interval(evaluate(env, policy).returns.tolist())
    return {"mean": found.mean, "low": found.low, "high": found.high, "episodes": EPISODES, "seed": seed}


def fresh_text(facts: Mapping[str, Any]) -> str:
    """What :func:`evaluate_winner` has found, in words."""
    found = Interval(facts["mean"], facts["low"], facts["high"], facts["episodes"])
    return f"{found} in {facts['episodes']} episodes"
