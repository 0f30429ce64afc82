"""Standard streams that nobody reads, that lack letters, or that were closed from the start."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fault_cases import TRAIN

from warpvox.cli import main


def test_a_training_goes_on_when_its_reader_has_gone(tmp_path: Path, monkeypatch, capfd: pytest.CaptureFixture) -> None:
    monkeypatch.chdir(tmp_path)
    theirs, ours = os.pipe()
    os.close(theirs)
    with os.fdopen(ours, "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert main(TRAIN) == 0
    assert capfd.readouterr().err.endswith("warpvox: nobody reads the output any more; going on without it\n")
    (run,) = tmp_path.glob("outputs/train/*/*")
    assert json.loads((run / "summary.json").read_text())["status"] == "done"


@pytest.mark.skipif(os.name != "posix", reason="a shell makes the streams")
@pytest.mark.parametrize("streams", ["| true", pytest.param("<&- >&-", marks=pytest.mark.slow)])
def test_a_listing_ends_quietly(streams: str, tmp_path: Path) -> None:
    line = f'"{sys.executable}" -m warpvox tasks {streams}'
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(line, shell=True, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)
    assert (done.returncode, done.stderr) == (0, "")
