"""Exports of a rollout: an estimate of what is to come, and ``every``."""

from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest
from PIL import Image
from rich.console import Console

from warpvox.cli.exports import Estimate


def test_a_long_film_is_announced(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 1.0, 2.5, 2.6])
    monkeypatch.setattr("warpvox.cli.exports.time.monotonic", lambda: next(clock))
    shown = StringIO()
    tell = Estimate("rollout.mp4", Console(file=shown, width=200))
    for number in (100, 250, 260):
        tell(number, 250_000)
    assert shown.getvalue() == "rollout.mp4: 250,000 pictures, about 42 minutes more; every=N makes fewer\n"


def test_every_reaches_every_format(warpvox: Callable, tmp_path: Path) -> None:
    assert warpvox(*"play agent=zero steps=40 num_envs=1 window=off export=[]".split()).code == 0
    (rollout,) = tmp_path.glob("outputs/play/*/*/rollout.npz")
    words = ["export", f"rollout={rollout}", "format=[gif,html,usd]", "size=[64,36]"]
    assert warpvox(*words, "every=4").code == 0
    (folder,) = tmp_path.glob("outputs/export/*/*")
    with Image.open(folder / "rollout.gif") as image:
        assert image.n_frames == 5
    assert '"frames":11,' in (folder / "rollout.html").read_text()
    assert warpvox(*words, "every=0").code == 2
