"""Films of the best robots of a design search, which its report shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from warpvox.algos.codesign.archive import Record
from warpvox.algos.report import FILM
from warpvox.algos.training.playing import Playing, load_trained, own_code
from warpvox.io.writing import atomic_path
from warpvox.runs import find_run
from warpvox.view.painter import Painter
from warpvox.view.rollout import record

SIZE, VOXELS = (320, 150), 13.0
"""Of a picture, in pixels, and the height of what it shows."""
LONGEST, EVERY, PAUSE = 300, 5, 100
"""Control steps that are shown at most, those from one picture to the next, and the milliseconds that they take."""


def film_designs(folder: Path, records: Sequence[Record], settings: Any) -> None:
    """Have each robot act for an episode, and write it beside its policy; one that is there already stays.

    Args:
        folder: of the search.
        records: designs; those without a policy, or whose policy is gone, are left out.
        settings: of the search, with the code that the user has named.
    """
    for one in records:
        policy = folder / str(one.policy)
        file = policy.with_name(FILM)
        if file.is_file() or not policy.is_file():
            continue
        rollout = record(*load_trained(find_run(str(file.parent), ""), Playing(**own_code(settings))), LONGEST)
        painter = Painter(rollout, 0, SIZE, VOXELS)
        first, *others = [painter.frame(frame) for frame in range(0, rollout.num_frames, EVERY)]
        with atomic_path(file) as temporary:
            first.save(temporary, "WEBP", save_all=True, append_images=others, duration=PAUSE, loop=0, quality=40)
