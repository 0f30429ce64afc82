"""Starts Warp without its chatter."""

from __future__ import annotations

import os
import sys
import tempfile

__all__ = ["start_warp"]

NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"
"""Warp's native code prints this on every machine without a GPU, whatever its log level is."""


def start_warp() -> None:
    """Initialise Warp; only what it complains about besides a missing GPU gets through."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    sys.stderr.flush()
    try:
        caught, kept = tempfile.TemporaryFile(), os.dup(2)  # noqa: SIM115  (closed below)
    except OSError:  # no stderr to keep clean, or no room to keep it
        wp.init()
        return
    with caught:
        os.dup2(caught.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        caught.seek(0)
        for line in caught:
            if NO_DRIVER not in line:
                sys.stderr.write(line.decode(errors="replace"))
