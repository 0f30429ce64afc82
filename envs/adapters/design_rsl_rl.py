"""Environments in which bodies are designed (:mod:`warpvox.envs.design_episodes`) behind rsl-rl's interface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from warpvox.design import check_design
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.design_episodes import NUM_TYPES, DesignVecEnv
from warpvox.errors import DesignError


class RslRlDesignEnv(RslRlVecEnv):
    """:class:`RslRlVecEnv` for environments of :func:`warpvox.envs.design_episodes.design_episodes`.

    Outputs of the policy for the control stage are scaled as there; those for the design stage are taken as they are.

    Args:
        env: made with ``auto_reset=True``.
        settings: of :class:`RslRlVecEnv`.
    """

    env: DesignVecEnv

    def __init__(self, env: DesignVecEnv, **settings: Any) -> None:
        super().__init__(env, **settings)  # type: ignore[arg-type]

    def _goals(self, outputs: torch.Tensor) -> torch.Tensor:
        control = self.env.layout.control
        return torch.cat([super()._goals(outputs[:, :control]), outputs[:, control:]], dim=1)

    def controller(
        self, policy: Callable[[TensorDict], torch.Tensor], bodies: Sequence[object]
    ) -> Callable[[torch.Tensor], torch.Tensor]:
        """The policy of the control stage, for environments whose bodies are given.

        Args:
            policy: TensorDict of observations to outputs, as ``runner.get_inference_policy()`` gives.
            bodies: one for each environment, of the shape that is designed here.

        Returns:
            A function of the observations ``[num_envs, n]`` of ``make_vec(..., grid=shape)`` with the same ``obs``,
            which gives actions: for :func:`warpvox.record` and the like.

        Raises:
            DesignError: a body that is not valid, or of another shape.
        """
        layout = self.env.layout
        grids = np.stack([check_design(body) for body in bodies])
        if grids.shape[1:] != (layout.rows, layout.columns):
            raise DesignError(f"Bodies must have the shape {(layout.rows, layout.columns)}, got {grids.shape[1:]}.")
        cells = torch.as_tensor(grids, device=self.device).long().flatten(1)
        types = torch.nn.functional.one_hot(cells, NUM_TYPES).flatten(1)
        tail = torch.zeros(len(grids), layout.num_obs - layout.task - types.shape[1], device=self.device)
        tail[:, -1] = 1  # the design is complete

        @torch.no_grad()
        def act(obs: torch.Tensor) -> torch.Tensor:
            whole = torch.cat([obs, types.to(obs), tail.to(obs)], dim=1).to(torch.get_default_dtype())
            outputs = policy(TensorDict({"policy": whole}, batch_size=[len(whole)]))
            return self._goals(outputs)[:, : layout.control]

        return act
