"""Design search: algorithms that propose bodies and learn from their fitness, and never simulate.

All speak the protocol of :class:`warpvox.algos.candidate.Search`::

    search = make_search(GaSettings(max_evaluations=100), shape=(5, 5), seed=0)
    while candidates := search.ask():
        search.tell([fitness_of(candidate.body) for candidate in candidates])

The names of ``__init__.pyi`` load on first use: BoTorch, neat-python and pyribs are imported only by the search that
needs them.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
