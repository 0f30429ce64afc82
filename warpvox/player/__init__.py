"""The browser player: a rollout as one self-contained page, which needs no network and no server.

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
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.errors import RolloutError
from warpvox.files import write_text
from warpvox.palette import CELL_NAMES, RAMPS
from warpvox.rollout import FRAME_SECONDS, Rollout
from warpvox.scene import Scene
from warpvox.types import ACTION_HIGH, ACTION_LOW, VOXEL

__all__ = ["asset", "fill_template", "page_of", "write_html"]

PRECISION = 4096  # steps per simulator unit: 0.24 % of a voxel
SCRIPTS = ("data.js", "view.js", "player.js")


def write_html(
    rollout: Rollout,
    path: str | os.PathLike[str],
    envs: Sequence[int] | None = None,
    title: str | None = None,
) -> Path:
    """Write a rollout as a page that plays it in a browser; return the path.

    Args:
        rollout: what was recorded.
        path: where to; written whole or not at all.
        envs: environments to show; None: all.
        title: heading of the page; None: the task.

    Raises:
        RolloutError: no such environment, or positions that are out of range.
    """
    write_text(path, page_of(rollout, envs, title))
    return Path(path)


def page_of(rollout: Rollout, envs: Sequence[int] | None = None, title: str | None = None) -> str:
    """The page that :func:`write_html` writes, as text."""
    chosen = [rollout.check_env(env) for env in (range(rollout.num_envs) if envs is None else envs)]
    if not chosen:
        raise RolloutError("No environment was chosen to be shown.")
    scale, data = _pack(rollout, chosen)
    meta = _describe(rollout, chosen, scale) | {"title": title or rollout.title}
    return fill_template(
        asset("player.html"),
        values={"meta": meta},
        title=escape(meta["title"]),
        style=asset("player.css"),
        script="\n".join(asset(name) for name in SCRIPTS),
        data=base64.b64encode(data).decode(),
    )


def fill_template(template: str, values: Mapping[str, Any], **texts: str) -> str:
    """A page: ``{{name}}`` becomes the text of that name, or the JSON of the value of that name."""
    # "<" could end the element that carries the text
    parts = texts | {
        name: json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        for name, value in values.items()
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def asset(name: str) -> str:
    """A file of this package as text."""
    return files(__name__).joinpath(name).read_text(encoding="utf-8")


def _describe(rollout: Rollout, envs: list[int], scale: int) -> dict[str, Any]:
    """All but the trajectories, as JSON values."""
    used = sorted({int(rollout.design_index[env]) for env in envs})
    about = {
        key: rollout.metadata[key]
        for key in ("rules", "physics", "agent", "seed", "iteration")
        if isinstance(rollout.metadata.get(key), str | int)
    }
    lengths = rollout.lengths
    return {
        "frames": rollout.num_frames,
        "dt": FRAME_SECONDS,
        "scale": scale,
        "voxel": VOXEL,
        "limits": [ACTION_LOW, ACTION_HIGH],
        "about": about,
        "colours": {int(cell): ramp for cell, ramp in RAMPS.items()},
        "names": {int(cell): name for cell, name in CELL_NAMES.items()},
        "scenes": [_describe_scene(rollout.scenes[number]) for number in used],
        "envs": [
            {"env": env, "scene": used.index(int(rollout.design_index[env])), "length": int(lengths[env])}
            for env in envs
        ],
    }


def _describe_scene(scene: Scene) -> dict[str, Any]:
    return {
        "width": scene.width,
        "height": scene.height,
        "terrain": ["".join(map(str, row)) for row in scene.terrain.tolist()],
        "points": scene.num_points,
        "robot": scene.robot_points.tolist(),
        "objects": [
            {
                "name": obj.name,
                "cells": obj.cells.tolist(),
                "places": obj.places.tolist(),
                "corners": obj.corners.tolist(),
            }
            for obj in scene.moving
        ],
    }


def _pack(rollout: Rollout, envs: list[int]) -> tuple[int, bytes]:
    """Steps per simulator unit, and the compressed arrays."""
    tracks = [rollout.positions[:, env, : rollout.scene(env).num_points] for env in envs]
    values = np.concatenate([track.reshape(len(track), -1).T for track in tracks]).astype(np.float64)
    # Differences must fit into 16 bits, what they start from into 32.
    jump = max(float(np.abs(np.diff(values, axis=1)).max(initial=0)), float(np.abs(values).max()) / 2**16)
    scale = PRECISION
    # A leap too long for 16 bits costs precision everywhere; in a simulation there is none.
    while scale > 1 and jump * scale > 32766:
        scale //= 2
    if jump * scale > 32766:
        raise RolloutError(f"Points leap {jump:.3g} simulator units in a step: too far for the page's format.")
    whole = np.rint(values * scale).astype(np.int32)
    steps = np.diff(np.ascontiguousarray(whole), axis=1).astype("<i2", order="C")
    arrays = (
        whole[:, 0].astype("<i4"),
        rollout.rewards[:, envs].T.astype("<f4"),
        steps.astype(np.uint8),
        (steps >> 8).astype(np.uint8),
    )
    packer = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)
    return scale, packer.compress(b"".join(array.tobytes() for array in arrays)) + packer.flush()
