"""Design searches from end to end, on trainings of a moment."""

import contextlib
import csv
import json
import re
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from fault_cases import digest
from PIL import Image
from rich.console import Console
from tiny import tiny

from warpvox.algos.archive import FILE, Archive
from warpvox.algos.candidate import Candidate
from warpvox.algos.checkpoints.policy import read_policy
from warpvox.algos.codesign import results as results_of
from warpvox.algos.codesign.results import Results
from warpvox.algos.codesign.settings import Codesign
from warpvox.cli import main
from warpvox.design import example_design, load_design, sample_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.palette import cell_colour
from warpvox.runs import read_summary
from warpvox.view.cell_text import body_rows

SIZES = "search.population=5", "search.max_designs=8", "training.iterations=2", "training.eval_interval=2"
ROUNDING = 1e-6  # of the rewards in a rollout, which are summed up in float64 and stored one by one in float32


@pytest.fixture
def search(warpvox: Callable) -> Callable[..., Path]:
    """Make a small search; returns its folder."""

    def call(*words: str) -> Path:
        before = set(Path("outputs").glob("codesign/*/*"))
        warpvox(*tiny("codesign", *SIZES, *words))
        (folder,) = set(Path("outputs").glob("codesign/*/*")) - before
        return folder

    return call


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A search of five designs; not to be changed."""
    place = tmp_path_factory.mktemp("made")
    assert main(tiny("codesign", *SIZES, "search.max_designs=5", f"output_dir={place}")) == 0
    (folder,) = place.glob("codesign/*/*")
    return folder


@pytest.fixture
def copied(made: Path, warpvox: Callable) -> Path:
    return Path(shutil.copytree(made, Path("outputs/codesign/Walker-v0") / made.name))


def test_a_search_leaves_what_was_promised(search: Callable, warpvox: Callable) -> None:
    folder = search("seed=3", "name=first", "export=[csv,npz]", "top=2")
    assert folder.parent == Path("outputs/codesign/Walker-v0")
    assert folder.name.endswith("_first")
    names = {file.name for file in folder.iterdir()}
    assert names == {
        "config.yaml", "summary.json", "report.html", "archive.sqlite", "archive.sqlite.lock", "archive.backup.sqlite",
        "designs", "generations", "designs.csv", "structures",
    }  # fmt: skip
    figures = read_summary(folder)
    with Archive.read(folder / FILE) as archive:
        records, best = archive.records(), archive.best()[0]
        assert (figures["status"], figures["evaluations"]) == ("done", 8)
        assert len(records) == 8
        assert (figures["best_fitness"], figures["best_design"]) == (best.fitness, best.id)
        assert figures["steps"] == sum(record.steps for record in records) == 8 * 2 * 4 * 8
        for record in records:
            assert record.fitness == max(value for _, value in record.curve)
            stored = yaml.safe_load((folder / "designs" / str(record.id) / "config.yaml").read_text())
            assert stored["design"] == record.candidate.body.tolist()
            read_policy(folder / record.policy_file)
        pictures = sorted((folder / "generations").iterdir())
        assert [file.name for file in pictures] == [f"{row['generation']:03}.png" for row in archive.generations()]
    assert {Image.open(file).format for file in pictures} == {"PNG"}
    assert len(list(csv.DictReader((folder / "designs.csv").open()))) == 8
    assert len(list((folder / "structures").rglob("*.npz"))) == 8
    # played on the same task without exploration, the best design does what it was judged by
    warpvox("play", "run=latest", "num_envs=2", "export=[]", "device=cpu")
    (played,) = Path("outputs/play/Walker-v0").iterdir()
    assert read_summary(played)["mean_return"] == pytest.approx(best.fitness, abs=ROUNDING)
    other = next(record for record in records if record.id != best.id)
    warpvox("play", f"run={folder}/designs/{other.id}", "num_envs=1", "export=[]", "name=b")
    (played,) = Path("outputs/play/Walker-v0").glob("*_b")
    assert read_summary(played)["mean_return"] == pytest.approx(other.fitness, abs=ROUNDING)


@pytest.mark.parametrize("words", [["task=Catcher-v0"], ["protocol=noise", "training.episodes=2"]])
def test_a_winner_among_random_episodes_is_judged_again_on_fresh_seeds(words, search, warpvox, monkeypatch) -> None:
    monkeypatch.setattr(results_of, "FRESH", 12)  # of 64
    folder = search(*words, "search.max_designs=5", "seed=3")
    fresh, text = read_summary(folder)["fresh_seeds"], (folder / "report.html").read_text()
    how = "protocol=noise" if "protocol=noise" in words else "protocol=nominal"
    warpvox("evaluate", f"runs=[{folder}]", how, "episodes=12", "device=cpu", "threads=1")
    (judged,) = Path("outputs/evaluate").glob("*/*")
    (again,) = read_summary(judged)["runs"]
    assert [fresh[name] for name in ("mean", "low", "high")] == [again[name] for name in ("mean", "low", "high")]
    assert (fresh["episodes"], fresh["mean"] != read_summary(folder)["best_fitness"]) == (12, True)
    assert f"<dd>{fresh['mean']:.3f} [" in text
    # nothing is random in the other tasks: there is nothing else to judge by
    assert [task for task in task_ids() if get_task(task).is_random] == ["BidirectionalWalker-v0", "Catcher-v0"]


def test_the_same_seed_gives_the_same_search_and_a_sweep_makes_several(search: Callable, warpvox: Callable) -> None:
    one = digest(search("seed=1", "search.max_designs=5"))
    warpvox(*tiny("codesign", *SIZES, "search.max_designs=5", "--multirun", "seed=1,2"))
    folders = sorted(Path("outputs/codesign/Walker-v0").iterdir())
    assert len(folders) == 3
    found = [digest(folder) for folder in folders]
    assert found.count(one) == 2


def test_resuming_refuses_what_would_be_another_search(copied: Path, warpvox: Callable) -> None:
    before = digest(copied)
    for word, phrase in {
        "seed=5": "seed cannot change",
        "search.max_designs=9": "search.max_designs cannot change",
        "training.ppo.gamma=0.5": "training.ppo.gamma cannot change",
        "search=random": "search.algorithm cannot change",
    }.items():
        warpvox("codesign", "resume=latest", word, fails=phrase)
    config = copied / "config.yaml"
    config.write_text(config.read_text().replace("reuse: true", "reuse: false"))
    warpvox("codesign", "resume=latest", fails="reuse=True, asked for reuse=False")
    assert digest(copied) == before
    warpvox("train", f"resume={copied}", fails="it has no state.pt")


def test_a_search_that_goes_on_is_exported_as_it_was_asked_at_its_beginning(search: Callable, warpvox) -> None:
    folder = search("search.max_designs=5", "export=[csv]")
    table = (folder / "designs.csv").read_bytes()
    for word in ("top=2", "device=cpu"):
        (folder / "designs.csv").unlink()
        warpvox("codesign", f"resume={folder}", word)
        assert (folder / "designs.csv").read_bytes() == table
    assert yaml.safe_load((folder / "config.yaml").read_text())["resume"] is None
    warpvox("codesign", f"resume={folder}", "export=[npz]")
    assert (folder / "structures").is_dir()


def test_the_report_is_made_again(search: Callable, warpvox: Callable) -> None:
    folder = search("search.max_designs=5")
    page = (folder / "report.html").read_text()
    (folder / "report.html").unlink()
    picture = folder / "generations" / "000.png"
    drawn = picture.read_bytes()
    picture.write_bytes(b"of other designs")
    warpvox("codesign", "report=latest", "export=[json,csv]")
    assert (folder / "report.html").read_text() == page
    assert picture.read_bytes() == drawn
    films = sorted(folder.glob("designs/*/film.webp"))
    assert all(Image.open(film).is_animated for film in films)
    assert page.count("data:image/webp;base64,") == 5
    played = re.findall("<code>(warpvox play run=[^<]*)</code>", page)
    assert sorted(played) == [f"warpvox play run={film.parent}" for film in films]
    files = list((folder / "structures").rglob("*.json"))
    assert len(files) == 5
    for file in files:
        assert load_design(file).shape == (3, 3)
    with Archive.open(folder / FILE) as archive:  # the best after a generation are not known while it is under way
        archive.propose([Candidate(5, example_design("walker"), (), "random", 1)], 0)
        warpvox("codesign", "report=latest")
        assert list(picture.parent.iterdir()) == [picture]
        for fresh in False, True:
            picture.write_bytes(b"of other designs")
            Results(folder, archive, Codesign()).told(0, fresh)
            assert (picture.read_bytes() == b"of other designs") != fresh


def test_a_report_that_is_made_while_its_search_ends_tells_the_end(
    copied: Path, warpvox: Callable, monkeypatch
) -> None:
    warpvox("codesign", "report=latest")
    page = (copied / "report.html").read_text()
    summary = copied / "summary.json"
    report_page = results_of.report_page
    ended = summary.read_text()

    def late(*given: Any) -> str:
        summary.write_text(ended)
        return report_page(*given)

    summary.write_text(ended.replace('"done"', '"running"'))
    monkeypatch.setattr(results_of, "report_page", late)
    warpvox("codesign", "report=latest")
    assert (copied / "report.html").read_text() == page


DAMAGED = '{"elapsed_seconds": "x", "steps": [], "fresh_seeds": {"mean": 1}, "status": "done"}'


def test_neither_a_damaged_summary_nor_damaged_designs_stop_a_report(copied: Path, warpvox: Callable) -> None:
    folder = copied
    for words in ("report=latest", "resume=latest"):
        (folder / "summary.json").write_text(DAMAGED)
        warpvox("codesign", words)
    assert read_summary(folder)["evaluations"] == 5
    for film in folder.glob("designs/*/film.webp"):
        film.unlink()
    (folder / "designs/1/config.yaml").write_text("task: Wal")
    (folder / "designs/2/model_best.pt").write_bytes(b"")
    config = folder / "designs/3/config.yaml"
    config.write_text(config.read_text().replace("num_envs: ", "num_envs: -"))
    warpvox("codesign", "report=latest")
    page = (folder / "report.html").read_text()
    assert page.count("data:image/webp;base64,") == 2
    assert page.count("<code>warpvox play") == 4
    assert "designs/1/config.yaml has been cut short" in page


def test_a_search_of_version_0_1_goes_on_or_is_refused_in_a_sentence(copied: Path, warpvox: Callable) -> None:
    folder = copied

    def records() -> list[tuple[str, float | None, list]]:
        with Archive.read(folder / FILE) as archive:
            return [(str(one.candidate.body.tolist()), one.fitness, one.curve) for one in archive.records()]

    before = records()

    def store(method: str, policy: str = "mlp", evaluation: str = "specialist") -> None:
        """Give the search the keys that version 0.1.0 had besides."""
        config = yaml.safe_load((folder / "config.yaml").read_text())
        with contextlib.closing(sqlite3.connect(folder / FILE)) as db, db:
            (text,) = db.execute("SELECT value FROM experiment WHERE key='settings'").fetchone()
            settings = json.loads(text)
            for values in (config, settings):
                values["evaluation"] = values.get("evaluation", values["fitness"]) | {"name": evaluation}
                values |= {"policy": policy, "network": None, "fitness": values.pop("protocol", "nominal")}
                values["search"].setdefault("max_evaluations", values["search"].pop("max_designs", None))
                values["training"] |= {"method": method, "eval_envs": values["training"].pop("episodes", None)}
            config["training"]["save_interval"] = 25
            db.execute("UPDATE experiment SET value=? WHERE key='settings'", [json.dumps(settings)])
        (folder / "config.yaml").write_text(yaml.safe_dump(config) + "...\n")

    store("population")
    (folder / "summary.json").unlink()
    warpvox("codesign", f"resume={folder}")
    warpvox("codesign", f"report={folder}")
    assert records() == before
    for key, changes in {
        "training.method=sequential": ("sequential",),
        "policy=grid": ("population", "grid"),
        "evaluation=few_shot": ("population", "mlp", "few_shot"),
    }.items():
        store(*changes)
        for words in (f"resume={folder}", f"report={folder}", f"config={folder}"):
            warpvox("codesign", words, fails=("warpvox 0.1.0", key))
        warpvox("play", f"run={folder}", "window=off", fails=("warpvox 0.1.0", key))


def test_on_a_terminal_a_search_is_watched_live(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # as rich takes for a terminal
    shown = warpvox(*tiny("codesign", *SIZES)).out
    assert "\x1b[?25l" in shown  # the block hides the cursor
    assert "best so far" in re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown)


def test_bodies_are_painted_side_by_side_on_a_terminal() -> None:
    console = Console(force_terminal=True, color_system="truecolor", width=120)
    bodies = [example_design("walker"), sample_design((5, 5), 0)]
    rows = body_rows(bodies, ["2.500 #0", "0.500 #1"], console)
    assert rows.plain.splitlines()[-1].split() == ["2.500", "#0", "0.500", "#1"]
    painted = [str(span.style) for span in rows.spans]
    assert painted == [
        f"on rgb({','.join(map(str, cell_colour(int(cell))))})"
        for line in range(5)
        for body in bodies
        for cell in body[line]
        if cell
    ]
