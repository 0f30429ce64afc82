"""Design search: algorithms that propose bodies and learn from their fitness, and never simulate.

All speak the protocol of :class:`warpvox.algos.candidate.Search`::

    search = make_search(GaSettings(max_evaluations=100), shape=(5, 5), seed=0)
    while candidates := search.ask():
        search.tell([fitness_of(candidate.body) for candidate in candidates])

Names load on first use: BoTorch, neat-python and pyribs are imported only by the search that needs them.
"""

from importlib import import_module as _import_module

_PLACES = {
    "warpvox.algos.search.base": ("BaseSearch", "Proposal"),
    "warpvox.algos.search.factory": ("make_search",),
    "warpvox.algos.search.settings": (
        "ALGORITHMS",
        "BoSettings",
        "CppnNeatSettings",
        "CustomSettings",
        "GaSettings",
        "MapElitesSettings",
        "RandomSettings",
        "SearchSettings",
        "settings_from",
    ),
}
_HOME = {name: module for module, names in _PLACES.items() for name in names}

__all__ = [
    "ALGORITHMS",
    "BaseSearch",
    "BoSettings",
    "CppnNeatSettings",
    "CustomSettings",
    "GaSettings",
    "MapElitesSettings",
    "Proposal",
    "RandomSettings",
    "SearchSettings",
    "make_search",
    "settings_from",
]


def __getattr__(name: str) -> object:
    module = _HOME.get(name)
    if module is None:
        raise AttributeError(f"module 'warpvox.algos.search' has no attribute '{name}'")
    return getattr(_import_module(module), name)
