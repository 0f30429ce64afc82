"""Values of the paper's presets for each task (section D.1); YAML files ask for it by ``${paper_shape:${task}}``."""

from __future__ import annotations

__all__ = ["design_of", "shape_of"]

SHAPE, SHAPES = (5, 5), {"Lifter-v0": (5, 7)}
"""Rows and columns of bodies (Table 2): one task has a larger grid, for the sake of a body designed by hand."""

DESIGN, DESIGNS = "walker", {"Lifter-v0": "lifter"}
"""An example body of that shape."""


def shape_of(task: str) -> list[int]:
    """Rows and columns of the bodies that a search on a task proposes."""
    return list(SHAPES.get(task, SHAPE))


def design_of(task: str) -> str:
    """The example design that is trained on a task unless another is named."""
    return DESIGNS.get(task, DESIGN)
