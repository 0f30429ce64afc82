"""Named sets of settings from the YAML files of this package, for Python."""

from __future__ import annotations

from typing import Any, cast

from omegaconf import OmegaConf

from warpvox.algos.settings import DesignTraining
from warpvox.configs.composition import composed, hydras_errors, quoted


def training_preset(name: str, ppo: dict[str, Any] | None = None, **changes: Any) -> DesignTraining:
    """The settings ``training=<name>`` of a design search, with other ``training.*`` and ``training.ppo.*``."""
    with hydras_errors():
        preset = composed("codesign", [f"training={quoted(name)}"]).training
        return cast(Any, OmegaConf.to_object)(OmegaConf.merge(preset, {**changes, "ppo": ppo or {}}))


def ppo_preset(name: str) -> dict[str, Any]:
    """The settings of a training that ``ppo=<name>`` sets, by name: ``ppo``, and what goes with it."""
    with hydras_errors():
        words = [], [f"ppo={quoted(name)}"]
        usual, named = (vars(OmegaConf.to_object(composed("train", one))) for one in words)
    return {key: value for key, value in named.items() if value != usual[key]}
