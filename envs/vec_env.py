"""Vector environment: many environments of one task, stepped together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from warpvox.batch.options import SimKeywords, SimOptions
from warpvox.checks import check_choice, check_flag, check_integer, check_mask, is_mapping
from warpvox.design import Design
from warpvox.devices.out_of_memory import enough_memory, fewer
from warpvox.envs.checks import FiniteGuard, check_fields, check_memory, check_terms
from warpvox.envs.episodes import Episodes, Outcomes, rows_of
from warpvox.envs.graph import Capture, Graph, capture_on_cuda
from warpvox.envs.memory import ask, environment_bytes
from warpvox.envs.observations import ObservationLayout
from warpvox.envs.random_stream import RandomStream
from warpvox.envs.registry import get_task
from warpvox.envs.snapshot import Quantity, Snapshot
from warpvox.envs.spec import ROBOT, Observation, TaskSpec
from warpvox.envs.terms.observations import NAME as TIME, ElapsedSteps, is_timed
from warpvox.envs.voxels import VoxelGrid, voxel_layouts, voxel_observations
from warpvox.envs.worlds import load_worlds, one_body
from warpvox.errors import ConfigError, DesignError, SimulationError, did_you_mean, listing
from warpvox.keys import in_words
from warpvox.simulation import Simulation
from warpvox.types import OBSERVATIONS

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from warpvox.envs.dumps import DivergenceDump

StepResult = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]


@in_words
def make_vec(
    task: str | TaskSpec,
    designs: Sequence[object] | np.ndarray | str | None = None,
    num_envs: int = 1,
    *,
    rules: str = "evogym",
    obs: str = "task",
    seed: int | Sequence[int] = 0,
    auto_reset: bool = True,
    body: object = None,
    connections: Sequence[object] | np.ndarray | None = None,
    max_episode_steps: int | None = None,
    sim: SimOptions | None = None,
    **options: Unpack[SimKeywords],
) -> VoxelVecEnv:
    """Create ``num_envs`` environments of a task.

    Args:
        task: an id out of ``task_ids()``, ``module:NAME`` or ``file.py:NAME``, or a specification of your own.
        designs: robot bodies: arrays, or anything :func:`warpvox.load_design` reads; a single body will do, also as
            rows of cells: ``[[3, 3, 3], [4, 0, 4]]``.
            Environments come in equal blocks, design by design. Default: the example design ``walker``. Where a
            task has several robots, a design is a mapping ``{name: body}``; a single body is meant for all of them.
        num_envs: a multiple of the number of designs.
        rules: ``evogym`` (as released) or ``paper`` (section B as printed); the physics follow unless told otherwise.
        obs: ``task`` (what the task observes) or ``voxel`` (every cell of the body, then the rest of what the task
            observes; see :mod:`warpvox.envs.voxels`); ``timed`` and ``timed_voxel``: the same, then the control steps
            since the episode began.
        seed: of all random numbers of a task (there are none in the deterministic ones). The numbers of environment k
            do not depend on the other environments. Or one seed for each design, whose environments then draw as if
            they were alone; or one for each environment.
        auto_reset: reset environments in the step in which they end; otherwise they stay as they ended.
        body: one body for all environments, as in ``gymnasium.make``: short for ``designs=[body]``. ``connections`` are
            then its own.
        connections: for each design EvoGym's ``[2, k]`` index pairs, or None to connect all neighbours.
        max_episode_steps: another time limit than the task's.
        sim: how they are computed; its fields may also be given by name: ``device="cpu"``.
        options: fields of :class:`warpvox.SimOptions`: ``device``, ``dtype``, ``arithmetic``, ``physics``, ...

    Raises:
        TaskError: unknown task. DesignError: a body that is not valid. WorldError: a body that does not fit.
        ConfigError: a count or name out of range, an unknown argument, or both ``body`` and ``designs``.
        SimulationError, DeviceError: an option that cannot be. MemoryLimitError: more environments than fit.
    """
    check_choice("obs", obs, OBSERVATIONS)
    auto_reset = check_flag("auto_reset", auto_reset)
    sim = SimOptions.of(sim, options, make_vec)
    spec = get_task(task).under(rules)
    if max_episode_steps is not None:
        spec = replace(spec, max_episode_steps=check_integer("max_episode_steps", max_episode_steps, 1))
    bodies, worlds = load_worlds(spec, *one_body(body, designs, connections))
    count = check_integer("num_envs", num_envs, 1)
    if count % len(bodies):
        below = count - count % len(bodies)
        near = f"{below} or {below + len(bodies)}" if below else f"{len(bodies)}"
        what = f"a multiple of the number of designs ({len(bodies)})"
        raise ConfigError(f"num_envs must be {what}, got {count}; try {near}.")
    _check_seeds(seed, len(bodies), count)
    sim = sim.resolved(count, rules)
    ambient = torch.empty(0).device.type  # torch 2.7 cannot be asked once its default device was set to None
    if ambient not in ("cpu", torch.device(sim.device).type):
        raise ConfigError(f"torch's default device is {ambient}, but the environments are on {sim.device}.")
    if sim.memory_check and (count > 1 or sim.grid is not None):
        ask(environment_bytes(spec, worlds, count, sim, obs=obs), count, sim.device, step=len(bodies))
    with enough_memory(fewer(count)), torch.inference_mode(False):  # a tensor of that mode can be used in it alone
        worlds = [world for world in worlds for _ in range(count // len(bodies))]
        made = Simulation(worlds, sim, loose=spec.randomized)
        return VoxelVecEnv(spec, bodies, made, rules=rules, seed=seed, auto_reset=auto_reset, obs=obs)


class VoxelVecEnv:
    """Environments of one task in one simulation; created by :func:`make_vec`.

    All returned tensors are fresh: keeping them is safe, changing them has no effect on the environments. Episode state
    is in ``episodes``, in tensors that are allocated once.

    Attributes:
        spec: the task under the rules chosen; ``rules`` names those.
        sim: the simulation, for positions, velocities and everything else.
        designs: list of int8 bodies; where a task has several robots, ``{name: body}`` of all.
        design_index: long ``[num_envs]``, which of the designs an environment has.
        num_envs, num_obs, num_actions: sizes; the latter two are the largest over the designs.
        obs_mask, action_mask: bool ``[num_designs, num_obs]`` and ``[num_designs, num_actions]``: which
            entries are real for a design. Real ones come first, observations are padded with 0.
        obs_columns: per design where each observation term lies, ``{term name: slice}``.
        action_columns: per design where the actions of each robot lie, ``{robot name: slice}``.
        layout: where observation terms lie (:class:`warpvox.envs.observations.ObservationLayout`).
        voxels: with ``obs="voxel"`` the :class:`warpvox.envs.voxels.VoxelLayout` of every robot, by name.
        episodes: length, return, memory of the running episodes (:class:`warpvox.envs.episodes.Episodes`).
        auto_reset: whether environments are reset in the step in which they end; may be changed between steps, to True
            once those that have ended are reset (``reset(mask=...)``).
        capture: how control steps are recorded as a CUDA graph; None: they are not. A step within a larger recording
            becomes a part of it.
        device: torch's name of the device; ``dtype``: of observations and rewards.
    """

    def __init__(
        self,
        spec: TaskSpec,
        designs: list[Design | dict[str, Design]],
        sim: Simulation,
        *,
        rules: str = "evogym",
        seed: int | Sequence[int] = 0,
        auto_reset: bool = True,
        obs: str = "task",
    ) -> None:
        self.episodes = Episodes(sim.num_envs, sim.device, spec.max_episode_steps)
        if obs.endswith("voxel"):
            spec = replace(spec, observations=voxel_observations(spec.observations, tuple(spec.robots), sim))
        if obs.startswith("timed"):
            spec = replace(spec, observations=(*spec.observations, Observation(ElapsedSteps(self.episodes))))
        self.spec = spec
        self.rules = rules
        self.sim = sim
        self.seed = seed
        self.auto_reset = auto_reset
        self.num_envs = sim.num_envs
        self.device = sim.device
        self.dtype = sim.dtype
        self._updates = {memory.name: memory.advance for memory in spec.memory}
        self._has_code = spec.has_code
        self._random: Any = None
        self._limit = spec.max_episode_steps

        # Designs, each for a block of environments that may have a seed of its own
        self.designs = designs
        self._blocks = len(designs)
        block = sim.num_envs // len(designs)
        self.design_index = torch.arange(len(designs), device=sim.device).repeat_interleave(block)

        # Memory, and what the terms give at the beginning of an episode
        self._draws = RandomStream(seed, self.num_envs, sim.device) if spec.memory else None
        if self._draws is not None:
            check_memory(spec, sim, self._draws)
            self._start_memory(self._draws, None, {})
        probe = self._snapshot()
        check_terms(spec, sim, probe)
        # Rewards compare with the state before a step: find out once which quantities they need.
        before = self._snapshot()
        for term in spec.rewards:
            term(before, probe)
        self.episodes.before = {quantity: before.value(quantity).clone() for quantity in before.quantities}

        # Observations and actions
        self.layout = ObservationLayout(spec.observations, sim, probe)
        self.num_obs = self.layout.num_obs
        self.num_actions = sim.num_actions
        self._set_masks_and_columns(sim.design_index[::block])  # equal designs share one world of the simulation
        self.voxels = voxel_layouts(spec.observations, self.obs_columns[0])

        # What an episode begins with: its observation (under "obs"), and what its first step is compared with. Episodes
        # of a task without memory all begin alike; code of the user's own may do anything.
        self._first: dict[Any, torch.Tensor] = {}
        if not spec.memory and not self._has_code:
            self._first = {quantity: value.clone() for quantity, value in self.episodes.before.items()}
            self._first["obs"] = self.layout.observe(probe)

        # On the CPU a mask can be read to skip work; elsewhere reading it would wait for the device.
        self._on_cpu = sim.device == "cpu"
        self._outcomes = Outcomes(spec, sim, self.episodes)
        self._finite = FiniteGuard(spec, sim, self.layout, self._outcomes.nonfinite_rewards)
        self.dump: DivergenceDump | None = None
        self.capture: Capture | None = None
        self._graph: Graph | None = None
        wanted = sim.options.cuda_graph
        if not self._on_cpu and (not self._has_code if wanted is None else wanted):
            self.capture = partial(capture_on_cuda, sim.device)
            self._graph = Graph(self.capture, "Control steps")

    def __repr__(self) -> str:
        counts = f"num_envs={self.num_envs}, num_designs={self.num_designs}"
        sizes = f"num_obs={self.num_obs}, num_actions={self.num_actions}"
        return f"VoxelVecEnv({self.spec.id}, {counts}, {sizes}, device={self.device})"

    def _snapshot(self, values: Mapping[Quantity, torch.Tensor] | None = None) -> Snapshot:
        """Return the present state for terms; the user's own terms get copies, so that they cannot change it."""
        return Snapshot(self.sim, self.episodes.memory, values, copies=self._has_code)

    def _set_masks_and_columns(self, worlds: torch.Tensor) -> None:
        """Compute the masks and columns of observations and actions of every design.

        Args:
            worlds: long ``[num_designs]``: for each design the index of its world in ``sim.worlds``.
        """
        self.obs_mask = self.layout.mask[worlds]
        self.action_mask = self.sim.action_mask[worlds]
        numbers: list[int] = worlds.cpu().numpy().tolist()
        self.obs_columns = [self.layout.columns[number] for number in numbers]
        action_columns = self.sim.action_columns
        self.action_columns = [action_columns[number] for number in numbers]

    @property
    def num_designs(self) -> int:
        """Number of designs."""
        return len(self.designs)

    @property
    def episode_length(self) -> torch.Tensor:
        """Control steps of the present episodes, long ``[num_envs]``; updated in place by steps, no copy.

        May be assigned, or written to; :meth:`retimed` brings earlier observations up to date.
        """
        return self.episodes.length

    @episode_length.setter
    def episode_length(self, lengths: torch.Tensor | Sequence[int]) -> None:
        lengths = torch.as_tensor(lengths, device=self.device)
        if tuple(lengths.shape) != (self.num_envs,) or lengths.dtype.is_floating_point:
            got = f"{lengths.dtype} {list(lengths.shape)}"
            raise ConfigError(f"episode_length must be integers [{self.num_envs}], got {got}.")
        self.episodes.length.copy_(lengths)

    @property
    def max_episode_steps(self) -> int:
        """Time limit of an episode in control steps; may be assigned."""
        return self._limit

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int) -> None:
        self._limit = check_integer("max_episode_steps", steps, 1)
        self.episodes.limit.fill_(self._limit)

    @property
    def memory(self) -> dict[str, torch.Tensor]:
        """Values of the task's memories by name (``spec.memory``): new tensors ``[num_envs, ...]``."""
        return {name: value.clone() for name, value in self.episodes.memory.items()}

    def reset(
        self,
        seed: int | Sequence[int] | None = None,
        memory: Mapping[str, Any] | None = None,
        mask: torch.Tensor | np.ndarray | None = None,
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        """Begin a new episode in all environments, or where ``mask`` is True.

        Args:
            seed: restart the random streams from this seed (or one for each design, or for each environment); None
                continues them.
            memory: episode state to set in place of what the task draws, ``[num_envs, ...]`` by name; entries that are
                missing at the end of a row are 0. For this episode only.
            mask: bool ``[num_envs]``; None means all. The other environments stay as they are.

        Returns:
            Observations ``[num_envs, num_obs]`` (where ``mask`` is False: of the present state) and an empty
            dictionary.

        Raises:
            ConfigError: the task has no memory of that name, or not such numbers; no such seed or mask.
        """
        mask = None if mask is None else check_mask(mask, self.design_index)
        if seed is not None:
            _check_seeds(seed, self._blocks, self.num_envs)
            self.seed = seed if mask is None else self.seed
        given = self._given(memory)
        self.sim.reset(mask)
        if self._draws is not None:
            if seed is not None:
                self._draws.begin(seed, mask)
            elif mask is not None:
                self._draws.episode.add_(mask)
            elif not self.episodes.drawn:
                self._draws.episode.add_(1)
            self.episodes.drawn = False
            self._start_memory(self._draws, mask, given)
        self.episodes.clear(mask)
        state = self._snapshot()
        self.episodes.set_before(state)
        if self.dump is not None:
            self.dump.clear(mask)
        return self._finite.first_observation(self.layout.observe(state), mask), {}

    def draw_as(self, numbers: torch.Tensor) -> None:
        """Make environments draw the random numbers of others after their next reset, until a reset with a seed.

        Args:
            numbers: long ``[num_envs]``: for each environment the index of the one whose numbers it draws.
        """
        if self._draws is not None:
            self._draws.keys.copy_(self._draws.keys[numbers.to(self.device)])

    def set_designs(
        self, designs: object, mask: torch.Tensor | np.ndarray, connections: Sequence[object] | None = None
    ) -> torch.Tensor:
        """Replace the bodies of some environments, which begin a new episode; the others continue.

        Nothing is compiled and no array moves; sizes of observations and actions stay. ``designs``, ``design_index``,
        the masks and columns follow: equal designs are one then. Returned is what :meth:`reset` observes.

        Args:
            designs, connections: a body for each environment of the mask in their order, or one for all; as in
                :func:`make_vec`.
            mask: bool ``[num_envs]``.

        Raises:
            SimulationError: made without ``grid``, or a body that does not fit it. DesignError, WorldError: a body that
                is not valid or does not fit the world. Nothing has changed then.
        """
        mask = check_mask(mask, self.design_index)
        if designs is None:
            raise DesignError("set_designs needs a body, or a list of bodies; got None.")
        count = int(mask.sum())
        worlds = load_worlds(self.spec, designs, connections)[1]
        if len(worlds) not in (1, count):
            raise ConfigError(f"{count} environments need a design each, or one for all; got {len(worlds)}.")
        self.sim.set_worlds(worlds if len(worlds) == count else worlds * count, mask)
        self.layout.refresh()
        self._finite.refresh()
        for term in self.spec.observations:
            if isinstance(term.function, VoxelGrid):
                term.function.refresh()
        worlds = self.sim.worlds
        teams = [{name: world.objects[name].grid for name in self.spec.robots} for world in worlds]
        self.designs = list(teams) if self.spec.partners else [team[ROBOT] for team in teams]
        self.design_index.copy_(self.sim.design_index)
        self._set_masks_and_columns(torch.arange(len(worlds), device=self.device))
        if self.dump is not None:
            self.dump.refresh()
        obs = self.reset(mask=mask)[0]
        for name, value in self._first.items():
            new = obs if name == "obs" else self.episodes.before[name]
            torch.where(rows_of(mask, value), new, value, out=value)
        return obs

    def _start_memory(self, stream: RandomStream, mask: torch.Tensor | None, given: Mapping[str, torch.Tensor]) -> None:
        """Start the memories of new episodes where ``mask`` is True, and move the randomized objects."""
        draws = stream.rewind()
        fresh = {memory.name: memory.begin(draws) for memory in self.spec.memory} | dict(given)
        self.episodes.set_memory(fresh, mask)
        if self.spec.randomized:
            self.sim.shift(fresh["offset"], mask)

    def _given(self, memory: Mapping[str, Any] | None) -> dict[str, torch.Tensor]:
        """Check the given values of memories; return tensors padded with 0 to the task's shapes."""
        drawn = self.episodes.memory
        given = dict[str, torch.Tensor]()
        if not is_mapping(memory or {}):
            raise ConfigError(f"memory must be values by name, got {memory!r:.60}.")
        for name, values in (memory or {}).items():
            if name not in drawn:
                hint = did_you_mean(name, drawn)
                raise ConfigError(f"The episode state of {self.spec.id} is {listing(drawn)}, not {name!r}.{hint}")
            most = list(drawn[name].shape)
            try:
                fits = bool(torch.isfinite(torch.as_tensor(values)).all())  # an integer always is
                values = torch.as_tensor(values, dtype=drawn[name].dtype, device=self.device)
                fits = fits and bool(torch.isfinite(values).all())
            except Exception:  # `as_tensor` may raise anything for what is no array
                fits = False
            if not fits:
                raise ConfigError(f"The memory {name!r} must be finite numbers {most}, got {values!r:.60}.")
            shape = list(values.shape)
            if len(shape) != len(most) or shape[0] != most[0] or any(n > m for n, m in zip(shape, most, strict=True)):
                raise ConfigError(f"The memory {name!r} must have the shape {most}, got {shape}.")
            given[name] = torch.zeros_like(drawn[name])
            given[name][tuple(slice(n) for n in shape)] = values
        return given

    def random_actions(self) -> torch.Tensor:
        """Draw uniform random actions ``[num_envs, num_actions]`` from 0.6 to 1.6, new ones at each call."""
        from warpvox.view.rollout import agent_of

        self._random = self._random or agent_of("random", self)
        return self._random(None).to(self.device)

    def step(self, actions: torch.Tensor | np.ndarray) -> StepResult:
        """Do one control step in all environments.

        Args:
            actions: ``[num_envs, num_actions]``, target lengths of the actuators in units of their rest length,
                clipped to [0.6, 1.6]; entries beyond a design's own actuators are ignored.

        Returns:
            Observation ``[num_envs, num_obs]``, reward ``[num_envs]``, terminated and truncated (bool
            ``[num_envs]``; both can be True, as in gymnasium), and a dictionary with

            - ``final_obs`` ``[num_envs, num_obs]``: the observation at the end of this step; the returned one
              is that of the next episode's beginning where an episode has ended and been reset;
            - ``episode``: ``return`` and ``length`` of the episodes up to this step, and ``done``, the mask
              of those that this step has ended;
            - ``unstable``: bool, the step was stopped, by self-folding or divergence (the observation is that
              before it);
            - ``diverged``: bool, those of them that diverged: the simulation's (see
              :attr:`Simulation.diverged`), or a term of the task that was NaN or infinite. The latter is named by a
              warning, once (see :meth:`not_finite`), and its entries of the observation are 0;
            - ``reward_terms``: what each term has added to the reward, by name.

            With ``auto_reset=False`` an ended environment keeps its state, observation and flags; its reward
            is 0 until :meth:`reset`.

        Raises:
            ActionError: wrong shape; on the CPU also entries that are not finite. Nothing has been stepped
                then. On CUDA an environment with such entries becomes unstable.
            DeviceError: memory has run out; says what to lower.
        """
        # Where an episode has ended, its last actions stay: the last observation may show them.
        active = None if self.auto_reset else self.episodes.active
        self.sim.take(actions, active)
        self.episodes.drawn = False
        if self.dump is not None:
            self.dump.before(self.sim.actions)

        with enough_memory(fewer(self.num_envs)):
            if self._graph is None or torch.cuda.is_current_stream_capturing():
                result = self._step_on_device()
            else:
                result = self._graph(self._step_on_device, self.auto_reset)
                self.sim.forget_sensed()

        if self.dump is not None:
            self.dump.after(result[1], result[4])
        return result

    @torch.no_grad()
    def _step_on_device(self) -> StepResult:
        """Step all environments with the stored actions; return the results of :meth:`step`.

        It runs on the CPU, too; on CUDA a graph may record and repeat it. Therefore tensors that later calls use are
        written in place, and on CUDA nothing is read back.
        """
        episodes = self.episodes

        # Physics
        self.sim.advance()
        self._outcomes.count()

        # Observations. They show the new episode length, but the memory from before its update.
        before = self._snapshot(episodes.before)
        after = self._snapshot()
        obs = self.layout.observe(after)
        self._finite.observation(obs, self._outcomes.is_counted, self._outcomes.nonfinite)
        memory = after.update(self._updates)

        # Rewards and ends of episodes
        rewards, hits = self.evaluate_terms(before, after)
        found, reward_terms = self._outcomes.score(rewards.values(), hits.values(), self.auto_reset)
        done = found["done"]
        info = {
            "final_obs": obs,
            "episode": {
                "return": found["episode_return"],
                "length": found["episode_length"],
                "done": done,
            },
            "unstable": found["unstable"],
            "diverged": found["diverged"],
            "reward_terms": reward_terms,
        }

        # The next step: new episodes begin, or ended ones wait for their reset with the memory that they ended with.
        # On the CPU a look at what has ended saves work; elsewhere it would wait for the device.
        may_begin = not self._on_cpu or bool(done.any())
        if self._on_cpu and may_begin and self._outcomes.nonfinite.any():
            self._finite.report()
        episodes.set_memory(memory, None if self.auto_reset else episodes.active)
        if self.auto_reset and may_begin:
            obs = self._begin_episodes(done, after, obs)
        else:
            episodes.set_before(after)
        return obs, found["reward"], found["terminated"], found["truncated"], info

    def not_finite(self) -> dict[str, int]:
        """Count the environments in which each term has been NaN or infinite; waits for the device.

        Terms that were not named before are named in a warning. On the CPU that happens in the step itself.
        """
        return self._finite.report()

    def not_finite_total(self) -> torch.Tensor:
        """Return a tensor that is 0 unless :meth:`not_finite` has counts; does not wait for the device."""
        return self._finite.total()

    def retimed(self, obs: torch.Tensor) -> torch.Tensor:
        """Update the time column of ``obs`` after a caller changed episode lengths.

        Only observations of ``obs="timed"`` have that column; others are returned as they are.
        """
        if not is_timed(self.obs_columns[0]):
            return obs
        column = torch.tensor([columns[TIME].start for columns in self.obs_columns], device=obs.device)
        return obs.scatter(1, column[self.design_index][:, None], self.episode_length[:, None].to(obs.dtype))

    def evaluate_terms(
        self, before: Snapshot, after: Snapshot
    ) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """Compute the reward terms without their weights, and the terminations, each ``[num_envs]`` by name.

        Args:
            before, after: the states around the step; equal where the step was stopped.
        """
        rewards = {term.name: term(before, after) for term in self.spec.rewards}
        return rewards, {term.name: term(after) for term in self.spec.terminations}

    def _begin_episodes(self, done: torch.Tensor, after: Snapshot, obs: torch.Tensor) -> torch.Tensor:
        """Begin new episodes where ``done``; return ``obs`` with the first observations of new episodes.

        ``after`` is the state after the step, ``obs`` its observation.
        """
        if self._first:
            self.episodes.set_before(after, self._first, done)
            self.sim.reset(done)
            return torch.where(done[:, None], self._first["obs"], obs)

        self.sim.reset(done)
        if self._draws is not None:
            self._draws.episode.add_(done)
            self._start_memory(self._draws, done, {})

        # Of episodes that go on nothing has moved, and `obs` was made before their memory was updated.
        state = self._snapshot()
        self.episodes.set_before(state)
        first_obs = self._finite.first_observation(self.layout.observe(state), done)
        return torch.where(done[:, None], first_obs, obs)

    def state(self) -> dict[str, Any]:
        """Return the full state for :meth:`set_state`: tensors with a row for every environment."""
        return {
            "sim": self.sim.state(),
            "world": self.sim.world_numbers.clone(),
            "actions": self.sim.actions,
            "memory": self.memory,
            "draws": None if self._draws is None else self._draws.episode.clone(),
            **self.episodes.state(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a :meth:`state` of environments of the same task, designs, seeds and settings.

        Raises:
            SimulationError: the state is that of other worlds or another number of environments, or lacks something;
                the message names it, and nothing has changed.
        """
        like = self.state()
        if is_mapping(state) and getattr(state.get("actions"), "ndim", 0) == 2:
            # how far actions are padded depends on the other bodies; the precision may be another one, as in `sim`
            padding = self.num_actions - state["actions"].shape[1]
            actions = state["actions"]
            actions = actions.to(like["actions"]) if actions.dtype in (torch.float32, torch.float64) else actions
            state = dict(state) | {"actions": torch.nn.functional.pad(actions, (0, padding))}
        check_fields(state, like | {"sim": dict.fromkeys(like["sim"], torch.Tensor)})
        if not torch.equal(state["world"].to(self.device), like["world"]):
            raise SimulationError("The state is that of other worlds: bodies have been exchanged since.")
        self.sim.set_state({name: value.to(self.device) for name, value in state["sim"].items()})
        self.episodes.set_memory({name: state["memory"][name].to(self.device) for name in self.episodes.memory})
        self.sim.action_buffer.copy_(state["actions"])
        if self._draws is not None:
            self._draws.episode.copy_(state["draws"])
        self.episodes.drawn = False
        self.episodes.set_state(state)
        self.episodes.set_before(self._snapshot())
        if self.dump is not None:
            self.dump.clear()


def _check_seeds(seed: int | Sequence[int], designs: int, num_envs: int) -> None:
    """Raise ConfigError unless ``seed`` is one number, or one for each design or each environment."""
    seeds = seed if isinstance(seed, Sequence) and not isinstance(seed, str | bytes) else None
    if seeds is not None and len(seeds) not in (designs, num_envs):
        raise ConfigError(
            f"seed must be one number, or one for each of the {designs} designs or {num_envs} environments;"
            f" got {len(seeds)}."
        )
    for one in [seed] if seeds is None else seeds:
        check_integer("seed", one, 0)
