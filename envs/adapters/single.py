"""Fast stepping of one environment on the CPU: the task's terms run on numpy arrays instead of tensors.

Starting an operation of torch takes longer than what a single environment has to compute. warpvox's own terms take
arrays as well (:mod:`warpvox.envs.terms.arrays`); :func:`fast_stepper` compares both ways, bit for bit, when an
environment is made, and leaves to torch what differs, and terms that are not warpvox's own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from warpvox.envs.snapshot import Quantity, Snapshot
from warpvox.kernels.state import DIVERGED, STOPPED

if TYPE_CHECKING:
    from warpvox.envs.spec import TaskSpec
    from warpvox.envs.vec_env import VoxelVecEnv
    from warpvox.simulation import Simulation


class Sensors:
    """Sensors of a simulation with one environment, as numpy arrays ``[1, ...]``.

    The methods are those of :class:`warpvox.Simulation`, with the same values: launches of the same kernels, into
    buffers of our own. Rows are fresh.
    """

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        self._senses: dict[tuple[Any, ...], Callable[[], np.ndarray]] = {}
        self._points: dict[str, np.ndarray | None] = {}
        self._centres: Any = None  # launch, positions and velocities by name
        self.moved = True
        """True if something has moved since the centres were sensed."""

    def _record(self, method: str, args: tuple[Any, ...]) -> tuple[torch.Tensor, Any, list[torch.Tensor]]:
        """Call a sensing method; return the result, its recorded kernel launch (or None) and the launch's buffers."""
        with self._sim.sensing_anew() as launches:
            value = getattr(self._sim, method)(*args)
        command, buffers = next(iter(launches.values()), (None, list[torch.Tensor]()))
        return value, command, buffers

    def _centre(self, name: str, which: int) -> np.ndarray:
        """Return the centre of mass (``which`` 1) or its velocity (2), ``[1, 2]``, cached until the points move."""
        if self.moved:
            if self._centres is None:
                _, command, buffers = self._record("com", (name,))
                rows = [buffer.numpy() for buffer in buffers]
                names = self._sim.object_names
                self._centres = command, *({name: row[:, k] for k, name in enumerate(names)} for row in rows)
            self._centres[0].launch()
            self.moved = False
        return self._centres[which][name].copy()

    def com(self, name: str) -> np.ndarray:
        """Return the centre of mass of an object, ``[1, 2]``."""
        return self._centre(name, 1)

    def velocity(self, name: str) -> np.ndarray:
        """Return the velocity of an object's centre of mass, ``[1, 2]``."""
        return self._centre(name, 2)

    def robot_actions(self, name: str) -> np.ndarray:
        return self._sim.robot_actions(name).numpy()

    def relative_positions(self, name: str) -> np.ndarray:
        """Return all points of an object relative to the centre of mass, ``[1, 2, points]``."""
        if name not in self._points:
            self._points[name] = self._find_points(name)
        points = self._points[name]
        if points is None:
            return self.launched("relative_positions", name)
        centre = self.com(name)
        found = np.empty(points.shape)
        for axis in (0, 1):  # one after the other: a broadcast over rows of two takes three times as long
            np.subtract(points[0, axis], centre.item(axis), found[0, axis])
        return found

    def _find_points(self, name: str) -> np.ndarray | None:
        """Return a numpy view of an object's points, ``[1, 2, points]``; None if the order of rows forbids one."""
        sim = self._sim
        body = next((body for body in sim.designs[0].bodies if body.name == name), None)
        places = sim.array("pos").numpy()
        if body is None or sim.arithmetic != "exact" or places.shape[::2] != (1, 1):
            return None
        points = places.reshape(-1, 2)[body.first_point :][: len(body.points)].T[None]
        there = sim.object_positions(name).numpy().transpose(0, 2, 1)
        return points if np.array_equal(points, there) else None

    def launched(self, method: str, *args: Any) -> np.ndarray:
        """Return a quantity by relaunching the recorded kernel of ``method``; the first call records it."""
        key = (method, *args)
        if key not in self._senses:
            self._senses[key] = self._sense(method, args)
        return self._senses[key]()

    def __getattr__(self, method: str) -> Callable[..., np.ndarray]:
        """Return a cached function that senses by the simulation's method of this name.

        Raises:
            AttributeError: the simulation has no public method of that name.
        """
        if method.startswith("_") or not callable(getattr(type(self._sim), method, None)):
            raise AttributeError(f"A simulation has no method {method!r} that senses.", name=method, obj=self)
        ask = partial(self.launched, method)
        setattr(self, method, ask)
        return ask

    def _sense(self, method: str, args: tuple[Any, ...]) -> Callable[[], np.ndarray]:
        """Record a sensing method; return a function that relaunches the kernel and returns a new array.

        Raises:
            NotImplementedError: the method does more than one launch.
        """
        value, command, buffers = self._record(method, args)
        if command is None:  # what never moves
            fixed = value.numpy()
            return fixed.copy
        row = buffers[0].numpy()
        if row.shape != tuple(value.shape):  # x and y apart
            row = row.transpose(0, 2, 1)
        kind = value.numpy().dtype
        if not np.array_equal(row.astype(kind), value.numpy()):
            raise NotImplementedError(f"{method} is more than what one launch gives")

        def sense() -> np.ndarray:
            command.launch()
            return row.astype(kind)

        return sense


class RowTerms:
    """Evaluates a task's observations, rewards and terminations with numpy.

    Args:
        spec: the task; its terms are warpvox's own.
        dtype: of observations.
    """

    def __init__(self, spec: TaskSpec, dtype: np.typing.DTypeLike = np.float64) -> None:
        self._dtype = np.dtype(dtype)
        self._penalty = spec.unstable_penalty
        self._observations = [(term.function, dict(term.params)) for term in spec.observations]
        self._rewards = [(term.name, term.function, dict(term.params), term.weight) for term in spec.rewards]
        self._terminations = [(term.name, term.function, dict(term.params), term.bonus) for term in spec.terminations]

    def compared(self, state: Snapshot) -> tuple[Quantity, ...]:
        """Return the quantities of the state before a step that rewards compare with."""
        for _, reward, params, _ in self._rewards:
            reward(state, Snapshot(state.sim, state.memory_values), **params)
        return state.quantities

    def observe(self, state: Snapshot) -> np.ndarray:
        """Compute the observation of a state, a new array ``[num_obs]``."""
        parts = [term(state, **params).reshape(-1) for term, params in self._observations]
        return np.concatenate(parts, dtype=self._dtype, casting="same_kind")

    def judge(self, before: Snapshot, after: Snapshot, stopped: bool) -> tuple[dict[str, float], bool]:
        """Compute the reward terms by name, and whether the episode terminates."""
        terms = {name: f(before, after, **params).item() * weight for name, f, params, weight in self._rewards}
        terms["unstable"] = float(stopped) * self._penalty
        ended = stopped
        for name, test, params, bonus in self._terminations:
            hit: Any = test(after, **params).item()
            terms[name] = float(hit) * bonus
            ended = ended or hit
        return terms, ended


class SingleStepper:
    """Steps a ``VoxelVecEnv`` of one environment with numpy, without automatic reset.

    Args:
        env: on the CPU, with terms of warpvox's own.
    """

    def __init__(self, env: VoxelVecEnv) -> None:
        sim = self._sim = env.sim
        self._sensors = Sensors(sim)
        self._terms = RowTerms(env.spec, env.sim.options.dtype)
        self._without = dict.fromkeys((term.name for term in env.spec.rewards), 0.0)
        self._actions = sim.action_buffer.numpy()[0]
        self._status = sim.array("status").numpy().reshape(-1)
        self._slot = int(sim.slot[0])
        self._updates = {memory.name: memory.advance for memory in env.spec.memory if memory.update is not None}
        episodes = self._episodes = env.episodes
        self._memory = {name: value.numpy() for name, value in episodes.memory.items()}
        self._length = episodes.length.numpy()
        self._return = episodes.returns.numpy()
        self._terminated = episodes.terminated.numpy()
        self.begin()

    def begin(self) -> None:
        """Read the present state, after a reset or another change from outside."""
        self._times_set = self._episodes.times_set
        self._sensors.moved = True
        memory = {name: value.copy() for name, value in self._memory.items()}
        self._before = Snapshot(self._sensors, memory).fetch(self._episodes.before)

    def evaluate(self) -> tuple[np.ndarray, tuple[dict[str, float], bool]]:
        """Compute observation, reward terms and termination in the present state, without a step."""
        state = Snapshot(self._sensors, self._before.memory_values)
        return self._terms.observe(state), self._terms.judge(self._before, state, False)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, dict[str, float], bool, bool, bool]:
        """Do one control step with a finite ``action``.

        Returns:
            Observation ``[num_obs]``, what each term has added to the reward, terminated, whether the step was
            stopped, and whether by divergence. After a termination results are undefined until a reset.
        """
        if self._times_set != self._episodes.times_set:
            self.begin()
        self._actions[:] = action
        self._sim.advance()
        self._length[0] = self._length.item() + 1  # before it is observed
        self._sensors.moved = True
        before = self._before
        after = Snapshot(self._sensors, self._before.memory_values)
        obs = self._terms.observe(after)
        self._episodes.drawn = False
        if self._updates:
            memory_values = after.update(self._updates)
            for name in self._updates:
                self._memory[name][...] = memory_values[name]
        status = self._status.item(self._slot)  # a number of Python's: those of numpy are slow
        stopped = bool(status & STOPPED)
        diverged = bool(status & DIVERGED)
        terms, ended = self._terms.judge(before, after, stopped)
        if diverged:
            terms |= self._without
        self._before = after
        self._return[0] = self._return.item() + sum(terms.values())
        if ended:
            self._terminated[0] = True
        return obs, terms, ended, stopped, diverged


def fast_stepper(env: VoxelVecEnv) -> SingleStepper | None:
    """Return a :class:`SingleStepper` for ``env``; None if the task's terms need torch."""
    terms = [*env.spec.observations, *env.spec.rewards, *env.spec.terminations]
    functions = [term.function for term in terms] + [memory.update for memory in env.spec.memory if memory.update]
    # Terms of this package follow the rules: functions of states alone, without branches on values.
    ours = "warpvox.envs.terms."
    own = all(str(getattr(getattr(f, "func", f), "__module__", "")).startswith(ours) for f in functions)
    if env.num_envs != 1 or str(env.device) != "cpu" or env.auto_reset or not own:
        return None
    try:
        stepper = SingleStepper(env)
        obs, judged = stepper.evaluate()
    except NotImplementedError:  # a quantity that is more than one launch
        return None
    there = Snapshot(env.sim, env.episodes.memory)
    theirs = env.layout.observe(there)[0].numpy()
    rewards, hits = env.evaluate_terms(there, there)
    parts = {term.name: rewards[term.name].item() * term.weight for term in env.spec.rewards}
    parts["unstable"] = 0.0
    parts |= {term.name: hits[term.name].item() * term.bonus for term in env.spec.terminations}
    same = judged == (parts, any(hit.item() for hit in hits.values()))
    return stepper if same and obs.dtype == theirs.dtype and np.array_equal(obs, theirs) else None
