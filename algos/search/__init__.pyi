from .base import BaseSearch as BaseSearch, Proposal as Proposal
from .factory import make_search as make_search
from .settings import (
    ALGORITHMS as ALGORITHMS,
    BoSettings as BoSettings,
    CppnNeatSettings as CppnNeatSettings,
    CustomSettings as CustomSettings,
    GaSettings as GaSettings,
    MapElitesSettings as MapElitesSettings,
    RandomSettings as RandomSettings,
    SearchSettings as SearchSettings,
    settings_from as settings_from,
)
