"""The public names, for type checkers and for loading on first use."""

from .entry import (
    Robot as Robot,
    read_robot as read_robot,
    save_robot as save_robot,
    zoo as zoo,
    zoo_tasks as zoo_tasks,
)
from .episodes import Judgement as Judgement, judge as judge, robot_env as robot_env
from .policies import gait_policy as gait_policy, network_policy as network_policy
