"""Commands for tests of faults, and checks of the folders that they leave."""

import json
import math
from pathlib import Path
from typing import Any

import torch
import yaml
from learning import rows
from tiny import tiny

from warpvox.algos.archive import FILE, Archive
from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.codesign.stored_policies import policy_sha256
from warpvox.algos.metrics import read_metrics
from warpvox.io.writing import MARK

TRAIN = tiny("train", "max_iterations=3", "save_interval=1")
CODESIGN = tiny("codesign", *"batch=2 training.iterations=2 training.eval_interval=2".split())


def same(one: Any, other: Any) -> bool:
    """Return whether two checkpoints' contents are equal bit for bit, except for times."""
    if isinstance(one, torch.Tensor):
        return one.dtype == other.dtype and torch.equal(one, other)
    if isinstance(one, dict):
        keys = one.keys() - {"elapsed"}
        return keys == other.keys() - {"elapsed"} and all(same(one[key], other[key]) for key in keys)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other or (isinstance(one, float) and math.isnan(one) and math.isnan(other))


def only(folder: Path, command: str) -> Path | None:
    """Return the single run's folder in ``folder``, if there is one."""
    found = list(folder.glob(f"outputs/{command}/*/*"))
    assert len(found) <= 1
    return found[0] if found else None


def check_files(run: Path) -> None:
    """Assert that every file is complete, except temporary files of a killed process."""
    for file in run.rglob("*"):
        if file.name.startswith(MARK) or not file.is_file():
            continue
        if file.suffix == ".json":
            json.loads(file.read_text())
        elif file.name == "config.yaml":
            assert yaml.safe_load(file.read_text())["task"] == "Walker-v0"
        elif file.name in ("state.pt", "model_best.pt"):
            load_checkpoint(file)
        elif file.suffix == ".png":
            assert file.read_bytes().endswith(b"IEND\xaeB`\x82")
        elif file.suffix == ".html":
            assert file.read_text().rstrip().endswith("</html>")


def check_models(run: Path, whole: Path) -> None:
    """Assert that every checkpoint equals the undisturbed training's."""
    check_files(run)
    for file in run.glob("model_?.pt"):
        assert same(load_checkpoint(file), load_checkpoint(whole / file.name)), file
    read_metrics(run)


def check_training(run: Path, whole: Path) -> None:
    """Assert that a training ended with the same result as the undisturbed one."""
    check_models(run, whole)
    for name in ("model_3.pt", "model_best.pt", "state.pt"):
        assert same(load_checkpoint(run / name), load_checkpoint(whole / name)), name
    assert rows(run) == rows(whole)
    assert json.loads((run / "summary.json").read_text())["status"] == "done"
    assert not list(run.rglob(f"{MARK}*"))


def digest(run: Path) -> str:
    with Archive.read(run / FILE) as archive:
        return archive.digest()


def check_archive(run: Path, whole: Path) -> None:
    """Assert that an archive's policies exist and equal the undisturbed search's."""
    check_files(run)
    if not (run / FILE).is_file():
        return
    with Archive.read(run / FILE) as archive, Archive.read(whole / FILE) as other:
        for record in archive.records():
            twin = other.record(record.id)
            assert record.candidate.body.tolist() == twin.candidate.body.tolist()
            if record.finished:
                assert (record.fitness, record.curve, record.policy_sha256) == (
                    twin.fitness,
                    twin.curve,
                    twin.policy_sha256,
                )
                policy = load_checkpoint(run / record.policy_file)["actor_state_dict"]
                assert policy_sha256(policy) == record.policy_sha256


def check_search(run: Path, whole: Path) -> None:
    """Assert that a search ended with the same result as the undisturbed one."""
    check_archive(run, whole)
    assert digest(run) == digest(whole)
    assert json.loads((run / "summary.json").read_text())["status"] == "done"
    assert not list((run / "training").glob("*"))
    assert not list(run.rglob(f"{MARK}*"))
    assert len(list(run.glob("generations/*.png"))) == len(list(whole.glob("generations/*.png")))


WHEN_LEFT = {"train": check_models, "codesign": check_archive}
WHEN_DONE = {"train": check_training, "codesign": check_search}


def has_begun(run: Path) -> bool:
    return (run / "state.pt").is_file() or (run / FILE).is_file()
