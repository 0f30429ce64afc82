"""The released simulator gives robots of the zoo the returns that ours recorded: ``pytest -m slow tests/robots``."""

import json
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import reference

from warpvox.algos.robots import gait_policy
from warpvox.algos.robots.entry import Robot, zoo, zoo_tasks
from warpvox.algos.robots.episodes import judge, robot_env
from warpvox.design import full_connections, load_design
from warpvox.envs.registry import get_task, released_id
from warpvox.view.rollout import record

ROUNDING = 1e-8  # of a sum of up to 1000 rewards; orientations (Flipper-v0) round more
PROGRAM = """
import json, sys, warnings
warnings.filterwarnings("ignore")
import numpy, gymnasium, evogym.envs
given = json.load(sys.stdin)
body, connections = numpy.array(given["body"], float), numpy.array(given["connections"])
env = gymnasium.make(given["task"], body=body, connections=connections)
env.reset()
total, steps, over = 0.0, 0, False
for action in given["actions"]:
    _, reward, terminated, truncated, _ = env.step(numpy.array(action))
    total, steps, over = total + reward, steps + 1, terminated or truncated
    if over:
        break
print(json.dumps([total, steps, bool(over)]))
"""

pytestmark = [pytest.mark.slow, reference.NEEDED]


def check(robot: Robot) -> None:
    """Replay the actions of ``robot`` in the reference."""
    rollout = record(robot_env(robot), robot.policy)
    given = {"task": released_id(robot.task), "body": robot.body.tolist(), "connections": robot.connections.tolist()}
    given["actions"] = rollout.actions[:, 0].astype(float).tolist()
    line = [reference.PYTHON, "-I", "-c", PROGRAM]
    done = subprocess.run(line, input=json.dumps(given), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (answer,) = (line for line in done.stdout.splitlines() if line.startswith("["))  # the simulator greets after it
    total, steps, over = json.loads(answer)
    tolerance = 5e-3 if robot.task == "Flipper-v0" else ROUNDING
    assert total == pytest.approx(robot.mean_return, abs=tolerance)
    assert [steps] == robot.about["lengths"]
    assert over


@pytest.mark.parametrize("task", [name for name in zoo_tasks() if not get_task(name).is_random])
def test_the_reference_gives_the_recorded_return(task: str) -> None:
    check(zoo(task))


def test_the_reference_gives_the_return_of_a_gait() -> None:
    body, wave = load_design("mini"), np.linspace(0, 2 * np.pi, 16).reshape(2, 8)
    gait = gait_policy(body, [0, 100], [20, 12], np.full((2, 8), 0.9), wave, np.zeros((2, 8)))
    robot = Robot("UpStepper-v0", body, full_connections(body).T, gait)
    found = judge(robot)
    check(replace(robot, about={"return": found.mean_return, "lengths": found.lengths}))
