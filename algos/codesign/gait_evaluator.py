"""Evaluation of designs by open-loop gaits that children inherit from their parents."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

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
from warpvox.design import Design
from warpvox.devices.out_of_memory import enough_memory
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.types import ACTION_SCALE, Cell


class GaitSearch(Protocol):
    """Settings of the search for gaits (fields of the evaluation ``gaits``)."""

    gaits: int
    rounds: int
    stages: int
    passes: int
    beam: int
    stage_steps: int


@dataclass(frozen=True)
class GaitEvaluator:
    """Evaluator by open-loop gaits: the best return is the fitness, the best gait the policy.

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
        """Search gaits for ``candidates`` and return their outcomes."""
        most = max(self.settings.gaits, self.settings.beam if self.settings.passes else 0)
        hint = (
            f"Take less at once: {most} gaits are tried with each of {len(candidates)} designs (fitness.gaits,"
            " fitness.beam, batch)."
        )
        with enough_memory(hint):
            return self._search(candidates, parents, report)

    def _search(self, candidates: Sequence[Candidate], parents: Parents, report: Report) -> list[Outcome]:
        """Run beam searches and evolution rounds for all candidates together; return their outcomes."""
        settings = self.settings
        bodies = [candidate.body for candidate in candidates]
        # 0x6A17 keeps the random numbers of gaits apart from those of environments and searches.
        rngs = [np.random.default_rng([0x6A17, self.seed, candidate.id]) for candidate in candidates]
        env = self._environments(candidates, settings.beam if settings.passes else settings.gaits)
        inherited = [self._inherited_gaits(candidate, parents, env.max_episode_steps) for candidate in candidates]
        noise = None
        if self.factory.protocol != NOMINAL:  # on the actions, the same for all gaits
            noise = Draws(self.seed, SEARCHED, self.episodes, env.device)

        # Stage length of each pass, as a factor on `stage_steps`, cycled. Long stages leave time for a throw or a turn.
        stage_factors = (1.0, 3.0, 0.6, 2.0, 4.0, 1.4, 0.8)
        best: list[tuple[float, Gait]] = []
        curves: list[list[tuple[int, float]]] = [[] for _ in candidates]
        spent = [0] * len(candidates)
        rounds = settings.passes + settings.rounds
        for number in range(rounds + 1):
            # Progress, also before the first round
            if report is not None:
                report(
                    {
                        "iteration": number,
                        "iterations": rounds,
                        "steps": sum(spent),
                        "best": [value for value, _ in best] or [math.nan] * len(bodies),
                        "training": [number < rounds] * len(bodies),
                    }
                )
            if number == rounds:
                break

            # The best of the gaits that are tried in a round
            if number < settings.passes:
                known = [[gait] for _, gait in best] if best else inherited
                steps = max(1, round(settings.stage_steps * stage_factors[number % len(stage_factors)]))
                found, taken = beam_search(env, bodies, known, rngs, self.seed, steps, self.episodes, noise)
            else:
                if env.num_envs != len(bodies) * settings.gaits * self.episodes:
                    env = self._environments(candidates, settings.gaits)
                gaits = []
                steps = env.max_episode_steps
                for place, candidate in enumerate(candidates):
                    rng = rngs[place]
                    if best:
                        gait = best[place][1]
                        gaits.append([mutate_gait(rng, gait, candidate.body, steps) for _ in range(settings.gaits)])
                    else:
                        gaits.append(self._first_gaits(rng, inherited[place], candidate, steps))
                found, taken = self._play(env, bodies, gaits, noise)

            # The best so far
            if best:
                found = [max(pair, key=lambda one: one[0]) for pair in zip(best, found, strict=True)]
            best = found
            for place, (value, _) in enumerate(best):
                spent[place] += int(taken[place])
                curves[place].append((spent[place], value))

        outcomes = []
        for place, (value, gait) in enumerate(best):
            state, spec = _as_policy(gait, bodies[place], env.obs_columns[place].values())
            outcomes.append(Outcome(value, curves[place], spent[place], state, spec=spec))
        return outcomes

    def _environments(self, candidates: Sequence[Candidate], count: int) -> VoxelVecEnv:
        """Create environments for ``count`` gaits per candidate and ``episodes`` per gait."""
        bodies = [candidate.body for candidate in candidates]
        seeds = [candidate_seed(self.seed, candidate.id) for candidate in candidates]
        return self.factory.make(bodies, count * self.episodes, seeds, auto_reset=False, shared=True)

    def _inherited_gaits(self, candidate: Candidate, parents: Parents, steps: int) -> list[Gait]:
        """Return a candidate's own known gait, or the gaits of its parents, best parent first."""
        if candidate.origin == START:
            known = self.known.get(candidate.body.tobytes())
            return [] if known is None else [with_stages(known, self.settings.stages, steps)]
        found = [parents[number] for number in candidate.parents if number in parents]
        found.sort(key=lambda parent: -parent.fitness)
        gaits = []
        for parent in found:
            gaits.append(Gait(**{name: parent.policy[name].numpy() for name in Gait.__dataclass_fields__}))
        return gaits

    def _first_gaits(
        self, rng: np.random.Generator, inherited: Sequence[Gait], candidate: Candidate, steps: int
    ) -> list[Gait]:
        """Return the gaits of a design's first round: inherited, random and mutated ones."""
        body = candidate.body
        stages = self.settings.stages
        count = self.settings.gaits
        if not inherited:
            return [draw_gait(rng, body, steps, stages) for _ in range(count)]
        if count == 1:
            # A known robot keeps its gait. Half of the children keep that of their parent, the others mutate it.
            if candidate.origin == START or rng.random() < 0.5:
                return [inherited[0]]
            return [mutate_gait(rng, inherited[0], body, steps)]

        # One gait in eight is new, the others come from the parents.
        fresh = math.ceil(0.125 * (count - 1))
        gaits = list(inherited[: count - fresh])
        gaits += [draw_gait(rng, body, steps, stages) for _ in range(fresh)]
        return gaits + [mutate_gait(rng, inherited[0], body, steps) for _ in range(count - len(gaits))]

    def _play(
        self, env: VoxelVecEnv, bodies: Sequence[Design], gaits: Sequence[Sequence[Gait]], noise: Draws | None
    ) -> tuple[list[tuple[float, Gait]], np.ndarray]:
        """Simulate gaits; return each design's best gait, its mean return and the control steps ``[designs]``."""
        # All gaits of a design have the same episodes.
        env.reset(seed=[self.seed] * len(bodies))
        first_gait = torch.zeros(len(bodies), self.settings.gaits, dtype=torch.int64, device=env.device)
        env.set_state(continued(env.state(), first_gait, self.episodes))

        returns = play(env, bodies, gaits, self.episodes, noise=noise).numpy()
        found = []
        for values, tried in zip(returns, gaits, strict=True):
            place = int(values.argmax())
            found.append((float(values[place]), tried[place]))
        return found, env.state()["length"].view(len(bodies), -1).sum(1).cpu().numpy()


def _as_policy(gait: Gait, body: Design, columns: Iterable[slice]) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Convert a gait to a policy's state and specification; ``columns``: of the observation's terms."""
    driven = np.flatnonzero(body >= Cell.H_ACT)
    num_obs = sum(part.stop - part.start for part in columns) + 1  # with the time
    stages, rows, width = gait.phase.shape
    shape = {"stages": stages, "rows": rows, "columns": width}
    spec = PolicySpec(num_obs, len(driven), [], "", normalize_obs=False, action_scale=ACTION_SCALE, gait=shape)
    state = {name: torch.as_tensor(values) for name, values in vars(gait).items()}
    state["cells"] = torch.as_tensor(driven)
    return state, spec_dict(spec)
