"""Checks and benchmarks of a CUDA device in one call, within a time limit.

    python benchmarks/gpu.py

A GPU is often lent for minutes, and a call may be cut off. So what matters most comes first: whether results are right,
then figures, then what takes long. Each row is saved when it is there; a part that fails is written down and the others
go on; what the time does not suffice for is left out, and said. With `--device cpu` the same program runs in a small
size.
"""

import argparse
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from statistics import median, quantiles
from typing import Any

import torch
from common import ROOT, Batch, Report, alternate, full_body, number, options, training_rates
from learning import learn
from scaling import mix_bodies, scale_envs
from tasks import measure_tasks

import warpvox as wv

FIRST_CHECKS = "tests/envs/test_device.py", "tests/algos/ppo/test_iteration.py", "tests/kernels/test_sanitizer.py"
LARGE = {
    "envs": [16384, 65536, 4096, 1024, 256, 64],
    "num_envs": 1024,
    "sizes": [5, 15, 25, 35],
    "body_envs": [1024, 16384],
    "designs": 25,
    "training": wv.DesignTraining(envs=512, iterations=20, eval_interval=20, ppo=wv.Ppo(steps=16)),
}
SMALL = {
    "envs": [8, 1],
    "num_envs": 8,
    "sizes": [3],
    "body_envs": [8, 1],
    "designs": 2,
    "training": wv.DesignTraining(envs=8, iterations=1, eval_interval=1, ppo=wv.Ppo(steps=16)),
}
"""Sizes of the benchmarks on CUDA and on the CPU: environments, sides of bodies with environments each, designs
trained side by side.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run all parts; return exit code 1 if one failed."""
    parser = options(__doc__)
    parser.set_defaults(device="cuda", reference="")
    parser.add_argument("--tasks", nargs="*", default=wv.task_ids(), metavar="TASK", help="task ids")
    parser.add_argument("--goal", type=float, default=10.0, help="return that learning is to reach")
    parser.add_argument("--seconds", type=float, default=400.0, help="no row begins after so many")
    parser.add_argument("--parts", nargs="*", metavar="PART", help="parts to do; by default all")
    args = parser.parse_args(argv)
    size = SMALL if args.device == "cpu" else LARGE
    args = argparse.Namespace(**vars(args) | size)
    many = argparse.Namespace(**vars(args) | {"num_envs": size["envs"][0], "no_training": True})
    report = Report("gpu", args)
    report.end = time.perf_counter() + args.seconds

    parts: dict[str, Callable[[], object]] = {
        "checks": lambda: check(args, report, FIRST_CHECKS),
        "environments": lambda: scale_envs(args, report),
        "profile": lambda: profile(args, report),
        "learners": lambda: compare_learners(args, report),
        "designs": lambda: train_designs(args, report),
        "learning": lambda: learn(args, report, "parallel", args.seed, seconds=60.0),
        "different bodies": lambda: mix_bodies(args, report),
        "tasks": lambda: measure_tasks(many, report),
        "large bodies": lambda: scale_sides(args, report),
        "all checks": lambda: check(args, report, ["tests", *(f"--ignore={path}" for path in FIRST_CHECKS)]),
    }
    if args.device == "cpu":
        del parts["all checks"]  # those need a GPU
    failed = []
    for name in report.in_time(args.parts or parts):
        print(f"\n{name} ({report.end - time.perf_counter():.0f} s left)", flush=True)
        try:
            parts[name]()
        except Exception as error:  # whatever it is, the other parts are worth having
            failed.append(name)
            traceback.print_exc()
            report.note(f"FAILED, {name}: {type(error).__name__}: {error}")
    if report.left_out:
        report.note(f"Left out, for the {args.seconds:g} s were over: {', '.join(report.left_out)}.")
    return bool(failed)


def check(args: argparse.Namespace, report: Report, tests: Sequence[str]) -> None:
    """Run the tests marked `gpu` in these files (on the CPU: those without a GPU), with output to a file."""
    where = report.folder / f"{'all_' if 'tests' in tests else ''}checks.txt"
    marked = "not gpu and not slow and not packaging" if args.device == "cpu" else "gpu"
    command = [sys.executable, "-m", "pytest", "-v", "-m", marked, "-p", "no:cacheprovider", "-n", "4", *tests]
    with where.open("w", encoding="utf-8") as file:
        limit = max(1.0, report.end - time.perf_counter())
        done = subprocess.run(command, cwd=ROOT, stdout=file, stderr=subprocess.STDOUT, timeout=limit)
    last = where.read_text(encoding="utf-8").strip().splitlines()[-1].strip("= ")
    assert done.returncode == 0, f"{last}; see {where}"
    report.note(f"Tests of {', '.join(tests)}: {last}.")


def scale_sides(args: argparse.Namespace, report: Report) -> None:
    """Measure rates of full bodies of each size; sizes that do not fit into memory are skipped."""
    rows = []
    for side in report.in_time(args.sizes):
        for count in args.body_envs:
            try:
                batch = Batch(args, [full_body(side, args.seed)], count)
            except wv.MemoryLimitError as error:
                report.note(f"Left out: {error}")
                continue
            rates = alternate({"": batch.random_rate}, args.repeats)[""]
            batch.assert_finite()
            rows.append([f"{side} x {side} in {count:,}", rates])
            report.row(*rows[-1])
    title = f"{args.task}, full bodies, control steps per second, float32, {args.device}"
    report.table(title, ["body, environments", "step only"], rows)


def profile(args: argparse.Namespace, report: Report) -> None:
    """Profile a training with torch's profiler and write `profile.txt`."""
    batch = Batch(args, [wv.load_design(args.design)])
    with torch.profiler.profile() as found:
        training_rates(args, batch)
    order = "self_cpu_time_total" if args.device == "cpu" else "self_device_time_total"
    table = found.key_averages().table(sort_by=order, row_limit=40, max_name_column_width=80)
    (report.folder / "profile.txt").write_text(table)


def compare_learners(args: argparse.Namespace, report: Report) -> None:
    """Measure iterations replayed as one CUDA graph and those of rsl-rl, in turn: medians and quartiles."""
    rows = []
    for count in report.in_time(sorted(n for n in args.envs if n >= args.num_envs)):
        batch = Batch(args, [wv.load_design(args.design)], count)
        # A setting of rsl-rl's own, with its default: rsl-rl learns then.
        learners = {"rsl-rl": {"extra": {"normalize_advantage_per_mini_batch": False}}, "one graph": {}}
        rates = {name: partial(trained_rate, args, batch, ppo) for name, ppo in learners.items()}
        found = alternate(rates, args.repeats)
        report.row(f"learners, {count}", *found.values())
        shown = [quartiles(values) for values in found.values()]
        rows.append([f"{count:,}", *shown, median(found["one graph"]) / median(found["rsl-rl"])])
    title = f"{args.task}, control steps per second with PPO, medians of {args.repeats} trainings in turn (quartiles)"
    report.table(title, ["environments", "rsl-rl as it is", "one graph an iteration", "ratio"], rows)


def trained_rate(args: argparse.Namespace, batch: Batch, ppo: dict[str, Any]) -> float:
    """Return the median rate over a few iterations of a new training."""
    return median(training_rates(args, batch, **ppo))


def quartiles(values: Sequence[float]) -> str:
    """Format the median and quartiles of several rates."""
    if len(values) < 2:
        return number(values)
    low, middle, high = quantiles(values, n=4, method="inclusive")
    return f"{number(middle)} ({number(low)} to {number(high)})"


def train_designs(args: argparse.Namespace, report: Report) -> None:
    """Measure control steps per second of designs trained side by side, over a whole search."""
    search = wv.RandomDesigns(population=args.designs, max_designs=args.designs)
    began = time.perf_counter()
    found = wv.codesign(
        args.task, search=search, training=args.training, device=args.device, folder=None, progress=False
    )
    seconds = time.perf_counter() - began
    steps = args.designs * args.training.envs * args.training.ppo.steps * args.training.iterations
    assert len(found.designs) == args.designs, "a design has no result"
    report.row("designs", args.designs, args.training.envs, steps / seconds)
    report.note(
        f"{args.designs} designs of {args.training.envs} environments side by side: {steps / seconds:,.0f} steps/s with"
        f" training, {args.training.iterations} iterations, preparation and evaluation included."
    )


if __name__ == "__main__":
    sys.exit(main())
