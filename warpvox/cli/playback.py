"""A rollout in a window, in real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from warpvox.errors import DisplayError
from warpvox.io.console import escaped
from warpvox.view.window import Window, why_no_window

if TYPE_CHECKING:
    from warpvox.view.rollout import Rollout

SIZE = (960, 540)
REST = 1.0  # seconds that the last picture stands before the episode is shown again


def wants_window(choice: str) -> bool:
    """Whether a window is to be shown: ``on``, ``off``, or ``auto``, where there is a display."""
    reason = why_no_window()
    if choice == "on" and reason is not None:
        raise DisplayError(f"window=on cannot be: {reason}. Leave it away, and look at files: export=[gif,html].")
    return choice != "off" and reason is None


def play_in_window(
    rollout: Rollout,
    envs: list[int],
    size: tuple[int, int] = SIZE,
    clock: Callable[[], float] = time.perf_counter,
    make_window: Callable[[tuple[int, int], str], Any] = Window,
) -> int:
    """Show environments side by side, again and again, until the window is closed; the number of pictures shown.

    Time runs as in the simulation: a machine too slow to draw every frame leaves some out.
    """
    from warpvox.types import FRAME_SECONDS
    from warpvox.view.render import Film

    film = Film(rollout, envs, size)
    window = make_window(size, f"{escaped(rollout.title)} - warpvox")
    last, shown, count, start = int(rollout.lengths.max()), -1, 0, clock()
    while not window.closed:
        passed = clock() - start
        frame = min(last, int(passed / FRAME_SECONDS))
        if frame != shown:
            picture, shown, count = film.array(frame), frame, count + 1
        else:
            time.sleep(FRAME_SECONDS / 4)
        window.show(picture)  # also the same one again: this is when the window answers
        if passed > last * FRAME_SECONDS + REST:
            start = clock()
    return count
