"""Settings of training by name, for programs; the command line composes them with Hydra."""

from __future__ import annotations

from typing import Any

from omegaconf import OmegaConf

from warpvox.algos.settings import TrainingConfig
from warpvox.configs.composition import composed, hydras_errors, quoted

__all__ = ["training_preset"]


def training_preset(name: str, ppo: dict[str, Any] | None = None, **changes: Any) -> TrainingConfig:
    """The settings ``training=<name>`` of a design search, with other values of ``training.*`` and ``training.ppo.*``.

    Raises:
        ConfigError: no such preset or key.
    """
    with hydras_errors():
        preset = composed("codesign", [f"training={quoted(name)}"]).training
        return OmegaConf.to_object(OmegaConf.merge(preset, {**changes, "ppo": ppo or {}}))
