"""Time to reach a return: warpvox's PPO settings and EvoGym's.

python benchmarks/learning.py --threads 2
"""

import argparse
from collections.abc import Mapping, Sequence
from contextlib import suppress
from statistics import median
from typing import Any

from common import Batch, Report, number, options

import warpvox as wv

NUM_ENVS = {"parallel": 512, "evogym": 4}
"""Number of environments of each settings."""


class TimeIsOverError(Exception):
    """A training exceeded its time limit."""


def main(argv: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--ppo", nargs="*", default=list(NUM_ENVS), help="settings that are compared")
    parser.add_argument("--seeds", type=int, default=3, help="trainings with each")
    parser.add_argument("--goal", type=float, default=10.0, help="return to reach in a deterministic evaluation")
    parser.add_argument("--seconds", type=float, default=150.0, help="of a training, at most")
    args = parser.parse_args(argv)
    report = Report("learning", args)
    rows = []
    for ppo in args.ppo:
        runs = [learn(args, report, ppo, args.seed + k, args.seconds) for k in range(args.seeds)]
        reached = [run for run in runs if run["reached"]]
        seconds = [run["seconds"] for run in reached]
        between = f"{number(min(seconds))} to {number(max(seconds))}" if reached else "-"
        steps = round(median(run["steps"] for run in reached)) if reached else None
        best = max(run["best_return"] for run in runs)
        name = f"ppo={ppo}, {NUM_ENVS[ppo]} environments"
        rows.append([name, f"{len(reached)} of {len(runs)}", seconds, between, steps, best])
    headings = ["", f"reached {args.goal:g}", "seconds", "from, to", "control steps", "best return"]
    title = f"{args.task}, {args.threads} threads, {args.device}: time to a return of {args.goal:g}"
    report.table(title, headings, rows)
    report.note(
        "Seconds of wall-clock time, evaluations included, kernels loaded; medians of the runs that got there."
        f" Others ended with the settings' own number of iterations or after {args.seconds:g} s."
    )


def learn(args: argparse.Namespace, report: Report, ppo: str, seed: int, seconds: float) -> dict[str, Any]:
    """Train until an evaluation reaches the goal or time is over; return steps, seconds and return."""
    common: dict[str, Any] = {"ppo": ppo, "device": args.device, "threads": args.threads, "seed": seed}
    common |= {"folder": None, "progress": False}
    Batch(args, [wv.load_design(args.design)], NUM_ENVS[ppo])  # asserts that the physics are right
    wv.train(args.task, args.design, max_iterations=2, **common)  # loads the kernels
    rows: list[Mapping[str, float]] = []

    def watch(row: Mapping[str, float]) -> None:
        rows.append(row)
        if row["elapsed"] > seconds:
            raise TimeIsOverError

    run = None
    with suppress(TimeIsOverError):
        run = wv.train(args.task, args.design, stop_return=args.goal, listeners=[watch], **common)
    best = rows[-1]["best_return"]
    if run is not None:
        repeated = wv.evaluate(run.policy, args.task, args.design, episodes=1)[0].mean
        assert abs(repeated - best) < 1e-3, f"the policy's return is {repeated:.3f}, not {best:.3f}"
    took = {"seconds": rows[-1]["elapsed"], "steps": int(rows[-1]["steps"]), "best_return": best}
    report.row(f"ppo={ppo}, seed {seed}", *took.values())
    return {"reached": best >= args.goal, **took}


if __name__ == "__main__":
    main()
