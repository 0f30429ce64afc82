"""Speed of each task, compared with EvoGym if available.

python benchmarks/tasks.py
"""

import argparse
from collections.abc import Sequence
from statistics import median

import numpy as np
from common import CHECKED_STEPS, COLUMNS, Batch, Report, measure, number, open_reference, options

import warpvox as wv


def main(argv: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--tasks", nargs="*", default=wv.task_ids(), metavar="TASK", help="task ids")
    args = parser.parse_args(argv)
    measure_tasks(args, Report("tasks", args))


def measure_tasks(args: argparse.Namespace, report: Report) -> None:
    """Measure each task: rates, and the speed-up over EvoGym of a whole control step."""
    body = wv.load_design(args.design)
    rng = np.random.default_rng(args.seed)
    rows = []
    errors = []
    with open_reference(args) as reference:
        for task in report.in_time(args.tasks):
            # Check
            batch = Batch(args, [body], task=task)
            errors.append(batch.error if reference is None else reference.difference(task, body, args.seed))

            # Measure, EvoGym right after warpvox
            found = measure(args, batch)
            theirs = ratio = None
            if reference is not None:
                reference.start(task, body)
                theirs = [reference.rate(args.steps, batch.env.num_actions, rng) for _ in range(args.repeats)]
                ratio = median(found["step only"]) / median(theirs)
            rows.append([task, *found.values(), theirs, ratio])
            report.row(*rows[-1])

    title = f"Control steps per second, {args.num_envs} environments, float32, {args.device}"
    report.table(title, ["task", *COLUMNS, "reference", "ratio"], rows)
    beside = f"EvoGym over {CHECKED_STEPS} steps" if reference else "one environment alone"
    report.note(f"Checked: each within {max(errors, default=0.0):.1e} of {beside} in float64.")
    ratios = [row[-1] for row in rows if row[-1] is not None]
    if ratios:
        least, most = min(ratios), max(ratios)
        report.note(f"Ratio: median {number(median(ratios))}, least {number(least)}, most {number(most)}.")


if __name__ == "__main__":
    main()
