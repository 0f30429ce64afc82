"""Arguments of the wrong kind from Python: one sentence, before anything is made."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import warpvox as wv

MANY = np.zeros(3)
CASES: dict[str, Callable[[], object]] = {
    "folder list": lambda: wv.train("Walker-v0", "mini", folder=["a"]),
    "folder null": lambda: wv.train("Walker-v0", "mini", folder="a\0b"),
    "output_dir null": lambda: wv.train("Walker-v0", "mini", output_dir="a\0b"),
    "designs": lambda: wv.train("Walker-v0", designs={1: 2}, folder=None),
    "progress": lambda: wv.train("Walker-v0", "mini", folder=None, progress=MANY),
    "arithmetic": lambda: wv.evaluate("zoo:Walker-v0", arithmetic=MANY),
    "dtype": lambda: wv.make_vec("Walker-v0", "mini", 2, dtype=MANY),
    "policy": lambda: wv.record(wv.make_vec("Walker-v0", "mini", 1, device="cpu"), np.int64(2)),
    "metadata": lambda: wv.record(wv.make_vec("Walker-v0", "mini", 1, device="cpu"), metadata="@x"),
    "source list": lambda: wv.load_policy(["a"]),
    "source null": lambda: wv.load_policy("a\0b"),
    "code": lambda: wv.load_policy("zoo:Walker-v0", policy=[1]),
    "executor": lambda: wv.codesign("Walker-v0", executor=1.5, folder=None),
    "search folder": lambda: wv.codesign("Walker-v0", folder=["a"]),
    "search null": lambda: wv.codesign("Walker-v0", folder="a\0b"),
    "listeners": lambda: wv.codesign("Walker-v0", listeners=[1], folder=None),
    "robot": lambda: wv.zoo(["a"]),
}


@pytest.mark.parametrize("name", CASES)
def test_arguments_of_the_wrong_kind_are_refused(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(wv.WarpvoxError) as caught:
        CASES[name]()
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
