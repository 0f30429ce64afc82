"""EvoGym's released data sets of robots, ``EvoGym/robots`` and ``EvoGym/robots-with-policies``, from files on the disk.

A row has ``uid``, ``body`` (rows of cell types), ``connections`` (two rows of indices), ``reward``, ``env_name``,
``generated_by`` and, in the second set, ``policy_blob``. Read are Parquet files (those of the Hugging Face Hub), a
folder of them, JSON with a list of rows, and JSON Lines; in JSON a policy is base64. No policy is unpickled.
"""

from __future__ import annotations

import base64
import binascii
import io
import json
import math
import pickle
import re
import zipfile
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.design import check_design, full_connections
from warpvox.errors import DesignError, RunError, did_you_mean, listing
from warpvox.io.reading import Unreadable, parse_json, read_text
from warpvox.robots.entry import Robot
from warpvox.robots.network import Network

__all__ = ["DataSet", "find_in_dataset", "network_of_blob", "split_place"]

SUFFIXES = (".parquet", ".json", ".jsonl")
LIGHT = ("uid", "reward", "env_name", "generated_by")
"""Columns that are read at once; those of a row are ``body``, ``connections`` and ``policy_blob``."""
NEEDED = ("body", "reward", "env_name")
LARGEST_JSON, LARGEST_POLICY = 1 << 30, 1 << 26
"""Bytes of a JSON file, and of a policy."""
OURS = {"WingspanMazimizer-v0": "WingspanMaximizer-v0"}
"""Tasks that the release spells otherwise."""
ACTIVATION = re.compile(r"activation\.(\w+)'")
LAYER = re.compile(r"mlp_extractor\.policy_net\.(\d+)\.weight")


class DataSet:
    """A data set of robots.

    Args:
        path: a file, or a folder of Parquet files.

    Attributes:
        rewards: float64 ``[rows]``; NaN where a row has none.
        tasks, algorithms, uids: texts ``[rows]``; ids of tasks are ours.
        has_policies: whether there is a column of policies.

    Raises:
        RunError: no such file, one that cannot be read or lacks a column, or pyarrow is missing.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).expanduser()
        if not self.path.exists():
            raise RunError(f"There is no data set at {self.path}: no such file or folder.")
        parquet = self.path.is_dir() or self.path.suffix.lower() == ".parquet"
        self._source = _Parquet(self.path) if parquet else _Json(self.path)
        missing = [name for name in NEEDED if name not in self._source.names]
        if missing:
            raise RunError(f"{self.path} is no data set of robots: its columns are {listing(self._source.names)}.")
        columns = {name: self._source.column(name) for name in LIGHT if name in self._source.names}
        self.rewards = np.array([_number(value) for value in columns["reward"]], dtype=np.float64)
        self.tasks = [OURS.get(str(name), str(name)) for name in columns["env_name"]]
        self.algorithms = list(map(str, columns.get("generated_by", ["unknown"] * len(self))))
        self.uids = list(map(str, columns.get("uid", range(len(self)))))
        self.has_policies = "policy_blob" in self._source.names

    def __len__(self) -> int:
        return len(self.rewards)

    @cached_property
    def task_names(self) -> list[str]:
        """The tasks that there are robots for."""
        return sorted(set(self.tasks))

    def best(self, task: str, count: int | None = None) -> list[int]:
        """Rows of a task, the highest reward first.

        Raises:
            RunError: it has none.
        """
        rows = [row for row, name in enumerate(self.tasks) if name == task and math.isfinite(self.rewards[row])]
        if not rows:
            hint = did_you_mean(task, self.task_names)
            raise RunError(f"{self.path} has no robot for {task!r:.80}.{hint} It has {listing(self.task_names, 40)}.")
        return sorted(rows, key=lambda row: -self.rewards[row])[:count]

    def find(self, text: str) -> int:
        """The row that ``text`` names: a uid, a task (its best robot), or ``TASK:RANK`` counted from 1.

        Raises:
            RunError: there is none.
        """
        if text in self.uids:
            return self.uids.index(text)
        task, _, rank = text.partition(":")
        rows = self.best(OURS.get(task, task))
        number = int(rank) if rank.isdecimal() else 0 if rank else 1
        if not 1 <= number <= len(rows):
            raise RunError(
                f"{self.path} has {len(rows)} robots for {task}: ranks are 1 to {len(rows)}, got {rank!r:.20}."
            )
        return rows[number - 1]

    def robot(self, row: int) -> Robot:
        """The robot of a row, with its policy where there is one; ``about["no_policy"]`` says why one cannot be read.

        Raises:
            RunError: its body is not valid.
        """
        values, where = self._source.row(row), f"{self.path}, robot {self.uids[row]}"
        try:
            body = check_design(values.get("body"))
            given = values.get("connections")
            pairs = full_connections(body).T if given is None else _pairs(given, body.size)
        except (DesignError, ValueError, TypeError) as error:
            raise RunError(f"{where} is not valid: {error}") from None
        about = {"return": _number(values.get("reward")), "generated_by": self.algorithms[row], "uid": self.uids[row]}
        policy, blob = None, values.get("policy_blob")
        try:
            policy = None if blob is None else network_of_blob(_bytes(blob))
        except (RunError, Unreadable) as error:
            about["no_policy"] = str(error)
        return Robot(self.tasks[row], body, pairs, policy, about | {"source": str(self.path)})


def find_in_dataset(path: Path, text: str) -> Robot:
    """The robot of a data set that ``text`` names, see :meth:`DataSet.find`; nothing for the only one of a set.

    Raises:
        RunError: there is no such file or robot.
    """
    data = DataSet(path)
    if text or len(data) == 1:
        return data.robot(data.find(text) if text else 0)
    raise RunError(f"{path} has {len(data):,} robots: name one, {path}:TASK, {path}:TASK:RANK or {path}:UID.")


def split_place(text: str) -> tuple[Path, str] | None:
    """``FILE:WHICH`` as the path of a data set and the rest; None: ``text`` names no data set."""
    parts = text.split(":")
    for count in range(1, len(parts) + 1):
        path = Path(":".join(parts[:count])).expanduser()
        if path.suffix.lower() in SUFFIXES or (count < len(parts) and path.is_dir()):
            return path, ":".join(parts[count:])
    return None


def network_of_blob(blob: bytes) -> Network:
    """The deterministic policy of a model that Stable-Baselines3 has saved: PPO with fully connected layers.

    ``blob`` is the ZIP archive of ``PPO.save`` or the ``policy.pth`` in it. Actions are clipped, observations taken as
    they are. torch loads tensors alone (``weights_only``).

    Raises:
        RunError: something else, or other layers.
    """
    text, activation = blob, "tanh"
    try:
        with zipfile.ZipFile(io.BytesIO(blob)) as archive:
            names = archive.namelist()
            if "policy.pth" in names:
                text = _member(archive, "policy.pth")
                activation = _activation(_member(archive, "data")) if "data" in names else activation
    except (zipfile.BadZipFile, OSError, NotImplementedError) as error:
        raise RunError(f"its policy is no model of Stable-Baselines3 ({error}).") from None
    return _network(_weights(text), activation)


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    if archive.getinfo(name).file_size > LARGEST_POLICY:
        raise RunError(f"its policy has more than {LARGEST_POLICY:,} bytes.")
    return archive.read(name)


def _activation(text: bytes) -> str:
    """The activation that a saved model's settings name; Stable-Baselines3 has tanh where they name none."""
    try:
        settings = json.loads(text).get("policy_kwargs")
    except (ValueError, AttributeError, RecursionError):
        raise RunError("the settings of its policy are no JSON.") from None
    named = settings.get("activation_fn") if isinstance(settings, dict) else None
    found = ACTIVATION.search(str(named))
    return "tanh" if named is None or found is None else found[1].lower()


def _weights(text: bytes) -> dict[str, np.ndarray]:
    import torch

    try:
        state = torch.load(io.BytesIO(text), map_location="cpu", weights_only=True)
        return {str(name): value.numpy() for name, value in state.items()}
    except (pickle.UnpicklingError, RuntimeError, ValueError, AttributeError, TypeError, KeyError, EOFError) as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise RunError(f"its policy is no state of a Stable-Baselines3 policy ({reason:.120}).") from None


def _network(state: dict[str, np.ndarray], activation: str) -> Network:
    layers = sorted((int(found[1]), name) for name in state if (found := LAYER.fullmatch(name)))
    names = [name.removesuffix("weight") for _, name in layers] + ["action_net."]
    try:
        weights = tuple(state[f"{name}weight"].astype(np.float32) for name in names)
        biases = tuple(state[f"{name}bias"].astype(np.float32) for name in names)
    except KeyError as error:
        raise RunError(f"its policy has no {error.args[0]}: expected an MlpPolicy of Stable-Baselines3.") from None
    if weights[0].ndim != 2:
        raise RunError("its policy has layers that are no matrices.")
    num_obs = weights[0].shape[1]
    mean, deviation = np.zeros(num_obs, np.float32), np.ones(num_obs, np.float32)
    return Network(weights, biases, mean, deviation, activation, 1.0, 0.0)


# ----------------------------------------------------------------------------------------------------- files


class _Parquet:
    """Rows of Parquet files; bodies and policies stay on the disk until they are asked for."""

    def __init__(self, path: Path) -> None:
        try:
            import pyarrow as pa
            from pyarrow import dataset
        except ImportError:
            raise RunError(
                "Parquet needs pyarrow, which is not installed: pip install 'warpvox[analysis]', or use JSON Lines."
            ) from None
        files = sorted(map(str, path.glob("**/*.parquet"))) if path.is_dir() else [str(path)]
        if not files:
            raise RunError(f"There are no Parquet files in {path}.")
        self.path, self._errors = path, (pa.ArrowException, OSError)
        try:
            self._data = dataset.dataset(files, format="parquet")
        except self._errors as error:
            raise self._unreadable(error) from None
        self.names = list(self._data.schema.names)

    def column(self, name: str) -> list[Any]:
        try:
            return self._data.to_table(columns=[name]).column(name).to_pylist()
        except self._errors as error:
            raise self._unreadable(error) from None

    def row(self, number: int) -> dict[str, Any]:
        try:
            return self._data.take([number]).to_pylist()[0]
        except self._errors as error:
            raise self._unreadable(error) from None

    def _unreadable(self, error: Exception) -> RunError:
        return RunError(f"{self.path} cannot be read as Parquet: {str(error).strip().splitlines()[0]:.200}.")


class _Json:
    """Rows of a JSON file: a list, or one a line."""

    def __init__(self, path: Path) -> None:
        try:
            text = read_text(path, LARGEST_JSON)
            rows = parse_json(text) if text.lstrip().startswith("[") else list(map(parse_json, _lines(text)))
        except Unreadable as error:
            raise RunError(f"{path} cannot be read as rows of JSON: {error}.") from None
        if not rows or not all(isinstance(row, dict) for row in rows):
            raise RunError(f"{path} is no data set of robots: expected a list of rows, or a row in each line.")
        self._rows = rows
        self.names = list(dict.fromkeys(name for row in rows for name in row))

    def column(self, name: str) -> list[Any]:
        return [row.get(name) for row in self._rows]

    def row(self, number: int) -> dict[str, Any]:
        return self._rows[number]


def _lines(text: str) -> Iterator[str]:
    return (line for line in text.splitlines() if line.strip())


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _bytes(blob: Any) -> bytes:
    if isinstance(blob, bytes):
        return blob
    try:
        return base64.b64decode(blob, validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise Unreadable("its policy is neither bytes nor base64.") from None


def _pairs(given: Sequence[Sequence[int]], cells: int) -> np.ndarray:
    """Connections, int32 ``[2, k]``, of known cells."""
    pairs = np.asarray(given, dtype=np.int64)
    if pairs.size == 0:
        return np.zeros((2, 0), np.int32)
    if pairs.ndim != 2 or len(pairs) != 2 or pairs.min() < 0 or pairs.max() >= cells:
        raise ValueError(f"connections must be [2, k] with indices of its {cells} cells, got the shape {pairs.shape}.")
    return pairs.astype(np.int32)
