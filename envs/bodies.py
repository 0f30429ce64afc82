"""Bodies as :func:`warpvox.make_vec` takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from warpvox.design import Design, load_design
from warpvox.envs.spec import ROBOT, TaskSpec
from warpvox.envs.worlds import task_team, task_world
from warpvox.errors import ConfigError, DesignError
from warpvox.examples import AUTO, example_for
from warpvox.world import World

DEFAULT_DESIGN = "walker"


def one_body(body: object, designs: Any, connections: Any) -> tuple[Any, Any]:
    """``designs`` and ``connections`` of several bodies from those of one; raises ConfigError if both are given."""
    if body is None:
        return designs, connections
    if designs is not None:
        raise ConfigError("Give one body for all environments (body=...) or a list of them (designs=[...]), not both.")
    return [body], None if connections is None else [connections]


def load_worlds(spec: TaskSpec, designs: Any, connections: Any) -> tuple[list[Design | dict[str, Design]], list[World]]:
    """Valid bodies (for a task with several robots those of all, by name), and the world of each.

    Raises:
        DesignError, WorldError: a body that is not valid, or does not fit. ConfigError: not a connection for each.
    """
    if designs is None:
        designs = [DEFAULT_DESIGN]
    single = isinstance(designs, str | Mapping) or (isinstance(designs, np.ndarray) and designs.ndim in (0, 2))
    if not single and not isinstance(designs, Sequence | np.ndarray):
        raise DesignError(f"designs must be a list of bodies, got {type(designs).__name__}.")
    bodies = [designs] if single else list(designs)
    if not bodies:
        raise DesignError("The list of designs is empty: at least one body is needed.")
    loaded = []
    for number, body in enumerate(bodies):
        try:
            body = example_for(spec.id) if isinstance(body, str) and body == AUTO else body
            team = {name: load_design(given) for name, given in task_team(spec, body).items()}
        except DesignError as error:
            raise DesignError(f"Design {number}: {error}" if len(bodies) > 1 else str(error)) from None
        loaded.append(team if spec.partners else team[ROBOT])
    links = [None] * len(loaded) if connections is None else connections
    if not isinstance(links, Sequence | np.ndarray) or len(links) != len(loaded):
        got = len(links) if isinstance(links, Sequence | np.ndarray) else type(links).__name__
        raise ConfigError(f"connections must be a list with one entry a design ({len(loaded)}), got {got}.")
    return loaded, [task_world(spec, body, link) for body, link in zip(loaded, links, strict=True)]
