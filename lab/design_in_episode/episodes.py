"""Design inside the episode: the first steps set voxels, later steps control the finished body.

An episode has two stages. In the **design stage** the physics of an environment stands still. Each of its
``design_steps`` steps sets the types of cells, of all at once (``revise="all"``, as a neural cellular automaton does)
or of one after another in row-major order (``revise="one"``). After the last one the body is complete and the **control
stage** begins: an ordinary episode of the task. Nothing is compiled for a body, and environments of a batch may be in
different stages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

import warpvox as wv
from warpvox.design import repair_design
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.vec_env import VoxelVecEnv

NUM_TYPES = 5
"""Number of cell types of a robot: empty, rigid, soft, horizontal and vertical actuator (:class:`warpvox.Cell`)."""
CHOICES = {"revise": ("all", "one"), "actions": ("types", "logits"), "invalid": ("repair", "end")}
"""Valid names for arguments of :func:`design_episodes`."""
AT_REST = 1.0
"""Goal length of actuators without a valid action."""


@dataclass(frozen=True)
class DesignLayout:
    """Layout of observations and actions of both stages.

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
        """Number of cells in the grid."""
        return self.rows * self.columns

    @property
    def revised(self) -> int:
        """Number of cells set by a design step."""
        return self.cells if self.revise == "all" else 1

    @property
    def design(self) -> int:
        """Number of action entries in the design stage: a type, or five logits, per cell set by a step."""
        return self.revised * (NUM_TYPES if self.actions == "logits" else 1)

    @property
    def num_obs(self) -> int:
        """Number of observations."""
        return self.task + self.cells * (NUM_TYPES + (self.revise == "one")) + 2

    @property
    def num_actions(self) -> int:
        """Number of actions."""
        return self.control + self.design

    def types(self, obs: torch.Tensor) -> torch.Tensor:
        """Extract one-hot cell types ``[..., cells, 5]`` from observations ``[..., num_obs]``."""
        types = obs[..., self.task : self.task + self.cells * NUM_TYPES]
        return torch.unflatten(types, -1, (self.cells, NUM_TYPES))

    def cursor(self, obs: torch.Tensor) -> torch.Tensor:
        """Extract the mask of the cell that the next design step sets, ``[..., cells]`` (``revise="one"``)."""
        return obs[..., self.task + self.cells * NUM_TYPES : -2]

    def designing(self, obs: torch.Tensor) -> torch.Tensor:
        """Return a mask of observations from the design stage, bool ``[...]``."""
        return obs[..., -2] > 0.5

    def progress(self, obs: torch.Tensor) -> torch.Tensor:
        """Extract the fraction of finished design steps, ``[...]``; 1 in the control stage."""
        return obs[..., -1]

    def action_mask(self, obs: torch.Tensor) -> torch.Tensor:
        """Return a mask of the action entries with an effect in the next step, bool ``[..., num_actions]``.

        In the design stage those of the design; in the control stage one for each actuator of the body.
        """
        designing = self.designing(obs)[..., None]
        actuators = self.types(obs)[..., int(wv.Cell.H_ACT) :].sum((-2, -1))[..., None]
        control = (torch.arange(self.control, device=obs.device) < actuators) & ~designing
        return torch.cat([control, designing.expand(*designing.shape[:-1], self.design)], dim=-1)

    def dict(self) -> dict[str, Any]:
        """Convert the layout to a dictionary for a checkpoint."""
        return asdict(self)


def design_episodes(
    task: Any,
    num_envs: int = 1,
    shape: tuple[int, int] = (5, 5),
    design_steps: int | None = None,
    revise: str = "all",
    actions: str = "types",
    start: Any = "empty",
    invalid: str = "repair",
    penalty: float = 0.0,
    cost: float | Sequence[float] = 0.0,
    seed: int = 0,
    **options: Any,
) -> DesignVecEnv:
    """Create environments in which the body is designed within the episode.

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
        options: ``rules``, ``obs`` (here ``voxel`` by default), ``sim`` and its fields, as in
            :func:`warpvox.make_vec`; ``max_episode_steps`` limits the control stage.

    Raises:
        ConfigError: a value that is not valid. And what ``make_vec`` raises.
    """
    for name, value in {"revise": revise, "actions": actions, "invalid": invalid}.items():
        if value not in CHOICES[name]:
            raise wv.ConfigError(f"{name} must be one of {', '.join(CHOICES[name])}, got {value!r}.")
    if design_steps is None:
        design_steps = max(shape) if revise == "all" else shape[0] * shape[1]
    if design_steps < 1:
        raise wv.ConfigError(f"design_steps must be at least 1, got {design_steps}.")
    prices = list(cost) if isinstance(cost, Sequence) else [cost] * 4
    if len(prices) != 4:
        raise wv.ConfigError(f"cost must be a number, or four (rigid, soft, horizontal, vertical), got {cost}.")
    first = None if isinstance(start, str) else np.asarray(start, np.int8)
    if first is None and start not in ("empty", "random"):
        raise wv.ConfigError(f"start, if it is a name, must be empty or random, got {start!r}.")
    if isinstance(start, str) and start == "empty":
        first = np.zeros(shape, np.int8)
    if first is not None and (first.shape != tuple(shape) or first.min() < 0 or first.max() >= NUM_TYPES):
        raise wv.ConfigError(f"start must hold cell types 0 to {NUM_TYPES - 1} in the shape {shape}.")

    fast = {} if options.get("sim") else {"arithmetic": "fast"}  # exact arithmetic cannot exchange bodies
    settings: dict[str, Any] = {"obs": "voxel"} | fast | options
    largest = np.full(shape, wv.Cell.H_ACT, np.int8)
    env = wv.make_vec(task, [largest], num_envs, auto_reset=False, seed=seed, grid=(shape[0], shape[1]), **settings)
    if len(env.spec.robots) > 1:
        raise wv.ConfigError(f"Bodies are designed in tasks of one robot; {env.spec.id} has several.")
    layout = DesignLayout(*shape, env.num_obs, env.num_actions, revise, actions)
    return DesignVecEnv(env, layout, design_steps, first, invalid, penalty, (0.0, *prices), seed)


class DesignVecEnv:
    """Environments whose episodes begin with designing a body; made by :func:`design_episodes`.

    It steps, resets and spreads episodes as :class:`warpvox.envs.vec_env.VoxelVecEnv` does; an episode, its length,
    return and time limit comprise both stages. Returned tensors are fresh.

    Attributes:
        env: the environments of the control stage. Those that are in the design stage wait at the end of an episode.
        layout: how observations and actions are made up.
        design_steps: steps of the design stage.
        designing: bool ``[num_envs]``, which environments are in the design stage.
        cells: int8 ``[num_envs, rows, columns]``: the cells as designed so far; in the control stage the body.
    """

    auto_reset = True

    def __init__(
        self,
        env: VoxelVecEnv,
        layout: DesignLayout,
        design_steps: int,
        start: np.ndarray | None,
        invalid: str,
        penalty: float,
        prices: Sequence[float],
        seed: int,
    ) -> None:
        self.env = env
        self.layout = layout
        self.design_steps = design_steps
        self.num_envs, self.num_obs, self.num_actions = env.num_envs, layout.num_obs, layout.num_actions
        self.spec, self.rules, self.sim = env.spec, env.rules, env.sim
        self.device, self.dtype = env.device, env.dtype
        self._start, self._invalid, self._penalty = start, invalid, penalty
        self._prices = torch.tensor(prices, dtype=torch.float64, device=self.device)
        self._seed = seed
        self._episode = np.zeros(self.num_envs, int)  # episodes so far, for random starts
        self._all = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self.designing = self._all
        self._length: torch.Tensor = torch.zeros_like(self._all, dtype=torch.long)
        self._skipped = torch.zeros_like(self._length)
        self._returns: torch.Tensor = torch.zeros_like(self._all, dtype=torch.float64)
        self.cells = torch.zeros(self.num_envs, layout.rows, layout.columns, dtype=torch.int8, device=self.device)
        self._task = torch.zeros(self.num_envs, layout.task, dtype=self.dtype, device=self.device)
        self._begin(self._all)

    @property
    def num_designs(self) -> int:
        """Number of distinct bodies in use."""
        return self.env.num_designs

    @property
    def design_index(self) -> torch.Tensor:
        """Index of each environment's body, long ``[num_envs]``: its own."""
        return torch.arange(self.num_envs, device=self.device)

    @property
    def max_episode_steps(self) -> int:
        """Time limit of an episode in steps, the design stage included."""
        return self.design_steps + self.env.max_episode_steps

    @property
    def episode_length(self) -> torch.Tensor:
        """Steps of the present episodes, the design stage included, long ``[num_envs]``.

        May be assigned, to spread the ends of episodes over time: a running episode then ends as much earlier as its
        length was raised.
        """
        return self._length.clone()

    @episode_length.setter
    def episode_length(self, lengths: torch.Tensor) -> None:
        most = self.env.max_episode_steps - 1
        lived = (self._length - self.design_steps).clamp(min=0)
        skipped = (lengths - self._length).clamp(min=0).minimum((most - lived).clamp(min=0))
        self._skipped = torch.where(self.designing, skipped, 0)
        self.env.episode_length = torch.where(self.designing, self.env.episode_length, lived + skipped)
        self._length = self._length + torch.where(self.designing, 0, skipped)
        self._task = self.env.retimed(self._task)

    @property
    def action_mask(self) -> torch.Tensor:
        """Mask of the action entries with an effect in the next step, bool ``[num_envs, num_actions]``."""
        control = self.env.action_mask[self.env.design_index] & ~self.designing[:, None]
        return torch.cat([control, self.designing[:, None].expand(-1, self.layout.design)], dim=1)

    def reset(self, seed: int | None = None, mask: torch.Tensor | None = None) -> tuple[torch.Tensor, dict[str, Any]]:
        """Begin new episodes, with their design stages, everywhere or where ``mask`` is True.

        Args:
            seed: restart the task's random numbers and those of ``start="random"``; None continues them.
            mask: bool ``[num_envs]``.

        Returns:
            Observations ``[num_envs, num_obs]`` and an empty dictionary.
        """
        mask = self._all if mask is None else mask
        if seed is not None:
            self._seed = seed
            self._episode[mask.cpu().numpy()] = 0
            self.env.reset(seed, mask=mask)
        self._begin(mask)
        return self._observe(self._task), {}

    def _begin(self, mask: torch.Tensor) -> None:
        """Begin the design stage in environments where ``mask`` is True, which ends their episodes."""
        # tensors are replaced, not written to: those made in inference mode could not be changed outside of it
        rows = mask.nonzero()[:, 0].tolist()
        if self._start is None:
            self.cells = self.cells.clone()
            for row in rows:
                rng = np.random.default_rng([self._seed, row, int(self._episode[row])])
                body = wv.sample_design((self.layout.rows, self.layout.columns), rng)
                self.cells[row] = torch.as_tensor(body, device=self.device)
        else:
            start = torch.as_tensor(self._start, device=self.device)
            self.cells = torch.where(mask[:, None, None], start, self.cells)
        self._episode[rows] += 1
        self.designing = self.designing | mask
        self._length = self._length.masked_fill(mask, 0)
        self._skipped = self._skipped.masked_fill(mask, 0)
        self._returns = self._returns.masked_fill(mask, 0)
        self.env.episodes.truncated.logical_or_(mask)  # the next step does not move them

    def _observe(self, task: torch.Tensor) -> torch.Tensor:
        """Build observations ``[num_envs, num_obs]`` from the task's observations ``[num_envs, n]``."""
        layout = self.layout
        task = torch.where(self.designing[:, None], 0.0, task)
        types = torch.nn.functional.one_hot(self.cells.long().flatten(1), NUM_TYPES).flatten(1)
        parts = [task, types.to(task.dtype)]
        if layout.revise == "one":
            cursor = torch.nn.functional.one_hot(self._length % layout.cells, layout.cells)
            parts.append((cursor * self.designing[:, None]).to(task.dtype))
        done = self._length.clamp(max=self.design_steps).to(task.dtype) / self.design_steps
        return torch.cat([*parts, self.designing.to(task.dtype)[:, None], done[:, None]], dim=1)

    def step(
        self, actions: torch.Tensor | np.ndarray
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Do one step in all environments, of design or of control according to each one's stage.

        Args:
            actions: ``[num_envs, num_actions]``. Entries that do not count (:attr:`action_mask`) may hold anything.

        Returns:
            As :meth:`VoxelVecEnv.step`. The observation after the last design step is the first of the control stage.
            ``reward_terms`` has ``design`` besides (cost of material and penalty); the dictionary has ``design`` with
            ``done`` (bool ``[num_envs]``: this step has completed a body) and ``valid`` (bool: that body needed no
            repair).

        Raises:
            ActionError: wrong shape, or entries that count and are not finite.
        """
        actions = torch.as_tensor(actions, device=self.device)
        if tuple(actions.shape) != (self.num_envs, self.num_actions):
            raise wv.ActionError(f"actions must be [{self.num_envs}, {self.num_actions}], got {list(actions.shape)}.")
        actions = torch.where(self.action_mask, actions, AT_REST)
        if not bool(actions.isfinite().all()):
            raise wv.ActionError("actions that count must be finite.")

        # Control
        control = self.layout.control
        designing, acting = self.designing, ~self.designing
        task, reward, terminated, truncated, info = self.env.step(actions[:, :control])
        reward = reward.double() * acting
        terminated, truncated = terminated & acting, truncated & acting
        self._length = self._length + 1

        # Design
        self.cells = torch.where(designing[:, None, None], self._revised(actions[:, control:]), self.cells)
        complete = designing & (self._length >= self.design_steps)
        valid, paid, task = self._complete(complete, task)
        if self._invalid == "end":
            terminated = terminated | (complete & ~valid)

        # Bookkeeping of episodes
        self._returns = self._returns + reward + paid
        self._task = task
        done = terminated | truncated
        obs = self._observe(task)
        info = {
            "final_obs": obs,
            "episode": {"return": self._returns.to(self.dtype), "length": self._length.to(self.dtype), "done": done},
            "unstable": info["unstable"] & acting,
            "diverged": info["diverged"] & acting,
            "reward_terms": {name: values * acting for name, values in info["reward_terms"].items()} | {"design": paid},
            "design": {"done": complete, "valid": valid},
        }
        if bool(done.any()):
            self._begin(done)
            obs = torch.where(done[:, None], self._observe(task), obs)
        return obs, (reward + paid).to(self.dtype), terminated, truncated, info

    def _revised(self, actions: torch.Tensor) -> torch.Tensor:
        """Apply a design step's actions to the cells, int8 ``[num_envs, rows, columns]``."""
        layout = self.layout
        if layout.actions == "logits":
            types = torch.unflatten(actions, 1, (layout.revised, NUM_TYPES)).argmax(-1)
        else:
            types = actions.round().clamp(0, NUM_TYPES - 1)
        types = types.to(torch.int8)
        if layout.revise == "one":
            place = ((self._length - 1).clamp(min=0) % layout.cells)[:, None]
            types = self.cells.flatten(1).scatter(1, place, types)
        return torch.unflatten(types, 1, (layout.rows, layout.columns))

    def _complete(self, complete: torch.Tensor, task: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Begin the control stage in environments with a finished design.

        Returns:
            Where the bodies are valid, or no body is complete (bool); what the design stage adds to rewards (float64);
            and the task's observations with those of the new bodies.
        """
        valid, paid = torch.ones_like(complete), torch.zeros_like(self._returns)
        if not bool(complete.any()):
            return valid, paid, task
        grids = self.cells[complete].cpu().numpy()
        repaired = np.stack([repair_design(grid) for grid in grids])
        unchanged = (repaired == grids).all((1, 2))  # valid bodies stay as they are
        valid[complete] = torch.as_tensor(unchanged, device=self.device)
        if self._invalid == "repair":
            self.cells[complete] = torch.as_tensor(repaired, device=self.device)
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
        """Return observations with updated time, as :meth:`VoxelVecEnv.retimed` does."""
        task = torch.where(self.designing[:, None], 0.0, self._task)
        return torch.cat([task.to(obs.dtype), obs[:, self.layout.task :]], dim=1)

    def not_finite(self) -> dict[str, int]:
        """Count non-finite terms, as :meth:`VoxelVecEnv.not_finite` does."""
        return self.env.not_finite()


class RslRlDesignEnv(RslRlVecEnv):
    """Adapter to rsl-rl for environments of :func:`design_episodes`.

    Outputs of the policy for the control stage are scaled as there; those for the design stage are taken as they are.
    """

    env: DesignVecEnv  # stands in for a VoxelVecEnv

    def __init__(self, env: DesignVecEnv, **settings: Any) -> None:
        super().__init__(env, **settings)  # pyright: ignore[reportArgumentType]

    def goals(self, outputs: torch.Tensor) -> torch.Tensor:
        control = self.env.layout.control
        return torch.cat([super().goals(outputs[:, :control]), outputs[:, control:]], dim=1)

    def controller(
        self, policy: Callable[[TensorDict], torch.Tensor], bodies: Sequence[object]
    ) -> Callable[[torch.Tensor], torch.Tensor]:
        """Return the policy of the control stage, for environments with given bodies.

        Args:
            policy: TensorDict of observations to outputs, as ``runner.get_inference_policy()`` gives.
            bodies: one for each environment, of the shape that is designed here.

        Returns:
            A function of the observations ``[num_envs, n]`` of ``make_vec(..., grid=shape)`` with the same ``obs``,
            which gives actions: for :func:`warpvox.record` and the like.
        """
        layout = self.env.layout
        cells = torch.as_tensor(np.stack([wv.check_design(body) for body in bodies]), device=self.device)
        types = torch.nn.functional.one_hot(cells.long().flatten(1), NUM_TYPES).flatten(1)
        tail = torch.zeros(len(cells), layout.num_obs - layout.task - types.shape[1], device=self.device)
        tail[:, -1] = 1  # the design is complete

        @torch.no_grad()
        def act(obs: torch.Tensor) -> torch.Tensor:
            joined = torch.cat([obs, types.to(obs), tail.to(obs)], dim=1).to(torch.get_default_dtype())
            outputs = policy(TensorDict({"policy": joined}, batch_size=[len(joined)]))
            return self.goals(outputs)[:, : layout.control]

        return act
