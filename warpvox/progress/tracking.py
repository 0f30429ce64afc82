"""Logging to Weights & Biases: configuration, metrics, and a film of the result."""

import os
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from warpvox.algos.find import find_run
from warpvox.algos.listener import Listener
from warpvox.algos.metrics import tagged
from warpvox.algos.training.job import Job
from warpvox.algos.training.playing import load_result
from warpvox.errors import RunError
from warpvox.io.reading import parse_yaml
from warpvox.io.writing import write_text
from warpvox.runs import CONFIG
from warpvox.view.render import write_gif
from warpvox.view.rollout import record


class Tracker:
    """A run at Weights & Biases, created from the configuration in ``folder``."""

    def __init__(self, folder: Path, *tags: str) -> None:
        self._wandb: Any = import_module("wandb")
        # Keep the id of the run, to continue the same one when it is resumed.
        self._folder = folder
        file = folder / "wandb_id.txt"
        config: Any = parse_yaml((folder / CONFIG).read_text(encoding="utf-8"))
        options: dict[str, Any] = {
            "project": "warpvox",
            "group": config["name"] or config["task"],
            "name": "/".join(folder.absolute().parts[-2:]),
            "tags": [config["task"], *tags],
            "dir": str(folder),
        }
        # Leave out options that the user has set by environment variables, WANDB_PROJECT for instance.
        variables = {"project": "PROJECT", "group": "RUN_GROUP", "name": "NAME", "tags": "TAGS", "dir": "DIR"}
        options = {key: value for key, value in options.items() if not os.environ.get(f"WANDB_{variables[key]}")}
        known = file.read_text(encoding="utf-8") if file.is_file() else None
        self._run = self._wandb.init(config=config, id=known, resume="allow", **options)
        write_text(file, self._run.id)

    def log(self, values: Mapping[str, Any], step: int, picture: Path | None = None) -> None:
        """Log values (None: left out), and a picture if its file exists."""
        known = {name: value for name, value in values.items() if value is not None}
        if picture is not None and picture.is_file():
            known["bodies"] = self._wandb.Image(str(picture))
        self._run.log(known, step=step)

    def end(self, summary: Mapping[str, Any], settings: Any) -> None:
        """Log the summary and a film of one episode, and finish the run."""
        status = summary.get("status", "failed")
        try:
            self._run.summary.update(dict(summary))
            if status == "done":
                with suppress(RunError):  # a user's own evaluator may give no policy
                    env, policy = load_result(find_run(str(self._folder), ""), settings)
                    film = write_gif(record(env, policy), self._folder / "film.gif")
                    self._run.log({"film": self._wandb.Video(str(film), format="gif")})
        finally:
            self._run.finish(exit_code=int(status == "failed"))


class TrackedTraining(Listener):
    """Logs a training to Weights & Biases: metrics of each iteration, a film of the policy at the end."""

    def begun(self, run: Job) -> None:
        self._job = run
        self._tracker = Tracker(cast(Path, run.folder), "train")

    def iterated(self, row: Mapping[str, float]) -> None:
        self._tracker.log(tagged(row) | self._job.runner.logger.means, int(row["iteration"]))

    def ended(self, summary: Mapping[str, Any]) -> None:
        self._tracker.end(summary, self._job.settings)
