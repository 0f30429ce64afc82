"""Validation of a task's terms and memories in new environments, and of saved states.

The checks find mistakes that a term makes in every step, so that steps need no checks: shape, type, device, non-finite
values, unknown objects and memories, exceptions. Values that are not finite later terminate the episode; a warning
names the term.
"""

import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from warpvox.checks import is_mapping
from warpvox.envs.about import about_of
from warpvox.envs.observations import ObservationLayout
from warpvox.envs.random_stream import RandomStream
from warpvox.envs.snapshot import Snapshot
from warpvox.envs.spec import Observation, TaskSpec, Term
from warpvox.errors import SimulationError, TaskError, counted, listing
from warpvox.kernels.episodes import replace_nonfinite
from warpvox.simulation import Simulation


def check_memory(spec: TaskSpec, sim: Simulation, draws: RandomStream) -> None:
    """Raise TaskError unless every memory of a task starts with finite numbers ``[num_envs, ...]``."""
    stream = draws.rewind()
    for memory in spec.memory:
        what = f"The memory '{memory.name}' of the task '{spec.id}'"
        value = memory.begin(stream)
        expected = f"a tensor [{sim.num_envs}, ...] on {sim.device}, a row for each environment"
        if moves := memory.name == "offset" and bool(spec.randomized):
            expected = f"integers [{sim.num_envs}, 2] on {sim.device}: cells to the right and up"
        if not _has_rows(value, sim) or (moves and (value.is_floating_point() or tuple(value.shape[1:]) != (2,))):
            raise TaskError(f"{what} must begin with {expected}; got {_got(value)}.")
        _check_finite(what, value)


def check_terms(spec: TaskSpec, sim: Simulation, state: Snapshot) -> None:
    """Raise TaskError unless all terms of a task return valid values at the start of an episode.

    Memories must have been drawn.

    Raises:
        TaskError: what is wrong, with the name of the term, what was expected and what it gave.
    """
    for term in spec.rewards:
        _check_column(_name(term, spec), term(state, state), "numbers", sim)
    for term in spec.observations:
        _check_observation(_name(term, spec), term, term(state), sim)
    for term in spec.terminations:
        _check_column(_name(term, spec), term(state), "bool", sim)
    for memory in spec.memory:
        before = state.memory_values[memory.name]
        after = memory.advance(state)
        if _got(after) != _got(before):
            raise TaskError(
                f"The update of the memory '{memory.name}' of the task '{spec.id}' must give what the memory began"
                f" with, {_got(before)}; got {_got(after)}."
            )


def _name(term: Term, spec: TaskSpec) -> str:
    return f"The {term.kind} '{term.name}' of the task '{spec.id}'"


def _check_column(what: str, value: Any, kind: str, sim: Simulation) -> None:
    """Raise TaskError unless a term returns one finite number (``kind="bool"``: one bool) per environment."""
    rows = _has_rows(value, sim)
    if not rows or value.ndim != 1 or value.dtype.is_complex or (kind == "bool") > (value.dtype == torch.bool):
        axis = " Leave its last axis out: value[:, 0]." if getattr(value, "shape", ())[1:] == (1,) else ""
        raise TaskError(
            f"{what} must give {kind} [{sim.num_envs}] on {sim.device}, one for each environment; got"
            f" {_got(value)}.{axis}"
        )
    _check_finite(what, value)


def _check_observation(what: str, term: Observation, value: Any, sim: Simulation) -> None:
    """Raise TaskError unless an observation term returns as many finite columns as ``@about`` declares."""
    if not _has_rows(value, sim) or value.ndim not in (2, 3) or value.dtype.is_complex or not value.shape[1]:
        columns = " Add the axis of columns: value[:, None]." if getattr(value, "ndim", 0) == 1 else ""
        raise TaskError(
            f"{what} must give numbers [{sim.num_envs}, k] or, about points, [{sim.num_envs}, 2, points] on"
            f" {sim.device}; got {_got(value)}.{columns}"
        )
    params = dict(term.params)
    name = params.get("name")
    points = sim.num_points(name) if name in sim.object_names else 0
    if value.ndim == 3 and tuple(value.shape[1:]) != (2, points):
        of = f"{name!r} has {points} points" if points else "no parameter 'name' says which object's"
        raise TaskError(f"{what} gives {_got(value)}, which must be x and y of all points of an object; {of}.")
    about = about_of(term.function)
    declared = None if about is None else about.size(params, points)
    if declared is not None and declared != value[0].numel():
        raise TaskError(
            f"{what} gives {value[0].numel()} columns, and its @about declares {declared}:"
            f" @about(..., entries={value[0].numel()})."
        )
    _check_finite(what, value)


def _has_rows(value: Any, sim: Simulation) -> bool:
    """Return whether ``value`` is a tensor on the simulation's device with a row for each environment."""
    strided = isinstance(value, torch.Tensor) and value.layout is torch.strided
    return strided and value.shape[:1] == (sim.num_envs,) and value.device == torch.device(sim.device)


def _check_finite(what: str, value: torch.Tensor) -> None:
    """Raise TaskError if a tensor ``[num_envs, ...]`` holds NaN or infinity."""
    bad = ~torch.isfinite(value).reshape(len(value), -1).all(1)
    if bool(bad.any()):
        raise TaskError(
            f"{what} is not finite (NaN or infinite) in {int(bad.sum())} of {len(value)} environments at the beginning"
            " of an episode, where nothing has moved yet: is something divided by 0?"
        )


def _got(value: Any) -> str:
    if not isinstance(value, torch.Tensor):
        return f"{type(value).__name__} {value!r:.60}"
    return f"{str(value.dtype).removeprefix('torch.')} {list(value.shape)} on {value.device}"


def check_fields(state: Any, like: Mapping[str, Any], inside: str = "") -> None:
    """Raise SimulationError unless a saved state has the right names, types and shapes.

    ``like``: nested mappings of tensors and None; ``torch.Tensor`` itself stands for any tensor.
    """
    if not is_mapping(state):
        raise SimulationError(f"{inside or 'A state'} must be a dictionary of {listing(like)}; got {state!r:.80}.")
    for name, expected in like.items():
        field = f"{inside}.{name}" if inside else str(name)
        if name not in state:
            raise SimulationError(f"The state lacks {field!r}; it has {listing(state) if state else 'nothing'}.")
        given = state[name]
        if is_mapping(expected):
            check_fields(given, expected, field)
        elif expected is None:
            if given is not None:
                raise SimulationError(f"The state's {field!r} must be None here; got {_got(given)}.")
        elif not isinstance(given, torch.Tensor):
            raise SimulationError(f"The state's {field!r} must be a tensor; got {_got(given)}.")
        elif expected is not torch.Tensor and (given.dtype != expected.dtype or given.shape != expected.shape):
            raise SimulationError(
                f"The state's {field!r} must be {_got(expected)}; got {_got(given)}. It is that of other environments."
            )


class FiniteGuard:
    """Replaces NaN and infinity in observations by 0, and counts them in observations and rewards by term.

    On the CPU :func:`all_finite` decides whether there is anything to do. Elsewhere reading it would wait for the
    device: every observation is gone through, and counts stay on the device until :meth:`report` reads them.

    Args:
        of_rewards: long ``[rewards]``, in how many environments each reward was not finite; others count there.
    """

    def __init__(self, spec: TaskSpec, sim: Simulation, layout: ObservationLayout, of_rewards: torch.Tensor) -> None:
        self._task = spec.id
        self.on_cpu = sim.device == "cpu"
        self._rewards = [term.name for term in spec.rewards]
        self._layout = layout
        self._columns = layout.columns
        self._sim = sim
        rows = sim.num_designs if sim.grid is None else sim.num_envs  # as many designs as there may be
        self._of_rewards = of_rewards
        self._of_columns = torch.zeros((rows, layout.num_obs), dtype=torch.int32, device=sim.device)
        self._earlier: dict[str, int] = {}  # counted under columns of earlier designs
        self._named: set[str] = set()

    def observation(self, obs: torch.Tensor, where: torch.Tensor, found: torch.Tensor) -> None:
        """Write 0 in place of non-finite entries of ``obs`` ``[num_envs, num_obs]``, and count them.

        Args:
            where: bool ``[num_envs]``: environments that count.
            found: bool ``[num_envs]``: set to True where an environment had a non-finite entry that was counted.
        """
        if self.on_cpu and all_finite(obs):
            return
        tensors = obs, where, self._sim.design_index, self._of_columns, found
        replace_nonfinite(self._sim.buffers, *tensors)

    def first_observation(self, obs: torch.Tensor, where: torch.Tensor | None) -> torch.Tensor:
        """Replace and count non-finite entries in the first observation of new episodes; return ``obs``.

        Args:
            where: bool ``[num_envs]``: environments that count; None: all.
        """
        if self.on_cpu and all_finite(obs):
            return obs
        where = torch.ones_like(self._sim.design_index, dtype=torch.bool) if where is None else where
        self.observation(obs, where, torch.empty_like(where))
        if self.on_cpu:
            self.report()
        return obs

    def refresh(self) -> None:
        """Start new counts after designs have changed, and add the present ones to those of earlier designs.

        It waits for the device.
        """
        self._earlier = self._counts()
        self._of_rewards.zero_()
        self._of_columns.zero_()
        self._columns = self._layout.columns

    def total(self) -> torch.Tensor:
        """Return the number of non-finite values since the last change of designs, a long tensor on the device."""
        return self._of_rewards.sum() + self._of_columns.sum()

    def _counts(self) -> dict[str, int]:
        """Count the environments in which each term has been non-finite, zeros included."""
        counts: dict[str, int] = {}
        totals: list[int] = self._of_rewards.cpu().numpy().tolist()
        for name, count in zip(self._rewards, totals, strict=True):
            counts[f"reward {name}"] = count

        # An environment counts in all columns of a term that are not finite: the largest count is that of the term.
        counts |= {f"observation {name}": 0 for name in self._columns[0]}
        by_column = self._of_columns.cpu()
        for row in np.flatnonzero(by_column.any(1)).tolist():
            for name, place in self._columns[row].items():
                if place.stop > place.start:
                    counts[f"observation {name}"] += int(by_column[row, place].max())
        return {name: count + self._earlier.get(name, 0) for name, count in counts.items()}

    def report(self) -> dict[str, int]:
        """Return the counts of non-finite terms, and warn once for each term; waits for the device."""
        found = {name: count for name, count in self._counts().items() if count}
        for name in [name for name in found if name not in self._named]:
            self._named.add(name)
            kind, _, term = name.partition(" ")
            environments = counted(found[name], "environments")
            warnings.warn(
                f"The {kind} '{term}' of the task '{self._task}' was NaN or infinite in {environments}, which ended as"
                " diverged; this is said once, info['diverged'] says where it happens again.",
                RuntimeWarning,
                stacklevel=2,
            )
        return found


def all_finite(values: torch.Tensor) -> bool:
    """Return whether the sum of all values is finite, which it is not if a value is not; False also if it overflows."""
    return math.isfinite(values.sum().item())
