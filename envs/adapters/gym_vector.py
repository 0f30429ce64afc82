"""Vector environment for gymnasium: ``gymnasium.make_vec("warpvox/Walker-v0", num_envs=8, body=...)``."""

from collections.abc import Sequence
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from warpvox.checks import check_choice
from warpvox.envs.adapters.base import FPS, BatchAdapter, flat, spaces_of
from warpvox.envs.adapters.gym import NAMESPACE
from warpvox.envs.spec import TaskSpec
from warpvox.errors import ConfigError, SimulationError, did_you_mean, listing
from warpvox.keys import in_words


class VoxelGymVectorEnv(BatchAdapter, VectorEnv):
    """Environments behind gymnasium's vector interface, simulated in one batch and one process.

    Observations ``[num_envs, num_obs]``, rewards float64 and flags ``[num_envs]`` are numpy arrays; ``infos`` holds
    ``unstable``, ``diverged`` and ``reward_terms/NAME``, as they are for a single environment. An environment that has
    ended is reset as ``autoreset_mode`` says, with the results that gymnasium's ``SyncVectorEnv`` would have:

    - ``NEXT_STEP``: in the next step, whose action is ignored and whose reward is 0.
    - ``SAME_STEP``: in the same step. ``infos["final_obs"]`` and ``infos["final_info"]`` hold what ended, where
      ``infos["_final_obs"]`` is True.
    - ``DISABLED``: by ``reset(options={"reset_mask": mask})``, before the next step.

    ``envs``, :meth:`call`, :meth:`get_attr` and :meth:`set_attr` reach single environments
    (:class:`warpvox.envs.adapters.base.SubEnv`) as those of ``SyncVectorEnv`` do.

    Args:
        task, num_envs, body, connections: as in :func:`warpvox.make_vec`.
        designs: as there; smaller bodies are padded on the right, see ``vec.obs_mask`` and ``vec.action_mask``.
        render_mode: None or ``rgb_array``: :meth:`render` gives a picture of every environment.
        render_size: width and height of a picture in pixels.
        autoreset_mode: a ``gymnasium.vector.AutoresetMode`` or its name; also in ``metadata``.
        options: ``seed`` (of the first episodes, until :meth:`reset` gets another), ``rules``, ``obs``,
            ``max_episode_steps``, ``sim`` and its fields as in :func:`warpvox.make_vec`; here ``device="cpu"`` and
            ``dtype="float64"`` unless ``sim`` is given. With ``grid`` :meth:`set_designs` may bring other bodies.

    Raises: what :func:`warpvox.make_vec` raises; ConfigError: an unknown render mode or autoreset mode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": FPS,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    @in_words
    def __init__(
        self,
        task: str | TaskSpec,
        num_envs: int = 1,
        body: object = None,
        designs: Sequence[object] | None = None,
        connections: object = None,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (640, 360),
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        check_choice("render_mode", render_mode, [None, *self.metadata["render_modes"]])
        self.render_mode = render_mode
        self.render_size = render_size

        # The mode is a member of the enumeration, its name or its value.
        modes: dict[str, AutoresetMode] = {}
        for mode in AutoresetMode:
            modes[mode.name.casefold()] = modes[mode.value.casefold()] = mode
        word = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else str(autoreset_mode)
        if word.casefold() not in modes:
            names = [mode.name for mode in AutoresetMode]
            hint = did_you_mean(word, names)
            raise ConfigError(f"autoreset_mode must be one of {listing(names)}, got {autoreset_mode!r:.80}.{hint}")
        self.autoreset_mode = modes[word.casefold()]
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}

        # The environments
        if designs is None and body is None and connections is not None:
            connections = [connections]
        self._make(
            task,
            designs,
            num_envs,
            options,
            {"device": "cpu", "dtype": "float64"},
            body=body,
            connections=connections,
            auto_reset=self.autoreset_mode is AutoresetMode.SAME_STEP,
        )
        self.num_envs = self.vec.num_envs

        # Spaces
        self.single_spaces = spaces_of(self.vec)
        self.single_observation_space, self.single_action_space = self.single_spaces
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

        self._obs = np.zeros((self.num_envs, self.vec.num_obs), self.single_observation_space.dtype)
        self._ended = np.zeros(self.num_envs, dtype=bool)  # by the last step, and not reset since

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in all environments, or where ``options["reset_mask"]`` is True.

        Args:
            seed: one for each environment, or the first of ``seed, seed + 1, ...``.
            options: ``reset_mask``, bool ``[num_envs]``: which environments to reset. Others are not used.

        Raises:
            ConfigError: not a mask, or a mask that resets nothing; not a seed for each environment.
        """
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + env for env in range(self.num_envs)]
        if seed is not None and len(seed) != self.num_envs:
            raise ConfigError(f"seed must be one number, or one for each of {self.num_envs} environments; got {seed}.")
        # gymnasium's own generator
        super().reset(seed=None if seed is None else seed[0])
        mask: np.ndarray | Sequence[bool] | None = (options or {}).get("reset_mask")
        if mask is None:
            # Everywhere
            self._obs = self._reset(seed).cpu().numpy()
            self._ended = np.zeros(self.num_envs, dtype=bool)
        else:
            # Where the mask is True
            if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
                raise ConfigError(f"options['reset_mask'] must be a bool array [{self.num_envs}], got {mask!r:.80}.")
            if not mask.any():
                raise ConfigError("options['reset_mask'] must be True for one environment at least.")
            self.restart(mask, seed)
        return self._obs.copy(), {}

    def restart(self, mask: np.ndarray, seeds: Sequence[int] | None) -> np.ndarray:
        """Begin an episode where ``mask`` is True; return all observations."""
        fresh = self._reset(seeds, mask).cpu().numpy()
        self._obs = np.where(mask[:, None], fresh, self._obs)
        self._ended = self._ended & ~mask
        return self._obs

    def set_designs(self, designs: object, mask: np.ndarray, connections: Sequence[object] | None = None) -> np.ndarray:
        """Replace robot bodies, as :meth:`VoxelVecEnv.set_designs` does; return all observations.

        Observations of environments outside ``mask`` are unchanged.
        """
        fresh = self.vec.set_designs(designs, mask, connections).cpu().numpy()
        self._obs = np.where(np.asarray(mask)[:, None], fresh, self._obs)
        self._ended = self._ended & ~np.asarray(mask)
        return self._obs.copy()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Do one control step in all environments; ``actions`` are ``[num_envs, num_actions]``.

        Raises:
            ActionError: wrong shape, or entries that are not finite. SimulationError: with ``DISABLED`` an environment
                has ended and not been reset.
        """
        waiting = self._ended
        if waiting.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise SimulationError(
                f"Environments {listing(np.flatnonzero(waiting))} have ended: reset them by"
                ' env.reset(options={"reset_mask": terminated | truncated}) before the next step.'
            )

        # The step, as numpy arrays
        obs, reward, terminated, truncated, info = self.vec.step(np.asarray(actions))
        self._obs = obs.cpu().numpy()
        rewards = reward.double().cpu().numpy()
        terminations = terminated.cpu().numpy()
        truncations = truncated.cpu().numpy()
        details = {"unstable": info["unstable"], "diverged": info["diverged"], **flat(info["reward_terms"])}
        details = {name: value.cpu().numpy() for name, value in details.items()}

        # SAME_STEP: environments that have ended have been reset; infos hold what ended.
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            done = info["episode"]["done"].cpu().numpy()
            infos = {} if done.all() else _masked(details, ~done)
            if done.any():
                final = np.full(self.num_envs, None, dtype=object)
                last = info["final_obs"].cpu().numpy()
                for env in np.flatnonzero(done):
                    final[env] = last[env]
                infos["final_obs"] = final
                infos["_final_obs"] = done
                infos["final_info"] = _masked(details, done)
                infos["_final_info"] = done.copy()
            return self._obs.copy(), rewards, terminations, truncations, infos

        # NEXT_STEP: this step was the reset of those that had ended in the one before.
        if waiting.any():
            self.restart(waiting, None)
            rewards = np.where(waiting, 0.0, rewards)
            terminations = terminations & ~waiting
            truncations = truncations & ~waiting
        self._ended = terminations | truncations
        infos = {} if waiting.all() else _masked(details, ~waiting)
        return self._obs.copy(), rewards, terminations, truncations, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Render all environments, uint8 ``[height, width, 3]`` each."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without render_mode='rgb_array'.")
            return None
        return tuple(self.pictures())

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of each environment and return the results; a plain attribute is read instead."""
        found = [env.get_wrapper_attr(name) for env in self.envs]
        return tuple(value(*args, **kwargs) if callable(value) else value for value in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Read an attribute of each environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of each environment: one value for all, or a list with one value each.

        Raises:
            ConfigError (a ValueError): a list of another length.
        """
        one_each = isinstance(values, list | tuple)
        each = cast(Sequence[Any], values) if one_each else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ConfigError(f"{name} needs a value for each of {self.num_envs} environments, got {len(each)}.")
        for env, value in zip(self.envs, each, strict=True):
            setattr(env, name, value)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({NAMESPACE} {self.vec.spec.id}, num_envs={self.num_envs})"


def _masked(values: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
    """Add gymnasium's mask ``_name`` to values of ``info``, and set values to 0 where the mask is False."""
    out: dict[str, Any] = {}
    for name, value in values.items():
        out[name] = np.where(mask, value, np.zeros_like(value))
        out[f"_{name}"] = mask.copy()
    return out
