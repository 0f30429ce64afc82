"""Cell types, units and the constants of the physics."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from enum import IntEnum

from warpvox.checks import check_choice, is_number
from warpvox.errors import ConfigError, TaskError, did_you_mean

VOXEL = 0.1
"""Side of a voxel in simulator units."""
FRAME_SECONDS = 1 / 50
"""Nominal seconds of a control step (paper section A.2: 50 Hz)."""
SIGHT = 5
"""Voxels that robots see up and down."""


class _Axes(dict[str, int]):
    def __missing__(self, axis: str) -> int:
        check_choice("axis", axis, self, TaskError)
        raise KeyError(axis)


AXES = _Axes(x=0, y=1)
"""Component of a vector by its name; TaskError: another name."""
SUBSTEPS = 30
"""Sub-steps of a control step (paper section A.2), the default of ``Physics.substeps``."""
DT = 1.0e-4
"""Inner time of a sub-step, the default of ``Physics.dt``. Gravity and stiffness belong to this clock, not to the
nominal 1500 Hz."""
ACTION_LOW, ACTION_HIGH = 0.6, 1.6
"""Bounds of an action: the target length of an actuator's sides in units of their rest length."""
ACTION_CENTER, ACTION_SCALE = 1.1, 0.5
"""The middle of this range, which a policy's output of 0 means, and half of it: outputs of -1 and 1 are its ends."""


class Cell(IntEnum):
    """Types of cells of bodies and worlds (paper section A.1)."""

    EMPTY = 0
    RIGID = 1
    SOFT = 2
    H_ACT = 3
    V_ACT = 4
    FIXED = 5


@dataclass(frozen=True)
class Physics:
    """The constants of the dynamics; the defaults are those of EvoGym's release 2.2.5 (preset ``evogym``).

    Lengths are in simulator units (0.1 a voxel), time in inner units (``dt`` a sub-step, ``substeps`` of them a control
    step). The presets and how they differ: paper Table 1 and ``docs/physics.md``.

    Raises:
        ConfigError: a value of the wrong type or out of its range.
    """

    name: str = "evogym"
    dt: float = DT
    substeps: int = SUBSTEPS
    point_mass: float = 1.0  # of every point
    gravity: float = 110.0  # acceleration
    drag: float = 0.1  # force per velocity
    contact_stiffness: float = 2.1e6
    contact_depth: float = 5.0e-3  # added to the depth of penetration
    contact_damping: float = 140.0
    friction: float = 0.2
    friction_multiplier: float = 1.2e3
    floor_stiffness: float = 1.4e7  # of the implicit floor at y = 0
    floor_friction: float = 10.0
    actuation_rate: float = 6.0e-3  # share of the way to its goal that a spring's rest length goes in a sub-step
    strain_limit: float = 0.25  # of any spring; beyond it, each end moves by strain_share of half the excess
    strain_share: float = 0.8
    rigid_strain_limit: float = 0.03  # the same for the sides of rigid voxels
    rigid_strain_share: float = 0.5
    rigid_main: float = 3e8 / 3.5
    rigid_structural: float = 3e8 / 7
    soft_main: float = 3e8 / 6
    soft_structural: float = 3e8 / 24
    actuator_main: float = 3e8 / 5
    actuator_structural: float = 3e8 / 10
    shared_edge: str = "last"  # "last": the last soft or actuator voxel sets a shared side; "stiffest" wins

    def __post_init__(self):
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "shared_edge":
                if value not in ("last", "stiffest"):
                    raise ConfigError(f"physics.shared_edge must be 'last' or 'stiffest', got {value!r}.")
            elif field.name != "name":
                _check_constant(field.name, value)

    @property
    def label(self) -> str:
        """The preset's name and the constants that differ from it: ``evogym, gravity=80.0``."""
        base = _PRESETS.get(self.name, _PRESETS["evogym"])
        values = [(field.name, getattr(self, field.name)) for field in fields(self) if field.name != "name"]
        return ", ".join([self.name, *(f"{name}={value}" for name, value in values if value != getattr(base, name))])

    @property
    def weight(self) -> float:
        """Force of gravity on a point."""
        return self.gravity * self.point_mass

    @property
    def inverse_mass(self) -> float:
        """Acceleration of a point per force."""
        return 1.0 / self.point_mass

    @staticmethod
    def presets() -> tuple[str, ...]:
        """Names of the presets."""
        return tuple(_PRESETS)

    @staticmethod
    def preset(name: str, **changes: object) -> Physics:
        """A preset by name, with constants changed by keyword.

        Raises:
            ConfigError: unknown preset or constant, or a value out of range.
        """
        check_choice("physics", name, _PRESETS)
        known = [field.name for field in fields(Physics) if field.name != "name"]
        for key in changes:
            if key not in known:
                raise ConfigError(f"Unknown physics constant {key!r}.{did_you_mean(key, known)}")
        return replace(_PRESETS[name], **changes)

    def stiffness(self, cell: int) -> tuple[float, float]:
        """Stiffness of a cell's sides and of its diagonals."""
        if cell == Cell.SOFT:
            return self.soft_main, self.soft_structural
        if cell in (Cell.H_ACT, Cell.V_ACT):
            return self.actuator_main, self.actuator_structural
        return self.rigid_main, self.rigid_structural


_RANGES = {
    "dt": (1e-8, 1e-2),
    "substeps": (1, 10_000),
    "point_mass": (1e-3, 1e6),
    "strain_limit": (1e-3, 0.99),
    "strain_share": (0.0, 1.0),
    "rigid_strain_limit": (1e-3, 0.99),
    "rigid_strain_share": (0.0, 1.0),
}
"""Least and greatest values; constants that are not here may be anything from 0 on."""


def _check_constant(name: str, value: object) -> None:
    kind = "an integer" if name == "substeps" else "a finite number"
    low, high = _RANGES.get(name, (0.0, math.inf))
    valid = is_number(value) and low <= value <= high
    if not valid or (name == "substeps" and not isinstance(value, int)):
        limits = f"from {low:g} to {high:g}" if name in _RANGES else ">= 0"
        raise ConfigError(f"physics.{name} must be {kind} {limits}, got {value!r:.80}.")


_PAPER = Physics(
    name="paper",
    soft_main=3e8 / 5,
    soft_structural=3e8 / 10,
    actuator_main=3e8 / 6,
    actuator_structural=3e8 / 24,
    friction=0.1,
    friction_multiplier=2.4e3,
    shared_edge="stiffest",
)
_PRESETS = {
    "evogym": Physics(),
    "paper": _PAPER,  # Table 1 with one correction: its contact stiffness of 2.1e7 makes contacts add energy
    "paper_literal": replace(_PAPER, name="paper_literal", contact_stiffness=2.1e7),
}
