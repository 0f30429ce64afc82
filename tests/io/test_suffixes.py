"""Every writer knows its format by the suffix, and refuses another before anything is drawn or written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from refusals import refused
from sample_files import archive_bytes, checkpoint_content, rollout_bytes

import warpvox as wv
from warpvox.algos.archive import Archive
from warpvox.algos.checkpoints.export import write_onnx, write_script
from warpvox.algos.checkpoints.policy import read_policy
from warpvox.algos.codesign.archive_export import write_csv, write_parquet
from warpvox.algos.report.gallery import write_gallery
from warpvox.algos.report.learning_curves import write_curves
from warpvox.algos.robots.entry import Robot, save_robot
from warpvox.design import full_connections
from warpvox.errors import WarpvoxError
from warpvox.view.player import write_html
from warpvox.view.render import write_filmstrip, write_gif, write_mp4, write_png
from warpvox.view.rollout import Rollout
from warpvox.view.usd import write_usd

BODY = [[3, 4]]
SUFFIXES = (
    *(".gif", ".mp4", ".png", ".webp", ".html", ".usdc", ".npz", ".json", ".npy", ".csv", ".parquet"),
    *(".onnx", ".pt", ".svg", ".jpg", ".txt", ""),
)
Source = Callable[[str], Any]


def robot(_: Source) -> Robot:
    body = wv.check_design(BODY)
    return Robot("Walker-v0", body, full_connections(body).T, None)


def world(_: Source) -> wv.World:
    made = wv.World()
    made.add_from_array("robot", BODY, 0, 0)
    return made


WRITERS: dict[str, tuple[set[str], Callable[[Source, Path], object]]] = {
    "gif": ({".gif"}, lambda get, path: write_gif(get("rollout"), path, size=(32, 32))),
    "mp4": ({".mp4"}, lambda get, path: write_mp4(get("rollout"), path, size=(32, 32))),
    "png": ({".png"}, lambda get, path: write_png(get("rollout"), path, size=(32, 32))),
    "strip": ({".png"}, lambda get, path: write_filmstrip(get("rollout"), path, 2, size=(64, 32))),
    "page": ({".html"}, lambda get, path: write_html(get("rollout"), path)),
    "usd": ({".usdc"}, lambda get, path: write_usd(get("rollout"), path)),
    "rollout": ({".npz"}, lambda get, path: get("rollout").save(path)),
    "design": ({".json", ".npz", ".npy"}, lambda get, path: wv.save_design(path, BODY)),
    "world": ({".json"}, lambda get, path: world(get).to_json(path)),
    "robot": ({".npz"}, lambda get, path: save_robot(path, robot(get))),
    "onnx": ({".onnx"}, lambda get, path: write_onnx(get("policy"), path)),
    "script": ({".pt"}, lambda get, path: write_script(get("policy"), path)),
    "csv": ({".csv"}, lambda get, path: write_csv(get("archive"), path)),
    "parquet": ({".parquet"}, lambda get, path: write_parquet(get("archive"), path)),
    "gallery": ({".png"}, lambda get, path: write_gallery(path, [("Walker-v0", wv.check_design(BODY), "")])),
    "curves": ({".png", ".svg"}, lambda get, path: write_curves({}, path, "steps", (90, 90))),
}


@pytest.fixture
def source(tmp_path_factory: pytest.TempPathFactory) -> Source:
    """Things to write, by name."""
    folder = tmp_path_factory.mktemp("sources")

    def get(name: str) -> Any:
        if name == "rollout":
            (folder / "rollout.npz").write_bytes(rollout_bytes())
            return Rollout.load(folder / "rollout.npz")
        if name == "archive":
            (folder / "archive.sqlite").write_bytes(archive_bytes())
            return Archive.read(folder / "archive.sqlite")
        torch.save(checkpoint_content(), folder / "model_1.pt")
        return read_policy(folder / "model_1.pt")

    return get


@pytest.mark.parametrize("name", WRITERS)
def test_other_suffixes_are_refused_with_those_that_are_valid(name: str, source: Source, tmp_path: Path) -> None:
    suffixes, write = WRITERS[name]
    for suffix in SUFFIXES:
        if suffix in suffixes:
            continue
        path = tmp_path / f"file{suffix}"
        with refused(WarpvoxError, "must end in", path, *suffixes):
            write(source, path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["gif", "png", "strip", "page", "usd", "rollout", "design", "world", "robot", "csv"])
def test_suffixes_may_be_in_capitals(name: str, source: Source, tmp_path: Path) -> None:
    suffixes, write = WRITERS[name]
    for suffix in suffixes:
        path = tmp_path / f"file{suffix.upper()}"
        write(source, path)
        assert path.stat().st_size
