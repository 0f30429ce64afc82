"""EvoGym's side of the benchmarks: runs in a Python 3.10 with EvoGym and without warpvox.

Reads one JSON request a line from stdin and answers each with one JSON line on stdout:

- ``{"task": ..., "body": ...}`` makes an environment and gives the versions;
- ``{"actions": [steps][actuators], "centres": false}`` steps it and gives the CPU seconds, rewards and observations
  included; with ``true`` the robot's centre of mass after each step, ``[steps][2]``.
"""

import json
import os
import sys
import time
import warnings

import numpy

SPELLED = {"WingspanMaximizer-v0": "WingspanMazimizer-v0"}
"""Ids of tasks whose spelling differs in the release."""


def main():
    """Answer requests in JSON lines until standard input ends."""
    # What the libraries print must not mix with the answers.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    warnings.filterwarnings("ignore")
    env = None
    for line in sys.stdin:
        request = json.loads(line)
        if "task" in request:
            env, answer = make(request["task"], request["body"])
        elif request["centres"]:
            answer = centres(env, numpy.array(request["actions"]))
        else:
            answer = cpu_seconds(env, numpy.array(request["actions"]))
        print(json.dumps(answer), file=answers)


def make(task: str, body: list):
    """Create the environment; return it with the versions."""
    from importlib.metadata import version

    import evogym.envs  # noqa: F401  # pyright: ignore[reportMissingImports]  (registers)
    import gymnasium

    gymnasium.logger.min_level = 50
    env = gymnasium.make(SPELLED.get(task, task), body=numpy.array(body, dtype=float), disable_env_checker=True)
    env.reset()
    return env, {"python": sys.version.split()[0], "evogym": version("evogym")}


def centres(env, actions):
    """Record the trajectory of the centre of mass."""
    com = []
    for action in actions:
        env.step(action)
        world = env.unwrapped
        com.append(world.object_pos_at_time(world.get_time(), "robot").mean(axis=1).tolist())
    return com


def cpu_seconds(env, actions):
    """Measure CPU seconds of the steps of a gymnasium environment, without resets in between."""
    seconds = 0.0
    for action in actions:
        began = time.process_time()
        _, _, terminated, truncated, _ = env.step(action)
        seconds += time.process_time() - began
        if terminated or truncated:
            env.reset()
    return seconds


if __name__ == "__main__":
    main()
