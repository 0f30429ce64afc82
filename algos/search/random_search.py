"""Random search: the baseline that every other search has to beat."""

from __future__ import annotations

import numpy as np

from warpvox.algos.search.base import BaseSearch, Proposal


class RandomSearch(BaseSearch):
    """Designs by EvoGym's sampling rule, each a new one."""

    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        """``count`` random bodies."""
        return [self.random_proposal(rng) for _ in range(count)]
