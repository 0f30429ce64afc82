"""The reference's half of ``warpvox bench``.

Runs as a script under an interpreter that has evogym installed (Python 3.10, no warpvox), reads one JSON
request a line from stdin and answers each with one JSON line on stdout:

- ``{"do": "start", "task": ..., "body": ...}`` comes first and gives the versions;
- ``{"do": "check", "actions": [steps][actuators]}`` gives ``[steps][2]``, the robot's centre of mass
  after each step from a reset on;
- ``{"do": "time", "actions": ...}`` gives the CPU seconds of these steps, which go on with the episode,
  rewards and observations included;
- ``{"error": ...}`` is the answer where the reference fails.
"""

import json
import os
import sys
import time
import warnings

import numpy


def main():
    """Answer requests until stdin ends."""
    # Whatever the libraries print must not mix with the answers.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    warnings.filterwarnings("ignore")
    env = None
    for line in sys.stdin:
        request = json.loads(line)
        try:
            if request["do"] == "start":
                env, answer = start(request["task"], request["body"])
            else:
                answer = {"check": centres, "time": cpu_seconds}[request["do"]](env, numpy.array(request["actions"]))
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers)


def start(task, body):
    """Make the environment; returns it and the versions."""
    from importlib.metadata import version

    import evogym.envs  # noqa: F401  (registers)
    import gymnasium

    gymnasium.logger.min_level = 50
    env = gymnasium.make(task, body=numpy.array(body, dtype=float), disable_env_checker=True)
    env.reset()
    return env, {"python": sys.version.split()[0], "evogym": version("evogym")}


def centres(env, actions):
    """The trajectory of the centre of mass."""
    env.reset()
    com = []
    for action in actions:
        env.step(action)
        world = env.unwrapped
        com.append(world.object_pos_at_time(world.get_time(), "robot").mean(axis=1).tolist())
    env.reset()
    return com


def cpu_seconds(env, actions):
    """CPU seconds of the steps of a gymnasium environment; resets of episodes that end in between are not counted."""
    seconds, began = 0.0, time.process_time()
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            seconds += time.process_time() - began
            env.reset()
            began = time.process_time()
    return seconds + time.process_time() - began


if __name__ == "__main__":
    main()
