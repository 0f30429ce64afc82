"""Beam search for open-loop gaits, which chooses the motions of an episode stage by stage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from warpvox.algos.codesign.gait_actions import continued, play
from warpvox.algos.codesign.gaits import Gait, Motion, draw_motion, gait_of, motions_of, mutate_motion
from warpvox.algos.disturbance import Draws
from warpvox.envs.vec_env import VoxelVecEnv

_Begun = tuple[tuple[int, Motion], ...]
"""Motions with the control steps at which they begin."""


def beam_search(
    env: VoxelVecEnv,
    bodies: Sequence[np.ndarray],
    known: Sequence[Sequence[Gait]],
    random: Sequence[np.random.Generator],
    seed: int,
    steps: int,
    episodes: int,
    noise: Draws | None,
) -> tuple[list[tuple[float, Gait]], np.ndarray]:
    """Find the best gait of each design by a beam search through the stages of an episode.

    The beginnings of episodes found so far are each continued for a stage by several motions, from copies of the state
    of the simulation, and the best of what follows are the next beginnings. This takes as many control steps as
    episodes of all environments, but what to do in the middle of an episode is tried where it matters, without changing
    what was good before.

    Args:
        env: as many environments for each design, which do not reset themselves: continuations times ``episodes``.
        known: gaits of each design, if there are, the best one first: the result is never worse than this one.
        seed: of the episodes, which are the same for all designs.
        steps: control steps of a stage.
        episodes: of each gait, whose mean return counts.
        noise: on the actions of these episodes, the same for all gaits.

    Returns:
        The best mean return and its gait, of each design, and the control steps ``[designs]`` that it took.
    """
    limit = env.max_episode_steps
    count = env.num_envs // (len(bodies) * episodes)
    searches = [_Search(body, count, gaits, rng) for body, gaits, rng in zip(bodies, known, random, strict=True)]
    spent = np.zeros(len(searches), np.int64)
    env.reset(seed=[seed] * len(searches))
    state = env.state()
    for first in range(0, limit, steps):
        last = min(first + steps, limit)
        gaits = [search.continued(first, last) for search in searches]
        sources = torch.tensor([search.sources for search in searches], device=env.device)
        state = continued(state, sources, episodes)
        before = state["length"]
        env.set_state(state)
        values = play(env, bodies, gaits, episodes, first, last, noise).tolist()
        state = env.state()
        spent += (state["length"] - before).view(len(searches), -1).sum(1).cpu().numpy()
        ended = (state["terminated"] | state["truncated"]).view(len(searches), count, -1).all(2).tolist()
        for place, search in enumerate(searches):
            search.choose(values[place], ended[place])
        if not any(search.beginnings for search in searches):
            break
    return [search.best for search in searches if search.best is not None], spent


@dataclass(frozen=True)
class _Beginning:
    """Candidate of the beam: the motions of the first part of an episode.

    ``place``: index of the gait that played it; ``begun``: its motions; ``is_known``: they are those of the best known
    gait, which is continued whatever its value.
    """

    place: int = 0
    begun: _Begun = ()
    is_known: bool = False


class _Search:
    """Beam search for one design's gait.

    Attributes:
        beginnings: parts of episodes to continue; empty when all episodes have ended.
        sources: for each continuation, the index of the gait whose episode it continues.
        best: the best mean return of an episode that has ended, and its gait.
    """

    def __init__(self, body: np.ndarray, count: int, known: Sequence[Gait], rng: np.random.Generator) -> None:
        """Start the search for gaits of ``body`` with ``count`` gaits per stage; ``known`` gaits are best first."""
        self.body = body
        self.count = count
        self.rng = rng
        self.plan = motions_of(known[0]) if known else ()
        self.motions = [motion for gait in known for _, motion in motions_of(gait)]
        # After each stage, one in eight beginnings of episodes is kept.
        self.kept = max(1, round(0.125 * count))
        self.beginnings = [_Beginning(is_known=bool(known))]
        self.sources: list[int] = []
        self.best: tuple[float, Gait] | None = None
        self._tried: list[_Beginning] = []
        self._gaits: list[Gait] = []

    def continued(self, first: int, last: int) -> list[Gait]:
        """Return the gaits to simulate from control step ``first`` up to ``last``; sets ``sources``."""
        if not self.beginnings:  # all episodes have ended: the environments stay as they are
            self.sources = list(range(self.count))
            return self._gaits
        each, more = divmod(self.count, len(self.beginnings))
        self.sources = []
        self._tried = []
        self._gaits = []
        for rank, beginning in enumerate(self.beginnings):
            for number in range(each + (rank < more)):
                is_known = beginning.is_known and number == 0
                added = (
                    self._known_motions(first, last)
                    if is_known
                    else self._continuation(beginning.begun, number, first, last)
                )
                self.sources.append(beginning.place)
                # A motion that continues unchanged gets no new entry.
                begun = beginning.begun
                goes_on = bool(begun) and begun[-1][1] is added[0][1]
                begun += added[1:] if goes_on else added
                self._tried.append(_Beginning(len(self._tried), begun, is_known))
                self._gaits.append(gait_of(added))
        return self._gaits

    def choose(self, values: Sequence[float], ended: Sequence[bool]) -> None:
        """Keep the best continuations as ``beginnings``, and update ``best`` from ended episodes."""
        if not self.beginnings:
            return
        for tried in self._tried:
            value = values[tried.place]
            if ended[tried.place] and (self.best is None or value > self.best[0]):
                self.best = value, gait_of(tried.begun)
        active = [tried for tried in self._tried if not ended[tried.place]]
        active.sort(key=lambda tried: (not tried.is_known, -values[tried.place]))
        # At most a quarter of them may continue the same beginning, so that not all descend from one.
        most = max(2, round(0.25 * self.kept))
        chosen: list[_Beginning] = []
        children = dict.fromkeys(self.sources, 0)
        for tried in active:
            parent = self.sources[tried.place]
            if len(chosen) < self.kept and children[parent] < most:
                children[parent] += 1
                chosen.append(tried)
        self.beginnings = chosen

    def _continuation(self, begun: _Begun, number: int, first: int, last: int) -> _Begun:
        """Choose the ``number``-th continuation: the same motion, a mutant, a known or a random motion."""
        rng = self.rng
        body = self.body
        if begun and number == 0:
            return ((first, begun[-1][1]),)
        kind = rng.random()
        # A tenth follow the known gait, three tenths are mutants of the present motion, a quarter are motions
        # of known gaits or mutants of them, a tenth are mutants of an earlier motion, the others are random.
        if self.plan and kind < 0.1:
            return self._known_motions(first, last)
        if begun and kind < 0.4:
            motion = mutate_motion(rng, begun[-1][1], body, first)
        elif self.motions and kind < 0.65:
            motion = self.motions[rng.integers(len(self.motions))]
            if rng.random() < 0.5:
                motion = mutate_motion(rng, motion, body, first)
        elif begun and kind < 0.75:
            motion = mutate_motion(rng, begun[rng.integers(len(begun))][1], body, first)
        else:
            motion = draw_motion(rng, body)
        return ((first, motion),)

    def _known_motions(self, first: int, last: int) -> _Begun:
        """Return the best known gait's motions between control steps ``first`` and ``last``."""
        present = max(place for place, (begin, _) in enumerate(self.plan) if begin <= first)
        later = tuple((begin, motion) for begin, motion in self.plan[present + 1 :] if begin < last)
        return ((first, self.plan[present][1]), *later)
