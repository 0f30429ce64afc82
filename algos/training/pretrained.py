"""The key ``pretrained``: start a training or a design search from a trained policy."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpvox.algos.find import find_run
from warpvox.algos.training.settings import Training
from warpvox.code import load_code
from warpvox.errors import ConfigError, RunError
from warpvox.runs import CONFIG, TRAINING, ZOO

if TYPE_CHECKING:
    from warpvox.algos.checkpoints.files import PolicySpec

OBS_OF_VOXELS = {"task": "voxel", "timed": "timed_voxel"}
"""Voxel observations for each value of ``obs``."""


def find_pretrained(source: str, output_dir: str) -> tuple[Path, dict[str, Any]]:
    """Find the checkpoint named by ``source`` and its run's configuration; empty for a single file."""
    path = Path(source).expanduser()
    if path.is_file() and not (path.parent / CONFIG).is_file():
        return path, {}
    if source.startswith(ZOO):
        raise ConfigError(f"pretrained={source}: robots of the zoo are stored without what it takes to learn on.")
    run = find_run(source, output_dir, TRAINING)
    return run.find_checkpoint("best"), run.config


def check_learned(path: Path, content: Mapping[str, Any], network: str | None) -> PolicySpec:
    """Validate a whole checkpoint for further training, and return the policy's specification."""
    from warpvox.algos.checkpoints.files import checked_weights
    from warpvox.algos.checkpoints.policy import policy_of

    spec = policy_of(content, path, network).spec
    if "critic_state_dict" not in content or "optimizer_state_dict" not in content:
        raise ConfigError(f"{path} holds no value function to learn with: take a checkpoint of a training.")
    try:
        checked_weights(content["critic_state_dict"])
    except ValueError as error:
        raise RunError(f"{path} holds a value function of another kind ({error}).") from None
    return spec


def observed_by(spec: Mapping[str, Any] | None) -> str:
    """Return the key ``obs`` of a voxel policy: ``voxel`` or ``timed_voxel``."""
    voxels = (spec or {}).get("voxels") or {}
    return "timed_voxel" if voxels.get("layout", {}).get("timed") else "voxel"


def is_on_grid(layout: Mapping[str, Any]) -> bool:
    """Return whether a voxel policy has an action for every cell of its grid, so that it can control any body."""
    return layout["actions"] == layout["rows"] * layout["columns"]


def adopted(config: Training, pretrained: str, named: Collection[str]) -> tuple[Training, dict[str, Any]]:
    """Change ``config`` to start from the policy ``pretrained``; return it with the checkpoint's content.

    Network and observations are those of the policy. One that sees voxels keeps its grid, which other bodies
    lie in.

    Args:
        named: keys that the user has given, which must agree with the policy.
    """
    from warpvox.algos.checkpoints.files import RNN, load_checkpoint
    from warpvox.algos.policies.registry import NETWORKS

    path, run = find_pretrained(pretrained, config.output_dir)
    content = load_checkpoint(path)
    spec = check_learned(path, content, config.policy)
    ppo = {"action_scale": spec.action_scale, "normalize_obs": spec.normalize_obs}
    changes: dict[str, Any] = {"policy": "mlp", "network": None}
    if "obs" in run:
        changes["obs"] = run["obs"]
    usual: dict[str, Any] = {"ppo.rnn": RNN, "network": {}}
    if spec.voxels is None:
        ppo |= {"hidden": list(spec.hidden), "activation": spec.activation, "rnn": spec.rnn}
    else:
        name = spec.voxels["network"]
        settings = dict(spec.voxels["settings"])
        changes |= {"policy": name, "network": settings or None, "obs": observed_by(content["policy"])}
        taken = inspect.signature(NETWORKS.get(name) or load_code(name)).parameters.values()
        usual["network"] = {one.name: one.default for one in taken if one.default is not one.empty}
        layout = spec.voxels["layout"]
        if is_on_grid(layout):
            changes["designs"] = _designs_on_grid(config, layout)
    known = changes | {f"ppo.{key}": value for key, value in ppo.items()}
    known["network"] = usual["network"] | (known["network"] or {})
    for key in [key for key in known if key in named and key != "designs"]:
        given: Any = getattr(config.ppo, key[4:]) if key.startswith("ppo.") else getattr(config, key)
        given = {} if key == "network" and given is None else given
        given = {**usual[key], **given} if isinstance(given, Mapping) else given
        if given != known[key] and (key != "obs" or OBS_OF_VOXELS.get(given) != known[key]):
            raise ConfigError(f"{key}={given} is not that of the policy in {path}: {key}={known[key]}.")
    changes |= {"ppo": dataclasses.replace(config.ppo, **ppo), "pretrained": str(path.absolute())}
    return dataclasses.replace(config, **changes), content


def _designs_on_grid(config: Training, layout: dict[str, Any]) -> Any:
    """Return ``designs`` with the policy's grid; without bodies, use the body of ``config``."""
    from warpvox.algos.training.bodies import load_bodies  # and torch with it, for which mistakes in keys do not wait

    designs = config.designs
    grid = [layout["rows"], layout["columns"]]
    if designs.bodies is None:
        loaded = load_bodies(config.design, config.seed)
        bodies = [body.tolist() for body in loaded if not isinstance(body, dict)]
        if len(bodies) < len(loaded):
            raise ConfigError("A policy that sees voxels controls one robot; this design has several.")
        designs = dataclasses.replace(designs, bodies=bodies)
    if designs.grid not in (None, grid):
        raise ConfigError(f"designs.grid={designs.grid}: the grid of the pretrained policy is {grid}.")
    return dataclasses.replace(designs, grid=grid)
