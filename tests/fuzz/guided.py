"""The same readers under atheris, which watches which lines an input reaches and keeps what finds new ones.

    python tests/fuzz/guided.py "design .npz" [-runs=20000] [-max_total_time=60] ...

Needs atheris (``pip install atheris``), which nothing else here does. The first word is a row of the table
of ``run.py``, of the readers of files; what follows is libFuzzer's. Begins with inputs that ``run.py`` would draw, and
ends at the first defect with its input in a file ``crash-*``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["warpvox", "zipfile", "pickletools"]):
    from fuzz_files import Readers

    import warpvox.algos.checkpoints.files
    import warpvox.algos.codesign.archive
    import warpvox.io.reading  # noqa: F401

from fuzz_harness import Figures, judge, make

SEEDS = 200


def main(words: list[str]) -> None:
    """Fuzz one reader until libFuzzer is content; does not return."""
    with tempfile.TemporaryDirectory() as text:
        folder, corpus = Path(text), Path(text, "corpus")
        corpus.mkdir()
        targets = {target.name: target for target in Readers(folder).targets()}
        if not words or words[0] not in targets:
            sys.exit(f"usage: guided.py READER [option of libFuzzer ...]; READER is one of {', '.join(targets)}")
        target = targets[words[0]]
        for number in range(SEEDS):
            (corpus / str(number)).write_bytes(make(target, number, 0))

        def one(data: bytes) -> None:
            figures = Figures()
            judge(target, data, figures)
            for _, defect in figures.defects:
                raise RuntimeError(defect)

        atheris.Setup([sys.argv[0], "-max_len=65536", *words[1:], str(corpus)], one)
        atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
