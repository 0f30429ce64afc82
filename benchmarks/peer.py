"""Speed of one task: a batch, one gymnasium environment, one of the drop-in, and EvoGym, measured in turn.

    python benchmarks/peer.py --task Walker-v0

Needs a Python with evogym 2.0.0: `make reference`.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from statistics import median
from typing import Any

import gymnasium
import numpy as np
from common import CHECKED_STEPS, COLUMNS, Batch, Reference, Report, alternate, measure, options
from evogym_worker import SPELLED, cpu_seconds

import warpvox as wv
import warpvox.envs
import warpvox.evogym.envs  # both register their environments


def main(argv: Sequence[str] | None = None) -> None:
    args = options(__doc__).parse_args(argv)
    body = wv.load_design(args.design)
    rng = np.random.default_rng(args.seed)
    report = Report("peer", args)

    with Reference(args.reference) as reference:
        # Check
        error = reference.difference(args.task, body, args.seed)
        batch = Batch(args, [body])
        report.note(f"Checked: within {error:.1e} of EvoGym over {CHECKED_STEPS} steps in float64.")

        # Measure
        versions = reference.start(args.task, body)
        ours = f"warpvox, {args.num_envs} environments"
        theirs = f"evogym {versions['evogym']}, Python {versions['python']}"
        single = gymnasium.make(f"warpvox/{args.task}", body=body, device=args.device, disable_env_checker=True)
        released = SPELLED.get(args.task) or args.task
        drop_in = gymnasium.make(released, body=body.astype(float), disable_env_checker=True)
        rates: dict[str, Callable[[], float]] = {
            ours: batch.random_rate,
            "warpvox, one gymnasium environment": single_rate(single, args, rng),
            "warpvox, one environment of the drop-in": single_rate(drop_in, args, rng),
            theirs: partial(reference.rate, args.steps, batch.env.num_actions, rng),
        }
        found = alternate(rates, args.repeats)
    batch.assert_finite()

    # Report
    rows = [[name, rates, median(rates) / median(found[theirs])] for name, rates in found.items()]
    for row in rows:
        report.row(*row)
    title = f"{args.task}, control steps per second: median (least to most)"
    report.table(title, ["", "step only", "ratio"], rows, ranges=True)
    report.table("The batch in parts", COLUMNS, [list(measure(args, batch).values())])


def single_rate(env: Any, args: argparse.Namespace, rng: np.random.Generator) -> Callable[[], float]:
    """Return a function that measures one gymnasium environment under random actions."""
    size = args.steps, env.action_space.shape[0]
    env.reset(seed=args.seed)
    env.step(env.action_space.sample())
    return lambda: args.steps / cpu_seconds(env, rng.uniform(0.6, 1.6, size))


if __name__ == "__main__":
    main()
