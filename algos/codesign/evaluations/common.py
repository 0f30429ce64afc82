"""One policy controls the designs of a generation: it goes on learning (shared), or is tuned for them (few-shot)."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpvox.algos.candidate import FINALIST
from warpvox.algos.codesign.evaluations.base import Workload, probe, steps_of_training
from warpvox.algos.codesign.evaluations.specialist import Screened
from warpvox.algos.protocols import episodes_of
from warpvox.algos.settings import MLP, Ppo
from warpvox.algos.training.pretrained import check_learned, find_pretrained, observed_by
from warpvox.code import is_code
from warpvox.errors import ConfigError
from warpvox.keys import changed, check_values, convert, key

if TYPE_CHECKING:
    from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome
    from warpvox.algos.codesign.settings import Codesign
    from warpvox.algos.env_factory import EnvFactory
    from warpvox.envs.spec import TaskSpec
    from warpvox.robots.entry import Robot

PRETRAINED = Path("training") / "pretrained" / "policy.pt"
"""The copy of the pretrained policy in a run's folder: a search that is resumed does not depend on another run."""
STEPS = "pretraining_steps"
"""In this copy: control steps of the pretraining, if they are known."""


@dataclass
class CommonPolicy(Screened):
    """Settings of a policy that controls all designs."""

    fewer = "search.population"
    """The key that sets how many designs the policy learns on at once."""

    policy: str = key("grid", "network of the policy: grid, transformer, module:Class, file.py:Class")
    network: Any = key(None, "settings of this network, {width:32} for instance; null: its defaults")
    envs: int = key(16, "training environments for each design", low=1)
    iterations: int = key(10, "training iterations on the designs of each generation", low=0)
    eval_envs: int | None = key(None, "evaluation episodes for each design; null: 1, with fitness=robust 8", low=1)
    save_interval: int = key(10, "iterations between checkpoints of this training", low=1)
    ppo: Any = key(None, "settings of PPO that differ from training.ppo: {epochs:4,schedule:adaptive}")

    def check(self, search: Codesign) -> None:
        from warpvox.algos.policies.registry import check_policy
        from warpvox.algos.training.ppo import rsl_rl_config

        super().check(search)
        check_policy(self.policy)
        if self.policy == MLP:
            raise ConfigError(
                "evaluation.policy must see voxels to control many bodies: grid, transformer or your own."
            )
        rsl_rl_config(self.ppo_of(search), 1, {})

    def ppo_of(self, search: Codesign) -> Ppo:
        """PPO of the common policy: ``training.ppo`` with the changes of ``ppo``."""
        given = self.ppo or {}
        if not isinstance(given, Mapping):
            raise ConfigError(f"evaluation.ppo must be settings by name, such as {{epochs:4}}; got {given!r:.80}.")
        ppo = changed(search.training.ppo, given, "evaluation.ppo")
        convert(ppo, "evaluation.ppo.")
        check_values(ppo, "evaluation.ppo.")
        return ppo

    def factory(self, search: Codesign, obs: str = "voxel") -> EnvFactory:
        """Makes environments for the policy; ``obs``: what a pretrained one observes."""
        return search.factory(obs).computed(grid=tuple(search.shape))

    def layout(self, search: Codesign, obs: str = "voxel") -> Any:
        """The layout of the policy, after all that is named has been tried."""
        from warpvox.algos.policies.registry import check_network

        env = probe(self.factory(search, obs), search.shape)
        return check_network(env, self.policy, self.network, "evaluation.network")

    def cost(self, search: Codesign, task: TaskSpec) -> tuple[float, float]:
        each = self.ppo_of(search).steps * self.iterations * self.envs
        last = self.finalists * steps_of_training(search.training, self.finalists)
        return each + episodes_of(self.eval_envs, search.fitness) * task.max_episode_steps, last

    def workloads(self, search: Codesign) -> list[Workload]:
        designs = min(search.batch or search.search.population, search.search.population)
        ppo = self.ppo_of(search)
        batch = Workload(designs, self.envs, "evaluation.envs", self.envs, "voxel", ppo, self.fewer)
        judged = episodes_of(self.eval_envs, search.fitness)
        evaluated = Workload(designs, judged, "evaluation.eval_envs", judged, "voxel", fewer=self.fewer)
        return [*super().workloads(search), batch, evaluated]

    def run_of(self, search: Codesign, candidate: Candidate, outcome: Outcome) -> dict[str, Any]:
        if candidate.origin == FINALIST:
            return {}
        bodies = [candidate.body.tolist()]
        return {
            **{name: getattr(self, name) for name in ("policy", "network", "ppo", "eval_envs")},
            "num_envs": self.envs,
            **dict.fromkeys(("max_iterations", "eval_interval"), max(1, self.iterations)),
            "lanes": search.factory().shared_lanes(episodes_of(self.eval_envs, search.fitness)),
            "designs": {"bodies": bodies, "refresh": "none", "held_out": bodies},
        }


@dataclass
class Shared(CommonPolicy):
    """One policy goes on learning from generation to generation, on all designs of each in one batch."""

    name: str = key("shared", "one policy learns on all designs of each generation", choices=("shared",))
    iterations: int = key(10, "training iterations on the designs of each generation", low=1)

    def check(self, search: Codesign) -> None:
        super().check(search)
        if search.executor == "ray":
            raise ConfigError(
                "evaluation=shared has one policy that learns in one process: executor=local, or evaluation=few_shot."
            )
        if search.batch is not None:
            raise ConfigError("evaluation=shared takes all designs of a generation together: leave batch away.")
        if self.ppo_of(search).schedule == "linear":
            raise ConfigError(
                "evaluation=shared: one policy learns all the time, so that its learning rate cannot decay linearly to"
                " 0: evaluation.ppo={schedule:adaptive}, or fixed."
            )

    def resolved(self, search: Codesign, folder: Path | None) -> Shared:
        super().resolved(search, folder)
        self.layout(search)
        return dataclasses.replace(self, ppo=dataclasses.asdict(self.ppo_of(search)))

    def screening(self, search: Codesign, known: Any) -> DesignEvaluator:
        from warpvox.algos.codesign.common_policy import SharedEvaluator

        return SharedEvaluator(self.factory(search), self, search.seed)


@dataclass
class FewShot(CommonPolicy):
    """A pretrained policy is tuned for each generation, each time from the same weights."""

    fewer = "batch"

    name: str = key("few_shot", "a pretrained policy is tuned for each generation", choices=("few_shot",))
    iterations: int = key(10, "training iterations on the designs of each generation; 0: none", low=0)
    pretrained: str | None = key(
        None,
        "the policy to start from: latest, the folder of a training with designs=... or a checkpoint in it;"
        " network and policy are its own, but for code, which evaluation.policy must name",
    )

    def check(self, search: Codesign) -> None:
        super().check(search)
        if self.pretrained is None:
            raise ConfigError(
                "evaluation=few_shot needs evaluation.pretrained: latest, the folder of a training with"
                " designs=... or a checkpoint in it."
            )

    def resolved(self, search: Codesign, folder: Path | None) -> FewShot:
        from warpvox.algos.policies.layout import VoxelLayout

        super().resolved(search, folder)
        content = self.begins_with(search, (), folder)
        spec = content["policy"]
        ppo = dataclasses.replace(self.ppo_of(search), **{k: spec[k] for k in ("action_scale", "normalize_obs")})
        changes: dict[str, Any] = {"network": dict(spec["voxels"]["settings"]), "ppo": dataclasses.asdict(ppo)}
        if not is_code(spec["voxels"]["network"]):
            changes["policy"] = spec["voxels"]["network"]
        if folder is None:
            file, _ = find_pretrained(str(self.pretrained), search.output_dir)
            changes["pretrained"] = str(file.absolute())
        resolved = dataclasses.replace(self, **changes)
        layout, found = resolved.layout(search, observed_by(spec)), VoxelLayout(**spec["voxels"]["layout"])
        if found != layout:
            raise ConfigError(
                f"The policy in {resolved.pretrained} is for bodies of {found.rows}x{found.columns} with {found.rest}"
                f" other inputs; {search.task} with shape={list(search.shape)} has {layout.rows}x{layout.columns} with"
                f" {layout.rest}."
            )
        return resolved

    def begins_with(self, search: Codesign, start: Sequence[Robot], folder: Path | None) -> dict[str, Any]:
        """The checkpoint of the pretrained policy."""
        from warpvox.algos.checkpoints.expected import check_like
        from warpvox.algos.checkpoints.files import load_checkpoint

        path, run = (folder / PRETRAINED, {}) if folder else find_pretrained(str(self.pretrained), search.output_dir)
        content = load_checkpoint(path)
        voxels = content["policy"].get("voxels") if isinstance(content["policy"], Mapping) else None
        if not voxels:
            raise ConfigError(
                f"The policy in {path} is fully connected, which is about the bodies that it knows; few_shot takes one"
                " that sees voxels: designs=random:64 policy=grid."
            )
        if isinstance(voxels, Mapping) and is_code(voxels.get("network")) and not is_code(self.policy):
            raise ConfigError(
                f"The policy in {path} has a network of its own: name it, evaluation.policy=FILE.py:Class."
            )
        check_learned(path, content, self.policy)
        if {"num_envs", "ppo"} <= run.keys():
            check_like(content, {"iter": int})
            content[STEPS] = int(content["iter"]) * int(run["num_envs"]) * int(run["ppo"]["steps"])
        return content

    def keep(self, known: Any, folder: Path) -> None:
        from warpvox.algos.checkpoints.files import save_checkpoint

        (folder / PRETRAINED).parent.mkdir(parents=True, exist_ok=True)
        save_checkpoint(folder / PRETRAINED, dict(known))

    def pretraining_steps(self, known: Any) -> int | None:
        return known.get(STEPS)

    def screening(self, search: Codesign, known: Any) -> DesignEvaluator:
        from warpvox.algos.codesign.common_policy import SharedEvaluator

        return SharedEvaluator(self.factory(search, observed_by(known["policy"])), self, search.seed, known)
