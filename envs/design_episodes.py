"""The body inside the episode: the first steps of an episode set voxels, later ones act with the body that they made.

An episode has two stages. In the **design stage** the physics of an environment stands still. Each of its
``design_steps`` steps sets the types of cells, of all at once (``revise="all"``, as a neural cellular automaton does)
or of one after another in row-major order (``revise="one"``). After the last one the body is complete and the **control
stage** begins: an ordinary episode of the task. Nothing is compiled for a body, and environments of a batch may be in
different stages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from warpvox.batch.options import SimOptions
from warpvox.checks import check_choice, check_integer, check_known, check_mask, check_shape, is_number
from warpvox.design import are_valid, as_grid, repair_design, sample_design
from warpvox.envs.checks import check_fields
from warpvox.envs.random_stream import RandomStream
from warpvox.envs.registry import get_task
from warpvox.envs.spec import TaskSpec
from warpvox.envs.vec_env import StepResult, VoxelVecEnv, make_vec
from warpvox.errors import ConfigError, DesignError
from warpvox.simulation import checked_actions
from warpvox.types import Cell

NUM_TYPES = 5
"""Types of a cell of a robot: empty, rigid, soft, horizontal and vertical actuator (:class:`warpvox.types.Cell`)."""
CHOICES = {"revise": ("all", "one"), "actions": ("types", "logits"), "invalid": ("repair", "end")}
AT_REST = 1.0
"""Goal length of actuators whose action does not count."""


@dataclass(frozen=True)
class DesignLayout:
    """Composition of observations and actions.

    An observation is the task's (``task`` entries, 0 in the design stage), the types of the cells as one-hot vectors
    (``cells * 5``, row-major), with ``revise="one"`` the cell that the next design step sets as a one-hot vector
    (``cells``), 1 in the design stage, and the share of the design steps that are done. An action is that of the
    control stage (``control`` entries), then that of the design stage (``design``).

    Attributes:
        rows, columns: of the grid of cells.
        task: entries of the task's observation.
        control: entries of the control stage's action.
        revise, actions: as of :func:`design_episodes`.
    """

    rows: int
    columns: int
    task: int
    control: int
    revise: str
    actions: str

    @property
    def cells(self) -> int:
        """Cells of the grid."""
        return self.rows * self.columns

    @property
    def revised(self) -> int:
        """Cells that a design step sets."""
        return self.cells if self.revise == "all" else 1

    @property
    def design(self) -> int:
        """Entries of the design stage's action: a type, or five logits, for each cell that a step sets."""
        return self.revised * (NUM_TYPES if self.actions == "logits" else 1)

    @property
    def num_obs(self) -> int:
        """Entries of an observation."""
        return self.task + self.cells * (NUM_TYPES + (self.revise == "one")) + 2

    @property
    def num_actions(self) -> int:
        """Entries of an action."""
        return self.control + self.design

    def types(self, obs: torch.Tensor) -> torch.Tensor:
        """``[..., cells, 5]``: the types of the cells, one-hot, of observations ``[..., num_obs]``."""
        types = obs[..., self.task : self.task + self.cells * NUM_TYPES]
        return torch.unflatten(types, -1, (self.cells, NUM_TYPES))

    def cursor(self, obs: torch.Tensor) -> torch.Tensor:
        """``[..., cells]``: 1 for the cell that the next design step sets (``revise="one"``), else without entries."""
        return obs[..., self.task + self.cells * NUM_TYPES : -2]

    def designing(self, obs: torch.Tensor) -> torch.Tensor:
        """bool ``[...]``: whether observations are of the design stage."""
        return obs[..., -2] > 0.5

    def progress(self, obs: torch.Tensor) -> torch.Tensor:
        """``[...]``: the share of the design steps that are done; 1 in the control stage."""
        return obs[..., -1]

    def action_mask(self, obs: torch.Tensor) -> torch.Tensor:
        """bool ``[..., num_actions]``: the entries of an action that count after observations ``[..., num_obs]``.

        In the design stage those of the design; in the control stage one for each actuator of the body.
        """
        designing = self.designing(obs)[..., None]
        actuators = self.types(obs)[..., int(Cell.H_ACT) :].sum((-2, -1))[..., None]
        control = (torch.arange(self.control, device=obs.device) < actuators) & ~designing
        return torch.cat([control, designing.expand(*designing.shape[:-1], self.design)], dim=-1)

    def dict(self) -> dict[str, Any]:
        """The layout as stored in a checkpoint."""
        return asdict(self)


def design_episodes(
    task: str | TaskSpec,
    num_envs: int = 1,
    shape: tuple[int, int] = (5, 5),
    design_steps: int | None = None,
    revise: str = "all",
    actions: str = "types",
    start: object = "empty",
    invalid: str = "repair",
    penalty: float = 0.0,
    cost: float | Sequence[float] = 0.0,
    auto_reset: bool = True,
    **options: Any,
) -> DesignVecEnv:
    """Make environments in which the body is designed within the episode.

    Args:
        task: a task with one robot.
        num_envs: environments, each of which designs its own body.
        shape: rows and columns of the grid that bodies are made in. The largest body of it must fit into the world.
        design_steps: steps of the design stage. None: with ``revise="all"`` the longer side of the grid, so that what a
            cell is can reach all others through neighbours; with ``revise="one"`` the number of cells.
        revise: ``all``: a design step sets every cell; ``one``: one cell after another, row-major, from the beginning
            again after the last.
        actions: of the design stage: ``types``, a number for each cell that a step sets, rounded and clipped to 0..4;
            or ``logits``, five numbers, of which the largest (the first of equals) names the type.
        start: what a design begins with: ``empty``, ``random`` (a valid random body, drawn with ``seed``, another one
            in every episode) or a grid of cell types, which need not be a valid body.
        invalid: how a completed body that is not valid is treated (without voxels, in pieces, or without an actuator):
            ``repair``: :func:`warpvox.design.repair_design` makes a valid one of it; ``end``: the episode terminates.
        penalty: taken off the reward of the last design step if the completed body is not valid.
        cost: of material, taken off the reward of the last design step: for each voxel of the body that the control
            stage gets, or four numbers, for each rigid, soft, horizontally and vertically actuated voxel.
        auto_reset: begin the next episode, with its design stage, in the step in which one ends.
        options: ``rules``, ``obs`` (here ``voxel`` by default), ``seed``, ``sim`` and its fields, as in
            :func:`warpvox.make_vec`; ``max_episode_steps`` limits the control stage.

    Raises:
        ConfigError: a value that is not valid, or a task with several robots. SimulationError: exact arithmetic, in
            which bodies cannot be exchanged. DesignError: a ``start`` that is no grid of ``shape``. WorldError: the
            largest body does not fit. And what ``make_vec`` raises.
    """
    without = ("designs", "body", "connections", "grid")
    check_known(options, design_episodes, make_vec, SimOptions, without=without)
    for name, value in {"revise": revise, "actions": actions, "invalid": invalid}.items():
        check_choice(name, value, CHOICES[name])
    shape = check_shape("shape", shape)
    if get_task(task).partners:
        raise ConfigError(f"Bodies are designed in tasks of one robot; {get_task(task).id} has several.")
    if design_steps is None:
        design_steps = max(shape) if revise == "all" else shape[0] * shape[1]
    check_integer("design_steps", design_steps, 1)
    if not is_number(penalty):
        raise ConfigError(f"penalty must be a number, got {penalty!r:.80}.")
    prices = [cost] * 4 if is_number(cost) else cost
    if not isinstance(prices, Sequence) or len(prices) != 4 or not all(is_number(price) for price in prices):
        raise ConfigError(f"cost must be a number, or four (rigid, soft, horizontal, vertical), got {cost!r:.80}.")
    beginning, body = _start(start, shape), [np.full(shape, int(Cell.H_ACT), np.int8)]
    settings: dict[str, Any] = {} if options.get("sim") else {"arithmetic": "fast"}
    settings = {"obs": "voxel"} | settings | options | {"grid": shape}
    env = make_vec(task, body, num_envs, auto_reset=False, **settings)
    layout = DesignLayout(*shape, env.num_obs, env.num_actions, revise, actions)
    return DesignVecEnv(env, layout, design_steps, beginning, invalid, float(penalty), (0.0, *prices), auto_reset)


def _start(start: Any, shape: tuple[int, int]) -> np.ndarray | None:
    """The cells that a design begins with; None: those of a random body."""
    if isinstance(start, str):
        check_choice("start, if it is a name,", start, ("empty", "random"))
        return None if start == "random" else np.zeros(shape, np.int8)
    grid = as_grid(start, what="start")
    if grid.shape != shape or (grid >= NUM_TYPES).any():
        raise DesignError(f"start must hold cell types 0 to {NUM_TYPES - 1} in the shape {shape}, got {grid.shape}.")
    return grid


class DesignVecEnv:
    """Environments whose episodes begin with the design of a body; made by :func:`design_episodes`.

    Its interface is that of :class:`warpvox.envs.vec_env.VoxelVecEnv`; an episode, its length, return and time limit
    comprise both stages. Returned tensors are fresh.

    Attributes:
        env: the environments of the control stage. Those that are in the design stage wait at the end of an episode.
        layout: how observations and actions are made up.
        design_steps: steps of the design stage.
        designing: bool ``[num_envs]``, which environments are in the design stage.
        cells: int8 ``[num_envs, rows, columns]``: the cells as designed so far; in the control stage the body.
    """

    def __init__(
        self,
        env: VoxelVecEnv,
        layout: DesignLayout,
        design_steps: int,
        start: np.ndarray | None,
        invalid: str,
        penalty: float,
        prices: Sequence[float],
        auto_reset: bool,
    ) -> None:
        self.env, self.layout, self.design_steps, self.auto_reset = env, layout, design_steps, auto_reset
        self.num_envs, self.num_obs, self.num_actions = env.num_envs, layout.num_obs, layout.num_actions
        self.spec, self.rules, self.sim = env.spec, env.rules, env.sim
        self.device, self.dtype = env.device, env.dtype
        self._start, self._invalid, self._penalty = start, invalid, penalty
        self._prices = torch.tensor(prices, dtype=torch.float64, device=self.device)
        self._starts = RandomStream(env.seed, self.num_envs, "cpu")
        self._whole = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self.designing = self._whole
        self.terminated: torch.Tensor = ~self._whole
        self.truncated: torch.Tensor = ~self._whole
        self._length: torch.Tensor = torch.zeros_like(self._whole, dtype=torch.long)
        self._skipped = torch.zeros_like(self._length)
        self._returns: torch.Tensor = torch.zeros_like(self._whole, dtype=torch.float64)
        self.cells = torch.zeros(self.num_envs, layout.rows, layout.columns, dtype=torch.int8, device=self.device)
        self._task = torch.zeros(self.num_envs, layout.task, dtype=self.dtype, device=self.device)
        self._begin(self._whole)

    @property
    def num_designs(self) -> int:
        """Different bodies of the environments in use."""
        return self.env.num_designs

    @property
    def design_index(self) -> torch.Tensor:
        """long ``[num_envs]``: each environment designs a body of its own."""
        return torch.arange(self.num_envs, device=self.device)

    @property
    def max_episode_steps(self) -> int:
        """Steps after which an episode is truncated, the design stage included."""
        return self.design_steps + self.env.max_episode_steps

    @property
    def episode_length(self) -> torch.Tensor:
        """long ``[num_envs]``: steps of the episode so far, those of the design stage included.

        May be assigned, to spread the ends of episodes over time: a running episode then ends as much earlier as its
        length was raised.
        """
        return self._length.clone()

    @episode_length.setter
    def episode_length(self, lengths: torch.Tensor) -> None:
        lengths = torch.as_tensor(lengths, device=self.device)
        if tuple(lengths.shape) != (self.num_envs,) or lengths.dtype.is_floating_point:
            raise ConfigError(f"episode_length must be integers [{self.num_envs}], got {list(lengths.shape)}.")
        most = self.env.max_episode_steps - 1
        lived = (self._length - self.design_steps).clamp(min=0)
        skipped = (lengths - self._length).clamp(min=0).minimum((most - lived).clamp(min=0))
        self._skipped = torch.where(self.designing, skipped, 0)
        self.env.episode_length = torch.where(self.designing, self.env.episode_length, lived + skipped)
        self._length = self._length + torch.where(self.designing, 0, skipped)
        self._task = self.env.retimed(self._task)

    @property
    def action_mask(self) -> torch.Tensor:
        """bool ``[num_envs, num_actions]``: what counts in the next step (:meth:`DesignLayout.action_mask`)."""
        control = self.env.action_mask[self.env.design_index] & ~self.designing[:, None]
        return torch.cat([control, self.designing[:, None].expand(-1, self.layout.design)], dim=1)

    def reset(
        self, seed: int | Sequence[int] | None = None, mask: torch.Tensor | np.ndarray | None = None
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        """Begin new episodes, with their design stages; arguments and results as of :meth:`VoxelVecEnv.reset`.

        ``seed`` is also that of ``start="random"``.
        """
        mask = self._whole if mask is None else check_mask(mask, self._whole)
        if seed is not None:
            self.env.reset(seed, mask=mask)
            self._starts.begin(seed, mask.cpu())
        self._begin(mask)
        return self._observe(self._task), {}

    def _begin(self, mask: torch.Tensor) -> None:
        """Begin the design stage of environments; the control stage's episode of theirs is over."""
        # tensors are replaced, not written to: those made in inference mode could not be changed outside of it
        if self._start is None:
            self.cells = self.cells.clone()
            for number in np.flatnonzero(mask.cpu()).tolist():
                key, episode = (int(values[number]) for values in (self._starts.keys, self._starts.episode))
                rng = np.random.default_rng([key % 2**64, episode])
                body = sample_design((self.layout.rows, self.layout.columns), rng)
                self.cells[number] = torch.as_tensor(body, device=self.device)
        else:
            start = torch.as_tensor(self._start, device=self.device)
            self.cells = torch.where(mask[:, None, None], start, self.cells)
        self._starts.episode.add_(mask.cpu())
        self.designing = self.designing | mask
        self.terminated, self.truncated = self.terminated & ~mask, self.truncated & ~mask
        self._length, self._skipped = self._length.masked_fill(mask, 0), self._skipped.masked_fill(mask, 0)
        self._returns = self._returns.masked_fill(mask, 0)
        self.env.episodes.truncated.logical_or_(mask)  # the next step does not move them

    def _observe(self, task: torch.Tensor) -> torch.Tensor:
        """``[num_envs, num_obs]`` with the task's observations ``[num_envs, n]``."""
        layout = self.layout
        task = torch.where(self.designing[:, None], 0.0, task)
        types = torch.nn.functional.one_hot(self.cells.long().flatten(1), NUM_TYPES).flatten(1)
        parts = [task, types.to(task.dtype)]
        if layout.revise == "one":
            cursor = torch.nn.functional.one_hot(self._length % layout.cells, layout.cells)
            parts.append((cursor * self.designing[:, None]).to(task.dtype))
        done = self._length.clamp(max=self.design_steps).to(task.dtype) / self.design_steps
        return torch.cat([*parts, self.designing.to(task.dtype)[:, None], done[:, None]], dim=1)

    def step(self, actions: torch.Tensor | np.ndarray) -> StepResult:
        """One step everywhere: of the design or of control, whichever stage an environment is in.

        Args:
            actions: ``[num_envs, num_actions]``. Entries that do not count (:attr:`action_mask`) may hold anything.

        Returns:
            As :meth:`VoxelVecEnv.step`. The observation after the last design step is the first of the control stage.
            ``reward_terms`` has ``design`` besides (cost of material and penalty); the dictionary has ``design`` with
            ``done`` (bool ``[num_envs]``: this step has completed a body) and ``valid`` (bool: that body needed no
            repair).

        Raises:
            ActionError: wrong shape, no plain numbers; on the CPU also entries that count and are not finite.
        """
        counts = self.action_mask
        actions = checked_actions(actions, (self.num_envs, self.num_actions), self.device, counts)
        actions = torch.where(counts, actions, AT_REST)
        control = self.layout.control
        designing = self.designing & ~self.terminated
        going = ~self.designing & ~(self.terminated | self.truncated)
        task, reward, terminated, truncated, info = self.env.step(actions[:, :control])
        reward, terminated, truncated = reward.double() * going, terminated & going, truncated & going
        self._length = self._length + (designing | going)
        self.cells = torch.where(designing[:, None, None], self._revised(actions[:, control:]), self.cells)
        complete = designing & (self._length >= self.design_steps)
        valid, paid, task = self._complete(complete, task)
        terminated = terminated | (complete & ~valid if self._invalid == "end" else False)
        self._returns = self._returns + reward + paid
        done = terminated | truncated
        obs = self._observe(task)
        length, returns = self._length.to(self.dtype), self._returns.to(self.dtype, copy=True)
        info = {
            "final_obs": obs,
            "episode": {"return": returns, "length": length, "done": done},
            "unstable": info["unstable"] & going,
            "diverged": info["diverged"] & going,
            "reward_terms": {name: values * going for name, values in info["reward_terms"].items()} | {"design": paid},
            "design": {"done": complete, "valid": valid},
        }
        self._task = task
        if self.auto_reset:
            if bool(done.any()):
                self._begin(done)
                obs = torch.where(done[:, None], self._observe(task), obs)
        else:
            self.terminated, self.truncated = self.terminated | terminated, self.truncated | truncated
            terminated, truncated = self.terminated.clone(), self.truncated.clone()
        return obs, (reward + paid).to(self.dtype), terminated, truncated, info

    def _revised(self, actions: torch.Tensor) -> torch.Tensor:
        """int8 ``[num_envs, rows, columns]``: the cells after a design step with these actions everywhere."""
        layout = self.layout
        if layout.actions == "logits":
            types = torch.unflatten(actions, 1, (layout.revised, NUM_TYPES)).argmax(-1)
        else:
            types = actions.nan_to_num().round().clamp(0, NUM_TYPES - 1)
        types = types.to(torch.int8)
        if layout.revise == "one":
            place = ((self._length - 1).clamp(min=0) % layout.cells)[:, None]
            types = self.cells.flatten(1).scatter(1, place, types)
        return torch.unflatten(types, 1, (layout.rows, layout.columns))

    def _complete(self, complete: torch.Tensor, task: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Begin the control stage where designs are complete.

        Returns:
            Where the bodies are valid, or no body is complete (bool); what the design stage adds to rewards (float64);
            and the task's observations with those of the new bodies.
        """
        valid, paid = torch.ones_like(complete), torch.zeros_like(self._returns)
        if not bool(complete.any()):
            return valid, paid, task
        grids = self.cells[complete].cpu().numpy()
        fine = are_valid(grids)
        valid[complete] = torch.as_tensor(fine, device=self.device)
        if self._invalid == "repair":
            grids = np.stack([grid if ok else repair_design(grid) for grid, ok in zip(grids, fine, strict=True)])
            self.cells[complete] = torch.as_tensor(grids, device=self.device)
        begins = complete if self._invalid == "repair" else complete & valid
        paid -= self._penalty * (complete & ~valid)
        paid -= self._prices[self.cells.long()].sum((1, 2)) * begins
        if bool(begins.any()):
            first = self.env.set_designs(list(self.cells[begins].cpu().numpy()), begins)
            task = torch.where(begins[:, None], first, task)
            self.env.episode_length = torch.where(begins, self._skipped, self.env.episode_length)
            task = self.env.retimed(task)
            self._length = self._length + torch.where(begins, self._skipped, 0)
            self._skipped = self._skipped.masked_fill(begins, 0)
            self.designing = self.designing & ~begins
        return valid, paid, task

    def retimed(self, obs: torch.Tensor) -> torch.Tensor:
        """See :meth:`VoxelVecEnv.retimed`."""
        task = torch.where(self.designing[:, None], 0.0, self._task)
        return torch.cat([task.to(obs.dtype), obs[:, self.layout.task :]], dim=1)

    def not_finite(self) -> dict[str, int]:
        """See :meth:`VoxelVecEnv.not_finite`."""
        return self.env.not_finite()

    _STATE = ("cells", "designing", "terminated", "truncated", "_length", "_returns", "_skipped", "_task")

    def state(self) -> dict[str, Any]:
        """The full state, as tensors with a row for every environment, for :meth:`set_state`."""
        own = {name.strip("_"): getattr(self, name).clone() for name in self._STATE}
        bodies = np.stack([np.asarray(self.env.designs[int(number)]) for number in self.env.design_index.cpu()])
        bodies = torch.as_tensor(bodies, device=self.device)
        return own | {"env": self.env.state(), "bodies": bodies, "episode": self._starts.episode.clone()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go on from :meth:`state` of environments of the same task, seeds and settings.

        Raises:
            SimulationError: the state is that of other environments, or lacks something.
        """
        check_fields(state, self.state() | {"env": {}})
        self.env.set_designs(list(state["bodies"].cpu().numpy()), self._whole)
        self.env.set_state(state["env"])
        for name in self._STATE:
            setattr(self, name, state[name.strip("_")].to(self.device, copy=True))
        self._starts.episode.copy_(state["episode"])
