"""Settings of training by name, for programs; the command line composes them with Hydra."""

from __future__ import annotations

import dataclasses
from importlib.resources import files
from typing import Any

import yaml

from warpvox.algos.settings import PpoConfig, TrainingConfig
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
    values = yaml.safe_load((folder / f"{name}.yaml").read_text(encoding="utf-8"))
    inner = values.pop("ppo")
    for schema, given in ((TrainingConfig, changes), (PpoConfig, ppo or {})):
        known = [item.name for item in dataclasses.fields(schema)]
        for key in given:
            if key not in known:
                raise ConfigError(f"Training has no setting {key!r}.{did_you_mean(key, known)}")
    return TrainingConfig(**(values | changes), ppo=PpoConfig(**(inner | (ppo or {}))))
