from .base import BaseSearch as BaseSearch
from .base import Proposal as Proposal
from .factory import make_search as make_search
from .settings import (
    ALGORITHMS as ALGORITHMS,
)
from .settings import (
    BoSettings as BoSettings,
)
from .settings import (
    CppnNeatSettings as CppnNeatSettings,
)
from .settings import (
    CustomSettings as CustomSettings,
)
from .settings import (
    GaSettings as GaSettings,
)
from .settings import (
    MapElitesSettings as MapElitesSettings,
)
from .settings import (
    RandomSettings as RandomSettings,
)
from .settings import (
    SearchSettings as SearchSettings,
)
from .settings import (
    settings_from as settings_from,
)
