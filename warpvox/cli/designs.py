"""The keys ``designs.*``: many bodies for one policy, and bodies that it is judged on and never trained on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from warpvox.algos.settings import REFRESH
from warpvox.algos.training.bodies import Bodies, draw_bodies
from warpvox.cli.build import load_bodies
from warpvox.cli.runs import CONFIG
from warpvox.design import Design, load_design
from warpvox.envs.known_returns import known_returns
from warpvox.errors import ConfigError, DesignError
from warpvox.io.writing import write_table

if TYPE_CHECKING:
    from warpvox.algos.evaluate import Evaluation, Evaluator

__all__ = [
    "HeldOut",
    "bodies_of",
    "grid_of",
    "has_designs",
    "held_out_of",
    "is_many",
    "judged_by_its_own",
    "read_bodies",
    "resolved",
    "shades",
    "trained_on",
]

RANDOM = re.compile(r"random:(\d+)(?::(\d+)x(\d+))?")
SHAPE = (5, 5)
"""Rows and columns of random bodies that none are given for."""
HELD_OUT_SEED = 1_000_003
"""Held-out random bodies do not depend on the seed of a training, so that trainings can be compared."""
HELD_OUT = 32
"""Random bodies that are held out where none are named."""
FILES = (".json", ".npz", ".npy")
MOST = 1_000_000


def is_many(config: Any) -> bool:
    """Whether a configuration trains over many bodies."""
    designs = getattr(config, "designs", None)
    return designs is not None and designs.bodies is not None


def read_bodies(spec: Any, seed: int, key: str, without: Sequence[Design] = ()) -> list[Design]:
    """Bodies that a key names.

    Args:
        spec: ``random:64`` or ``random:64:5x7`` (drawn with ``seed``), a folder with design files, the folder of a
            design search (its bodies, the best first), or whatever the key ``design`` takes.
        key: the name of the key, for errors.
        without: bodies that random ones shall not be.

    Raises:
        DesignError, ConfigError: nothing of the kind.
    """
    if isinstance(spec, str):
        found = RANDOM.fullmatch(spec.strip())
        if found is not None:
            count, shape = int(found[1]), tuple(map(int, found.groups()[1:])) if found[2] else SHAPE
            if not 1 <= count <= MOST:
                raise ConfigError(f"{key} can be 1 to {MOST:,} random bodies, got {count:,}.")
            return draw_bodies(count, shape, np.random.default_rng(seed), without)
        if spec.startswith("random:") and spec.count(":") > 1:
            raise ConfigError(f"{key}: random bodies are random:64 or random:64:5x7, got {spec!r:.80}.")
        folder = Path(spec).expanduser()
        if folder.is_dir():
            return _of_folder(folder, key)
    bodies = load_bodies(spec, seed)
    if any(isinstance(body, dict) for body in bodies):
        raise ConfigError(f"{key} are bodies of one robot; for several robots use design.")
    return bodies


def _of_folder(folder: Path, key: str) -> list[Design]:
    from warpvox.algos.codesign.archive import FILE, Archive

    if (folder / FILE).is_file():
        with Archive.read(folder / FILE) as archive:
            best = [record.candidate.body for record in archive.best(MOST)]
        if not best:
            raise DesignError(f"{key}: the search in {folder} has evaluated no body yet.")
        return best
    files = _files(folder)
    if not files:
        raise DesignError(f"{key}: {folder} is neither a design search nor a folder of designs ({', '.join(FILES)}).")
    return [load_design(path) for path in files]


def has_designs(folder: Path) -> bool:
    """Whether a folder holds design files, and is not that of a run."""
    return bool(_files(folder)) and not (folder / CONFIG).is_file()


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in FILES)


def judged_by_its_own(config: Any) -> bool:
    """True if a policy over many bodies is judged on those that it is trained on, because the user has named them."""
    designs = config.designs
    drawn = designs.refresh == "new" or (isinstance(designs.bodies, str) and designs.bodies.startswith("random:"))
    return designs.held_out is None and not drawn


def held_out_of(config: Any) -> list[Design]:
    """Bodies that a policy over many bodies is judged on."""
    if judged_by_its_own(config):
        return read_bodies(config.designs.bodies, config.seed, "designs")
    spec = config.designs.held_out
    if spec is None:
        rows, columns = _shape(read_bodies(config.designs.bodies, config.seed, "designs"))
        spec = f"random:{HELD_OUT}:{rows}x{columns}"
    return read_bodies(spec, HELD_OUT_SEED, "designs.held_out")


def grid_of(config: Any) -> tuple[int, int]:
    """Rows and columns that there is room for: those of the key, or of the largest of all bodies.

    Raises:
        DesignError: a body that there is no room for.
    """
    largest = _shape([*read_bodies(config.designs.bodies, config.seed, "designs"), *held_out_of(config)])
    if config.designs.grid is None:
        return largest
    rows, columns = config.designs.grid
    if largest[0] > rows or largest[1] > columns:
        raise DesignError(f"There are bodies of {largest[0]}x{largest[1]}, and designs.grid is {rows}x{columns}.")
    return rows, columns


def resolved(spec: Any, seed: int, key: str) -> Any:
    """Bodies as a configuration keeps them: random ones by name, others cell by cell, whatever becomes of files."""
    if spec is None or (isinstance(spec, str) and spec.startswith("random:")):
        return spec
    return [body.tolist() for body in read_bodies(spec, seed, key)]


def bodies_of(config: Any, seed: int) -> Bodies:
    """The bodies of a training; ``seed``: of the order in which they come, which differs between processes.

    Raises:
        ConfigError: keys that do not go together.
    """
    designs, held_out = config.designs, held_out_of(config)
    bodies = read_bodies(designs.bodies, config.seed, "designs", held_out)
    if designs.refresh not in REFRESH[:2] and len(bodies) < 2:
        raise ConfigError(f"designs.refresh={designs.refresh} chooses among bodies, and there is only one.")
    if designs.refresh == "none" and len(bodies) > config.num_envs:
        raise ConfigError(
            f"{len(bodies)} bodies need as many environments, or others take their place while the policy learns:"
            f" num_envs={len(bodies)}, or designs.refresh=random."
        )
    return Bodies(bodies, designs.refresh, np.random.default_rng([seed, 1]), held_out)


def _shape(bodies: Sequence[Design]) -> tuple[int, int]:
    return max(body.shape[0] for body in bodies), max(body.shape[1] for body in bodies)


def trained_on(config: Any) -> dict[str, Any]:
    """What a checkpoint says of its training."""
    known = {"task": str(config.task), "rules": config.rules, "seed": config.seed, "design": config.design}
    if is_many(config):
        spec = config.designs
        known["design"] = None
        known["designs"] = {"bodies": spec.bodies, "refresh": spec.refresh, "held_out": spec.held_out}
    return known


def shades(task: str, returns: np.ndarray) -> list[float]:
    """How good returns are: 0 for those of random actions and below, 1 for the best published one.

    Of a task for which none is published 0 is a return of 0, and 1 the largest return by size.
    """
    known = known_returns().get(task)
    if known is None or known.best is None:
        return (returns.clip(min=0) / max(np.abs(returns).max(), 1e-9)).tolist()
    return np.clip((returns - known.random) / (known.best - known.random), 0, 1).tolist()


class HeldOut:
    """An evaluator on many bodies, which writes the return of each to a table and a picture.

    Args:
        judge: evaluates a policy on the bodies.
        bodies: those that it is evaluated on.
        name: of the files, ``held_out.csv`` and ``held_out.png``.
        task: its id, which says what returns are good.

    Attributes:
        folder: of the run; None: nothing is written.
    """

    def __init__(self, judge: Evaluator, bodies: Sequence[Design], name: str = "held_out", task: str = "") -> None:
        self.judge, self.bodies, self.name, self.task, self.folder = judge, list(bodies), name, task, None
        self.best = np.full(len(self.bodies), -np.inf)

    @property
    def about(self) -> str:
        """A description of the bodies in words."""
        count = f"{len(self.bodies)} bod{'y' if len(self.bodies) == 1 else 'ies'}"
        return f"the {count} trained on" if self.name == "bodies" else f"{count} held out from training"

    def __call__(self, policy: Any) -> Evaluation:
        """Evaluate ``policy``."""
        result = self.judge(policy)
        last = result.fitness.numpy()
        self.best = np.maximum(self.best, last)
        if self.folder is not None:
            self._write(last)
            self._draw(last)
        return result

    def state(self) -> dict[str, Any]:
        """Best returns so far, as :class:`warpvox.algos.evaluate.StatefulEvaluator` has it."""
        return {"best": torch.from_numpy(self.best.copy())}

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on from :meth:`state`."""
        self.best = state["best"].cpu().numpy().copy()

    def _draw(self, last: np.ndarray) -> None:
        """The bodies, the best first, on paper that is the greener the better they are: see :func:`shades`."""
        from warpvox.view.body_picture import write_bodies

        order = np.argsort(-last, kind="stable")
        low, middle, high = np.quantile(last, (0.1, 0.5, 0.9))
        title = f"{self.about}: mean {last.mean():.2f}, quantiles 10, 50, 90 %: {low:.2f}, {middle:.2f}, {high:.2f}"
        write_bodies(
            self.folder / f"{self.name}.png",
            [self.bodies[number] for number in order],
            [(f"{last[number]:.2f}", f"body {number}") for number in order],
            title,
            cell=20,
            shades=shades(self.task, last[order]),
            columns=8,
        )

    def _write(self, last: np.ndarray) -> None:
        cells = ["/".join("".join(map(str, row)) for row in body.tolist()) for body in self.bodies]
        figures = [[f"{value:.6g}" for value in values] for values in (last, self.best)]
        rows = zip(range(len(cells)), *figures, cells, strict=True)
        write_table(self.folder / f"{self.name}.csv", ("body", "last_return", "best_return", "cells"), rows)
