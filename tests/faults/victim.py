"""Runs commands in copies of this process, each of which is killed, or finds the disk full, at one of its writes.

Arguments: a folder, and as JSON the words of commands by name and the moments ``[[how, number], ...]``, where a number
is a share of all writes. The copy of moment ``k`` runs in the folder ``k`` below that of its command, and the last one
undisturbed in ``whole``.
"""

import errno
import json
import os
import signal
import sys
from pathlib import Path

from warpvox.cli import main


def run(folder: Path, words: list[str], how: str = "", at: int = 0) -> int:
    """Run the command in a copy of the process and say how it ends; it leaves ``output`` and ``writes`` beside."""
    folder.mkdir()
    if process := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    os.chdir(folder)
    for number in (1, 2):
        os.dup2(os.open("../output", os.O_WRONLY | os.O_CREAT | os.O_APPEND), number)
    writes, replace = 0, os.replace

    def write(*paths: str) -> None:
        nonlocal writes
        writes += 1
        if how == "killed" and writes == at:
            os.kill(os.getpid(), signal.SIGKILL)
        if how == "full" and writes >= at:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(*paths)

    os.replace = write
    code = main(words)
    Path("../writes").write_text(str(writes))
    sys.stdout.flush()
    os._exit(code)


if __name__ == "__main__":
    commands, moments = map(json.loads, sys.argv[2:])
    for command, words in commands.items():
        home = Path(sys.argv[1], command)
        home.mkdir(parents=True)
        main([*words, f"output_dir={home / 'first'}"])  # loads libraries and kernels
        codes = [run(home / "whole", words)]
        count = int((home / "writes").read_text())
        codes += [run(home / str(k), words, how, 1 + int(share * count)) for k, (how, share) in enumerate(moments)]
        (home / "codes").write_text(json.dumps(codes))
