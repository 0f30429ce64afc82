"""Example bodies as rows of digits from the top: 0 empty, 1 rigid, 2 soft, 3 horizontal and 4 vertical actuator.

All are our own. Each is a starting point for one kind of task, not the best body for it.
"""

import re
from typing import Any

_BODIES = {
    "walker": "14441/33333/33333/44044/44044",  # a bounding quadruped: two muscle bands over two legs
    # two wide pads that can press against the walls of a shaft, a column between them that stretches
    "climber": "33333/33333/04440/33333/33333",
    "carrier": "10001/33333/33333/44044/44044",  # a walker with raised edges, so that a load stays on its back
    "stepper": "23332/33333/44444/44044/40004",  # long legs under a soft back: for steps
    "hopper": "11111/44444/44444/44444/33033",  # a stack of vertical muscle between a stiff top and two feet
    "worm": "2332332/4334334",  # low and long
    # a crane on four columns: the legs sink, the inner columns reach into the hole and hold the box between their tips
    "lifter": "1111111/4040404/4040404/4040404/4030304",
    "mini": "333/444/404",  # the smallest body with two legs
}
EXAMPLES = {name: tuple(tuple(map(int, row)) for row in rows.split("/")) for name, rows in _BODIES.items()}

MADE_FOR: dict[str, tuple[str, ...]] = {
    "walker": ("Walker-v0", "BridgeWalker-v0", "BidirectionalWalker-v0"),
    "climber": ("Climber-v0", "Climber-v1", "Climber-v2"),
    "carrier": ("Carrier-v0", "Carrier-v1"),
    "stepper": ("UpStepper-v0", "DownStepper-v0"),
    "hopper": ("Jumper-v0",),
    "worm": ("CaveCrawler-v0",),
    "lifter": ("Lifter-v0",),
}
"""Tasks for which an example body is a good starting point, by the example's name; none for "mini"."""


def bare_id(task: Any) -> Any:
    """Strip ``warpvox/`` from a gymnasium id such as ``warpvox/Walker-v0``; other values are returned unchanged."""
    is_id = isinstance(task, str) and re.fullmatch(r"warpvox/\w+-v\d+", task)
    return task.removeprefix("warpvox/") if is_id else task


def design_for(task: Any, design: Any) -> Any:
    """Replace the design ``auto`` by the task's example body, or ``walker`` if it has none."""
    made = next((name for name, tasks in MADE_FOR.items() if task in tasks), "walker")
    return made if isinstance(design, str) and design == "auto" else design
