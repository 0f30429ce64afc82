"""Members of a suite with outcomes of the test's choice, importable by other processes: imports nothing heavy."""

import os
import signal
import time
from pathlib import Path
from typing import Any

IGNORED = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
"""Whether Ctrl-C was ignored when the process had just begun."""


class Late:
    """Asks the process to end when it is sent to another one."""

    def __reduce__(self) -> Any:
        os.kill(os.getpid(), signal.SIGTERM)
        return Late, ()


def act(job: str, folder: Path) -> dict[str, Any]:
    """``die``: be killed; ``wait``: until asked to end; ``early`` and ``late``: be asked to end before the work begins
    and when it is done; anything else: be done."""
    print(f"this is {job}")
    if job == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "early":
        os.kill(os.getpid(), signal.SIGTERM)
    if job == "late":
        return {"status": "done", "error": Late()}
    if job == "wait":
        try:
            time.sleep(600)
        except KeyboardInterrupt:
            return {"status": "interrupted", "error": ""}
    return {"status": "done", "error": "" if IGNORED else "Ctrl-C would have ended this process at its beginning"}
