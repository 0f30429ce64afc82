"""Tasks as data: a :class:`TaskSpec` lists a world, observations, rewards, terminations and limits.

A *term* is a small function on :class:`warpvox.envs.snapshot.Snapshot` together with its parameters. The vector
environment adds terms up, so that no task has code of its own.
"""

# Users may give anything for a text.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

import re
import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from functools import cached_property, partial
from inspect import signature
from math import isfinite
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeAlias

from warpvox.checks import check_choice, check_integer, is_integer, is_list, is_mapping
from warpvox.devices.out_of_memory import shortage
from warpvox.envs.about import About, about_of
from warpvox.errors import TaskError, WarpvoxError, did_you_mean, listing
from warpvox.types import RULES
from warpvox.world import WorldObject

if TYPE_CHECKING:
    from torch import Tensor

    from warpvox.envs.random_stream import RandomStream
    from warpvox.envs.snapshot import Snapshot

ROBOT = "robot"
"""Name of the robot in the world of a task."""

Function: TypeAlias = "Callable[..., Tensor]"
"""A term's function of states, with parameters passed by name."""


@dataclass(frozen=True)
class Term:
    """A function of states with fixed parameters."""

    function: Function
    params: tuple[tuple[str, Any], ...] = ()

    kind: ClassVar[str] = "term"
    states: ClassVar[tuple[str, ...]] = ("state",)

    def __post_init__(self) -> None:
        """Raise TaskError if the function cannot be called with states and these parameters."""
        try:
            taken = signature(self.function)
        except (TypeError, ValueError):  # what cannot be called, or does not say how
            return
        given = dict(self.params)
        try:
            taken.bind(*self.states, **given)
        except TypeError as error:
            options = [*taken.parameters, *vars(self)]
            call = ", ".join([*self.states, *given])
            hint = next((did_you_mean(name, options) for name in given if name not in taken.parameters), "")
            takes = f"takes ({', '.join(taken.parameters)}) and is called with ({call})"
            raise TaskError(f"The {self.kind} '{self.name}' {takes}: {error}.{hint}") from None

    def __call__(self, *states: object) -> Tensor:
        """Evaluate the term in these states; TaskError: the function failed."""
        try:
            return self.bound(*states)
        except Exception as error:
            _raise_task_error(f"{self.kind} '{self.name}'", error)

    @cached_property
    def bound(self) -> Function:
        """The function with its parameters bound, taking only states."""
        return partial(self.function, **dict(self.params))

    @property
    def name(self) -> str:
        """Name of the function followed by its string parameters: ``displacement_robot_x``."""
        words = [value for _, value in self.params if isinstance(value, str)]
        return "_".join([getattr(self.function, "__name__", type(self.function).__name__), *words])

    @property
    def formula(self) -> str:
        """Formula as text from ``@about``, else the function's name and parameters."""
        described = about_of(self.function)
        if described is not None:
            return described.text(dict(self.params))
        return f"{self.function.__name__}({', '.join(f'{key}={value}' for key, value in self.params)})"


@dataclass(frozen=True)
class Observation(Term):
    """A term ``function(state)`` that returns ``[num_envs, k]``, or ``[num_envs, 2, points]`` for all points."""

    kind: ClassVar[str] = "observation"

    @property
    def about(self) -> About:
        """Formula, unit and range; without ``@about``, any number of unlimited size."""
        return about_of(self.function) or About(self.formula)


@dataclass(frozen=True)
class Reward(Term):
    """A term ``function(before, after)`` that returns float64 ``[num_envs]``, multiplied by ``weight``."""

    weight: float = 1.0
    kind: ClassVar[str] = "reward"
    states: ClassVar[tuple[str, ...]] = ("before", "after")


@dataclass(frozen=True)
class Termination(Term):
    """A term ``function(after)`` that returns bool ``[num_envs]``: True ends the episode and adds ``bonus``."""

    bonus: float = 0.0
    kind: ClassVar[str] = "termination"


@dataclass(frozen=True)
class Memory:
    """A task's own state within an episode, which terms read by ``state.memory(name)``.

    Attributes:
        name: unique in its task.
        start: ``start(draws)`` gives the value at the beginning of an episode, ``[num_envs, ...]``; what is random
            in it comes from the :class:`warpvox.envs.random_stream.RandomStream`.
        update: ``update(state)`` gives the value after a step; None: it stays what it was. Observations are made
            before the update, rewards and terminations see the new value.
    """

    name: str
    start: Callable[[RandomStream], Tensor]
    update: Callable[[Snapshot], Tensor] | None = None

    def begin(self, draws: RandomStream) -> Tensor:
        """Compute the value at the start of an episode, ``[num_envs, ...]``, with the random stream.

        Raises:
            TaskError: the function has failed; the message says where.
        """
        try:
            return self.start(draws)
        except Exception as error:
            _raise_task_error(f"start of the memory '{self.name}'", error)

    def advance(self, state: Snapshot) -> Tensor:
        """Compute the value after a step; without ``update``, return the present value.

        Raises:
            TaskError: the function has failed; the message says where.
        """
        if self.update is None:
            return state.memory_values[self.name]
        try:
            return self.update(state)
        except Exception as error:
            _raise_task_error(f"update of the memory '{self.name}'", error)


def _raise_task_error(part: str, error: Exception) -> NoReturn:
    """Raise a TaskError for an ``error`` raised by a task's function; ``part`` names the function.

    If the error is not one of warpvox, the message gives its file and line. A shortage of memory is raised as it is.
    """
    if shortage(error):
        raise error
    text = str(error).rstrip(".")
    if not isinstance(error, WarpvoxError):
        frames = traceback.extract_tb(error.__traceback__)
        text = f"{type(error).__name__}: {text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"
    raise TaskError(f"The {part} has failed: {text}.") from error


def _is_ours(function: Callable[..., Any]) -> bool:
    """Return whether a function is part of warpvox or of Python's ``operator``."""
    while isinstance(function, partial):
        function = function.func
    module = str(getattr(function, "__module__", ""))
    return module == "operator" or module.startswith("warpvox.")


def observes(function: Function, name: str = "robot", **params: Any) -> Observation:
    """Declare an observation of the object ``name``."""
    return Observation(function, (("name", name), *params.items()))


def rewards(function: Function, name: str = "robot", weight: float = 1.0, **params: Any) -> Reward:
    """Declare a reward for the object ``name``."""
    return Reward(function, (("name", name), *params.items()), weight)


def terminates(function: Function, name: str = "robot", bonus: float = 0.0, **params: Any) -> Termination:
    """Declare a termination by the object ``name``."""
    return Termination(function, (("name", name), *params.items()), bonus)


@dataclass(frozen=True)
class TaskSpec:
    """Specification of a task: world, observations, rewards, terminations, memories, limits.

    Attributes:
        id: what users type, for instance ``Walker-v0``.
        section: where the paper defines it, for instance ``B.2.1``; empty for a task of your own.
        summary: one sentence: what the robot has to do.
        difficulty: ``easy``, ``medium`` or ``hard``.
        objects: everything in the world but the robots that are designed.
        robot_cell: (x, y) of the lower left cell of the body's bounding box. The body is the object ``robot``.
        partners: further robots whose bodies are designed: their names, and (x, y) as for ``robot_cell``.
        max_episode_steps: control steps after which an episode is truncated.
        observations: in the order in which they are concatenated.
        rewards: summed.
        terminations: independent of each other; several may fire in one step.
        memory: the episode state, random values included; the update of an entry sees those before it updated.
        randomized: objects whose placement is randomized: each episode moves them by the cells (x, y) in the memory
            ``offset``.
        unstable_penalty: added to the reward of a step that self-folding has stopped; the episode ends.
        paper: fields that differ under ``rules="paper"``.
    """

    id: str
    section: str = ""
    summary: str = ""
    difficulty: str = "medium"
    _: KW_ONLY
    objects: tuple[WorldObject, ...]
    robot_cell: tuple[int, int]
    max_episode_steps: int
    observations: tuple[Observation, ...]
    rewards: tuple[Reward, ...]
    terminations: tuple[Termination, ...] = ()
    memory: tuple[Memory, ...] = ()
    randomized: tuple[str, ...] = ()
    partners: Mapping[str, tuple[int, int]] = field(default_factory=dict[str, tuple[int, int]])
    unstable_penalty: float = -3.0
    paper: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def __repr__(self) -> str:
        return f"TaskSpec({self.id}, {self.max_episode_steps} steps: {self.summary})"

    def __post_init__(self) -> None:
        """Validate fields and unique names (TaskError), and make mappings read-only."""
        for name in ("paper", "partners"):
            if not is_mapping(given := getattr(self, name)):
                raise TaskError(f"{name} of the task {self.id!r} must be a dictionary, got {given!r:.60}.")
            object.__setattr__(self, name, MappingProxyType(dict(given)))
        # Ids are also names of folders and, behind a slash, of gymnasium's environments.
        if not isinstance(self.id, str) or not re.fullmatch(r"[\w.+-]+", self.id):
            raise TaskError(f"The id of a task may hold letters, digits and . _ + - only, got {self.id!r}.")
        check_choice(f"difficulty of the task '{self.id}'", self.difficulty, ("easy", "medium", "hard"), TaskError)
        names = [item.name for item in fields(self) if item.name != "paper"]
        for name in self.paper:
            check_choice(f"paper of the task '{self.id}' changes fields; each", name, names, TaskError)
        self._check_parts()
        check_integer(f"max_episode_steps of the task '{self.id}'", self.max_episode_steps, 1, error=TaskError)
        if not self.observations:
            raise TaskError(f"The task '{self.id}' needs an observation.")
        if self.randomized and all(memory.name != "offset" for memory in self.memory):
            raise TaskError(
                f"The task '{self.id}' randomizes objects but has no memory named 'offset' that says how far."
            )
        parts = (self.observations, (*self.rewards, *self.terminations), self.memory)
        counts = [Counter(part.name for part in some) for some in parts] + [Counter([ROBOT, *self.partners])]
        twice = {name for count in counts for name in count if count[name] > 1}
        if twice:
            raise TaskError(
                f"The task '{self.id}' has several observations, reward terms, end terms, memories or robots named"
                f" {listing(twice)}."
            )

    def _check_parts(self) -> None:
        """Raise TaskError unless all parts have the right types; term values are checked later."""
        kinds = {"objects": WorldObject, "observations": Observation, "rewards": Reward}
        kinds |= {"terminations": Termination, "memory": Memory}
        for name, kind in kinds.items():
            parts: Sequence[object] = getattr(self, name)
            if not isinstance(parts, tuple | list):
                got = type(parts).__name__
                raise TaskError(f"The {name} of the task '{self.id}' must be a tuple of {kind.__name__}, got {got}.")
            for number, part in enumerate(parts):
                if not isinstance(part, kind):
                    given = getattr(part, "__name__", None)
                    got = f"the {part.kind} '{part.name}'" if isinstance(part, Term) else f"{part!r:.60}"
                    maker = {"observations": "observes", "rewards": "rewards", "terminations": "terminates"}.get(name)
                    hint = f": {maker or kind.__name__}({given})" if given else f", got {got}"
                    article = "an" if kind is Observation else "a"
                    raise TaskError(
                        f"{name}[{number}] of the task '{self.id}' must be {article} {kind.__name__}{hint}."
                    )
        for name, cell in self.robots.items():
            if not is_list(cell) or len(cell) != 2 or not all(map(is_integer, cell)):
                raise TaskError(f"The cell of {name!r} in the task '{self.id}' must be (x, y), got {cell!r:.60}.")
        objects = [obj.name for obj in self.objects] + list(self.robots)
        for name in self.randomized:
            if name not in objects:
                hint = did_you_mean(name, objects)
                raise TaskError(f"The task '{self.id}' randomizes {name!r}; its objects are {listing(objects)}.{hint}")
        numbers = {"unstable_penalty": self.unstable_penalty}
        numbers |= {f"weight of '{term.name}'": term.weight for term in self.rewards}
        numbers |= {f"bonus of '{term.name}'": term.bonus for term in self.terminations}
        for what, number in numbers.items():
            if not isinstance(number, Real) or not isfinite(number):
                raise TaskError(f"The {what} in the task '{self.id}' must be a finite number, got {number!r:.60}.")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy the task by its fields."""
        # Views of mappings cannot be copied or sent to other processes; the mappings can.
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return partial(TaskSpec, **values | {"paper": dict(self.paper), "partners": dict(self.partners)}), ()

    @property
    def has_code(self) -> bool:
        """True if the task contains functions written by the user."""
        functions = [term.function for term in (*self.observations, *self.rewards, *self.terminations)]
        functions += [function for memory in self.memory for function in (memory.start, memory.update) if function]
        return not all(_is_ours(function) for function in functions)

    @property
    def is_random(self) -> bool:
        """True if some memory starts at random, so that environments differ."""
        from torch import equal

        from warpvox.envs.random_stream import RandomStream

        draws = RandomStream(0, 16, "cpu")
        begun = [memory.begin(draws) for memory in self.memory]
        return not all(equal(value, value[:1].expand_as(value)) for value in begun)

    @property
    def robots(self) -> dict[str, tuple[int, int]]:
        """Robots with designed bodies: ``{name: (x, y)}``, positions as in ``robot_cell``."""
        return {ROBOT: self.robot_cell, **self.partners}

    def under(self, rules: str) -> TaskSpec:
        """Return the task under a rule set (:data:`RULES`); ``paper`` applies the changes in :attr:`paper`.

        Raises:
            ConfigError: unknown rules.
        """
        check_choice("rules", rules, RULES)
        return replace(self, paper={}, **self.paper) if rules == "paper" else self
