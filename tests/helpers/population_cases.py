"""Helpers for tests of evaluations: fast settings, bodies and an environment factory."""

from dataclasses import replace
from typing import Any

import numpy as np

from warpvox.algos.candidate import Candidate
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.settings import DesignTraining
from warpvox.batch.options import SimOptions
from warpvox.configs.composition import settings_named
from warpvox.design import sample_design
from warpvox.envs.registry import get_task

LIMIT = 16  # control steps of an episode


def training_preset(name: str, ppo: dict[str, Any] | None = None, **changes: Any) -> DesignTraining:
    """Return the settings ``training=<name>`` of a design search with changes."""
    preset = settings_named("codesign", training=name).get("training", DesignTraining())
    return replace(preset, ppo=replace(preset.ppo, **(ppo or {})), **changes)


def small(preset: str = "fast", **changes: object) -> DesignTraining:
    quick = {"steps": 4, "epochs": 2, "minibatches": 2, "hidden": [32]}
    return training_preset(preset, quick, **({"envs": 4, "iterations": 6, "eval_interval": 2} | changes))


def factory(task: str = "Walker-v0", dtype: str = "float32", limit: int = LIMIT) -> EnvFactory:
    return EnvFactory(replace(get_task(task), max_episode_steps=limit), sim=SimOptions("cpu", dtype, threads=1))


def bodies(count: int) -> list[np.ndarray]:
    """Return bodies with different numbers of points and actuators."""
    return [sample_design((3, 3), seed=number) for number in range(count)]


def candidates(count: int) -> list[Candidate]:
    return [Candidate(number, body) for number, body in enumerate(bodies(count))]
