"""Grouping of runs that differ only in their seed, with a label for each group."""

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
    """Group runs whose settings differ only in the seed, in the order given.

    A label says what differs between the groups, of a single one the task.
    """
    # Groups
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(json.dumps(settings(run), sort_keys=True, default=str), []).append(run)

    # Labels
    groups = [settings(several[0]) for several in found.values()]
    keys = differing(groups)
    if keys:
        groups = [_with_presets(values, keys) for values in groups]
        shown = telling(groups, differing(groups))
        labels = [_label(values, shown) for values in groups]
    else:
        labels = [str(values.get("task", "run")) for values in groups]
    if len(set(labels)) < len(labels):  # the first few settings do not distinguish them
        labels = [f"{label} #{number + 1}" for number, label in enumerate(labels)]
    return [Group(label, tuple(several)) for label, several in zip(labels, found.values(), strict=True)]


def settings(run: Run) -> dict[str, Any]:
    """Return a run's settings by dotted key, without seed, folders and other keys that do not affect results.

    They include the named checkpoint, because several checkpoints of one run are not repetitions.
    """
    flat: dict[str, Any] = flat_values("train", run.config) | {"checkpoint": run.checkpoint and run.checkpoint.name}
    if isinstance(flat.get("device"), str):
        flat["device"] = flat["device"].partition(":")[0]  # which of several GPUs makes no difference
    # Keys that do not distinguish experiments; the settings of a preset are in the other keys.
    left_out = (
        "seed", "name", "output_dir", "resume", "config", "export", "threads", "torch_threads", "lanes",
        "save_interval", "nan_guard", "logger", "memory_check", "preset",
    )  # fmt: skip
    return {name: value for name, value in flat.items() if name not in left_out}


def _with_presets(values: dict[str, Any], keys: list[str]) -> dict[str, Any]:
    """Replace settings that come from a preset by the name of the preset."""
    result = dict(values)

    # Name the physics preset instead of its constants.
    if "physics.preset" in keys:
        result = {key: value for key, value in result.items() if not key.startswith("physics.")}
        if values.get("physics.preset") != values.get("rules"):
            result["physics"] = values.get("physics.preset")

    # Name the file of configs/ppo that has these settings; otherwise keep the single settings.
    if sum(key.startswith("ppo.") for key in keys) > SHOWN:
        own = {key.removeprefix("ppo."): value for key, value in values.items() if key.startswith("ppo.")}
        for name in ("parallel", "evogym"):
            if vars(load("train", [f"ppo={name}"]).ppo) == own:
                others = {key: value for key, value in result.items() if not key.startswith("ppo.")}
                return {"ppo": name} | others
    return result


def _label(values: dict[str, Any], keys: list[str]) -> str:
    """Build a label from the first few settings that distinguish a group from the others."""
    parts = []
    for key in [key for key in keys if key in values][:SHOWN]:  # a robot of the zoo has only some of the keys
        value = values[key]
        if key == "task":
            parts.append(str(value))
            continue
        text = _design(value) if key == "design" else as_typed(value)
        if len(text) > 28:
            text = f"{text[:25]}..."
        parts.append(f"{key}={text}")
    return ", ".join(parts) + (", ..." if len(keys) > SHOWN else "")


def _design(body: Any) -> str:
    """Return the name of an example body, or the size and a short hash of any other body."""
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
