"""Files that a command writes into a folder lie in it, whatever links came with the folder."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny import tiny

from warpvox.editor.documents import document_of, file_names, read_file, save_file
from warpvox.errors import RunError, WorldError
from warpvox.io.writing import check_links, claimed, write_bytes, write_table, write_text

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links need a right on Windows")
SEARCH = ("task=Walker-v0", "search=random", "search.population=2")
MAKERS = {
    "train": tiny("train", "task=Walker-v0", "design=mini"),
    "codesign": tiny("codesign", *SEARCH, "search.max_designs=2"),
}
WRITERS = {
    "train": [["train", "resume=run", "max_iterations=2"]],
    "codesign": [
        ["codesign", "report=run", "export=[csv,npz]"],
        ["codesign", "resume=run", "search.max_designs=3"],
    ],
}
"""Commands that write into the folder of a run."""
LINKS = {
    "train": ["summary.json", "metrics.csv", "state.pt"],
    "codesign": ["report.html", "generations", "archive.sqlite.lock", "designs/0", "structures", "archive.sqlite-wal"],
}
"""Files and folders that they write."""


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("kind", MAKERS)
def test_no_command_writes_through_a_link(kind: str, warpvox: Callable, tmp_path: Path) -> None:
    run, victim = tmp_path / "run", tmp_path / "victim"
    warpvox(*MAKERS[kind])
    shutil.move(
        next(path.parent for path in sorted(Path("outputs").rglob("config.yaml"), key=lambda p: len(p.parts))), run
    )
    for number, name in enumerate(LINKS[kind]):
        victim.mkdir()
        path = run / name
        if path.exists():
            shutil.move(path, victim / "it")
        path.symlink_to(victim / "it")
        before = content(victim)
        for words in WRITERS[kind][number % 2 :]:
            outcome = warpvox(*words, code=None)
            assert content(victim) == before, (name, words)
            assert "Traceback" not in outcome.err, (name, words, outcome)
        path.unlink(missing_ok=True)
        if (victim / "it").exists():
            shutil.move(victim / "it", path)
        shutil.rmtree(victim)


@pytest.mark.parametrize("name", ["a.txt", "below/a.txt", "below", "new"])
@pytest.mark.parametrize("there", [True, False])
def test_a_folder_with_a_link_that_leads_out_of_it_is_not_written_to(name: str, there: bool, tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "run", tmp_path / "run-2"
    (folder / "below").mkdir(parents=True)
    (folder / "below" / "b.txt").write_text("b")
    (folder / "inner").symlink_to("below")
    with claimed(folder):
        pass
    shutil.rmtree(folder / name, ignore_errors=True)
    if there:
        elsewhere.mkdir()
    (folder / name).symlink_to(elsewhere)
    with pytest.raises(RunError), claimed(folder):
        pass
    with pytest.raises(RunError):
        check_links(folder, [Path(name).parts[0]])
    check_links(folder, ["other"])


def test_a_pipe_is_no_file_to_write_to(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log.txt")
    with pytest.raises(RunError):
        check_links(tmp_path)


@pytest.mark.parametrize("there", [True, False])
def test_writers_replace_a_link(there: bool, tmp_path: Path) -> None:
    victim, link = tmp_path / "victim", tmp_path / "folder" / "a"
    link.parent.mkdir()
    for write in (
        lambda: write_text(link, "new"),
        lambda: write_bytes(link, b"new"),
        lambda: write_table(link, ["new"], []),
    ):
        if there:
            victim.write_text("old")
        link.symlink_to(victim)
        write()
        assert (link.is_symlink(), link.read_text().strip()) == (False, "new")
        assert victim.read_text() == "old" if there else not victim.exists()
        link.unlink()


def test_the_editor_reads_and_writes_in_its_folder_only(tmp_path: Path) -> None:
    folder, victim = tmp_path / "mine", tmp_path / "secret.json"
    folder.mkdir()
    body = document_of([[3]])
    (folder / "new.json").symlink_to(tmp_path / "nowhere.json")
    with pytest.raises(FileExistsError):  # as of any other file: it asks before it replaces one
        save_file(body, folder, "new")
    save_file(body, folder, "new", overwrite=True)
    assert not (tmp_path / "nowhere.json").exists()
    victim.write_text("[[3]]")
    (folder / "robot.json").symlink_to(victim)
    assert file_names(folder) == ["new.json"]
    with pytest.raises(WorldError):
        read_file(folder / "robot.json")
    save_file(body, folder, "robot", overwrite=True)
    assert (victim.read_text(), file_names(folder)) == ("[[3]]", ["new.json", "robot.json"])
