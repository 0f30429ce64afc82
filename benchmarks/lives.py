"""CPU time of creating and resetting an environment, each with a new random 5x5 body.

    python benchmarks/lives.py [--reference PYTHON] [--bodies 40] [TASK ...]

``--reference`` names an interpreter in which evogym is installed: its times stand beside ours, and its first
observations must be ours.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

TASKS = ("Walker-v0", "UpStepper-v0", "Traverser-v0", "Climber-v0", "BridgeWalker-v0", "Carrier-v0")
ROUNDING = 1e-14
"""Tolerance of observations against EvoGym, which sums a body's points in another order."""
WARM_UP = 3
"""Environments of each task that are not measured, while kernels load and terrain is meshed."""


def live(make: Callable[..., Any], task: str, body: np.ndarray) -> tuple[float, np.ndarray]:
    """Create, reset and close an environment; return CPU milliseconds and the first observation."""
    began = time.process_time()
    env = make(task, body=body)
    obs, _ = env.reset(seed=0)
    passed = time.process_time() - began
    env.close()
    return 1e3 * passed, np.array(obs)


def reference_lives(interpreter: str, task: str, bodies: list[np.ndarray]) -> tuple[list[float], list[list[float]]]:
    """Run this script in EvoGym's interpreter; return times and first observations."""
    # Isolated, because the drop-in puts its own ``evogym`` on PYTHONPATH for children.
    command = [interpreter, "-I", __file__, "--serve", task]
    sent = json.dumps([body.tolist() for body in bodies])
    found = subprocess.run(command, input=sent, capture_output=True, text=True, check=True)
    # The simulator prints its name, too, at the start or at the end.
    answer = next(line for line in found.stdout.splitlines() if line.startswith("[["))
    times, observations = json.loads(answer)
    return times, observations


def serve(task: str) -> None:
    """Read bodies and print times and first observations, in EvoGym's interpreter."""
    import evogym.envs  # noqa: F401  # pyright: ignore[reportMissingImports]  # registers the tasks
    import gymnasium

    lives = [live(gymnasium.make, task, np.array(body)) for body in json.load(sys.stdin)]
    print()
    print(json.dumps([[ms for ms, _ in lives], [obs.tolist() for _, obs in lives]]))


def measure(task: str, count: int, interpreter: str | None) -> dict[str, float]:
    """Measure median milliseconds for each way to create an environment; AssertionError: a wrong observation."""
    import gymnasium

    import warpvox as wv

    bodies = [wv.sample_design((5, 5), seed=seed) for seed in range(count + WARM_UP)]
    times: dict[str, list[float]] = {"gymnasium": [], "drop-in": []}
    observations = []
    for body in bodies:
        # One after the other, so that what else the machine does slows both
        ours_ms, ours = live(gymnasium.make, f"warpvox/{task}", body)
        drop_in_ms, drop_in = live(gymnasium.make, task, body)
        expected, _ = wv.make_vec(task, [body], device="cpu", dtype="float64", threads=1).reset(0)
        assert np.array_equal(ours, expected[0].numpy()), f"{task}: gymnasium observes something else"
        assert np.array_equal(drop_in, ours), f"{task}: the drop-in observes something else"
        times["gymnasium"].append(ours_ms)
        times["drop-in"].append(drop_in_ms)
        observations.append(ours)
    if interpreter is not None:
        times["evogym"], theirs = reference_lives(interpreter, task, bodies)
        for ours, other in zip(observations, theirs, strict=True):
            assert np.allclose(ours, other, rtol=0, atol=ROUNDING), f"{task}: evogym observes something else"
    return {name: statistics.median(values[WARM_UP:]) for name, values in times.items()}


def main() -> None:
    """Print a table of the medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", default=TASKS, metavar="TASK")
    parser.add_argument("--reference", metavar="PYTHON", help="an interpreter with evogym")
    parser.add_argument("--bodies", type=int, default=40, help="lives of each task")
    parser.add_argument("--serve", metavar="TASK", help=argparse.SUPPRESS)
    options = parser.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # of gymnasium, about ids with a newer version
    if options.serve:
        serve(options.serve)
        return

    import warpvox.envs  # noqa: F401  # registers the tasks
    from warpvox.evogym import install

    install()
    import evogym.envs  # noqa: F401  # pyright: ignore[reportMissingImports]  # registers the tasks

    names = ["gymnasium", "drop-in", *(["evogym"] if options.reference else [])]
    print(f"ms of CPU, median of {options.bodies} environments with a new body each")
    print(f"{'task':22}" + "".join(f"{name:>12}" for name in names), flush=True)
    for task in options.tasks:
        medians = measure(task, options.bodies, options.reference)
        print(f"{task:22}" + "".join(f"{medians[name]:12.1f}" for name in names), flush=True)


if __name__ == "__main__":
    main()
