"""Open-loop gaits as policies: actions depend on the time only, the last observation with ``obs=timed``."""

import math
from collections.abc import Mapping

import torch
from torch import nn

from warpvox.envs.adapters.rsl_rl import OBS_GROUP


class GaitModel(nn.Module):
    """rsl-rl actor that plays a :class:`warpvox.algos.codesign.gaits.Gait` on one body.

    Its state are the fields of the gait and ``cells``, long ``[actuators]``: their places in the grid, counted row by
    row, in the order of actions.
    """

    begin: torch.Tensor
    period: torch.Tensor
    amplitude: torch.Tensor
    phase: torch.Tensor
    rest: torch.Tensor
    cells: torch.Tensor

    def __init__(self, actuators: int, stages: int, rows: int, columns: int) -> None:
        super().__init__()
        self.register_buffer("begin", torch.zeros(stages, dtype=torch.float64))
        self.register_buffer("period", torch.ones(stages, dtype=torch.float64))
        for name in ("amplitude", "phase", "rest"):
            self.register_buffer(name, torch.zeros(stages, rows, columns, dtype=torch.float64))
        self.register_buffer("cells", torch.zeros(actuators, dtype=torch.int64))

    def forward(self, obs: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Compute outputs float64 ``[n, actuators]`` in [-1, 1] from observations ``[n, num_obs]``."""
        values = (value.flatten(1)[:, self.cells] for value in (self.amplitude, self.phase, self.rest))
        return gait_outputs(obs[OBS_GROUP][:, -1:].double(), self.begin, self.period, *values)


def phase_at(time: torch.Tensor, period: torch.Tensor) -> torch.Tensor:
    """Compute the phase of an oscillation in radians, 0 to 2 pi; ``time`` and ``period`` in control steps."""
    # of the time within its period, which is exact, float32 keeps all digits, too
    return 2 * math.pi * torch.remainder(time, period) / period


def gait_outputs(
    time: torch.Tensor,
    begin: torch.Tensor,
    period: torch.Tensor,
    amplitude: torch.Tensor,
    phase: torch.Tensor,
    rest: torch.Tensor,
) -> torch.Tensor:
    """Compute the outputs of all actuators at ``time`` ``[..., 1]``: ``[..., actuators]`` in [-1, 1].

    Of many times at once, ``[times, 1, 1]``, it is ``[times, n, actuators]``.

    ``begin`` and ``period`` are ``[stages]``, or ``[stages, n, 1]`` for a gait of each row; the others
    ``[stages, actuators]``, or ``[stages, n, actuators]``.
    """
    values = rest[0]
    for stage in range(len(begin)):
        motion = rest[stage] + amplitude[stage] * torch.sin(phase_at(time, period[stage]) + phase[stage])
        values = motion if stage == 0 else torch.where(time >= begin[stage], motion, values)
    return values.clamp(-1.0, 1.0)
