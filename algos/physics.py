"""The keys ``physics.*``, a preset of constants and those that differ from it; how settings have worlds simulated."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import make_dataclass
from typing import TYPE_CHECKING, Any

from warpvox.keys import key
from warpvox.types import Physics

if TYPE_CHECKING:
    from warpvox.batch.options import SimOptions

CONSTANTS = {
    "dt": "time step of a sub-step, 1e-8 to 0.01; stable up to about 1.3e-4 with the default constants",
    "substeps": "sub-steps of a control step, 1 to 10000",
    "point_mass": "mass of every point, 0.001 to 1e6",
    "gravity": "downward acceleration, in simulator units",
    "drag": "drag force on a point per unit of velocity",
    "contact_stiffness": "contact force per unit of penetration depth",
    "contact_depth": "length added to the penetration depth",
    "contact_damping": "damping force per unit of approach velocity",
    "friction": "friction coefficient between voxels",
    "friction_multiplier": "friction force per unit of sliding velocity, up to the limit set by friction",
    "floor_stiffness": "force of the floor per unit of depth below y = 0",
    "floor_friction": "friction of the floor at y = 0, as a multiple of friction",
    "actuation_rate": "fraction of the gap to its target length that a spring closes in a sub-step",
    "strain_limit": "strain of a spring beyond which its two ends are moved back, 0.001 to 0.99",
    "strain_share": "fraction of half the excess length by which each end is moved, 0 (no limit) to 1",
    "rigid_strain_limit": "strain_limit of the sides of rigid voxels",
    "rigid_strain_share": "strain_share of the sides of rigid voxels",
    "rigid_main": "stiffness of the sides of rigid voxels",
    "rigid_structural": "stiffness of the diagonals of rigid voxels",
    "soft_main": "stiffness of the sides of soft voxels",
    "soft_structural": "stiffness of the diagonals of soft voxels",
    "actuator_main": "stiffness of the sides of actuators",
    "actuator_structural": "stiffness of the diagonals of actuators",
    "shared_edge": "which voxel sets the stiffness of a shared side: last or stiffest",
}
"""Meanings of the constants of the physics."""


_meaning = "preset to start from; auto: the one that belongs to rules"
_fields: list[tuple[str, Any, Any]] = [
    ("preset", str, key("auto", _meaning, choices=("auto", *Physics.presets()))),
    *(
        (one.name, type(one.default) | None, key(None, f"{CONSTANTS[one.name]}; null: the preset's value"))
        for one in dataclasses.fields(Physics)
        if one.name != "name"
    ),
]
_Constants: Any = make_dataclass("_Constants", _fields, namespace={"__module__": __name__})


class PhysicsConfig(_Constants):
    """Keys ``physics.*``: a preset, and constants that differ from it (paper section A, Table 1)."""


PRESETS = {name: PhysicsConfig(preset=name) for name in ("auto", *Physics.presets())}
"""The choices of the group ``physics``."""


def physics_of(config: Any) -> Physics:
    """The constants that ``physics`` and ``rules`` name together."""
    values = dict(config.physics if isinstance(config.physics, Mapping) else dataclasses.asdict(config.physics))
    preset = values.pop("preset")
    changes = {name: value for name, value in values.items() if value is not None}
    return Physics.preset(config.rules if preset == "auto" else preset, **changes)


def sim_of(config: Any) -> SimOptions:
    """How a configuration has environments computed."""
    from warpvox.batch.options import SimOptions  # and torch with it, for which mistakes in keys do not wait

    return SimOptions(
        config.device,
        config.dtype,
        config.arithmetic,
        physics_of(config),
        getattr(config, "lanes", None),
        config.threads,
        memory_check=config.memory_check,
    )
