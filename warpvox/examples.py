"""Example bodies, as data. Row 0 on top; 0 empty, 1 rigid, 2 soft, 3 horizontal and 4 vertical actuator.

All are our own. Each is a starting point for one kind of task, not the best body for it.
"""

from __future__ import annotations

AUTO = "auto"
"""The name that stands for the example made for the task."""

EXAMPLES: dict[str, tuple[tuple[int, ...], ...]] = {
    # a bounding quadruped: two muscle bands over two legs
    "walker": (
        (1, 4, 4, 4, 1),
        (3, 3, 3, 3, 3),
        (3, 3, 3, 3, 3),
        (4, 4, 0, 4, 4),
        (4, 4, 0, 4, 4),
    ),
    # two wide pads that can press against the walls of a shaft, a column between them that stretches
    "climber": (
        (3, 3, 3, 3, 3),
        (3, 3, 3, 3, 3),
        (0, 4, 4, 4, 0),
        (3, 3, 3, 3, 3),
        (3, 3, 3, 3, 3),
    ),
    # a walker with raised edges, so that a load stays on its back
    "carrier": (
        (1, 0, 0, 0, 1),
        (3, 3, 3, 3, 3),
        (3, 3, 3, 3, 3),
        (4, 4, 0, 4, 4),
        (4, 4, 0, 4, 4),
    ),
    # long legs under a soft back: for steps
    "stepper": (
        (2, 3, 3, 3, 2),
        (3, 3, 3, 3, 3),
        (4, 4, 4, 4, 4),
        (4, 4, 0, 4, 4),
        (4, 0, 0, 0, 4),
    ),
    # a stack of vertical muscle between a stiff top and two feet
    "hopper": (
        (1, 1, 1, 1, 1),
        (4, 4, 4, 4, 4),
        (4, 4, 4, 4, 4),
        (4, 4, 4, 4, 4),
        (3, 3, 0, 3, 3),
    ),
    # low and long
    "worm": (
        (2, 3, 3, 2, 3, 3, 2),
        (4, 3, 3, 4, 3, 3, 4),
    ),
    # a crane on four columns: the legs sink, the inner columns reach into the hole and hold the box between their tips
    "lifter": (
        (1, 1, 1, 1, 1, 1, 1),
        (4, 0, 4, 0, 4, 0, 4),
        (4, 0, 4, 0, 4, 0, 4),
        (4, 0, 4, 0, 4, 0, 4),
        (4, 0, 3, 0, 3, 0, 4),
    ),
    # the smallest body with two legs
    "mini": (
        (3, 3, 3),
        (4, 4, 4),
        (4, 0, 4),
    ),
}

MADE_FOR: dict[str, tuple[str, ...]] = {
    "walker": ("Walker-v0", "BridgeWalker-v0", "BidirectionalWalker-v0"),
    "climber": ("Climber-v0", "Climber-v1", "Climber-v2"),
    "carrier": ("Carrier-v0", "Carrier-v1"),
    "stepper": ("UpStepper-v0", "DownStepper-v0"),
    "hopper": ("Jumper-v0",),
    "worm": ("CaveCrawler-v0",),
    "lifter": ("Lifter-v0",),
}
"""Tasks that an example is a starting point for; "mini" is for none in particular."""


def example_for(task: str) -> str:
    """The name of the example made for a task; ``walker`` where there is none."""
    return next((name for name, tasks in MADE_FOR.items() if task in tasks), "walker")
