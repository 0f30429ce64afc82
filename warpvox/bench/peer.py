"""``warpvox bench suite=peer``: ours and the reference in turns, on the same body, task and kind of actions."""

from __future__ import annotations

import time
from typing import Any

import gymnasium
import numpy as np

from warpvox.bench.bodies import one_body
from warpvox.bench.check import STEPS, against_reference, against_scalar
from warpvox.bench.reference import Reference, open_reference
from warpvox.bench.report import Report, middle, number, spread
from warpvox.bench.step import HEADINGS, unit
from warpvox.bench.subject import Subject, measure
from warpvox.envs.gym import register
from warpvox.envs.registry import released_id
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["run"]


def run(config: Any, report: Report) -> dict[str, Any]:
    """A batch, one environment of gymnasium, and the reference.

    Raises:
        ConfigError: no reference. SimulationError: ours and the reference differ.
    """
    body = one_body(config)
    with open_reference(config, report) as reference:
        with report.status("checking the physics"):
            reference.start(config.task, body)
            error = against_reference(config, config.task, body, reference)
            subject = Subject(config, config.task, body, config.num_envs)
            against_scalar(subject.env, config.seed)
        report.note(f"Checked: within {error:.1e} of the reference over {STEPS} steps in float64.")
        with report.status("measuring"):
            subject.settle()
            theirs = _Theirs(config, reference, subject.env.num_actions)
            alone, drop_in = _alone(config, body), _drop_in(config, body)
            turns = (alone, drop_in, theirs)
            rates = measure(subject, config.columns, config.repeats, lambda: [one.measure() for one in turns])
    base = middle(theirs.rates)
    rows = {
        f"warpvox, {config.num_envs} environments": rates,
        "warpvox, one gymnasium environment": {"step": alone.rates},
        "warpvox, one environment of the drop-in": {"step": drop_in.rates},
        reference.name: {"step": theirs.rates},
    }
    _show(config, report, rows, base)
    report.plot("peer", lambda figure: _draw(figure, config, rows))
    return {
        "task": config.task,
        "check_error": error,
        "steps": subject.steps,
        "rates": rates,
        "gymnasium": alone.rates,
        "drop_in": drop_in.rates,
        "reference": theirs.rates,
        "versions": reference.versions,
        "ratio": {column: middle(values) / base for column, values in rates.items() if values},
        "ratio_gymnasium": middle(alone.rates) / base,
        "ratio_drop_in": middle(drop_in.rates) / base,
    }


def _alone(config: Any, body: np.ndarray) -> _Alone:
    """One environment of gymnasium."""
    register()
    return _Alone(config, f"warpvox/{config.task}", body=body, device=config.device)


def _drop_in(config: Any, body: np.ndarray) -> _Alone:
    """One environment as scripts that were written for EvoGym make it."""
    import warpvox.evogym.envs  # noqa: F401  (registers)

    return _Alone(config, released_id(config.task), body=body.astype(float))


class _Alone:
    """One environment of ours through gymnasium."""

    def __init__(self, config: Any, name: str, **options: Any) -> None:
        self._env = gymnasium.make(name, **options, disable_env_checker=True)
        self._rng, self._steps, self.rates = np.random.default_rng(config.seed), config.steps, []
        self._env.reset()
        self._env.step(self._env.action_space.sample())

    def measure(self) -> None:
        actions = self._rng.uniform(ACTION_LOW, ACTION_HIGH, (self._steps, *self._env.action_space.shape))
        seconds, began = 0.0, time.process_time()
        for action in actions:
            _, _, terminated, truncated, _ = self._env.step(action)
            if terminated or truncated:  # as with the reference, resets are not counted
                seconds += time.process_time() - began
                self._env.reset()
                began = time.process_time()
        self.rates.append(self._steps / (seconds + time.process_time() - began))


class _Theirs:
    """The reference, in its own process."""

    def __init__(self, config: Any, reference: Reference, actuators: int) -> None:
        self._reference, self._shape = reference, (config.steps, actuators)
        self._rng, self.rates = np.random.default_rng(config.seed), []

    def measure(self) -> None:
        self.rates.append(self._reference.rate(self._rng.uniform(ACTION_LOW, ACTION_HIGH, self._shape)))


def _show(config: Any, report: Report, rows: dict[str, dict], base: float) -> None:
    shown = []
    for name, rates in rows.items():
        best = rates.get("step") or next(iter(rates.values()))
        cells = [spread(rates.get(column, [])) for column in config.columns]
        shown.append([name, *cells, number(middle(best) / base)])
    report.table(
        f"{config.task}, control steps per {unit(config.device)}: median (least to most)",
        ["", *(HEADINGS[column] for column in config.columns), "ratio"],
        shown,
    )
    if config.device == "cpu":
        report.note("Rates are per second of CPU time, that is of one core; the ratio is that of the medians.")


def _draw(figure: Any, config: Any, rows: dict[str, dict]) -> None:
    axes = figure.subplots()
    bars = [
        (f"{name}\n{HEADINGS[column]}", middle(values))
        for name, rates in rows.items()
        for column, values in rates.items()
        if values
    ]
    axes.barh([label for label, _ in bars], [value for _, value in bars])
    axes.bar_label(axes.containers[0], [number(value) for _, value in bars], padding=3)
    axes.set(xscale="log", xlabel=f"control steps per {unit(config.device)}", title=config.task)
    axes.invert_yaxis()
    axes.margins(x=0.2)
