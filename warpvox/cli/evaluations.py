"""The keys of ``warpvox codesign`` about how designs are evaluated: checks, and the evaluator that they name."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpvox.algos.candidate import FINALIST, Candidate
from warpvox.algos.settings import Ppo, ScreeningConfig
from warpvox.algos.training.pretrained import check_learned, find_pretrained, kept_name, observed_by
from warpvox.code import is_code
from warpvox.configs.schema import CodesignConfig
from warpvox.errors import ConfigError, did_you_mean
from warpvox.keys import check_values
from warpvox.types import Cell

if TYPE_CHECKING:
    from warpvox.algos.candidate import DesignEvaluator
    from warpvox.algos.codesign.gaits import Gait
    from warpvox.algos.env_factory import EnvFactory

__all__ = [
    "STEPS",
    "check_evaluation",
    "episodes_of",
    "evaluator_of",
    "has_common_policy",
    "is_screened",
    "keep_pretrained",
    "learns_by_gradients",
    "read_pretrained",
    "resolve_evaluation",
    "screened_values",
    "values_of_gait",
]

PRETRAINED = Path("training") / "pretrained" / "policy.pt"
"""The copy of the pretrained policy in a run's folder: a search that is resumed does not depend on another run."""
STEPS = "pretraining_steps"
"""In this copy: control steps of the pretraining, if they are known."""
FULL = Cell.H_ACT
EPISODES = 4
"""Of a gait, in tasks that draw at random."""


def is_screened(config: CodesignConfig) -> bool:
    """Whether designs are compared without a training for each, and finalists get one."""
    return config.evaluation != "specialist"


def has_common_policy(config: CodesignConfig) -> bool:
    """Whether one policy controls the designs of a generation."""
    return config.evaluation in ("shared", "few_shot")


def learns_by_gradients(config: CodesignConfig) -> bool:
    """Whether the policy of all designs, once resolved, is tuned by gradients through the physics."""
    from warpvox.algos.policies.registry import CPG

    how = config.screening
    return has_common_policy(config) and how.policy == CPG and how.iterations > 0


def check_evaluation(config: CodesignConfig) -> None:
    """Find keys that do not go together.

    Raises:
        ConfigError: which, and what would.
    """
    from warpvox.algos.codesign.sequential_evaluator import SequentialEvaluator
    from warpvox.algos.policies.registry import MLP, check_policy

    training, how = config.training, f"evaluation={config.evaluation}"
    check_policy(config.policy)
    if training.method == "sequential":
        SequentialEvaluator(None, training)
    if config.policy == MLP and config.network is not None:
        raise ConfigError(
            "network has the settings of policy=grid, transformer or your own; mlp has training.ppo.hidden."
        )
    if config.policy != MLP and training.method != "sequential":
        raise ConfigError(
            f"policy={config.policy} needs training.method=sequential: designs that are trained side by side have"
            " fully connected layers (policy=mlp)."
        )
    if (config.pretrained is not None) != (config.evaluation == "few_shot"):
        raise ConfigError(
            "evaluation=few_shot and pretrained go together: pretrained=latest, the folder of a run of `warpvox train"
            " designs=...` or a checkpoint in it."
        )
    if not is_screened(config):
        return
    if training.inherit:
        raise ConfigError(
            f"training.inherit does not go with {how}: the trainings of the finalists begin with new networks."
        )
    if config.evaluation == "shared" and config.executor == "ray":
        raise ConfigError(f"{how} has one policy that learns in one process: executor=local, or evaluation=few_shot.")
    if config.evaluation == "shared" and config.batch is not None:
        raise ConfigError(f"{how} takes all designs of a generation together: leave batch away.")
    if not has_common_policy(config):
        _check_gaits(config.screening)
        return
    check_policy(config.screening.policy)
    if config.screening.policy == MLP:
        raise ConfigError("screening.policy must see voxels to control many bodies: grid, transformer or your own.")
    _screening_ppo(config)


def _check_gaits(how: ScreeningConfig) -> None:
    for prefix, passes, rounds in ("", how.passes, how.rounds), ("final_", how.final_passes, how.final_rounds):
        if passes + rounds == 0:
            raise ConfigError(
                f"screening.{prefix}passes and screening.{prefix}rounds are both 0: one of them must be 1 or more, or"
                " no gait is tried."
            )


def _screening_ppo(config: CodesignConfig) -> Ppo:
    """PPO of the common policy: ``training.ppo`` with what ``screening.ppo`` changes.

    Raises:
        ConfigError: no such setting, or a value that it cannot have.
    """
    given = config.screening.ppo or {}
    known = dataclasses.asdict(config.training.ppo)
    if not isinstance(given, Mapping):
        raise ConfigError(f"screening.ppo must be settings by name, such as {{epochs:4}}; got {given!r:.80}.")
    for name, value in given.items():
        if name not in known:
            raise ConfigError(f"screening.ppo: PPO has no setting {name!r:.80}.{did_you_mean(str(name), known)}")
        wanted = (int, float) if isinstance(known[name], float) else type(known[name])
        if not isinstance(value, wanted) or isinstance(value, bool) != isinstance(known[name], bool):
            raise ConfigError(f"screening.ppo: {name} must be like {known[name]!r}, got {value!r:.80}.")
    ppo = dataclasses.replace(config.training.ppo, **given)
    check_values(ppo, "screening.ppo.")
    return ppo


def resolve_evaluation(config: CodesignConfig, folder: Path | None) -> CodesignConfig:
    """A copy with what the keys stand for, after all of them have been checked.

    Args:
        folder: of the search that is resumed.

    Raises:
        WarpvoxError: a network, its settings, or a pretrained policy that is not to be had or does not fit.
    """
    from warpvox.algos.policies.layout import VoxelLayout
    from warpvox.algos.policies.registry import MLP, layout_for, make_network
    from warpvox.algos.training.ascent import check_gradients

    networks = {}
    if config.policy != MLP:
        networks["policy"] = config.policy, config.network
    if has_common_policy(config):
        config = dataclasses.replace(config, screening=_resolved_screening(config, folder))
        if config.evaluation == "few_shot" and folder is None:
            file, _ = find_pretrained(config.pretrained, config.output_dir)
            config = dataclasses.replace(config, pretrained=kept_name(config.pretrained, file))
        networks["screening.policy"] = config.screening.policy, config.screening.network
    if not networks:
        return config
    pretrained = read_pretrained(config, folder)
    body = np.full(config.shape, FULL, np.int8)
    factory = _common_factory(config, pretrained).computed(device="cpu", threads=1)
    env = factory.make([body], 1, [0], auto_reset=False)
    for key, (name, settings) in networks.items():
        if settings is not None and not isinstance(settings, Mapping):
            raise ConfigError(f"{key}: settings of a network have names, {{width:32}}; got {settings!r:.80}.")
        layout = layout_for(name, env)
        make_network(name, layout, False, settings)
    if pretrained is not None and (found := VoxelLayout(**pretrained["policy"]["voxels"]["layout"])) != layout:
        raise ConfigError(
            f"The policy in {config.pretrained} is for bodies of {found.rows}x{found.columns} with {found.rest} other"
            f" inputs; {config.task} with shape={list(config.shape)} has {layout.rows}x{layout.columns} with"
            f" {layout.rest}."
        )
    if learns_by_gradients(config):
        check_gradients(env)
    return config


def _resolved_screening(config: CodesignConfig, folder: Path | None) -> ScreeningConfig:
    from warpvox.algos.codesign.common_policy import SharedEvaluator

    ppo = _screening_ppo(config)
    pretrained = read_pretrained(config, folder)
    changes: dict[str, Any] = {}
    if pretrained is not None:
        spec = pretrained["policy"]
        ppo = dataclasses.replace(ppo, action_scale=spec["action_scale"], normalize_obs=spec["normalize_obs"])
        changes["network"] = dict(spec["voxels"]["settings"])
        if not is_code(spec["voxels"]["network"]):
            changes["policy"] = spec["voxels"]["network"]
    screening = dataclasses.replace(config.screening, ppo=dataclasses.asdict(ppo), **changes)
    if config.evaluation == "shared":
        SharedEvaluator(None, screening)
    return screening


def screened_values(config: CodesignConfig, candidate: Candidate) -> dict[str, Any]:
    """What the configuration of a design that a common policy controls has in place of its own training's."""
    how, bodies = config.screening, [candidate.body.tolist()]
    return {
        "policy": how.policy,
        "network": how.network,
        "ppo": how.ppo,
        "num_envs": how.envs,
        "max_iterations": max(1, how.iterations),
        "eval_interval": max(1, how.iterations),
        "eval_envs": how.eval_envs,
        "lanes": factory_of(config).shared_lanes(how.eval_envs),
        "designs": {"bodies": bodies, "refresh": "none", "held_out": bodies},
    }


# ----------------------------------------------------------------------------------------- the pretrained policy


def read_pretrained(config: CodesignConfig, folder: Path | None) -> dict[str, Any] | None:
    """The checkpoint of the policy that ``evaluation=few_shot`` begins with; None: another evaluation.

    Args:
        folder: of the search, which has a copy; None: there is none yet.

    Raises:
        RunError: no such run or file. ConfigError: a policy that cannot be tuned for other bodies.
    """
    from warpvox.algos.checkpoints.files import load_checkpoint

    if config.evaluation != "few_shot":
        return None
    path, run = (folder / PRETRAINED, {}) if folder else find_pretrained(config.pretrained, config.output_dir)
    content = load_checkpoint(path)
    voxels = content["policy"].get("voxels") if isinstance(content["policy"], Mapping) else None
    if not voxels:
        raise ConfigError(
            f"The policy in {path} is fully connected, which is about the bodies that it knows; few_shot takes one"
            " that sees voxels: warpvox train designs=random:64 policy=grid."
        )
    own = isinstance(voxels, Mapping) and is_code(voxels.get("network"))
    if own and not is_code(config.screening.policy):
        raise ConfigError(f"The policy in {path} has a network of its own: name it, screening.policy=FILE.py:Class.")
    check_learned(path, content, config.screening.policy)
    if {"num_envs", "ppo"} <= run.keys():
        content[STEPS] = int(content["iter"]) * int(run["num_envs"]) * int(run["ppo"]["steps"])
    return content


def keep_pretrained(content: Mapping[str, Any] | None, folder: Path) -> None:
    """Copy a pretrained policy into the folder of a search."""
    from warpvox.algos.checkpoints.files import save_checkpoint

    if content is not None and not (folder / PRETRAINED).is_file():
        (folder / PRETRAINED).parent.mkdir(parents=True, exist_ok=True)
        save_checkpoint(folder / PRETRAINED, dict(content))


# ---------------------------------------------------------------------------------------------------- evaluators


def factory_of(config: CodesignConfig, obs: str = "task") -> EnvFactory:
    """Where a configuration has designs trained; ``config.device`` may still be auto."""
    from warpvox.algos.env_factory import EnvFactory
    from warpvox.algos.physics import sim_of

    return EnvFactory(config.task, config.rules, obs, sim=sim_of(config))


def evaluator_of(
    config: CodesignConfig, pretrained: Mapping[str, Any] | None, gaits: Mapping[bytes, Gait]
) -> DesignEvaluator:
    """The evaluator of a resolved configuration.

    Args:
        pretrained: of :func:`read_pretrained`.
        gaits: of robots that the search starts with, by the bytes of their bodies.
    """
    from warpvox.algos.codesign.common_policy import FewShotEvaluator, SharedEvaluator
    from warpvox.algos.codesign.finalists import TwoStages
    from warpvox.algos.codesign.population_evaluator import PopulationEvaluator
    from warpvox.algos.codesign.sequential_evaluator import SequentialEvaluator
    from warpvox.algos.policies.registry import MLP

    if config.training.method == "population":
        final: DesignEvaluator = PopulationEvaluator(factory_of(config), config.training, config.seed)
    elif config.policy == MLP:
        final = SequentialEvaluator(factory_of(config), config.training, config.seed)
    else:
        network = config.policy, dict(config.network or {})
        final = SequentialEvaluator(factory_of(config, "voxel"), config.training, config.seed, *network)
    if not is_screened(config):
        return final
    if config.evaluation == "gaits":
        return _by_gaits(config, final, gaits)
    common = _common_factory(config, pretrained)
    if config.evaluation == "shared":
        return TwoStages(SharedEvaluator(common, config.screening, config.seed), final)
    return TwoStages(FewShotEvaluator(common, config.screening, config.seed, pretrained), final)


def _common_factory(config: CodesignConfig, pretrained: Mapping[str, Any] | None) -> EnvFactory:
    """Makes environments for a policy that controls all designs: what a pretrained one observes, it observes."""
    from warpvox.algos.policies.registry import CPG

    # gradients, which train the policy without feedback, go through the layout of lanes
    without_feedback = config.screening.policy == CPG
    if pretrained is not None:
        obs = observed_by(pretrained["policy"])
    else:
        obs = "timed_voxel" if without_feedback else "voxel"
    layout = "lanes" if without_feedback else None
    return factory_of(config, obs).computed(grid=tuple(config.shape), layout=layout)


def _by_gaits(config: CodesignConfig, training: DesignEvaluator, known: Mapping[bytes, Gait]) -> DesignEvaluator:
    """Designs are compared by gaits, finalists try more of them and get a training."""
    from warpvox.algos.codesign.finalists import BestOf, TwoStages
    from warpvox.algos.codesign.gait_evaluator import GaitEvaluator

    how, episodes = config.screening, episodes_of(config.task)
    gaits = GaitEvaluator(
        factory_of(config),
        count=how.gaits,
        rounds=how.rounds,
        stages=how.stages,
        seed=config.seed,
        episodes=episodes,
        passes=how.passes,
        beam=how.beam,
        stage_steps=how.stage_steps,
        known=known,
    )
    final = dataclasses.replace(
        gaits, count=how.gaits_of_finalist, rounds=how.final_rounds, passes=how.final_passes, beam=how.final_beam
    )
    return TwoStages(gaits, BestOf(final, training))


def values_of_gait(config: CodesignConfig, candidate: Candidate) -> dict[str, Any]:
    """What the configuration of a design with a gait has, which is simulated as in the evaluation of its fitness."""
    from warpvox.algos.policies.registry import MLP

    how = config.screening
    count, episodes = how.gaits_of_finalist if candidate.origin == FINALIST else how.gaits, episodes_of(config.task)
    lanes = factory_of(config).shared_lanes(count * episodes)
    return {"policy": MLP, "network": None, "obs": "timed", "lanes": lanes, "eval_envs": episodes}


def episodes_of(task: str) -> int:
    """Of a gait: several where the task draws at random, or the best of many returns would be a lucky one."""
    from warpvox.envs.registry import get_task

    return EPISODES if get_task(task).is_random else 1
