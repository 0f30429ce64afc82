"""Runs that differ only in their seed, and labels that distinguish such groups."""

import hashlib
import json
from collections.abc import Sequence
from typing import Any

from warpvox.algos.report.learning_curves import Group
from warpvox.algos.report.members import SHOWN, differing, telling
from warpvox.cli.config import load
from warpvox.cli.help import as_typed, flat_values
from warpvox.design import example_design, example_designs
from warpvox.runs import Run


def group_runs(runs: Sequence[Run]) -> list[Group]:
    """Runs with the same settings together, in the order in which they are given."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(json.dumps(settings(run), sort_keys=True, default=str), []).append(run)
    kept = [settings(several[0]) for several in found.values()]
    labels = _labels(kept)
    return [Group(label, tuple(several)) for label, several in zip(labels, found.values(), strict=True)]


def settings(run: Run) -> dict[str, Any]:
    """Settings of a run by dotted keys, without those that only say where and how it was computed.

    Among them the checkpoint that was named, as several of one run are no repetitions.
    """
    flat: dict[str, Any] = flat_values("train", run.config) | {"checkpoint": run.checkpoint and run.checkpoint.name}
    if isinstance(flat.get("device"), str):
        flat["device"] = flat["device"].partition(":")[0]  # which of several GPUs makes no difference
    # These keys do not make a run another experiment; what a preset has set stands in the other keys.
    left_out = (
        "seed", "name", "output_dir", "resume", "config", "export", "threads", "torch_threads", "lanes",
        "save_interval", "nan_guard", "logger", "memory_check", "preset",
    )  # fmt: skip
    return {name: value for name, value in flat.items() if name not in left_out}


def _labels(groups: list[dict[str, Any]]) -> list[str]:
    """A label for each group of settings: what differs; of a single one the task."""
    keys = differing(groups)
    if not keys:
        return [str(values.get("task", "run")) for values in groups]
    named = [_presets(values, keys) for values in groups]
    short = differing(named)
    labels = [_label(values, telling(named, short)) for values in named]
    if len(set(labels)) < len(labels):  # the first few settings do not distinguish them
        labels = [f"{label} #{number + 1}" for number, label in enumerate(labels)]
    return labels


def _presets(values: dict[str, Any], keys: list[str]) -> dict[str, Any]:
    """Settings with the name of a preset in the place of what it has set."""
    result = dict(values)
    if "physics.preset" in keys:  # the constants follow from it
        result = {key: value for key, value in result.items() if not key.startswith("physics.")}
        if values.get("physics.preset") != values.get("rules"):
            result["physics"] = values.get("physics.preset")
    if sum(key.startswith("ppo.") for key in keys) > SHOWN:
        own = {key.removeprefix("ppo."): value for key, value in values.items() if key.startswith("ppo.")}
        # Sets of settings: names of configs/ppo
        name = next((name for name in ("parallel", "evogym") if vars(load("train", [f"ppo={name}"]).ppo) == own), None)
        if name is not None:
            result = {key: value for key, value in result.items() if not key.startswith("ppo.")}
            result = {"ppo": name} | result
    return result


def _label(values: dict[str, Any], keys: list[str]) -> str:
    parts = []
    for key in [key for key in keys if key in values][:SHOWN]:  # a robot of the zoo has but a few
        text = _design(values[key]) if key == "design" else as_typed(values[key])
        longest = 28
        text = text if len(text) <= longest else f"{text[: longest - 3]}..."
        parts.append(str(values[key]) if key == "task" else f"{key}={text}")
    return ", ".join(parts) + (", ..." if len(keys) > SHOWN else "")


def _design(body: Any) -> str:
    """The name of an example, or the size of a body and what distinguishes it from others of this size."""
    for name in example_designs():
        if example_design(name).tolist() == body:
            return name
    if isinstance(body, str):
        return body
    mark = hashlib.sha256(json.dumps(body, default=str).encode()).hexdigest()[:6]
    try:
        return f"{len(body)}x{len(body[0])} {mark}"
    except (TypeError, KeyError, IndexError):
        return f"several {mark}"
