"""The public names, for type checkers and for loading on first use."""

from .algos.codesign.fitness import (
    Fitness as Fitness,
    Gaits as Gaits,
    Specialist as Specialist,
)
from .algos.codesign.results import Found as Found
from .algos.codesign.settings import Codesign as Codesign
from .algos.robots.entry import zoo as zoo
from .algos.search.settings import (
    BO as BO,
    GA as GA,
    CppnNeat as CppnNeat,
    MapElites as MapElites,
    RandomDesigns as RandomDesigns,
)
from .algos.settings import DesignTraining as DesignTraining, Ppo as Ppo
from .algos.training.loading import TrainedRun as TrainedRun, load_policy as load_policy
from .algos.training.settings import Training as Training
from .api import evaluate as evaluate, record as record, train as train
from .batch.options import SimOptions as SimOptions
from .code import Code as Code
from .design import (
    check_design as check_design,
    example_design as example_design,
    example_designs as example_designs,
    load_design as load_design,
    sample_design as sample_design,
    save_design as save_design,
)
from .design_search import codesign as codesign
from .envs.registry import task_ids as task_ids
from .envs.vec_env import make_vec as make_vec
from .errors import (
    ActionError as ActionError,
    ConfigError as ConfigError,
    DesignError as DesignError,
    DeviceError as DeviceError,
    DisplayError as DisplayError,
    DivergenceError as DivergenceError,
    MemoryLimitError as MemoryLimitError,
    ResumeError as ResumeError,
    RolloutError as RolloutError,
    RunError as RunError,
    SearchError as SearchError,
    SimulationError as SimulationError,
    StorageError as StorageError,
    StoredCodeError as StoredCodeError,
    TaskError as TaskError,
    UnknownArgumentError as UnknownArgumentError,
    WarpvoxError as WarpvoxError,
    WorldError as WorldError,
)
from .gradients import Gradients as Gradients
from .simulation import Simulation as Simulation
from .types import Cell as Cell, Physics as Physics
from .view.body_picture import draw_bodies as draw_bodies
from .world import World as World, WorldObject as WorldObject

__version__: str
