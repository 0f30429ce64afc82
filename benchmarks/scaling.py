"""Scaling with larger bodies, more environments, more threads, exact arithmetic and different bodies.

    python benchmarks/scaling.py --sizes 5 10 15 20 25 30 35 --bodies 3 --simulated 2

The first table is the paper's Figure 2 (section A.5): robots of n x n voxels, one at a time on the terrain of
Walker-v0, under random actions. Beside it: EvoGym, and a batch of the first robot. ``--sizes --envs``, without numbers,
leaves out the first two tables.
"""

import argparse
from collections.abc import Sequence
from statistics import fmean, median
from typing import Any

import numpy as np
import torch
from common import (
    COLUMNS,
    Batch,
    Reference,
    Report,
    alternate,
    full_body,
    measure,
    number,
    open_reference,
    options,
    sampled_bodies,
)

import warpvox as wv

STEPS_PER_SECOND = 50
"""Control steps of a simulated second (section A.2)."""
CHECK_STEPS = 20
"""Steps over which large bodies are compared with EvoGym; contacts amplify round-off."""
ALONE = 4
"""Number of random bodies measured in batches of one body, for comparison with mixed batches."""


def main(argv: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--sizes", nargs="*", type=int, default=list(range(5, 36)), help="sizes n of bodies n x n")
    parser.add_argument("--bodies", type=int, default=10, help="robots of each size")
    parser.add_argument("--simulated", type=float, default=10.0, help="simulated seconds of each robot")
    envs = [1, 8, 64, 512, 4096, 16384, 65536]
    parser.add_argument("--envs", nargs="*", type=int, default=envs, help="numbers of environments")
    args = parser.parse_args(argv)
    report = Report("scaling", args)
    scale_bodies(args, report)
    scale_envs(args, report)
    if args.device == "cpu":
        scale_threads(args, report)
    compare_arithmetic(args, report)
    mix_bodies(args, report)


def scale_bodies(args: argparse.Namespace, report: Report) -> None:
    """Measure robots of each size: one environment, EvoGym, and a batch."""
    headings = ["robots", "voxels", "steps/s", "reference", "ratio", "in a batch", "batch of", "ratio"]
    rows = []
    with open_reference(args) as reference:
        for side in report.in_time(args.sizes):
            rows.append(scale_body(args, side, reference))
            report.row(*rows[-1])
    title = f"{args.task}, means of {args.bodies} robots, one at a time, {args.simulated:g} simulated seconds each"
    report.table(f"{title}: control steps per second", headings, rows)
    report.note(
        f"Checked: the first robot of each size with {'EvoGym' if reference else 'one environment alone in float64'}."
        " Voxels: those that are not empty; in a batch: the first robot of a size in so many environments."
    )


def scale_body(args: argparse.Namespace, side: int, reference: Reference | None) -> list[Any]:
    """Measure one size and return the table row."""
    # Independent voxels of a large grid are hardly ever connected: then bodies are full.
    kind = "sampled"
    try:
        bodies = sampled_bodies(side, args.bodies, args.seed)
    except wv.DesignError:
        kind = "full"
        bodies = [full_body(side, args.seed + k) for k in range(args.bodies)]

    # Robots one at a time
    rng = np.random.default_rng(args.seed)
    steps = max(1, round(args.simulated * STEPS_PER_SECOND))
    ours = []
    theirs = []
    for body in bodies:
        one = Batch(args, [body], 1)
        ours.append(one.random_rate(steps))
        one.assert_finite()
        if reference is not None:
            if not theirs:
                reference.difference(args.task, body, args.seed, CHECK_STEPS)
            reference.start(args.task, body)
            theirs.append(reference.rate(steps, one.env.num_actions, rng))

    # A batch of the first, smaller for larger bodies, in whole packs of 32
    count = args.num_envs
    if count > 32:
        count = max(32, count * 25 // side**2 // 32 * 32)
    batch = Batch(args, bodies[:1], count)
    rates = alternate({"": batch.random_rate}, args.repeats)[""]
    batch.assert_finite()

    row = [f"{side} x {side} {kind}", round(fmean(np.count_nonzero(body) for body in bodies)), fmean(ours)]
    if reference is None:
        return [*row, None, None, rates, count, None]
    return [*row, fmean(theirs), fmean(ours) / fmean(theirs), rates, count, median(rates) / theirs[0]]


def scale_envs(args: argparse.Namespace, report: Report) -> None:
    """Measure rates by number of environments; what does not fit into memory is skipped."""
    body = wv.load_design(args.design)
    rows = []
    for count in report.in_time(args.envs):
        try:
            found = measure(args, Batch(args, [body], count))
        except wv.MemoryLimitError as error:
            report.note(f"Left out: {error}")
            continue
        rows.append([f"{count:,}", *found.values()])
        report.row(*rows[-1])
    title = f"{args.task}, control steps per second, float32, {args.device}"
    report.table(title, ["environments", *COLUMNS], rows)


def scale_threads(args: argparse.Namespace, report: Report) -> None:
    """Measure control steps per second with one thread and with all cores."""
    body = wv.load_design(args.design)
    batches = [Batch(args, [body], threads=threads) for threads in (1, None)]
    found = alternate({str(batch.env.sim.threads): batch.random_rate for batch in batches}, args.repeats)
    rows = [[name, rates, median(rates) / median(found["1"])] for name, rates in found.items()]
    title = f"{args.task}, {args.num_envs} environments, control steps per second"
    report.table(title, ["threads", "step only", "gain"], rows)


def compare_arithmetic(args: argparse.Namespace, report: Report) -> None:
    """Measure control steps per second in fast and exact arithmetic."""
    body = wv.load_design(args.design)
    cases = {
        "fast, float32": {},
        "fast, float64": {"dtype": "float64", "arithmetic": "fast"},
        "exact, float64": {"dtype": "float64", "arithmetic": "exact"},
    }
    batches = {name: Batch(args, [body], **given) for name, given in cases.items()}
    found = alternate({name: batch.random_rate for name, batch in batches.items()}, args.repeats)
    for batch in batches.values():
        batch.assert_finite()
    rows = [[name, rates, median(rates) / median(found["fast, float32"])] for name, rates in found.items()]
    title = f"{args.task}, {args.num_envs} environments, control steps per second"
    report.table(title, ["arithmetic", "step only", "speed of fast, float32"], rows, ranges=True)


def mix_bodies(args: argparse.Namespace, report: Report) -> None:
    """Measure a batch of different bodies, one of equal bodies, and the exchange of some bodies."""
    count = args.num_envs
    bodies = sampled_bodies(5, count, args.seed)
    cases = {f"body {k} in all": [body] for k, body in enumerate(bodies[:ALONE])}
    cases["a full body in all"] = [full_body(5, args.seed)]
    batches = {name: Batch(args, designs) for name, designs in cases.items()}
    mixed = Batch(args, bodies, grid=(5, 5))  # last: the others have loaded the kernels
    batches = {f"{count} different bodies": mixed} | batches

    found = alternate({name: batch.random_rate for name, batch in batches.items()}, args.repeats)
    for batch in batches.values():
        batch.assert_finite()
    title = f"{args.task}, {count} environments, random 5x5 bodies, control steps per second"
    report.table(title, ["", "step only"], list(found.items()), ranges=True)

    # An eighth of the bodies is exchanged for new ones, as often as there are repetitions.
    mask = torch.arange(count, device=mixed.env.device) % 8 == 0
    times = []
    for repeat in range(args.repeats + 1):
        others = sampled_bodies(5, int(mask.sum()), args.seed + 1 + repeat)
        began = mixed.clock()
        mixed.env.set_designs(others, mask)
        times.append(mixed.clock() - began)
    different, *same, full = map(median, found.values())
    worst = max(batch.error for batch in batches.values())
    report.note(
        f"Different bodies step at {different / fmean(same):.0%} of the speed of one in all (the mean of {len(same)}),"
        f" and at {different / full:.0%} of that of a body without empty cells. They were built in {mixed.built:.2f} s;"
        f" {len(others)} of {count} were exchanged in {number(1e3 * median(times[1:]))} ms. Checked: each within"
        f" {worst:.1e} of one environment alone in float64."
    )


if __name__ == "__main__":
    main()
