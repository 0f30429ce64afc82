"""EvoGym's released data sets of robots (``EvoGym/robots``, ``EvoGym/robots-with-policies``) as robots of warpvox.

    python examples/released_robots.py FILE                  # tasks, how many robots, the best reward
    python examples/released_robots.py FILE TASK COUNT FOLDER    # the best robots of a task, as FOLDER/1.npz, ...
    warpvox play zoo=FOLDER/1.npz

FILE is Parquet (``pip install 'warpvox[analysis]'``), as on the Hugging Face Hub, or JSON Lines with policies in
base64. A row has ``uid``, ``body``, ``connections``, ``reward``, ``env_name``, ``generated_by`` and, in the second set,
``policy_blob``: PPO with an ``MlpPolicy`` as Stable-Baselines3 saves it. Its tensors alone are read (``weights_only``).
"""

import base64
import heapq
import io
import itertools
import json
import math
import re
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warpvox.algos.checkpoints.policy import Policy
from warpvox.algos.robots import Robot, network_policy, save_robot
from warpvox.design import check_design, full_connections
from warpvox.envs.registry import get_task, released_id
from warpvox.errors import RunError

MOST_ROWS, LONGEST_ROW, LARGEST_POLICY = 1_000_000, 1 << 24, 1 << 26
"""Rows of a file, bytes of a row of JSON, and of a policy."""


def rows_of(path: Path) -> Iterator[dict[str, Any]]:
    """The rows of a data set, one after another.

    Raises:
        RunError: the file cannot be read, or has too many or too long rows.
    """
    rows = _parquet(path) if path.suffix == ".parquet" else _json_lines(path)
    for number in itertools.count(1):
        try:
            row = next(rows)
            tidy = {**row, "reward": float(row["reward"]), "env_name": str(row["env_name"])}
        except StopIteration:
            return
        except Exception as error:  # pyarrow and json raise nearly anything
            raise RunError(f"{path}, row {number}: {type(error).__name__}: {error!s:.200}") from error
        if number > MOST_ROWS:
            raise RunError(f"{path} has more than {MOST_ROWS:,} rows.")
        yield tidy


def _parquet(path: Path) -> Iterator[dict[str, Any]]:
    from pyarrow.parquet import ParquetFile

    with ParquetFile(path) as file:
        if file.metadata.num_rows > MOST_ROWS:
            raise ValueError(f"the file has {file.metadata.num_rows:,} rows, and {MOST_ROWS:,} are the limit")
        for batch in file.iter_batches(16):
            if batch.nbytes > 16 * LONGEST_ROW:
                raise ValueError(f"16 rows have {batch.nbytes:,} bytes, and {16 * LONGEST_ROW:,} are the limit")
            yield from batch.to_pylist()


def _json_lines(path: Path) -> Iterator[dict[str, Any]]:
    with path.open("rb") as file:
        while line := file.readline(LONGEST_ROW + 1):
            if len(line) > LONGEST_ROW:
                raise ValueError(f"the row has more than {LONGEST_ROW:,} bytes")
            yield json.loads(line)


def best_of(path: Path, task: str, count: int) -> list[Robot]:
    """The robots of a task with the highest rewards, as many as ``count``; the release's names of tasks do as well."""
    task = get_task(task).id
    rows = (row for row in rows_of(path) if row["env_name"] in (task, released_id(task)))
    best = heapq.nlargest(count, (row for row in rows if math.isfinite(row["reward"])), key=lambda row: row["reward"])
    return [robot_of(row, task) for row in best]


def robot_of(row: dict[str, Any], task: str) -> Robot:
    """The robot of a row; ``about["no_policy"]`` says why its policy cannot be read.

    Raises:
        DesignError: its body is not valid.
    """
    body = check_design(row["body"])
    pairs = full_connections(body).T if row.get("connections") is None else np.asarray(row["connections"], np.int32)
    about = {"return": row["reward"], "generated_by": str(row.get("generated_by")), "uid": str(row.get("uid"))}
    policy, blob = None, row.get("policy_blob")
    try:
        policy = None if blob is None else policy_of(blob if isinstance(blob, bytes) else base64.b64decode(blob))
    except Exception as error:  # zipfile, zlib, torch and pickle raise nearly anything
        about["no_policy"] = f"it is not read ({type(error).__name__}: {error!s:.120})."
    return Robot(task, body, pairs.reshape(2, -1), policy, about)


def policy_of(blob: bytes) -> Policy:
    """The deterministic policy of the ZIP archive of ``PPO.save``, or of the ``policy.pth`` in it."""
    activation = "tanh"
    with zipfile.ZipFile(io.BytesIO(blob)) as archive:
        if "policy.pth" in archive.namelist():
            if archive.getinfo("policy.pth").file_size > LARGEST_POLICY:
                raise ValueError(f"it has more than {LARGEST_POLICY:,} bytes")
            settings = json.loads(archive.read("data")) if "data" in archive.namelist() else {}
            named = re.search(r"activation\.(\w+)'", str((settings.get("policy_kwargs") or {}).get("activation_fn")))
            activation = named[1].lower() if named else activation
            blob = archive.read("policy.pth")
    state = torch.load(io.BytesIO(blob), map_location="cpu", weights_only=True)
    names = sorted(filter(re.compile(r"mlp_extractor\.policy_net\.\d+\.weight").fullmatch, state), key=_number)
    names = [name.removesuffix("weight") for name in names] + ["action_net."]
    weights = [_array(state[f"{name}weight"]) for name in names]
    biases = [_array(state[f"{name}bias"]) for name in names]
    inputs = weights[0].shape[-1]
    return network_policy(weights, biases, np.zeros(inputs), np.ones(inputs), activation, scale=1.0, center=0.0)


def _number(name: str) -> int:
    return int(name.split(".")[2])


def _array(value: torch.Tensor) -> np.ndarray:
    if value.untyped_storage().nbytes() < value.numel() * value.element_size():
        raise ValueError("an array is larger than its storage")  # one number can pose as a million
    return value.numpy().astype(np.float32)


def main(file: str, task: str | None = None, count: str = "10", folder: str = "robots") -> None:
    """List the tasks of a data set, or write the best robots of one."""
    if task is None:
        rewards: dict[str, list[float]] = {}
        for row in rows_of(Path(file)):
            rewards.setdefault(row["env_name"], []).append(row["reward"])
        for name, values in sorted(rewards.items()):
            print(f"{name!r:30.80} {len(values):8,} robots, best {max(values):.3f}")
        return
    for rank, robot in enumerate(best_of(Path(file), task, int(count)), start=1):
        place = save_robot(Path(folder) / f"{rank}.npz", robot)
        print(f"{place}: {robot.mean_return:.3f}, {robot.about.get('no_policy') or ascii(robot.about['generated_by'])}")


if __name__ == "__main__":
    main(*sys.argv[1:])
