"""Browser player: a rollout as a self-contained HTML page.

The page carries the rollout in two script elements that are not scripts. ``meta`` is JSON: the numbers below,
the scenes and the colours. ``data`` is base64 of raw deflate of these little-endian arrays, one after the
other, for E environments, P their points, F frames::

    start    int32 [sum of P, 2]              positions in frame 0
    rewards  float32 [E, F - 1]
    low      uint8 [sum of P, 2, F - 1]       low bytes of the int16 differences from frame to frame
    high     uint8 [sum of P, 2, F - 1]       their high bytes (apart, bytes repeat more and pack better)

Positions are whole multiples of ``1 / scale`` simulator units. Differences are taken after rounding, so
errors do not add up: a position is off by half of that at most.
"""

from __future__ import annotations

import base64
import json
import os
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.checks import check_integer
from warpvox.errors import RolloutError
from warpvox.io.text import in_html
from warpvox.io.writing import check_suffix, write_text
from warpvox.types import ACTION_HIGH, ACTION_LOW, FRAME_SECONDS, MATERIALS, VOXEL
from warpvox.view.scene import Scene

MOST_NUMBERS = 1 << 28
"""Maximum number of coordinates in a page, over all points and frames; a browser needs about 2 GB for it."""


def write_html(
    rollout: Any,
    path: str | os.PathLike[str],
    envs: Sequence[int] | None = None,
    title: str | None = None,
    every: int = 1,
) -> Path:
    """Write a rollout as an HTML page that plays it; return the path.

    Args:
        rollout: the :class:`warpvox.view.rollout.Rollout`; it shows itself by this module, which does not import it.
        path: where to; written whole or not at all.
        envs: environments to show; None: all.
        title: heading of the page; None: the task.
        every: show every n-th frame only.

    Raises:
        RolloutError: another suffix than .html or .htm, no such environment, positions that are out of range, or more
            than a browser can hold.
    """
    check_suffix("The file of a page", path, (".html", ".htm"), RolloutError)
    write_text(path, page_of(rollout, envs, title, every), follow=True)
    return Path(path)


def page_of(rollout: Any, envs: Sequence[int] | None = None, title: str | None = None, every: int = 1) -> str:
    """Build the HTML page of :func:`write_html` as text."""
    chosen = rollout.check_envs(envs)

    # More than a browser can hold?
    check_integer("every", every, 1, error=RolloutError)
    points = sum(rollout.scene(env).num_points for env in chosen)
    numbers = 2 * points * len(range(0, rollout.num_frames, every))
    if numbers > MOST_NUMBERS:
        least = -(-numbers * every // MOST_NUMBERS)
        raise RolloutError(
            f"A page with {points:,} points in {rollout.num_frames:,} frames is more than a browser can hold; show"
            f" every {least}th frame (every={least}), fewer environments, or write an MP4."
        )

    # The page
    scale, data = _pack(rollout, chosen, every)
    meta = _page_data(rollout, chosen, scale, every) | {"title": title or rollout.title}
    return fill_template(
        asset("player.html"),
        values={"meta": meta},
        title=in_html(meta["title"]),
        style=asset("player.css"),
        script="\n".join(asset(name) for name in ("data.js", "view.js", "player.js")),
        data=base64.b64encode(data).decode(),
    )


def fill_template(template: str, values: Mapping[str, Any], **texts: str) -> str:
    """Replace each ``{{name}}`` in an HTML template by a text or a value as JSON."""
    # one pass: what is filled in is not searched again; "<" could end the element that carries the text
    parts = texts | {
        name: json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        for name, value in values.items()
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def asset(name: str, package: str = __name__) -> str:
    """Read a text file of a package."""
    return files(package).joinpath(name).read_text(encoding="utf-8")


def _page_data(rollout: Any, envs: list[int], scale: int, every: int) -> dict[str, Any]:
    """Collect everything that the page shows, except the trajectories, as JSON values."""
    designs = [int(rollout.design_index[env]) for env in envs]
    used = sorted(set(designs))
    known = {key: rollout.metadata.get(key) for key in ("rules", "physics", "agent", "seed", "iteration")}
    shown = []
    for env, design in zip(envs, designs, strict=True):
        length = int(rollout.lengths[env]) // every
        shown.append({"env": env, "name": rollout.names[env], "scene": used.index(design), "length": length})
    scenes = []
    for number in used:
        scene: Scene = rollout.scenes[number]
        objects = []
        for obj in scene.moving:
            parts = {part: getattr(obj, part).tolist() for part in ("cells", "places", "corners")}
            objects.append({"name": obj.name} | parts)
        scenes.append(
            {
                "width": scene.width,
                "height": scene.height,
                "terrain": ["".join(map(str, row)) for row in scene.terrain.tolist()],
                "points": scene.num_points,
                "robot": scene.robot_points.tolist(),
                "objects": objects,
            }
        )
    return {
        "frames": len(rollout.positions[::every]),
        "dt": FRAME_SECONDS * every,
        "scale": scale,
        "voxel": VOXEL,
        "limits": [ACTION_LOW, ACTION_HIGH],
        "about": {key: value for key, value in known.items() if isinstance(value, str | int)},
        "colours": {int(cell): material.colours for cell, material in MATERIALS.items()},
        "names": {int(cell): material.name for cell, material in MATERIALS.items()},
        "scenes": scenes,
        "envs": shown,
    }


def _pack(rollout: Any, envs: list[int], every: int) -> tuple[int, bytes]:
    """Quantise and compress the trajectories; return the steps per simulator unit, and the bytes.

    Environments are read one by one, which takes little memory.
    """

    def track(env: int) -> np.ndarray:
        """Return an environment's positions in the shown frames, float64 ``[2 points, frames]``."""
        shown = rollout.positions[::every, env, : rollout.scene(env).num_points]
        return shown.reshape(len(shown), -1).T.astype(np.float64)

    # Differences must fit into 16 bits, what they start from into 32.
    jump = 0.0
    for env in envs:
        values = track(env)
        jump = max(jump, np.abs(np.diff(values)).max(initial=0), np.abs(values).max() / 2**16)

    # 4096 steps per simulator unit are 0.24 % of a voxel. A leap too long for 16 bits costs precision everywhere; in a
    # simulation there is none.
    scale = 4096
    while scale > 1 and jump * scale > 32766:
        scale //= 2
    if jump * scale > 32766:
        raise RolloutError(f"Points leap {jump:.3g} simulator units in a step: too far for the page's format.")

    packer = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)
    steps = len(rollout.positions[::every]) - 1

    def arrays() -> Iterator[np.ndarray]:
        """Yield the arrays to compress: initial positions, rewards, then low and high bytes of the moves."""
        yield from (np.rint(track(env)[:, 0] * scale).astype("<i4") for env in envs)
        for env in envs:  # from one shown frame to the next
            yield rollout.rewards[: steps * every, env].reshape(steps, every).sum(axis=1).astype("<f4")
        for shift in (0, 8):
            for env in envs:
                moves = np.diff(np.rint(track(env) * scale).astype(np.int32)).astype("<i2", order="C")
                yield (moves >> shift).astype(np.uint8)

    return scale, b"".join([*(packer.compress(array.tobytes()) for array in arrays()), packer.flush()])
