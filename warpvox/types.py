"""Cell types, units and the constants of the physics."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum

from warpvox.checks import check_choice
from warpvox.errors import TaskError
from warpvox.keys import Settings, key

VOXEL = 0.1
"""Side of a voxel in simulator units."""
FRAME_SECONDS = 1 / 50
"""Nominal seconds of a control step (paper section A.2: 50 Hz)."""
SIGHT = 5
"""Number of voxels that robots see upwards and downwards."""
RULES = ("evogym", "paper")
"""Rule sets: ``evogym`` as in the released benchmark (2.0.0), ``paper`` as printed in section B of the paper."""
OBSERVATIONS = ("task", "timed", "voxel", "timed_voxel")
"""Kinds of observations: ``task`` as in the benchmark, ``voxel`` per cell; ``timed`` adds the time."""


class _Axes(dict[str, int]):
    """Index of x and y in vectors."""

    def __missing__(self, axis: str) -> int:
        check_choice("axis", axis, self, TaskError)
        raise KeyError(axis)


AXES = _Axes(x=0, y=1)
"""Index of a vector's component by axis name; TaskError: unknown axis."""
ACTION_LOW, ACTION_HIGH = 0.6, 1.6
"""Bounds of an action: the target length of an actuator's sides in units of their rest length."""
ACTION_CENTER, ACTION_SCALE = 1.1, 0.5
"""Action for a policy output of 0, and action range per unit of output (outputs from -1 to 1)."""


class Cell(IntEnum):
    """Cell types of bodies and worlds (paper section A.1)."""

    EMPTY = 0
    RIGID = 1
    SOFT = 2
    H_ACT = 3
    V_ACT = 4
    FIXED = 5


@dataclass(frozen=True)
class Material:
    """Name, colours and stiffness of a cell type.

    Attributes:
        cell: its number in bodies and worlds.
        name: its name in words.
        letter: its letter in drawings of text.
        stiffness: which of the physics' constants it has: ``<stiffness>_main`` and ``<stiffness>_structural``.
        colours: three of them, red, green and blue (0 to 255) when contracted to 0.6, at rest and extended to 1.6.
    """

    cell: Cell
    name: str
    letter: str
    stiffness: str
    colours: tuple[tuple[int, int, int], ...]


MATERIALS = {
    Cell.RIGID: Material(Cell.RIGID, "rigid", "R", "rigid", ((38, 38, 42),) * 3),
    Cell.SOFT: Material(Cell.SOFT, "soft", "S", "soft", ((190, 192, 196),) * 3),
    Cell.H_ACT: Material(
        Cell.H_ACT, "horizontal actuator", "H", "actuator", ((196, 82, 12), (247, 148, 60), (255, 212, 158))
    ),
    Cell.V_ACT: Material(
        Cell.V_ACT, "vertical actuator", "V", "actuator", ((32, 94, 160), (96, 164, 222), (184, 220, 250))
    ),
    Cell.FIXED: Material(Cell.FIXED, "fixed", "F", "rigid", ((74, 80, 92),) * 3),
}
"""Material of each cell type; colours at rest are those of EvoGym's viewer."""
ACTUATORS = (Cell.H_ACT, Cell.V_ACT)
"""Cell types whose springs change their length."""
ROBOT_CELLS = (Cell.EMPTY, Cell.RIGID, Cell.SOFT, Cell.H_ACT, Cell.V_ACT)
"""Cell types allowed in a robot's body."""
EMPTY_LETTER = "."
"""Letter for an empty cell in text drawings."""


@dataclass(frozen=True)
class Physics(Settings):
    """The constants of the dynamics; the defaults are those of EvoGym's release 2.2.5 (preset ``evogym``).

    Lengths are in simulator units (0.1 a voxel), time in inner units (``dt`` a sub-step, ``substeps`` of them a control
    step). The presets and how they differ: paper Table 1 and ``docs/physics.md``.

    Raises:
        ConfigError: a value of the wrong type or out of its range.
    """

    prefix = "physics."

    name: str = "evogym"
    # Gravity and stiffness belong to this clock, not to the nominal 1500 Hz.
    dt: float = key(
        1.0e-4,
        "time step of a sub-step, 1e-8 to 0.01; stable up to about 1.3e-4 with the default constants",
        low=1e-8,
        high=1e-2,
    )
    substeps: int = key(30, "sub-steps of a control step, 1 to 10000", low=1, high=10_000)
    point_mass: float = key(1.0, "mass of every point, 0.001 to 1e6", low=1e-3, high=1e6)
    gravity: float = key(110.0, "downward acceleration, in simulator units", low=0)
    drag: float = key(0.1, "drag force on a point per unit of velocity", low=0)
    contact_stiffness: float = key(2.1e6, "contact force per unit of penetration depth", low=0)
    contact_depth: float = key(5.0e-3, "length added to the penetration depth", low=0)
    contact_damping: float = key(140.0, "damping force per unit of approach velocity", low=0)
    friction: float = key(0.2, "friction coefficient between voxels", low=0)
    friction_multiplier: float = key(
        1.2e3, "friction force per unit of sliding velocity, up to the limit set by friction", low=0
    )
    floor_stiffness: float = key(1.4e7, "force of the floor per unit of depth below y = 0", low=0)
    floor_friction: float = key(10.0, "friction of the floor at y = 0, as a multiple of friction", low=0)
    actuation_rate: float = key(
        6.0e-3, "fraction of the gap to its target length that a spring closes in a sub-step", low=0
    )
    strain_limit: float = key(
        0.25, "strain of a spring beyond which its two ends are moved back, 0.001 to 0.99", low=1e-3, high=0.99
    )
    strain_share: float = key(
        0.8, "fraction of half the excess length by which each end is moved, 0 (no limit) to 1", low=0, high=1
    )
    rigid_strain_limit: float = key(0.03, "strain_limit of the sides of rigid voxels", low=1e-3, high=0.99)
    rigid_strain_share: float = key(0.5, "strain_share of the sides of rigid voxels", low=0, high=1)
    rigid_main: float = key(3e8 / 3.5, "stiffness of the sides of rigid voxels", low=0)
    rigid_structural: float = key(3e8 / 7, "stiffness of the diagonals of rigid voxels", low=0)
    soft_main: float = key(3e8 / 6, "stiffness of the sides of soft voxels", low=0)
    soft_structural: float = key(3e8 / 24, "stiffness of the diagonals of soft voxels", low=0)
    actuator_main: float = key(3e8 / 5, "stiffness of the sides of actuators", low=0)
    actuator_structural: float = key(3e8 / 10, "stiffness of the diagonals of actuators", low=0)
    shared_edge: str = key(  # last: of those that are soft or actuators
        "last", "which voxel sets the stiffness of a shared side: last or stiffest", choices=("last", "stiffest")
    )

    @property
    def label(self) -> str:
        """Name of the preset, followed by changed constants: ``evogym, gravity=80.0``."""
        base = _PRESETS.get(self.name, _PRESETS["evogym"])
        values = [(field.name, getattr(self, field.name)) for field in fields(self) if field.name != "name"]
        return ", ".join([self.name, *(f"{name}={value}" for name, value in values if value != getattr(base, name))])

    @property
    def weight(self) -> float:
        """Gravitational force on a point."""
        return self.gravity * self.point_mass

    @property
    def inverse_mass(self) -> float:
        """Inverse mass of a point: acceleration per force."""
        return 1.0 / self.point_mass

    @staticmethod
    def presets() -> tuple[str, ...]:
        """List the names of the presets."""
        return tuple(_PRESETS)

    @staticmethod
    def preset(name: str, **changes: object) -> Physics:
        """Return a preset by name, with some constants changed by keyword.

        Raises:
            ConfigError: unknown preset or constant, or a value out of range.
        """
        check_choice("physics", name, _PRESETS)
        return replace(_PRESETS[name], **changes) if changes else _PRESETS[name]

    def stiffness(self, cell: int) -> tuple[float, float]:
        """Return the stiffness of a cell type's sides and diagonals; an empty cell counts as rigid."""
        material = MATERIALS.get(Cell(cell), MATERIALS[Cell.RIGID])
        return getattr(self, f"{material.stiffness}_main"), getattr(self, f"{material.stiffness}_structural")


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
