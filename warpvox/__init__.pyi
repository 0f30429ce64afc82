"""The public names, for type checkers and for loading on first use."""

from .api import TrainedRun as TrainedRun
from .api import load_policy as load_policy
from .api import train as train
from .batch.options import SimOptions as SimOptions
from .code import Code as Code
from .design import (
    check_design as check_design,
)
from .design import (
    example_design as example_design,
)
from .design import (
    example_designs as example_designs,
)
from .design import (
    load_design as load_design,
)
from .design import (
    sample_design as sample_design,
)
from .design import (
    save_design as save_design,
)
from .envs.design_episodes import design_episodes as design_episodes
from .envs.registry import task_ids as task_ids
from .envs.vec_env import make_vec as make_vec
from .errors import (
    ActionError as ActionError,
)
from .errors import (
    ConfigError as ConfigError,
)
from .errors import (
    DesignError as DesignError,
)
from .errors import (
    DeviceError as DeviceError,
)
from .errors import (
    DisplayError as DisplayError,
)
from .errors import (
    DivergenceError as DivergenceError,
)
from .errors import (
    MemoryLimitError as MemoryLimitError,
)
from .errors import (
    RolloutError as RolloutError,
)
from .errors import (
    RunError as RunError,
)
from .errors import (
    SearchError as SearchError,
)
from .errors import (
    SimulationError as SimulationError,
)
from .errors import (
    StorageError as StorageError,
)
from .errors import (
    TaskError as TaskError,
)
from .errors import (
    WarpvoxError as WarpvoxError,
)
from .errors import (
    WorldError as WorldError,
)
from .gradients import Gradients as Gradients
from .robots.entry import zoo as zoo
from .simulation import Simulation as Simulation
from .types import Cell as Cell
from .types import Physics as Physics
from .view.rollout import record as record
from .world import World as World
from .world import WorldObject as WorldObject

__version__: str
