"""Tests of comparisons: run, skip finished searches, resume others, and read archives."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import warpvox as wv
from lab.comparison import paper
from lab.comparison.report import grouped, main as report, read_searches, scores_of
from lab.comparison.run import Member, finished, main, named_settings, run
from warpvox.algos.archive import Archive, Finished
from warpvox.algos.candidate import Candidate, Outcome
from warpvox.envs.registry import known_returns

ROOT = Path(__file__).resolve().parents[3]
SMALL = {
    "shape": [3, 3], "search.population": 3, "training.envs": 8, "training.iterations": 1, "training.eval_interval": 1,
    "training.ppo.steps": 4, "training.ppo.hidden": [8], "training.ppo.epochs": 1,
}  # fmt: skip
PATIENCE = 300.0  # seconds for anything in another process; a shared machine may stall
TWO = "Walker-v0/random/seed0", "Walker-v0/random/seed1"


def small(seed: int) -> Member:
    return Member("Walker-v0", "random", seed, named_settings("Walker-v0", "random", 4, SMALL))


def digest(folder: Path) -> list[tuple[bytes, float | None]]:
    """Return bodies and returns of a search."""
    with Archive.read(folder / "archive.sqlite") as archive:
        return [(record.candidate.body.tobytes(), record.fitness) for record in archive.records()]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run two searches in parallel."""
    home = tmp_path_factory.mktemp("made")
    assert run([small(0), small(1)], home, workers=2) == []
    return home


def test_a_member_is_an_ordinary_search(made: Path, tmp_path: Path) -> None:
    settings = small(1).settings
    wv.codesign("Walker-v0", seed=1, folder=tmp_path / "alone", device="cpu", threads=1, progress=False, **settings)
    assert digest(made / "members" / TWO[1]) == digest(tmp_path / "alone")


def test_finished_members_are_left_alone_and_a_failed_one_stops_no_other(made: Path, tmp_path: Path, capsys) -> None:
    home = tmp_path / "home"
    shutil.copytree(made, home)
    before = (home / "members" / TWO[0] / "summary.json").stat().st_mtime_ns
    wrong = Member("Walker-v0", "own", 0, small(0).settings | {"start": ["nowhere"]})
    failed = run([small(0), wrong, small(1), small(2)], home, workers=1)
    assert [(member, "nowhere" in error) for member, error in failed] == [(wrong, True)]
    assert (home / "members" / TWO[0] / "summary.json").stat().st_mtime_ns == before
    assert finished(small(2).folder(home))
    assert "4 members, 2 of them finished" in capsys.readouterr().out


@pytest.mark.parametrize("linked", ["members", "members/Walker-v0", f"members/{TWO[0]}"])
def test_links_in_the_folder_of_a_comparison_are_not_followed(linked: str, tmp_path: Path) -> None:
    home, outside = tmp_path / "home", tmp_path / "outside"
    outside.mkdir()
    (home / linked).parent.mkdir(parents=True)
    (home / linked).symlink_to(outside, target_is_directory=True)

    with pytest.raises(wv.RunError):
        run([small(0)], home, workers=1)
    assert not list(outside.iterdir())


def test_an_interrupted_comparison_continues_to_the_same_results(made: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    words = [str(home), *"--tasks Walker-v0 --searches random --seeds 2 --designs 4 --workers 2 --set".split()]
    words += [f"{key}={value}" for key, value in SMALL.items()]
    command = [sys.executable, "-m", "lab.comparison.run", *words]
    process = subprocess.Popen(command, cwd=ROOT, start_new_session=True, stdout=subprocess.PIPE, text=True)
    archive = home / "members" / TWO[0] / "archive.sqlite"
    until = time.monotonic() + PATIENCE
    while not archive.is_file() and time.monotonic() < until:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    assert "states saved" in process.communicate(timeout=PATIENCE)[0]
    assert process.returncode == 130
    assert not all(finished(home / "members" / name) for name in TWO)

    assert main(words) == 0
    for name in TWO:
        assert digest(home / "members" / name) == digest(made / "members" / name)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--tasks Walkr-v0 --searches ga", "Did you mean 'Walker-v0'"),
        ("--tasks Walker-v0 --searches gaa", "search must be one of"),
        ("--tasks Walker-v0 --searches ga --set training.envz=3", "no setting 'envz'; there are"),
        ("--tasks Walker-v0 --searches ga --set training.envs=many", "envs must be an integer"),
        ("--tasks Walker-v0 --searches ga --set seed=3", "seed is an option of the comparison"),
        ("--tasks Walker-v0 --searches ga --part 3/2", "expected K/N"),
    ],
)
def test_mistakes_are_found_before_anything_is_written(words: str, says: str, tmp_path: Path, capsys) -> None:
    with pytest.raises(SystemExit):
        main([str(tmp_path / "home"), *words.split()])
    assert says in capsys.readouterr().err
    assert not (tmp_path / "home").exists()


def make_search(folder: Path, task: str, seed: int, fitness: list[float], steps: int = 100, **other: object) -> None:
    """Create an archive with these returns; every design takes ``steps``."""
    folder.mkdir(parents=True)
    settings = {"task": task, "seed": seed, "search": {"algorithm": "ga"}} | other
    with Archive.create(folder / "archive.sqlite", settings) as archive:
        bodies = [wv.sample_design((5, 5), 1000 * seed + k) for k in range(len(fitness))]
        archive.propose([Candidate(k, body) for k, body in enumerate(bodies)], seed)
        archive.finish([Finished(k, Outcome(value, [(steps, value)], steps)) for k, value in enumerate(fitness)])


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create searches on three tasks (one without a published return) with two seeds, and one that has only begun."""
    root = tmp_path_factory.mktemp("toys")
    for task, base in (("Catcher-v0", -1.0), ("Walker-v0", 4.0), ("Traverser-v0", 0.0)):
        for number, search in enumerate(("slow", "quick<")):
            for seed in range(2):
                fitness = [base + number + seed + k / 10 for k in range(7)]
                make_search(root / task / search / f"seed{seed}", task, seed, fitness, 100 * (1 + number))
    make_search(root / "Walker-v0" / "slow" / "seed2", "Walker-v0", 2, [])
    return root


def test_searches_are_compared_at_equal_control_steps(toys: Path) -> None:
    scores, steps = scores_of(grouped(read_searches([toys])))
    assert steps == {"Walker-v0": 700, "Catcher-v0": 700}
    # after 700 steps all seven designs of the one are done, and three of the other
    known = known_returns()["Walker-v0"]
    for name, values in {"slow": [4.6, 5.6], "quick<": [5.2, 6.2]}.items():
        assert scores[name]["Walker-v0"].tolist() == pytest.approx([known.score(value) for value in values])


def test_the_report_says_what_the_archives_say(toys: Path, tmp_path: Path) -> None:
    for name in "ab":
        report([str(toys), "--out", str(tmp_path / name)])
    names = {"report.html", "results.csv", "curves.svg", "winners.png"}
    assert {path.name for path in (tmp_path / "a").iterdir()} == names
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in names)
    page = (tmp_path / "a" / "report.html").read_text(encoding="utf-8")
    rows = [re.findall(r"<td>(.*?)</td>", row) for row in page.split("<tr>")]
    # returns of the two runs end at -1 + 0.6 and 0 + 0.6
    assert ["Catcher-v0", "slow", "2", "0.600", "0.100 ± 0.707", "0.333", "14", "1,400"] in rows
    assert re.search("<td>quick&lt; better than slow</td><td>0.750 ", page)
    with (tmp_path / "a" / "results.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if (row["task"], row["search"]) == ("Walker-v0", "slow")]
    assert [(row["seed"], float(row["best_return"]), row["designs"]) for row in rows] == [
        ("0", 4.6, "7"),
        ("1", 5.6, "7"),
    ]


def test_seeds_of_a_search_that_differ_by_more_are_refused(tmp_path: Path) -> None:
    for seed in range(2):
        make_search(tmp_path / "Walker-v0" / "ga" / f"seed{seed}", "Walker-v0", seed, [1.0], batch=seed)
    with pytest.raises(SystemExit, match="differ in batch"):
        read_searches([tmp_path])
    with pytest.raises(SystemExit, match="No design search"):
        read_searches([tmp_path / "elsewhere"])


def test_the_page_is_made_of_the_tables() -> None:
    text = paper.README.read_text(encoding="utf-8")
    assert text == paper.page(text), "run `python -m lab.comparison.paper tables`"


def test_the_papers_experiments_are_complete_and_a_cut_is_useful() -> None:
    every = paper.members()
    keys = [(one.task, one.search, one.seed) for one in every]
    assert set(keys) == paper.keys_of(paper.read_rows(paper.MEMBERS))
    assert len(set(keys)) == len(keys) == 156
    quick = [task for task in paper.BENCHMARK10 if task != paper.SLOWEST]
    assert set(keys[:27]) == {(task, search, 0) for task in quick for search in paper.NAMES}
    assert {(search, seed) for _, search, seed in keys[27:49]} == {("ga", 0)}
    assert {task for task, _, _ in keys[147:]} == {paper.SLOWEST}
    settings = [one.settings for one in every]
    assert {one["search"].max_designs for one in settings} == {20_000_000 // (32 * 64 * 60)}
    assert {(one["training"].envs, one["training"].iterations) for one in settings} == {(32, 60)}
    assert {tuple(one.settings["shape"]) for one in every if one.task == "Lifter-v0"} == {(5, 7)}


def test_rows_of_finished_searches_are_added_once(made: Path, tmp_path: Path, monkeypatch) -> None:
    for name, columns in (("MEMBERS", (*paper.KEY, *paper.FACTS)), ("CURVES", paper.CURVE_COLUMNS)):
        monkeypatch.setattr(paper, name, tmp_path / name)
        (tmp_path / name).write_text(",".join(columns) + "\n")
    monkeypatch.setattr(paper, "members", lambda: [small(0), small(1), small(7)])
    assert (paper.add(made), paper.add(made)) == (2, 0)
    rows = paper.read_rows(paper.MEMBERS)
    assert [(row["search"], row["seed"], row["evaluations"]) for row in rows] == [("random", k, "4") for k in "01"]
    summary = json.loads((made / "members" / TWO[0] / "summary.json").read_text())
    assert float(rows[0]["return"]) == pytest.approx(summary["best_fitness"], abs=0.05)
    curve = paper.read_rows(paper.CURVES)[1]
    assert float(curve["1"]) == pytest.approx(summary["best_fitness"], rel=1e-5)
