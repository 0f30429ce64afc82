"""``python -m warpvox.bench.gpu_check``: everything about a CUDA device in one call of under eight minutes.

Correctness first, then figures with what was predicted beside them. Each row is shown and saved when it is there, so
that a call that is cut off leaves everything it had in ``outputs/bench/gpu``. ``seconds=120`` sets another limit.

The same as ``warpvox bench suite=gpu device=cuda``, with further ``KEY=VALUE`` appended. Exit code 2 if there is no
CUDA device, or if a check has failed; ``device=cpu`` runs the same program in a small size, which tests it.
"""

from __future__ import annotations

import sys

from warpvox.cli import main

if __name__ == "__main__":
    sys.exit(main(["bench", "suite=gpu", *sys.argv[1:]]))
