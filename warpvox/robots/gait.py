"""Open-loop policies of stored robots: each actuator follows a sinusoid of the time."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from warpvox.errors import RunError
from warpvox.robots.network import WIDEST, as_observations
from warpvox.types import ACTION_CENTER, ACTION_SCALE

ARRAYS = ("begin", "period", "amplitude", "phase", "rest")
"""The arrays of a gait, by their names in files."""


@dataclass(frozen=True, eq=False)
class Gait:
    """Sinusoids of the time in one stage or several: observations of ``obs="timed"`` to actions, in float64.

    ``action = 1.1 + 0.5 * clip(rest + amplitude * sin(2 pi t / period + phase), -1, 1)`` with the values of the last
    stage that begins at ``t`` or before. ``t`` is the control steps since the episode began, the last number of the
    observation; nothing else of it is read. What is cut is rounded to float32, and so is the action, as in the search
    that finds a gait: on all machines, but for the sines (one in 1e9) that lie just between two numbers of float32. The
    numbers of a gait are those of float32, too, which all files of policies hold.

    Attributes:
        begin: control step at which each stage begins, float64 ``[stages]``: 0 first, never decreasing.
        period: of the oscillation in each stage in control steps, float64 ``[stages]``.
        amplitude, phase, rest: of each actuator, float64 ``[stages, num_actions]``; phases in radians.

    Raises:
        RunError: arrays that do not fit together, or values out of range.
    """

    begin: np.ndarray
    period: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    rest: np.ndarray

    def __post_init__(self) -> None:
        for name in ARRAYS:
            try:
                with np.errstate(over="ignore"):
                    values = np.asarray(getattr(self, name), np.float64).astype(np.float32)
            except (TypeError, ValueError):
                raise RunError(f"{name} of a gait must be an array of numbers.") from None
            object.__setattr__(self, name, values.astype(np.float64))
        shape = self.amplitude.shape
        if len(shape) != 2 or not all(0 < size <= WIDEST for size in shape):
            raise RunError(f"amplitude of a gait must have the shape [stages, actuators], got {list(shape)}.")
        expected = {"begin": shape[:1], "period": shape[:1], "phase": shape, "rest": shape}
        for name, size in expected.items():
            if getattr(self, name).shape != size:
                got = list(getattr(self, name).shape)
                raise RunError(f"{name} of a gait must have the shape {list(size)} as its amplitude has, got {got}.")
        for name in ARRAYS:
            if not np.isfinite(getattr(self, name)).all():
                raise RunError(f"{name} of a gait has numbers that are not finite.")
        if (self.period <= 0).any():
            raise RunError(f"period of a gait must be above 0 control steps, got {self.period.min():g}.")
        if self.begin[0] != 0 or (np.diff(self.begin) < 0).any():
            raise RunError(f"begin of a gait must start with 0 and never decrease, got {self.begin.tolist()!r:.100}.")

    @property
    def num_stages(self) -> int:
        """Stages of an episode."""
        return len(self.begin)

    @property
    def num_actions(self) -> int:
        """Size of an action."""
        return self.amplitude.shape[1]

    @property
    def num_parameters(self) -> int:
        """Numbers in all arrays but the beginning of the first stage, which is 0."""
        return sum(getattr(self, name).size for name in ARRAYS) - 1

    def __call__(self, obs: Any) -> np.ndarray:
        """``obs`` ``[..., num_obs]``, array or torch tensor, to actions float64 ``[..., num_actions]``."""
        time = as_observations(obs)[..., -1]
        stage = np.searchsorted(self.begin[1:], time, side="right")
        period = self.period[stage]
        angle = (2 * np.pi * np.remainder(time, period) / period)[..., None] + self.phase[stage]
        outputs = self.rest[stage] + self.amplitude[stage] * np.sin(angle)
        return (
            np.float32(ACTION_CENTER) + np.float32(ACTION_SCALE) * np.clip(outputs, -1.0, 1.0).astype(np.float32)
        ).astype(np.float64)
