"""Feed spoilt inputs to all readers and public functions, and print what became of them.

    python tests/fuzz/run.py count=100000 [seed=0] [only=rollout] [show=5]

``count`` is shared out by weight among all targets; ``only`` picks those whose name has this part (or, after a
semicolon, that). Ends with 1 if there was a defect:
an error that is not of warpvox, an input that took too long or too much memory, or an accepted one that is of no use.
The same seed gives the same inputs, whatever the other arguments are.
"""

from __future__ import annotations

import faulthandler
import os
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fuzz_arguments import Editor, Environments, function_targets
from fuzz_files import Readers
from fuzz_harness import Target, feed, shortened

LONGEST = 7200
"""Seconds for a target, after which the process is ended with a trace: a loop in a library cannot be interrupted."""


@contextmanager
def all_targets() -> Iterator[list[Target]]:
    """Every target, in a folder of its own that is gone afterwards."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        editor = Editor(folder)
        os.chdir(folder)
        try:
            yield [
                *Readers(folder).targets(),
                *function_targets(folder),
                *editor.targets(),
                *Environments().targets(),
            ]
        finally:
            os.chdir(before)
            editor.close()


def main(words: list[str]) -> int:
    """Run and print the table; returns the exit code."""
    given = dict(word.split("=", 1) for word in words)
    count, seed, show = (
        int(given.get(name, default)) for name, default in (("count", 10000), ("seed", 0), ("show", 5))
    )
    total = accepted = defects = 0
    start = time.perf_counter()
    print(f"{'reader':<24} {'inputs':>8} {'accepted':>8} {'refused':>8} {'defects':>7} {'slowest s':>9} {'peak MB':>8}")
    with all_targets() as targets:
        weights = sum(target.weight for target in targets)
        parts = given.get("only", "").split(";")
        chosen = [target for target in targets if any(part in target.name for part in parts)]
        for target in chosen:
            faulthandler.dump_traceback_later(LONGEST, exit=True)
            figures = feed(target, -(-count * target.weight // weights), seed, show)
            faulthandler.cancel_dump_traceback_later()
            total, accepted = total + figures.inputs, accepted + figures.accepted
            defects += len(figures.defects)
            print(
                f"{target.name:<24} {figures.inputs:>8} {figures.accepted:>8} {figures.refused:>8}"
                f" {len(figures.defects):>7} {figures.slowest:>9.2f} {figures.peak / 1e6:>8.1f}",
                flush=True,
            )
            for given_input, defect in figures.defects:
                print(f"    {shortened(given_input)}\n    {defect.strip()}\n".replace("\n", "\n    "), flush=True)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{total} inputs, {accepted} accepted, {defects} defects, {time.perf_counter() - start:.0f} s, {memory:.0f} MB"
    )
    return 1 if defects else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
