"""Record the digests: ``python tests/determinism/record.py`` (a minute; commit what it has changed)."""

import json

import torch
from rollouts import PINNED, digests

from warpvox.envs.registry import task_ids
from warpvox.io.writing import write_text

if __name__ == "__main__":
    torch.set_num_threads(1)
    write_text(PINNED, json.dumps(digests(task_ids()), indent=1) + "\n")
