"""Stored robots: body, connections, policy and metadata in one ``.npz`` file without pickle.

The file holds ``header`` (JSON in UTF-8, uint8: ``format``, ``version``, ``task``, ``network``, ``about``, ``sha256``),
``body`` int8 ``[rows, columns]``, ``connections`` int32 ``[2, k]`` and, if there is a policy, ``mean``, ``deviation``
(float32 ``[num_obs]``), ``weight_0``, ``bias_0``, ... (float32, see :func:`warpvox.algos.robots.network_policy`). Where
``network`` is ``{"kind": "gait"}`` the policy is open loop instead: ``begin``, ``period`` (float64 ``[stages]``),
``amplitude``, ``phase`` and ``rest`` (float64 ``[stages, actuators]``, see :func:`warpvox.algos.robots.gait_policy`).
"""

from __future__ import annotations

import hashlib
import html
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from warpvox.checks import is_number
from warpvox.design import Design, check_design, full_connections, zoo_file, zoo_tasks as zoo_tasks
from warpvox.errors import DesignError, RunError
from warpvox.io.reading import ArrayFile, Missing, Unreadable, parse_json
from warpvox.io.writing import atomic_path, check_suffix
from warpvox.palette import body_svg

if TYPE_CHECKING:  # torch, which the help of commands does without
    from warpvox.algos.checkpoints.policy import Policy

FORMAT, VERSION = "warpvox robot", 1
DIGITS = 9
"""Decimals of recorded returns; sums over points round differently (about 1e-15) on other CPUs."""
GAIT = {"kind": "gait"}
"""Value of ``network`` in the header of a file with an open-loop policy."""
LARGEST, LARGEST_HEADER = 1 << 26, 1 << 20
"""Maximum sizes of a robot file's arrays and of its header, in bytes."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A trained robot: body, task, policy and metadata.

    Attributes:
        task: id of the task.
        body: int8 ``[rows, columns]``.
        connections: EvoGym's index pairs, int32 ``[2, k]``.
        policy: observations, those of :attr:`obs`, to actions, in float64; None: a body alone. What is given is copied
            as files keep it: see :func:`warpvox.algos.robots.policies.as_stored`.
        about: of an entry of the zoo ``return`` (mean over ``returns``), ``returns``, ``lengths``, ``seeds`` (one an
            episode), ``noise`` (``return`` and ``returns`` of 32 episodes under noise), ``control_steps`` and
            ``wall_s`` (of the search or training that it comes from), ``command``, ``config``, ``date``, ``version``,
            ``commit``; of one from elsewhere at least ``return``.
        source: what names it where a run or a body is expected, ``zoo:TASK`` or ``zoo:FILE``; empty: it is in no file.
        sha256: of all arrays.
    """

    task: str
    body: Design
    connections: np.ndarray
    policy: Policy | None
    about: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""

    def __post_init__(self) -> None:
        """Convert the policy to the form stored in files."""
        if self.policy is not None:
            from warpvox.algos.robots.policies import as_stored

            object.__setattr__(self, "policy", as_stored(self.policy, self.body))

    def __repr__(self) -> str:
        rows, columns = self.body.shape
        kind = "network" if self.has_feedback else "gait"
        kind = "no policy" if self.policy is None else kind
        return f"Robot({self.task}, {rows} x {columns} cells, {kind}, return {self.mean_return:.3f})"

    def _repr_html_(self) -> str:
        """Show the body and its return as HTML, for notebooks."""
        return f"{body_svg(self.body, 20)}<br>{html.escape(repr(self))}"

    @property
    def mean_return(self) -> float:
        """Recorded mean return; NaN if unknown."""
        value = self.about.get("return")
        return float("nan") if value is None else float(value)

    @property
    def robust_return(self) -> float:
        """Recorded mean return under action noise; NaN if unknown."""
        value = self.about.get("noise", {}).get("return")
        return float("nan") if value is None else float(value)

    @property
    def has_feedback(self) -> bool:
        """True if actions depend on observations other than the time."""
        return self.policy is None or self.policy.spec.has_feedback

    @property
    def own_policy(self) -> Policy:
        """The policy.

        Raises:
            RunError: the robot is a body alone.
        """
        if self.policy is None:
            why = self.about.get("no_policy", "there is a body alone.")
            raise RunError(f"The robot has no policy: {why} play agent=sine task={self.task} design=zoo:... moves it.")
        return self.policy

    @property
    def obs(self) -> str:
        """Value of ``make_vec(obs=...)`` for the policy: ``timed`` for a gait, else ``task``."""
        return "task" if self.has_feedback else "timed"

    @property
    def fully_connected(self) -> bool:
        """True if all adjacent cells are connected."""
        pairs = np.sort(self.connections.T, axis=1)
        full = full_connections(self.body)
        return {tuple(pair) for pair in pairs.tolist()} == {tuple(pair) for pair in full.tolist()}

    @property
    def design(self) -> Design:
        """Body of the robot as a design; DesignError: some adjacent cells are not connected."""
        if not self.fully_connected:
            raise DesignError(
                "This robot lacks connections of neighbouring cells, which a design has: body=robot.body and"
                " connections=robot.connections."
            )
        return self.body

    @property
    def sha256(self) -> str:
        """SHA-256 of task, body, connections and policy."""
        total = hashlib.sha256(json.dumps([self.task, _network(self.policy)], sort_keys=True).encode())
        for name, array in _arrays(self).items():
            total.update(f"{name} {array.shape} ".encode() + array.astype(array.dtype.newbyteorder("<")).tobytes())
        return total.hexdigest()


@overload
def zoo(task: None = None) -> list[str]: ...


@overload
def zoo(task: str | os.PathLike[str]) -> Robot: ...


def zoo(task: str | os.PathLike[str] | None = None) -> Robot | list[str]:
    """Load the zoo's robot for a task: ``zoo("Thrower-v0").policy(obs)`` returns actions.

    Args:
        task: its id, or a file of a zoo of your own (``.npz``); None: the ids of all tasks that have a robot.

    Raises:
        RunError: the zoo has none for it; the message lists those that there are. Or a file that cannot be read.
    """
    if task is None:
        return zoo_tasks()
    return replace(read_robot(zoo_file(task, RunError)), source=f"zoo:{task}")


def save_robot(path: str | os.PathLike[str], robot: Robot) -> Path:
    """Write ``robot`` to ``path`` atomically; return the path.

    Raises:
        RunError: another suffix than .npz, or facts with values that JSON lacks.
    """
    check_suffix("The file of a robot", path, (".npz",), RunError)
    try:
        json.dumps(dict(robot.about), allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise RunError(f"What is known of the robot cannot be stored, as JSON lacks a value of it: {error}.") from None
    header = {"format": FORMAT, "version": VERSION, "task": robot.task, "network": _network(robot.policy)}
    header |= {"about": dict(robot.about), "sha256": robot.sha256}
    text = json.dumps(header, allow_nan=False).encode()
    with atomic_path(path, follow=True) as temporary, open(temporary, "wb") as file:
        arrays: dict[str, Any] = _arrays(robot)
        np.savez_compressed(file, header=np.frombuffer(text, np.uint8), **arrays)
    return Path(path)


def read_robot(path: str | os.PathLike[str]) -> Robot:
    """Read a robot written by :func:`save_robot`.

    Raises:
        RunError: no such file, one of another kind, or a damaged one.
    """
    try:
        with ArrayFile(path, LARGEST) as archive:
            if "header" not in archive.names:
                raise Unreadable("it has no header of warpvox")
            header = parse_json(archive.read("header", LARGEST_HEADER).astype(np.uint8).tobytes().decode())
            _check_header(header)
            arrays = {name: archive.read(name) for name in archive.names if name != "header"}
        robot = _robot(header, arrays)
    except Missing:
        raise RunError(f"There is no robot at {path}: no such file.") from None
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise RunError(f"{path} is no robot that warpvox has written, or damaged: {str(error).rstrip('.')}.") from None
    if robot.sha256 != header.get("sha256"):
        raise RunError(f"{path} is damaged: its arrays do not have the checksum that it states.")
    pairs = robot.connections
    cells = robot.body.size
    if pairs.ndim != 2 or len(pairs) != 2 or (pairs < 0).any() or (pairs >= cells).any():
        raise RunError(f"{path} has connections that are no pairs [2, k] of its {cells} cells: shape {pairs.shape}.")
    return robot


def _check_header(header: Any) -> None:
    """Raise Unreadable if a file's header has another format or version, or metadata of wrong types."""
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise Unreadable(f"its header is not one of {FORMAT}")
    if header.get("version") != VERSION:
        raise Unreadable(f"version {header.get('version')!r:.20} of the format; this warpvox reads {VERSION}")
    if not isinstance(header.get("task"), str) or not isinstance(header.get("about"), dict):
        raise Unreadable("its header names no task")
    about: dict[str, Any] = {"noise": {}} | header["about"]
    if not isinstance(about["noise"], dict):
        raise Unreadable(f"the noise in its header is {about['noise']!r:.40}, not a return and returns")
    for name, value in [*about.items(), *about["noise"].items()]:
        if name in ("return", "control_steps", "wall_s") and not (value is None or is_number(value)):
            raise Unreadable(f"the {name} in its header is {value!r:.40}, not a number")
        fits = (lambda one: isinstance(one, dict)) if name == "start" else is_number
        # These entries are lists: ``start`` of facts about other robots, the others of numbers.
        is_list = name in ("returns", "lengths", "seeds", "start")
        if is_list and not (isinstance(value, list) and all(map(fits, value))):
            raise Unreadable(f"the {name} in its header is {value!r:.40}, not a list")


def _robot(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Robot:
    """Build the robot from a file's header and arrays."""
    from warpvox.algos.robots.policies import gait_policy, network_policy

    body = check_design(arrays.pop("body"))
    connections = arrays.pop("connections").astype(np.int32)
    network = header["network"]
    policy: Policy | None = None
    if network == GAIT:
        policy = gait_policy(body, **arrays)
    elif network is not None:
        layers = range(sum(name.startswith("weight_") for name in arrays))
        weights = [arrays[f"weight_{layer}"] for layer in layers]
        biases = [arrays[f"bias_{layer}"] for layer in layers]
        policy = network_policy(weights, biases, arrays["mean"], arrays["deviation"], **network)
    return Robot(header["task"], body, connections, policy, header["about"])


def _network(policy: Policy | None) -> dict[str, Any] | None:
    """Describe the policy for the entry ``network`` of a file's header."""
    if policy is None:
        return None
    if policy.spec.gait is not None:
        return GAIT
    spec = policy.spec
    return {"activation": spec.activation, "scale": spec.action_scale, "center": spec.action_center}


def _arrays(robot: Robot) -> dict[str, np.ndarray]:
    """Collect the arrays of a robot's file: body, connections and the policy's arrays."""
    from warpvox.algos.robots.policies import arrays_of

    arrays = {"body": robot.body, "connections": robot.connections.astype(np.int32)}
    return arrays if robot.policy is None else arrays | arrays_of(robot.policy)
