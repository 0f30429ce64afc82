"""Evaluation of designs without a policy: a few gaits are tried with each, and handed on to its descendants."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch

from warpvox.algos.candidate import START, Candidate, Outcome, Parents, Report, candidate_seed
from warpvox.algos.checkpoints.files import PolicySpec, spec_dict
from warpvox.algos.codesign.gait_actions import continued, play
from warpvox.algos.codesign.gait_beam import beam_search
from warpvox.algos.codesign.gaits import Gait, draw_gait, mutate_gait, with_stages
from warpvox.algos.disturbance import SEARCHED, Draws
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.protocols import NOMINAL
from warpvox.devices.out_of_memory import enough_memory
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.types import ACTION_SCALE, Cell

FRESH = 0.125
"""Share of the first gaits of a design with a parent that owe nothing to it."""
KEPT = 0.5
"""Share of designs with one gait each that move as their parent."""
STRETCH = (1.0, 3.0, 0.6, 2.0, 4.0, 1.4, 0.8)
"""By what the stages of one pass after another are longer: a throw or a turn takes its time, and they end elsewhere."""
STREAM = 0x6A17
"""Keeps the random numbers of gaits apart from those of the environments."""


class GaitSearch(Protocol):
    """How many gaits are tried, and which: see the fields of the evaluation ``gaits``."""

    gaits: int
    rounds: int
    stages: int
    passes: int
    beam: int
    stage_steps: int


@dataclass(frozen=True)
class GaitEvaluator:
    """The fitness of a design is the best return of some open-loop gaits, and the best gait is its policy.

    The first ones are those of its parents with mutants of the best parent's; random ones, if it has none. In each
    further round mutants of the best so far are tried. Passes of a :func:`beam_search` may come before the rounds. It
    takes ``beam * passes + gaits * rounds`` episodes for a design, where a training of 512,000 control steps has a
    thousand.

    Attributes:
        settings: how many gaits are tried, and which; finalists have settings of their own.
        episodes: of each gait, whose mean counts; more than one for tasks that draw at random. All gaits of all
            designs play the same ones, those of ``seed``.
        known: gaits of candidates with the origin :data:`warpvox.algos.candidate.START`, by the bytes of the body.
    """

    factory: EnvFactory
    settings: GaitSearch
    seed: int = 0
    episodes: int = 1
    known: Mapping[bytes, Gait] = field(default_factory=dict)

    def evaluate(self, candidates: Sequence[Candidate], parents: Parents, report: Report = None) -> list[Outcome]:
        most = max(self.settings.gaits, self.settings.beam if self.settings.passes else 0)
        hint = (
            f"Take less at once: {most} gaits are tried with each of {len(candidates)} designs (evaluation.gaits,"
            " evaluation.beam, batch)."
        )
        with enough_memory(hint):
            return _Rounds(self, candidates, parents).run(report)


class _Rounds:
    """The gaits of some candidates, round by round."""

    def __init__(self, how: GaitEvaluator, candidates: Sequence[Candidate], parents: Parents) -> None:
        self.how, self.settings, self.bodies = how, how.settings, [candidate.body for candidate in candidates]
        self.seeds = [candidate_seed(how.seed, candidate.id) for candidate in candidates]
        self.random = [np.random.default_rng([STREAM, how.seed, candidate.id]) for candidate in candidates]
        self.origins = [candidate.origin for candidate in candidates]
        self.env = self._environments(self.settings.beam if self.settings.passes else self.settings.gaits)
        self.inherited = [self._inherited(candidate, parents) for candidate in candidates]
        self.round = 0  # passes are counted, too
        self.rounds = self.settings.passes + self.settings.rounds
        self.best: list[tuple[float, Gait]] = []
        self.curves: list[list[tuple[int, float]]] = [[] for _ in candidates]
        self.spent = [0] * len(candidates)
        noisy = how.factory.fitness != NOMINAL  # on the actions, the same for all gaits
        self.noise = Draws(how.seed, SEARCHED, how.episodes, self.env.device) if noisy else None

    def _environments(self, count: int) -> VoxelVecEnv:
        """``count`` of each design, times the episodes of a gait."""
        envs = count * self.how.episodes
        return self.how.factory.make(self.bodies, envs, self.seeds, auto_reset=False, shared=True)

    def run(self, report: Report) -> list[Outcome]:
        self._tell(report)
        while self.round < self.rounds:
            found, steps = self._pass() if self.round < self.settings.passes else self._try()
            self.best = [max(pair, key=lambda one: one[0]) for pair in zip(self.best or found, found, strict=True)]
            for place, (value, _) in enumerate(self.best):
                self.spent[place] += int(steps[place])
                self.curves[place].append((self.spent[place], value))
            self.round += 1
            self._tell(report)
        return [self._outcome(place) for place in range(len(self.bodies))]

    def _inherited(self, candidate: Candidate, parents: Parents) -> list[Gait]:
        """The gaits that a candidate begins with: those of its parents, the best first, or the one it is known by."""
        if candidate.origin == START:
            known = self.how.known.get(candidate.body.tobytes())
            return [] if known is None else [with_stages(known, self.settings.stages, self.env.max_episode_steps)]
        found = [parents[number] for number in candidate.parents if number in parents]
        found.sort(key=lambda parent: -parent.fitness)
        return [_gait_of(parent.policy) for parent in found]

    def _gaits(self, place: int) -> list[Gait]:
        rng, body, count = self.random[place], self.bodies[place], self.settings.gaits
        steps = self.env.max_episode_steps
        known, gaits = self.inherited[place], []
        if self.best:
            known, fresh = [self.best[place][1]], 0
        elif not known:
            fresh = count
        elif count == 1:
            kept = self.origins[place] == START or rng.random() < KEPT
            fresh, gaits = 0, known[:1] if kept else []
        else:
            fresh = math.ceil(FRESH * (count - 1))
            gaits = known[: count - fresh]
        gaits += [draw_gait(rng, body, steps, self.settings.stages) for _ in range(fresh)]
        return gaits + [mutate_gait(rng, known[0], body, steps) for _ in range(count - len(gaits))]

    def _pass(self) -> tuple[list[tuple[float, Gait]], np.ndarray]:
        """The best gait of each design by a beam search with its mean return, and the control steps ``[designs]``."""
        known = [[best[1]] for best in self.best] if self.best else self.inherited
        steps = max(1, round(self.settings.stage_steps * STRETCH[self.round % len(STRETCH)]))
        how = self.how.seed, steps, self.how.episodes, self.noise
        return beam_search(self.env, self.bodies, known, self.random, *how)

    def _try(self) -> tuple[list[tuple[float, Gait]], np.ndarray]:
        """The same of an episode of each gait that is tried next."""
        how, count = self.how, self.settings.gaits
        if self.env.num_envs != len(self.bodies) * count * how.episodes:
            self.env = self._environments(count)
        gaits = [self._gaits(place) for place in range(len(self.bodies))]
        self.env.reset(seed=[how.seed] * len(self.bodies))
        alike = torch.zeros(len(self.bodies), count, dtype=torch.int64, device=self.env.device)
        self.env.set_state(continued(self.env.state(), alike, how.episodes))
        returns = play(self.env, self.bodies, gaits, how.episodes, noise=self.noise).numpy()
        found = [(float(got.max()), tried[int(got.argmax())]) for got, tried in zip(returns, gaits, strict=True)]
        return found, self.env.state()["length"].view(len(self.bodies), -1).sum(1).cpu().numpy()

    def _outcome(self, place: int) -> Outcome:
        (value, gait), body = self.best[place], self.bodies[place]
        columns = self.env.obs_columns[place].values()
        sizes = sum(part.stop - part.start for part in columns) + 1, int((body >= Cell.H_ACT).sum())  # with the time
        shape: dict[str, int] = dict(zip(("stages", "rows", "columns"), gait.phase.shape, strict=True))
        spec = PolicySpec(*sizes, [], "", normalize_obs=False, action_scale=ACTION_SCALE, gait=shape)
        state = {name: torch.as_tensor(values) for name, values in vars(gait).items()}
        state["cells"] = torch.as_tensor(np.flatnonzero(body >= Cell.H_ACT))
        return Outcome(value, self.curves[place], self.spent[place], state, spec=spec_dict(spec))

    def _tell(self, report: Report) -> None:
        best = [value for value, _ in self.best] or [math.nan] * len(self.bodies)
        event = {"iteration": self.round, "iterations": self.rounds, "steps": sum(self.spent), "best": best}
        if report is not None:
            report(event | {"training": [self.round < self.rounds] * len(self.bodies)})


def _gait_of(state: Mapping[str, torch.Tensor]) -> Gait:
    return Gait(**{name: state[name].numpy() for name in Gait.__dataclass_fields__})
