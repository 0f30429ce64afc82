"""The command line's work from Python: train a policy, load one."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpvox.errors import ConfigError

if TYPE_CHECKING:
    from warpvox.algos.checkpoints.policy import Policy

__all__ = ["TrainedRun", "load_policy", "train"]


@dataclass(frozen=True)
class TrainedRun:
    """A run that has been trained.

    Attributes:
        folder: of the run, as ``warpvox play run=FOLDER`` takes it.
        summary: what ``summary.json`` says: ``status``, ``iterations``, ``steps``, ``best_iteration``, ...
    """

    folder: Path
    summary: Mapping[str, Any]

    @property
    def best_return(self) -> float | None:
        """The best mean return of a deterministic evaluation; None: there was none."""
        return self.summary["best_return"]

    def policy(self, checkpoint: str = "best", device: str = "cpu") -> Policy:
        """The policy of ``checkpoint``: best, last or an iteration; see :func:`load_policy`."""
        return load_policy(self.folder, checkpoint=checkpoint, device=device)

    def metrics(self) -> dict[str, np.ndarray]:
        """The columns of ``metrics.csv``, float64 ``[iterations]`` each; NaN where an iteration has no such value."""
        from warpvox.algos.training.metrics import read_metrics

        rows = read_metrics(self.folder)
        return {name: np.array([row.get(name, np.nan) for row in rows]) for name in (rows[0] if rows else {})}


def train(overrides: str | Mapping[str, Any] | None = None, /, *, progress: bool = True, **keys: Any) -> TrainedRun:
    """Train a policy as ``warpvox train KEY=VALUE ...`` does, and wait for it.

    Keys, defaults, files and results are those of the command (``warpvox train --help``): the same seed gives the same
    policy. Groups take a preset's name or single values: ``ppo="evogym"``, ``ppo={"steps": 64}``; keys with a dot go
    into ``overrides``: ``train({"ppo.steps": 64}, ppo="evogym")``. Bodies may be arrays. An interrupt (Ctrl-C, a
    notebook's stop button) waits for the end of the iteration, saves, and raises KeyboardInterrupt;
    ``resume="latest"`` goes on.

    Args:
        overrides: values by key, or the id of a task.
        progress: show the command's messages and live line.
        keys: further values.

    Raises:
        ConfigError: an unknown key, or a value that it does not take. WarpvoxError: as the command, in words.
        KeyboardInterrupt: interrupted; the state has been saved.
    """
    from rich.console import Console

    from warpvox.cli.commands.train import make_job, train as run
    from warpvox.cli.runs import SUMMARY

    overrides = {"task": overrides} if isinstance(overrides, str) else overrides
    words = [word for key, value in {**(overrides or {}), **keys}.items() for word in _words(key, value)]
    twice = sorted(set(overrides or {}) & set(keys))
    if twice:
        raise ConfigError(f"The key '{twice[0]}' is given twice: in the overrides and by name.")
    with _own_torch():
        folder = run(make_job(words), Console(quiet=not progress))
    return TrainedRun(folder, json.loads((folder / SUMMARY).read_text(encoding="utf-8")))


def load_policy(
    source: str | Path = "latest",
    *,
    checkpoint: str = "best",
    output_dir: str | Path = "outputs",
    device: str = "cpu",
    policy: str | None = None,
) -> Policy:
    """A trained policy as a torch module: observations to actions that the environment takes, without exploration.

    The module can be scripted, traced and exported (see :class:`warpvox.algos.checkpoints.policy.Policy`). No file is
    unpickled and none brings code: a run's task is not imported.

    Args:
        source: ``latest``, the folder of a run or of a design search (its best design), a checkpoint file, a file
            that ``warpvox export format=[onnx,jit]`` has written, or a robot of the zoo, ``zoo:Walker-v0``.
        checkpoint: of a run: ``best``, ``last`` or an iteration.
        output_dir: where ``latest`` is looked for.
        device: where the module shall be.
        policy: of a run with a network of your own, where its code is: ``FILE.py:Class``, ``module:Class``, or
            ``stored`` for the copy in the run's folder. It is imported only if it is named here.

    Raises:
        RunError: there is no such run, checkpoint or file, or it holds no policy. DeviceError: no such device.
    """
    from warpvox.algos.checkpoints.export import read_exported
    from warpvox.algos.checkpoints.policy import read_policy
    from warpvox.cli.runs import find_run
    from warpvox.cli.trust import STORED, allowed
    from warpvox.code import Code
    from warpvox.devices.names import resolve_device

    network = None if policy is None else policy if policy == STORED else Code(policy)
    device, path = resolve_device(device), Path(source).expanduser()
    if str(source) != "latest" and path.is_file():
        exported = read_exported(path)
        if exported is not None:
            return exported.to(device)
        if not (path.parent / "config.yaml").is_file():  # a checkpoint by itself
            return read_policy(path, device=device, network=network)
    run = find_run(str(source), str(output_dir))
    if run.robot is not None:
        from warpvox.robots.replay import torch_policy

        return torch_policy(run.robot, device)
    known = {name: run.config.get(name) for name in ("task", "rules", "obs", "design")}
    file = run.find_checkpoint(str(checkpoint))
    network = allowed("policy", run.config.get("policy"), network, run.folder)
    return read_policy(file, known | {"source": str(file)}, device, network)


def _words(key: str, value: Any) -> Iterator[str]:
    """A value from Python as ``KEY=VALUE``; a mapping for a group of keys as one word for each of them."""
    from warpvox.configs.schema import GROUPS

    if not isinstance(key, str):
        raise ConfigError(f"The names of keys are texts, got {key!r:.80}.")
    if isinstance(value, Mapping) and key in GROUPS:
        for name, one in value.items():
            yield from _words(f"{key}.{name}", one)
    else:
        yield f"{key}={_literal(value, key, top=True)}"


def _literal(value: Any, key: str, top: bool = False) -> str:
    """A value as the command line reads it."""
    from warpvox.configs.composition import quoted

    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | Path):
        return quoted(str(Path(value).expanduser() if isinstance(value, Path) else value))
    if isinstance(value, list | tuple):
        return f"[{','.join(_literal(item, key) for item in value)}]"
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{name}:{_literal(item, key)}" for name, item in value.items()) + "}"
    raise ConfigError(f"{key} cannot be a {type(value).__name__}: expected text, a number, a list or an array.")


@contextmanager
def _own_torch() -> Iterator[None]:
    """Training sets torch's threads and seed for its process; after a call from Python the caller's are restored."""
    import torch

    threads, state = torch.get_num_threads(), torch.get_rng_state()
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.set_rng_state(state)
