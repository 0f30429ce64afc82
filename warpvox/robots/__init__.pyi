"""The public names, for type checkers and for loading on first use."""

from .entry import (
    Robot as Robot,
    read_robot as read_robot,
    save_robot as save_robot,
    zoo as zoo,
    zoo_tasks as zoo_tasks,
)
from .gait import Gait as Gait
from .network import Network as Network
from .replay import robot_env as robot_env
from .returns import Judgement as Judgement, judge as judge
