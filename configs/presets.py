"""Settings of training by name, for programs; the command line composes them with Hydra."""

from __future__ import annotations

import dataclasses
from importlib.resources import files
from typing import Any

from omegaconf import OmegaConf

from warpvox.algos.settings import TrainingConfig
from warpvox.configs.composition import composed
from warpvox.errors import ConfigError, did_you_mean, listing

__all__ = ["training_preset"]


def training_preset(name: str, ppo: dict[str, Any] | None = None, **changes: Any) -> TrainingConfig:
    """The settings ``training=<name>`` of a design search, with other values of ``training.*`` and ``training.ppo.*``.

    Raises:
        ConfigError: no such preset or key.
    """
    folder = files("warpvox.configs") / "training"
    names = sorted(item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml"))
    if name not in names:
        raise ConfigError(f"training must be one of {listing(names)}; got {name!r}.{did_you_mean(name, names)}")
    preset = OmegaConf.to_object(composed("codesign", [f"training={name}"]).training)
    for settings, given in ((preset, changes), (preset.ppo, ppo or {})):
        for key in given:
            if key not in vars(settings):
                raise ConfigError(f"Training has no setting {key!r}.{did_you_mean(key, vars(settings))}")
    return dataclasses.replace(preset, **changes, ppo=dataclasses.replace(preset.ppo, **ppo or {}))
