"""One environment on the CPU, stepped with numpy: the same terms on arrays that answer to torch's names.

Starting an operation of torch takes longer than what a single environment has to compute. The terms of tasks are
therefore given :class:`Row` instead of tensors: numpy arrays with the methods of tensors that they use, so that every
term is written once. :func:`fast_stepper` compares both ways, bit for bit, when an environment is made, and leaves to
torch what differs: terms that are not warpvox's own, and operations that :class:`Row` does not know.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from warpvox.envs.snapshot import Quantity, Snapshot
from warpvox.kernels.state import DIVERGED, UNSTABLE

if TYPE_CHECKING:
    from warpvox.envs.spec import TaskSpec
    from warpvox.envs.vec_env import VoxelVecEnv
    from warpvox.simulation import Simulation

__all__ = ["Row", "RowTerms", "Sensors", "SingleStepper", "fast_stepper"]

OURS = "warpvox.envs.terms."
"""Where terms live that follow the rules: functions of states alone, without branches on values."""
_STOPPED, _DIVERGED = int(UNSTABLE | DIVERGED), int(DIVERGED)

Result = tuple[np.ndarray, dict[str, float], bool, bool, bool]


class Row(np.ndarray):
    """A numpy array ``[1, ...]`` with the methods of tensors that terms use; results are bit for bit those of torch.

    A value with one entry, ``[1]``, is a :class:`Number`.
    """

    def __getitem__(self, key: Any) -> Any:
        if type(key) is tuple and self.ndim == 2 and len(key) == 2 and type(key[1]) is int and len(self) == 1:
            return Number(self.item(key[1]))
        return super().__getitem__(key)

    def double(self) -> Row:
        return self.astype(np.float64)

    def long(self) -> Row:
        return self.astype(np.int64)

    def abs(self) -> Row:
        return np.abs(self.view(np.ndarray)).view(Row)

    def floor(self) -> Row:
        return np.floor(self)

    def ceil(self) -> Row:
        return np.ceil(self)

    def clamp(self, low: float, high: float) -> Row:
        return np.clip(self, low, high)

    def minimum(self, other: Row) -> Row:
        return np.minimum(self.view(np.ndarray), other.view(np.ndarray)).view(Row)

    def where(self, condition: np.ndarray, other: Any) -> Row:
        return np.where(condition, self, other).view(Row)

    def masked_fill(self, mask: np.ndarray, value: float) -> Row:
        filled = self.copy()
        filled[mask] = value
        return filled

    def unbind(self, axis: int) -> list[Any]:
        return [self[:, k] for k in range(self.shape[1])] if axis == 1 else list(np.moveaxis(self, axis, 0))

    def sum(self, axis: int, keepdim: bool = False) -> Any:  # type: ignore[override]
        if self.dtype != bool or len(self) != 1 or axis != 1:
            raise NotImplementedError("torch sums numbers in an order of its own")
        count = int(np.count_nonzero(self.view(np.ndarray)))
        return np.array([[count]]).view(Row) if keepdim else Number(count)

    def amin(self, axis: int, keepdim: bool = False) -> Any:
        return _one(np.minimum.reduce(self.view(np.ndarray), axis, keepdims=keepdim))

    def amax(self, axis: int, keepdim: bool = False) -> Any:
        return _one(np.maximum.reduce(self.view(np.ndarray), axis, keepdims=keepdim))

    def gather(self, axis: int, index: np.ndarray) -> Row:
        if len(self) != 1 or axis != 1:
            raise NotImplementedError("for a single row only")
        if index.size == 1:
            return np.array([[self.item(index.item())]]).view(Row)
        return self[:, index.view(np.ndarray)[0]]

    def repeat(self, *counts: int) -> Row:  # type: ignore[override]
        return np.tile(self.view(np.ndarray), counts).view(Row)

    def expand_as(self, other: np.ndarray) -> Row:
        return self.reshape(other.shape) if self.size == other.size else np.broadcast_to(self, other.shape).view(Row)

    def new_full(self, shape: tuple[int, ...], value: float) -> Row:
        row = Row(shape, self.dtype)
        row.fill(value)
        return row

    def new_zeros(self, shape: tuple[int, ...]) -> Row:
        return self.new_full(shape, 0)

    def new_ones(self, shape: int | tuple[int, ...]) -> Row:
        return self.new_full(shape, 1)

    def fill_(self, value: float) -> Row:
        self[...] = value
        return self

    def scatter_reduce_(self, axis: int, index: np.ndarray, source: np.ndarray, reduce: str) -> Row:
        if len(self) != 1 or axis != 1:
            raise NotImplementedError("for a single row only")
        {"amin": np.minimum, "amax": np.maximum}[reduce].at(self[0], index[0], source[0])
        return self


def _plain(value: Any) -> Any:
    """An operand without its class: numpy takes four times as long for one of a class of ours."""
    if type(value) is Row:
        return value.view(np.ndarray)
    return np.array([value.value]) if type(value) is Number else value


def _of_rows(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Row]:
    return lambda row, other: operation(row.view(np.ndarray), _plain(other)).view(Row)


class Number:
    """The entry of a tensor ``[1]`` or ``[]``, with the operations of tensors that terms use."""

    __array_ufunc__ = None  # numpy's arrays leave operations with a number to it
    __slots__ = ("value",)

    def __init__(self, value: float | int | bool) -> None:
        self.value = value

    def item(self) -> float | int | bool:
        return self.value

    def double(self) -> Number:
        return Number(float(self.value))

    def abs(self) -> Number:
        return Number(abs(self.value))

    def where(self, condition: Number, other: Any) -> Any:
        return self if condition.value else other

    def masked_fill(self, mask: Number, value: float) -> Number:
        return Number(type(self.value)(value)) if mask.value else self

    def new_full(self, shape: tuple[int, ...], value: float) -> Number:
        if shape not in ((), (1,)):
            raise NotImplementedError("for one entry only")
        return Number(type(self.value)(value))

    def __getitem__(self, key: Any) -> Row:
        return np.array([self.value])[key].view(Row)

    def __neg__(self) -> Number:
        return Number(-self.value)

    def __invert__(self) -> Number:
        return Number(not self.value)


def _one(values: np.ndarray) -> Any:
    return Number(values.item()) if values.shape == (1,) else values.view(Row)


def _of_numbers(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def on(number: Number, other: Any) -> Any:
        if type(other) is Number:
            return Number(operation(number.value, other.value))
        if type(other) is Row:
            return operation(np.array([number.value]), other.view(np.ndarray)).view(Row)
        return Number(operation(number.value, other))

    return on


for _name in ("add", "sub", "mul", "lt", "le", "gt", "ge", "eq", "ne", "and", "or", "truediv"):
    _operation = getattr(operator, f"__{_name}__")
    setattr(Row, f"__{_name}__", _of_rows(_operation))
    if _name != "truediv":  # Python refuses to divide by 0
        setattr(Number, f"__{_name}__", _of_numbers(_operation))
for _name in ("add", "sub", "mul"):
    _operation = getattr(operator, f"__{_name}__")
    setattr(Row, f"__r{_name}__", _of_rows(lambda row, other, _operation=_operation: _operation(other, row)))
    setattr(
        Number, f"__r{_name}__", _of_numbers(lambda number, other, _operation=_operation: _operation(other, number))
    )


class Sensors:
    """Sensing of a simulation of one environment, as rows ``[1, ...]``.

    The methods are those of :class:`warpvox.Simulation`, with the same values: launches of the same kernels, into
    buffers of our own. Rows are fresh.
    """

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        self._senses: dict[tuple, Callable[[], Row]] = {}
        self._points: dict[str, np.ndarray | None] = {}
        self._centres: tuple[Any, dict[str, Row], dict[str, Row]] | None = None
        self.moved = True
        """Whether something has moved since the centres were sensed."""

    def _record(self, method: str, args: tuple) -> tuple[torch.Tensor, Any, list[torch.Tensor]]:
        """The result of a method of the simulation, its kernel launch (None: none), and the launch's buffers."""
        with self._sim.sensing_anew() as launches:
            value = getattr(self._sim, method)(*args)
        command, buffers = next(iter(launches.values()), (None, []))
        return value, command, buffers

    def _sense_centres(self, name: str) -> None:
        if self._centres is None:
            _, command, buffers = self._record("com", (name,))
            rows = [buffer.numpy().view(Row) for buffer in buffers]
            names = self._sim.object_names
            self._centres = command, *({name: row[:, k] for k, name in enumerate(names)} for row in rows)
        self._centres[0].launch()
        self.moved = False

    def com(self, name: str) -> Row:
        if self.moved:
            self._sense_centres(name)
        return self._centres[1][name].copy()

    def velocity(self, name: str) -> Row:
        if self.moved:
            self._sense_centres(name)
        return self._centres[2][name].copy()

    def relative_positions(self, name: str) -> Row:
        if name not in self._points:
            self._points[name] = self._find_points(name)
        points = self._points[name]
        if points is None:
            return self.launched("relative_positions", name)
        centre, found = self.com(name), np.empty(points.shape)
        for axis in (0, 1):  # one after the other: a broadcast over rows of two takes three times as long
            np.subtract(points[0, axis], centre.item(axis), found[0, axis])
        return found.view(Row)

    def _find_points(self, name: str) -> np.ndarray | None:
        """A view ``[1, 2, points]`` on the simulation's own positions; None: they do not lie so."""
        sim = self._sim
        body = next((body for body in sim.designs[0].bodies if body.name == name), None)
        places = sim.array("pos").numpy()
        if body is None or sim.arithmetic != "exact" or places.shape[::2] != (1, 1):
            return None
        points = places.reshape(-1, 2)[body.first_point :][: len(body.points)].T[None]
        there = sim.object_positions(name).numpy().transpose(0, 2, 1)
        return points if np.array_equal(points, there) else None

    def launched(self, method: str, *args: Any) -> Row:
        """A quantity by the launch that the simulation makes for it."""
        key = (method, *args)
        if key not in self._senses:
            self._senses[key] = self._sense(method, args)
        return self._senses[key]()

    def __getattr__(self, method: str) -> Callable[..., Row]:
        ask = partial(self.launched, method)
        setattr(self, method, ask)
        return ask

    def _sense(self, method: str, args: tuple) -> Callable[[], Row]:
        value, command, buffers = self._record(method, args)
        if command is None:  # what never moves
            fixed = value.numpy().view(Row)
            return fixed.copy
        row = buffers[0].numpy().view(Row)
        if row.shape != tuple(value.shape):  # x and y apart
            row = row.transpose(0, 2, 1)
        kind = value.numpy().dtype
        if not np.array_equal(row.astype(kind), value.numpy()):
            raise NotImplementedError(f"{method} is more than what one launch gives")

        def sense() -> Any:
            command.launch()
            return row.astype(kind) if row.ndim > 1 else Number(row.item())

        return sense


class RowTerms:
    """Evaluates the terms of a task on states of :class:`Sensors`.

    Args:
        spec: the task; its terms are warpvox's own.
        dtype: of observations.
    """

    def __init__(self, spec: TaskSpec, dtype: np.dtype | type = np.float64) -> None:
        self._dtype, self._penalty = np.dtype(dtype), spec.unstable_penalty
        self._observations = [(term.function, dict(term.params)) for term in spec.observations]
        self._rewards = [(term.name, term.function, dict(term.params), term.weight) for term in spec.rewards]
        self._terminations = [(term.name, term.function, dict(term.params), term.bonus) for term in spec.terminations]

    @property
    def reward_names(self) -> list[str]:
        """Names of the reward terms."""
        return [name for name, *_ in self._rewards]

    def compared(self, state: Snapshot) -> tuple[Quantity, ...]:
        """The quantities that rewards ask of the state before a step."""
        for _, reward, params, _ in self._rewards:
            reward(state, Snapshot(state.sim, state.memory_values), **params)
        return state.quantities

    def observe(self, state: Snapshot) -> np.ndarray:
        """A fresh observation ``[num_obs]``."""
        parts = [term(state, **params).reshape(-1) for term, params in self._observations]
        return np.concatenate(parts, dtype=self._dtype, casting="same_kind").view(np.ndarray)

    def judge(self, before: Snapshot, after: Snapshot, stopped: bool) -> tuple[dict[str, float], bool]:
        """The parts of the reward, by name, and whether the episode terminates."""
        terms = {name: f(before, after, **params).item() * weight for name, f, params, weight in self._rewards}
        terms["unstable"] = float(stopped) * self._penalty
        ended = stopped
        for name, test, params, bonus in self._terminations:
            hit = test(after, **params).item()
            terms[name] = float(hit) * bonus
            ended = ended or hit
        return terms, ended


class SingleStepper:
    """Steps the one environment of a :class:`warpvox.envs.vec_env.VoxelVecEnv` that does not reset itself.

    Args:
        env: on the CPU, with terms of warpvox's own.
    """

    def __init__(self, env: VoxelVecEnv) -> None:
        sim = self._sim = env.sim
        self._sensors = Sensors(sim)
        self._terms = RowTerms(env.spec, str(env.dtype).removeprefix("torch."))
        self._actions = sim.action_buffer.numpy()[0]
        self._status = sim.array("status").numpy().reshape(-1)
        self._slot = int(sim.slot[0])
        self._updates = [memory for memory in env.spec.memory if memory.update is not None]
        episodes = self._episodes = env.episodes
        self._memory = {name: value.numpy() for name, value in episodes.memory.items()}
        self._length, self._return = episodes.length.numpy(), episodes.returns.numpy()
        self._terminated = episodes.terminated.numpy()
        self.begin()

    def begin(self) -> None:
        """Go on from where the environments stand: after a reset, or when something else has moved them."""
        self._sensors.moved = True
        memory = {name: value.copy().view(Row) for name, value in self._memory.items()}
        self._before = Snapshot(self._sensors, memory).fetch(self._episodes.before)

    def evaluate(self) -> tuple[np.ndarray, tuple[dict[str, float], bool]]:
        """The observation, and what :meth:`RowTerms.judge` gives, in the present state, without a step."""
        state = Snapshot(self._sensors, self._before.memory_values)
        return self._terms.observe(state), self._terms.judge(self._before, state, False)

    def step(self, action: np.ndarray) -> Result:
        """One control step: what :meth:`warpvox.envs.vec_env.VoxelVecEnv.step_one` returns; ``action`` is finite."""
        self._actions[:] = action
        self._sim.advance()
        self._length[0] = self._length.item() + 1  # before it is observed
        self._sensors.moved = True
        before, after = self._before, Snapshot(self._sensors, self._before.memory_values)
        obs = self._terms.observe(after)
        self._episodes.drawn = False
        if self._updates:
            memory_values = after.update(self._updates)
            for memory in self._updates:
                self._memory[memory.name][...] = memory_values[memory.name]
        status = self._status.item(self._slot)  # a number of Python's: those of numpy are slow
        stopped, diverged = bool(status & _STOPPED), bool(status & _DIVERGED)
        terms, ended = self._terms.judge(before, after, stopped)
        if diverged:
            terms |= dict.fromkeys(self._terms.reward_names, 0.0)
        self._before = after
        self._return[0] = self._return.item() + sum(terms.values())
        if ended:
            self._terminated[0] = True
        return obs, terms, ended, stopped, diverged


def fast_stepper(env: VoxelVecEnv) -> SingleStepper | None:
    """The fast stepper of a single environment; None if the environment needs torch (see the module's docstring)."""
    terms = [*env.spec.observations, *env.spec.rewards, *env.spec.terminations]
    functions = [term.function for term in terms] + [memory.update for memory in env.spec.memory if memory.update]
    own = all(str(getattr(getattr(f, "func", f), "__module__", "")).startswith(OURS) for f in functions)
    if env.num_envs != 1 or str(env.device) != "cpu" or env.auto_reset or not own:
        return None
    try:
        stepper = SingleStepper(env)
        obs, judged = stepper.evaluate()
    except (AttributeError, TypeError, ValueError, IndexError, NotImplementedError):
        return None  # an operation that rows do not have
    there = Snapshot(env.sim, env.episodes.memory)
    theirs = env.observe(there)[0].numpy()
    parts, ended = env.judge(there, there, torch.zeros(1, dtype=torch.bool))
    same = judged == ({name: part.item() for name, part in parts.items()}, ended.item())
    return stepper if same and obs.dtype == theirs.dtype and np.array_equal(obs, theirs) else None
