"""The public names, for type checkers and for loading on first use."""

from .entry import Robot as Robot
from .entry import find_robot as find_robot
from .entry import read_robot as read_robot
from .entry import save_robot as save_robot
from .entry import zoo as zoo
from .entry import zoo_tasks as zoo_tasks
from .gait import Gait as Gait
from .network import Network as Network
from .replay import Judgement as Judgement
from .replay import judge as judge
from .replay import robot_env as robot_env
