"""Search for bodies compared by one shared policy: python -m lab.shared_policy.search FOLDER [--pretrained RUN]"""

from __future__ import annotations

import argparse
import csv
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import warpvox as wv
from warpvox.algos.candidate import Candidate, Outcome


class CommonPolicy:
    """Evaluation by one policy trained on all bodies of the batch.

    Each batch is a training of its own, in a folder that is named by its first candidate. A search that is killed and
    goes on makes the training under way again, to the same results.

    Args:
        folder: of the trainings.
        pretrained: what each training begins with; None: what the training before has learned.
        iterations: of learning on a batch.
        envs: for each body.
        seed: of the trainings; that of the first candidate is added.
        training: further arguments of ``wv.train``: ``policy``, ``network``, ``ppo``, ``device``, ...
    """

    def __init__(
        self,
        folder: Path,
        task: str = "Walker-v0",
        pretrained: str | Path | None = None,
        iterations: int = 10,
        envs: int = 16,
        seed: int = 0,
        **training: Any,
    ) -> None:
        self.folder = folder
        self.task = task
        self.pretrained = pretrained
        self.iterations = iterations
        self.envs = envs
        self.seed = seed
        self.training: dict[str, Any] = {"policy": "grid", **training}

    def evaluate(
        self,
        candidates: Sequence[Candidate],
        parents: Mapping[int, Any],
        report: Callable[[dict[str, Any]], None] | None = None,
    ) -> list[Outcome]:
        """Evaluate candidates and return outcomes in their order; ``report`` is called after each iteration."""
        first = candidates[0].id
        run_folder = self.folder / f"from_{first:06}"
        # What is left of a training that was killed
        shutil.rmtree(run_folder, ignore_errors=True)
        earlier = sorted(place for place in self.folder.glob("from_*") if place.name < run_folder.name)
        begin = self.pretrained
        if begin is None and earlier:
            begin = earlier[-1] / f"model_{self.iterations}.pt"

        def tell(row: Mapping[str, float]) -> None:
            if report is not None:
                progress = {"iteration": int(row["iteration"]), "iterations": self.iterations}
                unknown = {"best": [float("nan")] * len(candidates), "training": [True] * len(candidates)}
                report({**progress, "steps": int(row["steps"]), **unknown})

        wv.train(
            self.task,
            designs={"bodies": [candidate.body.tolist() for candidate in candidates], "refresh": "none"},
            num_envs=self.envs * len(candidates),
            max_iterations=self.iterations,
            eval_interval=self.iterations,
            pretrained=None if begin is None else str(begin),
            seed=self.seed + first,
            folder=run_folder,
            progress=False,
            listeners=[tell],
            **self.training,
        )

        # The evaluation after the last iteration
        with (run_folder / "bodies.csv").open(encoding="utf-8") as file:
            returns = [float(row["last_return"]) for row in csv.DictReader(file)]
        with (run_folder / "metrics.csv").open(encoding="utf-8") as file:
            steps = int(float(list(csv.DictReader(file))[-1]["steps"]))
        each = steps // len(candidates)
        return [Outcome(value, [(each, value)], each) for value in returns]


def search(
    folder: Path,
    task: str = "Walker-v0",
    shape: tuple[int, int] = (5, 5),
    settings: Any = None,
    finalists: int = 4,
    training: Any = None,
    seed: int = 0,
    **policy: Any,
) -> tuple[wv.Found, wv.Found]:
    """Run a search by a shared policy, then train each of the best bodies.

    Args:
        settings: of the search, ``wv.GA(...)`` for instance.
        finalists: how many bodies get a training of their own.
        training: of the finalists, ``wv.DesignTraining(...)``.
        policy: further arguments of :class:`CommonPolicy`.

    Returns:
        The search, and its finalists.
    """
    common = {"shape": shape, "seed": seed, "progress": False}
    common |= {name: policy[name] for name in ("device", "threads") if name in policy}
    fitness = CommonPolicy(folder / "policy", task, seed=seed, **policy)
    found = wv.codesign(task, search=settings or wv.GA(), fitness=fitness, folder=folder / "search", **common)

    best = sorted(found.designs, key=lambda record: -(record.fitness or 0.0))
    bodies: dict[bytes, Any] = {}
    for record in best:
        bodies.setdefault(record.candidate.body.tobytes(), record.candidate.body)
    start = list(bodies.values())[:finalists]
    again = wv.RandomDesigns(population=len(start), max_designs=len(start))
    more = {} if training is None else {"training": training}
    finals = wv.codesign(task, search=again, start=start, folder=folder / "finalists", **common, **more)
    return found, finals


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the search, new or to go on with")
    parser.add_argument("--task", default="Walker-v0")
    parser.add_argument("--pretrained", help="a training with designs=..., whose policy each generation begins with")
    parser.add_argument("--designs", type=int, default=250)
    parser.add_argument("--finalists", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found, finals = search(
        given.folder,
        given.task,
        settings=wv.GA(max_designs=given.designs),
        finalists=given.finalists,
        pretrained=given.pretrained,
        seed=given.seed,
    )
    print(f"{len(found.designs)} bodies by one policy: best {found.best.fitness:.3f}")
    print(f"{len(finals.designs)} finalists, each with a policy of its own: best {finals.best.fitness:.3f}")
    print(f"look at it: warpvox play run={finals.folder}")


if __name__ == "__main__":
    main()
