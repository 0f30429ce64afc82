"""Exports of a rollout: ``every``."""

from collections.abc import Callable
from pathlib import Path

from PIL import Image


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
