"""Settings of training by name, for programs; the command line composes them with Hydra."""

from __future__ import annotations

import dataclasses
from importlib.resources import files
from typing import Any

import yaml

from warpvox.algos.settings import DesignTraining, Ppo
from warpvox.errors import ConfigError, did_you_mean, listing

__all__ = ["ppo_preset", "training_preset"]


def training_preset(name: str, ppo: dict[str, Any] | None = None, **changes: Any) -> DesignTraining:
    """The settings ``training=<name>`` of a design search, with other values of ``training.*`` and ``training.ppo.*``.

    Raises:
        ConfigError: no such preset or key.
    """
    from omegaconf import OmegaConf

    from warpvox.configs.composition import composed

    _check("training", name)
    preset = OmegaConf.to_object(composed("codesign", [f"training={name}"]).training)
    for settings, given in ((preset, changes), (preset.ppo, ppo or {})):
        for key in given:
            if key not in vars(settings):
                raise ConfigError(f"Training has no setting {key!r}.{did_you_mean(key, vars(settings))}")
    return dataclasses.replace(preset, **changes, ppo=dataclasses.replace(preset.ppo, **ppo or {}))


def ppo_preset(name: str) -> dict[str, Any]:
    """The settings of a training that ``ppo=<name>`` sets, by name: ``ppo``, and what goes with it.

    Raises:
        ConfigError: no such set.
    """
    _check("ppo", name)
    folder = files("warpvox.configs") / "ppo"
    about = yaml.safe_load((folder / f"{name}.yaml").read_text(encoding="utf-8")) or {}
    own = [part.partition("@")[0] for part in about.pop("defaults", ()) if part.endswith("@ppo")]
    parts = [yaml.safe_load((folder / f"{part}.yaml").read_text(encoding="utf-8")) for part in own]
    return about | {"ppo": Ppo(**{key: value for part in parts for key, value in part.items()})}


def _check(group: str, name: str) -> None:
    """Raise ConfigError unless a group has a file of this name."""
    folder = files("warpvox.configs") / group
    names = sorted(item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml"))
    if name not in names:
        raise ConfigError(f"{group} must be one of {listing(names)}; got {name!r}.{did_you_mean(name, names)}")
