"""Search algorithms for designs: they propose bodies and learn from fitness, without simulating.

All implement :class:`warpvox.algos.candidate.Search`::

    search = make_search(GA(max_designs=100), shape=(5, 5), seed=0)
    while candidates := search.ask():
        search.tell([fitness_of(candidate.body) for candidate in candidates])

BoTorch, neat-python and pyribs are imported only by the search that needs them.
"""

from warpvox.algos.search.base import BaseSearch, Proposal
from warpvox.algos.search.factory import make_search
from warpvox.algos.search.settings import (
    ALGORITHMS,
    BO,
    GA,
    CppnNeat,
    CustomSearch,
    MapElites,
    RandomDesigns,
    SearchSettings,
)

__all__ = [
    "ALGORITHMS", "BO", "GA", "BaseSearch", "CppnNeat", "CustomSearch", "MapElites", "Proposal", "RandomDesigns",
    "SearchSettings", "make_search",
]  # fmt: skip
