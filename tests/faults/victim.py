"""A process that runs commands of warpvox again and again, each in a copy of itself which may die.

Reads requests from stdin, a JSON object a line, and answers each by another. What takes seconds, libraries and kernels,
is loaded once.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any


def run(request: dict[str, Any]) -> None:
    """In the copy: arm the faults, run the command, and end with its exit code."""
    os.chdir(request["folder"])
    faults = ctypes.CDLL(None)
    faults.fault_count.restype = ctypes.c_long
    code = 1
    try:
        from warpvox.cli import main

        faults.fault_arm(request["folder"].encode(), ctypes.c_long(request["at"]), request["mode"])
        code = main(request["words"])
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        counted = faults.fault_count()
        faults.fault_arm(b"", ctypes.c_long(0), 0)
        sys.stderr.flush()
        Path(request["log"], "count").write_text(str(counted))
        os._exit(code)


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Run a request in a copy; ``seconds``: kill it after so long."""
    with tempfile.TemporaryDirectory() as log:
        request["log"] = log
        process = os.fork()
        if not process:
            for number, name in ((1, "out"), (2, "err")):
                os.dup2(os.open(f"{log}/{name}", os.O_WRONLY | os.O_CREAT), number)
            run(request)
        if request["seconds"] is not None:
            time.sleep(request["seconds"])
            os.kill(process, request["signal"])
        status = os.waitpid(process, 0)[1]
        texts = {name: Path(log, name).read_text() for name in ("out", "err")}
        counted = Path(log, "count")
        return texts | {
            "code": os.waitstatus_to_exitcode(status),
            "count": int(counted.read_text()) if counted.is_file() else None,
        }


def warm_up(commands: list[list[str]]) -> None:
    """Load libraries and kernels."""
    from warpvox.cli import main

    with tempfile.TemporaryDirectory() as folder, open(os.devnull, "w") as nowhere:
        os.chdir(folder)
        kept, sys.stdout = sys.stdout, nowhere
        for words in commands:
            if main(words):
                raise SystemExit(f"{words} failed")
        sys.stdout = kept
        os.chdir("/")


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    answers = os.fdopen(os.dup(1), "w")
    warm_up(json.loads(sys.stdin.readline()))
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), file=answers, flush=True)
