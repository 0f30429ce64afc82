"""Files of a run that are damaged: one line that names what is still good, and going on from there works."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fault_cases import CODESIGN, TRAIN, check_complaint, check_search, digest, only, same

from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.codesign.archive import BACKUP, FILE, Archive
from warpvox.errors import RunError


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A training and a search; not to be changed."""
    from warpvox.cli import main

    place = tmp_path_factory.mktemp("runs")
    for words in (TRAIN, CODESIGN):
        assert main([*words, f"output_dir={place / 'outputs'}"]) == 0
    return {command: only(place, command) for command in ("train", "codesign")}


@pytest.fixture
def copied(runs: dict[str, Path], warpvox: Callable, tmp_path: Path) -> Callable[[str], Path]:
    """A copy of a run that may be damaged, in the folder where commands are run."""

    def call(command: str) -> Path:
        return Path(shutil.copytree(runs[command], tmp_path / "outputs" / command / "Walker-v0" / runs[command].name))

    return call


def cut(path: Path, share: float) -> None:
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


# --------------------------------------------------------------------------------------------------- training


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_damaged_state_names_the_newest_checkpoint_that_is_whole(
    share: float, copied: Callable, warpvox: Callable
) -> None:
    run = copied("train")
    cut(run / "state.pt", share)
    cut(run / "model_3.pt", share)
    outcome = warpvox("train", "resume=latest", "max_iterations=4")
    check_complaint(outcome, "state.pt is not a readable checkpoint", "that of iteration 2", "model_2.pt")
    advised = outcome.err.split("resume=")[-1].strip()
    assert warpvox("train", f"resume={advised}", "max_iterations=3").code == 0
    assert load_checkpoint(run / "model_3.pt")["iter"] == 3


def test_where_nothing_is_whole_the_run_is_to_be_started_again(copied: Callable, warpvox: Callable) -> None:
    run = copied("train")
    for file in run.glob("*.pt"):
        cut(file, 0.5)
    check_complaint(warpvox("train", f"resume={run}", "max_iterations=4"), "start the run again")


def test_garbled_weights_are_noticed(copied: Callable, warpvox: Callable) -> None:
    """Every byte of a checkpoint counts towards a checksum or is of no account."""
    run = copied("train")
    path, rng = run / "model_3.pt", random.Random(0)
    before = path.read_bytes()
    whole = load_checkpoint(path)
    for _ in range(60):
        garbled = bytearray(before)
        garbled[rng.randrange(len(garbled))] ^= 1 << rng.randrange(8)
        path.write_bytes(garbled)
        try:
            content = load_checkpoint(path)
        except RunError:
            continue
        assert same(content, whole)


@pytest.mark.parametrize("command", ["train", "codesign"])
def test_a_configuration_that_was_cut_short_makes_no_other_run(
    command: str, copied: Callable, warpvox: Callable
) -> None:
    run = copied(command)
    text = (run / "config.yaml").read_text()
    assert text.endswith("...\n")
    lines = text.splitlines(keepends=True)
    for count in range(0, len(lines) - 2, 25):
        (run / "config.yaml").write_text("".join(lines[:count]))
        outcome = warpvox(command, f"resume={run}")
        check_complaint(outcome)
    (run / "config.yaml").write_text("".join(lines[:-4]))
    check_complaint(warpvox(command, f"resume={run}"), "has been cut short", "...")
    if command == "train":
        check_complaint(warpvox("play", f"run={run}", "window=off"), "has been cut short")


def test_damaged_curves_say_what_to_do(copied: Callable, warpvox: Callable) -> None:
    run = copied("train")
    metrics = run / "metrics.csv"
    metrics.write_text(metrics.read_text().replace("\n2,", "\n2x,"))
    for words in (("curves", f"runs=[{run}]"), ("train", f"resume={run}", "max_iterations=4")):
        check_complaint(warpvox(*words), "metrics.csv is damaged", "move it away")
    metrics.unlink()
    assert warpvox("train", f"resume={run}", "max_iterations=4").code == 0


def test_a_rollout_that_was_cut_short_is_refused(warpvox: Callable, tmp_path: Path) -> None:
    assert warpvox("play", "agent=zero", "steps=3", "window=off", "export=[]", "num_envs=1").code == 0
    (rollout,) = tmp_path.glob("outputs/play/*/*/rollout.npz")
    cut(rollout, 0.5)
    before = sorted(tmp_path.rglob("*"))
    check_complaint(warpvox("export", f"rollout={rollout}", "format=html"), "rollout.npz")
    assert sorted(tmp_path.rglob("*")) == before


# ----------------------------------------------------------------------------------------------------- search


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_damaged_archive_names_its_copy_and_the_search_goes_on_from_it(
    share: float, copied: Callable, warpvox: Callable, runs: dict[str, Path]
) -> None:
    run = copied("codesign")
    cut(run / FILE, share)
    for words in (("codesign", "resume=latest"), ("codesign", "report=latest"), ("play", "window=off")):
        check_complaint(warpvox(*words), "damaged", f"{BACKUP} beside it", "copy it over")
    (run / FILE).unlink()
    check_complaint(warpvox("codesign", "resume=latest"), f"has no {FILE}", f"{BACKUP} beside it", "copy it over")
    with pytest.raises(RunError, match=f"{FILE} is gone.*copy it over"):  # a member of a suite would make another one
        Archive.create(run / FILE, {})
    shutil.copy(run / BACKUP, run / FILE)
    assert warpvox("codesign", f"resume={run}").code == 0
    check_search(run, runs["codesign"])


def test_the_copy_is_the_archive_after_the_last_whole_generation(runs: dict[str, Path]) -> None:
    with Archive.read(runs["codesign"] / BACKUP) as copy, Archive.read(runs["codesign"] / FILE) as archive:
        assert copy.digest() == archive.digest()


@pytest.mark.parametrize("name", ["-journal", "-wal", "-shm"])
@pytest.mark.parametrize("content", [b"", b"nonsense" * 500])
def test_strange_journals_beside_an_archive_do_no_harm(
    name: str, content: bytes, copied: Callable, warpvox: Callable, runs: dict[str, Path]
) -> None:
    run = copied("codesign")
    (run / (FILE + name)).write_bytes(content)
    with Archive.open(run / FILE) as archive:
        assert archive.digest() == digest(runs["codesign"])


def test_a_damaged_training_of_designs_is_to_be_removed_and_made_again(
    warpvox: Callable, tmp_path: Path, runs: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    from warpvox.cli.codesign_progress import SearchProgress

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        seen: list[int] = []
        patch.setattr(SearchProgress, "progress", lambda *_: seen.append(1) or (len(seen) == 2 and stop()))
        assert warpvox(*CODESIGN).code == 130
    run = only(tmp_path, "codesign")
    (saved,) = (run / "training").iterdir()
    cut(saved, 0.5)
    check_complaint(warpvox("codesign", f"resume={run}"), saved.name, "Remove it", "to the same end")
    saved.unlink()
    assert warpvox("codesign", f"resume={run}").code == 0
    check_search(run, runs["codesign"])
