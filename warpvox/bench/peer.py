"""``warpvox bench suite=peer``: ours and the reference alternately, on the same body, task and kind of actions."""

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium

from warpvox.bench.cases import one_body
from warpvox.bench.check import STEPS, against_reference
from warpvox.bench.reference import HOW_TO_GET_IT, open_reference, random_rate
from warpvox.bench.reference_worker import cpu_seconds
from warpvox.bench.report import Report, middle, spread
from warpvox.bench.runner import HEADINGS, Runner, measure, unit
from warpvox.envs.registry import released_id
from warpvox.errors import ConfigError


def run(config: Any, report: Report) -> None:
    """A batch, one environment of gymnasium, one of the drop-in, and the reference; ConfigError: there is none."""
    import warpvox.envs
    import warpvox.evogym.envs  # noqa: F401  (both register their environments)

    body, batch = one_body(config), f"warpvox, {config.num_envs} environments"
    with open_reference(config, report) as reference:
        if reference is None:
            raise ConfigError(f"The reference is missing: {HOW_TO_GET_IT}")
        with report.console.status("checking the physics"):
            error = against_reference(config, config.task, body, reference)
            runner = Runner(config, [body])
        report.note(f"Checked: within {error:.1e} of the reference over {STEPS} steps in float64.")
        with report.console.status("measuring"):
            one = {"id": f"warpvox/{config.task}", "body": body, "device": config.device}
            drop_in = {"id": released_id(config.task), "body": body.astype(float)}
            theirs = f"evogym {reference.versions['evogym']}, Python {reference.versions['python']}"
            others = {
                "warpvox, one gymnasium environment": _timer(config, one),
                "warpvox, one environment of the drop-in": _timer(config, drop_in),
                theirs: reference.timer(config.steps, runner.env.num_actions, config.seed),
            }
            found = measure({batch: runner}, config.columns, config.repeats, others)
    base, rows = middle(found[theirs]["step"]), []
    for name, rates in found.items():
        best = rates.get("step") or next(iter(rates.values()))
        rows.append([name, *(rates.get(column) for column in config.columns), middle(best) / base])
    title = f"{config.task}, control steps per {unit(config.device)}: median (least to most)"
    report.table(title, ["", *(HEADINGS[column] for column in config.columns), "ratio"], rows, spread)
    if config.device == "cpu":
        report.note("Rates are per second of CPU time, that is of one core; the ratio is that of the medians.")
    report.figures |= {"check_error": error, "steps": runner.steps, "versions": reference.versions}


def _timer(config: Any, words: dict[str, Any]) -> Callable[[], float]:
    """A function that measures the rate of one environment of gymnasium."""
    env = gymnasium.make(**words, disable_env_checker=True)
    env.reset()
    env.step(env.action_space.sample())
    return random_rate(partial(cpu_seconds, env), config.steps, env.action_space.sample().size, config.seed)
