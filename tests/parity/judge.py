"""Judge recordings of the reference: which runs are reproduced, which bit for bit, and how far off the others are.

    python tests/parity/judge.py tests/parity/recordings

replays every run of every file, at most 200 control steps of it, strictly: no allowance for ties or chaos. With
``--whole`` it compares the returns of whole episodes instead. New runs to judge come from ``record.py --seed`` and
``record.py --whole`` where the reference is installed.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from replay import Replay, Run, load_runs, obs_error, position_error, replay, reward_error

POSITION = 1e-9  # simulator units, over 60 control steps: what is larger is another model, not rounding
REWARD = 1e-6  # over 200 control steps
OBSERVATION = 1e-9
ANGLE = 5e-3  # the arc cosine of the orientation is guarded at 0.99999, which makes noise of this size
STEPS = 200


@dataclass(frozen=True)
class Verdict:
    """What a run came to; ``exact``: all positions recorded are equal bit for bit."""

    position: float
    observation: float
    angle: float
    reward: float
    ends: bool
    exact: bool

    @property
    def near(self) -> bool:
        return self.position < POSITION and self.observation < OBSERVATION and self.angle < ANGLE

    @property
    def passed(self) -> bool:
        return self.near and self.reward < REWARD and self.ends

    def __str__(self) -> str:
        errors = f"position {self.position:.1e}, observation {self.observation:.1e}, angle {self.angle:.1e}"
        return f"{errors}, reward {self.reward:.1e}, ends {'equal' if self.ends else 'DIFFER'}"


def verdict(run: Run, ours: Replay) -> Verdict:
    """Compare all of a replay."""
    plain, angle = obs_error(run, ours)
    place, steps = position_error(run, ours), len(ours.reward)
    same_ends = np.array_equal(ours.terminated, run.arrays["terminated"][:steps])
    same_ends &= np.array_equal(ours.truncated, run.arrays["truncated"][:steps])
    return Verdict(
        float(place.max()), float(plain.max()), float(angle.max()), float(reward_error(run, ours).max()),
        bool(same_ends), bool(place.max() == 0.0),
    )  # fmt: skip


def judge(run: Run, device: str = "cpu") -> Verdict:
    """Replay a run and compare."""
    return verdict(run, replay(run, STEPS, device=device))


def ranks(values: np.ndarray) -> np.ndarray:
    """Ranks from 0, the mean of their places for equal values."""
    ordered = np.sort(values)
    return (np.searchsorted(ordered, values) + np.searchsorted(ordered, values, side="right") - 1) / 2


@dataclass(frozen=True)
class Comparison:
    """Returns of ours against theirs: mean of the paired differences and its standard error, the largest, ranks."""

    runs: int
    mean: float
    error: float
    largest: float
    equal: int
    rank: float

    def __str__(self) -> str:
        return (
            f"returns of {self.runs} runs: mean difference {self.mean:.1e} (standard error {self.error:.1e}), "
            f"largest {self.largest:.1e}, {self.equal} within {REWARD:.0e}; rank correlation {self.rank:.6f}"
        )


def compare(theirs: np.ndarray, ours: np.ndarray) -> Comparison:
    """Paired differences and rank correlation."""
    gap = ours - theirs
    error = gap.std(ddof=1) / np.sqrt(len(gap))
    rank = np.corrcoef(ranks(theirs), ranks(ours))[0, 1]
    near = int((np.abs(gap) < REWARD).sum())
    return Comparison(len(gap), float(gap.mean()), float(error), float(np.abs(gap).max()), near, float(rank))


def judge_returns(runs: list[Run]) -> None:
    theirs, ours = [], []
    for run in runs:
        theirs.append(run.arrays["reward"].sum())
        ours.append(replay(run).reward.sum())
        gap = ours[-1] - theirs[-1]
        print(f"{run}: {len(run.actions)} steps, return {theirs[-1]:.6f}, ours differs by {gap:.1e}", flush=True)
    print(compare(np.array(theirs), np.array(ours)))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tasks", nargs="*", help="default: every file of the folder")
    parser.add_argument("--whole", action="store_true", help="returns of whole episodes")
    args = parser.parse_args()
    torch.set_num_threads(1)
    runs = [run for run in load_runs(args.folder) if not args.tasks or run.task in args.tasks]
    if args.whole:
        judge_returns(runs)
        return
    verdicts = []
    for run in runs:
        found = judge(run)
        verdicts.append(found)
        word = "failed" if not found.passed else "exact" if found.exact else "passed"
        print(f"{word:7s}{run}: {found}", flush=True)
    passed, exact = sum(v.passed for v in verdicts), sum(v.exact for v in verdicts)
    print(f"{passed} of {len(verdicts)} runs pass, the positions of {exact} are equal bit for bit")


if __name__ == "__main__":
    main()
