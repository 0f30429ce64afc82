from .base import BaseSearch as BaseSearch, Proposal as Proposal
from .factory import make_search as make_search
from .settings import (
    ALGORITHMS as ALGORITHMS,
    BO as BO,
    GA as GA,
    CppnNeat as CppnNeat,
    CustomSearch as CustomSearch,
    MapElites as MapElites,
    RandomDesigns as RandomDesigns,
    SearchSettings as SearchSettings,
    settings_from as settings_from,
)
