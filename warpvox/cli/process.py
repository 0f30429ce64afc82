"""Settings of the process that a command runs in."""

from __future__ import annotations

import logging

import torch

from warpvox.devices.startup import LOGGER, start_warp


class _Console(logging.Handler):
    """Messages of the library go to the output, like those of the commands."""

    def emit(self, record: logging.LogRecord) -> None:
        print(record.getMessage(), flush=True)


def prepare(torch_threads: int, seed: int) -> None:
    """Settings of the process: threads, random numbers, and no chatter from Warp."""
    if not LOGGER.handlers:
        LOGGER.addHandler(_Console())
    start_warp()
    torch.set_num_threads(torch_threads)
    torch.manual_seed(seed)
