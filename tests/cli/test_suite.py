"""Suites of design searches: what their members are, what is left of them, and how they go on after an end."""

import csv
import dataclasses
import errno
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import parallel
import pytest
import yaml
from rich.console import Console
from suite_jobs import act
from tiny import tiny

from warpvox.algos.candidate import Outcome
from warpvox.algos.codesign import results, run as search_run
from warpvox.algos.codesign.archive import FILE, Archive
from warpvox.algos.codesign.evaluations.base import steps_of_training
from warpvox.algos.interrupt import Terminated
from warpvox.algos.report import benchmark
from warpvox.algos.settings import DesignTraining
from warpvox.algos.suite import run as making
from warpvox.algos.suite.members import CURVES, MEMBERS
from warpvox.algos.suite.pool import LOG, LocalPool
from warpvox.cli.commands import suite
from warpvox.cli.config import load
from warpvox.cli.suite_plan import BENCHMARK10, merged, plan, task_names
from warpvox.envs.registry import task_ids
from warpvox.errors import ConfigError, DivergenceError, StorageError, WarpvoxError
from warpvox.io.writing import MARK, claimed
from warpvox.runs import read_summary

SIZES = "tasks=[Walker-v0,Thrower-v0]", "searches=[ga]", "seeds=2", "evaluations=8", "search.population=5"
MEMBER_KEYS = [(task, "ga", seed) for seed in (0, 1) for task in ("Walker-v0", "Thrower-v0")]


def table(folder: Path, file: str = MEMBERS) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / file).read_text().splitlines()))


def states(folder: Path) -> list[str]:
    return [row["state"] for row in table(folder)]


def digests(folder: Path) -> dict[str, str]:
    found = {}
    for row in table(folder):
        with Archive.read(folder / row["folder"] / FILE) as archive:
            found[row["folder"]] = archive.digest()
    return found


def members(*words: str) -> list[Any]:
    own, typed = suite.split(list(words))
    config = load("suite", own)
    return plan(dataclasses.replace(config, codesign=merged(config.codesign, typed, "outputs")))


@pytest.fixture(scope="module")
def quick_keys() -> Any:
    """The configuration of ``suite=quick`` with one search."""
    return load("suite", ["searches=[random]"])


def test_presets_name_the_tasks_of_the_paper_and_a_quick_look() -> None:
    paper = members("suite=paper")
    assert {member.task for member in paper} == set(BENCHMARK10) <= set(task_ids())
    assert len(paper) == 10 * 3 * 3
    assert {tuple(member.settings.shape) for member in paper if member.task == "Lifter-v0"} == {(5, 7)}
    assert {tuple(member.settings.shape) for member in paper if member.task != "Lifter-v0"} == {(5, 5)}
    budgets = {member.task: member.settings.search.max_evaluations for member in paper}
    assert [budgets[task] for task in ("Walker-v0", "Climber-v0", "Lifter-v0")] == [250, 500, 750]
    table6 = load("codesign", ["training=paper"]).training
    assert all(member.settings.training == table6 for member in paper)
    assert {member.settings.search.acquisition for member in paper if member.search == "bo_paper"} == {"paper"}
    assert len(task_names(["all"])) == 32
    assert len(members("suite=quick")) == 3 * 2 * 3


def test_every_key_of_codesign_reaches_the_members() -> None:
    words = ["training.ppo.gamma=0.9", "physics.gravity=80", "rules=paper", "reuse=false", "dtype=float64", "top=2"]
    words.append("preset=null")  # the default
    (member,) = members(*words, "tasks=[Climber-v0]", "searches=[random]", "seeds=[7]")
    alone = load("codesign", [*words, "task=Climber-v0", "search=random", "seed=7"])
    for name in ("rules", "reuse", "dtype", "top", "physics", "task", "seed", "executor", "shape"):
        assert getattr(member.settings, name) == getattr(alone, name), name
    assert member.settings.training.ppo.gamma == 0.9


def test_settings_go_to_the_searches_that_have_them() -> None:
    found = members("searches=[ga,random]", "search.mutation_rate=0.3", "search.population=6", "seeds=[4]")
    assert [member.settings.search.mutation_rate for member in found if member.search == "ga"] == [0.3] * 3
    assert not hasattr(found[1].settings.search, "mutation_rate")
    assert {member.settings.search.population for member in found} == {6}


@pytest.mark.parametrize(
    "words", [["evaluation.finalists=4", "dtype=float32", "evaluation.gaits=3"], ["evaluation=specialist"]]
)
def test_what_a_suite_says_holds_against_the_file_of_a_search(words: list[str]) -> None:
    (member,) = members("searches=[auto]", "tasks=[Climber-v0]", "seeds=[2]", *words)
    alone = load("codesign", ["search=auto", *words])
    for name in ("evaluation", "dtype"):
        assert getattr(member.settings, name) == getattr(alone, name), name


@pytest.mark.usefixtures("whole_episodes")
def test_budgets_by_task() -> None:
    words = ["tasks=[Walker-v0,Climber-v0,Lifter-v0]", "searches=[ga]", "seeds=[0]"]
    found = members(*words, "evaluations={easy:10,default:20,Lifter-v0:30}")
    assert [member.settings.search.max_evaluations for member in found] == [10, 20, 30]
    training = found[0].settings.training
    cost = steps_of_training(training, 8)
    found = members(*words, f"control_steps={int(cost * 12.5)}", "search.population=8")
    assert [member.settings.search.max_evaluations for member in found] == [12] * 3
    # of search=auto the finalists take gaits and trainings; Walker-v0 has 500, Catcher-v0 400 steps, four times
    words = ["tasks=[Walker-v0,Catcher-v0]", "searches=[auto,ga]", "seeds=[0]", "control_steps=5000000"]
    walker, _, catcher, plain = members(
        *words, *(f"evaluation.{key}" for key in ("gaits=10", "rounds=2", "final_rounds=5", "final_passes=0"))
    )
    # with noise on the actions, by which search=auto chooses
    last = [2 * (5 * 10 * 4 * steps + steps_of_training(training, 2)) for steps in (500, 400)]
    budgets = [int((5_000_000 - spent) // (2 * 10 * 4 * steps)) for spent, steps in zip(last, (500, 400), strict=True)]
    assert [walker.settings.search.max_evaluations, catcher.settings.search.max_evaluations] == budgets
    assert (walker.settings.evaluation.name, plain.settings.evaluation.name) == ("gaits", "specialist")


@pytest.mark.parametrize(
    ("changes", "phrase"),
    [
        ({"tasks": []}, "got \\[\\]"),
        ({"seeds": []}, "seeds must be how many"),
        ({"seeds": 10**12}, "seeds must be an integer from 1 to 10000"),
        ({"evaluations": {"esay": 3}}, "Did you mean 'easy'"),
        ({"evaluations": {"hard": 3}}, "says nothing of Walker-v0"),
        ({"control_steps": 10}, "must be at least"),
        ({"codesign": ["seed=3"]}, "seed is set by the suite for each search. Did you mean 'seeds'"),
        ({"codesign": ["search.max_evaluations=3"]}, "set by the suite for each search. Did you mean 'evaluations'"),
        ({"codesign": ["search.max_evaluation=3"]}, "a suite says how much each search may do, evaluations="),
    ],
)
def test_mistakes_in_what_members_are(quick_keys: Any, changes: dict[str, Any], phrase: str) -> None:
    with pytest.raises(WarpvoxError, match=phrase):
        plan(dataclasses.replace(quick_keys, **changes))


def test_what_a_design_costs_with_successive_halving() -> None:
    settings = DesignTraining(envs=8, iterations=40, eval_interval=10, rungs=[0.25, 0.5], keep=0.5)
    settings.ppo.steps = 16
    # of 5 designs all train 10 iterations, 3 ten more, 2 the last 20
    assert steps_of_training(settings, 5) == (5 * 10 + 3 * 10 + 2 * 20) * 8 * 16 / 5
    # as many are kept as the share says, not one more for its rounding; and one at least
    shares = (0.28, 25), (0.07, 100), (0.56, 25), (0.5, 5), (0.51, 2), (1e-12, 3), (1.0, 3)
    assert [DesignTraining(keep=keep).kept(count) for keep, count in shares] == [7, 7, 14, 3, 2, 1, 3]


class Evaluator:
    """Fitness by the number of cells of each type; no policy."""

    def evaluate(self, candidates: Any, parents: Any, report: Any = None, checkpoint: Any = None) -> list[Outcome]:
        return [Outcome(float((item.body * item.body).sum()), [(8, 1.0)], 8) for item in candidates]


class HerePool:
    """Makes each member in this process as soon as it is begun."""

    def __init__(self, make: Callable, size: int) -> None:
        self.make, self.size, self.ended = make, size, []

    def begin(self, number: int, job: Any, folder: Path) -> None:
        self.ended.append((number, self.make(job, folder)))

    def wait(self, seconds: float) -> list:
        ended, self.ended = self.ended, []
        return ended

    def stop(self) -> None: ...

    def close(self) -> None: ...


@pytest.fixture
def quick(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> Callable:
    """``warpvox suite`` whose members take a moment, on 2 tasks x 1 search x 2 seeds unless told otherwise."""
    monkeypatch.setattr(search_run, "make_evaluator", lambda *_: Evaluator())
    monkeypatch.setattr(results, "draw_bodies", lambda *_: None)
    monkeypatch.setattr(results, "save_png", lambda _, path: path)
    monkeypatch.setattr(results, "report_page", lambda *_: "")
    monkeypatch.setattr(making, "LocalPool", HerePool)

    def call(*words: str, **ends: Any) -> Any:
        again = any(word.startswith(("resume=", "report=")) for word in words)
        return warpvox(*(["suite", *words] if again else tiny("suite", *SIZES, *words)), **ends)

    return call


def failing(monkeypatch: pytest.MonkeyPatch, fails: Callable[[Any], Exception | None]) -> None:
    """Members for which ``fails`` gives an error end with it."""
    made = making.run_codesign

    def make(settings: Any, *given: Any, **named: Any) -> Any:
        error = fails(settings)
        if error is not None:
            raise error
        return made(settings, *given, **named)

    monkeypatch.setattr(making, "run_codesign", make)


def test_a_suite_leaves_one_folder(quick: Callable) -> None:
    outcome = quick("name=first")
    folder = Path("outputs/suite/first")
    assert {file.name for file in folder.iterdir()} >= {"config.yaml", MEMBERS, CURVES, "members", "report.html"}
    rows = table(folder)
    assert [(row["task"], row["search"], int(row["seed"])) for row in rows] == sorted(
        MEMBER_KEYS, key=lambda key: (key[0] != "Walker-v0", key[2])
    )
    for row in rows:
        assert (row["state"], row["evaluations"], row["error"]) == ("done", "8", "")
        assert row["folder"] == f"members/{row['task']}/ga/seed{row['seed']}"
        config = yaml.safe_load((folder / row["folder"] / "config.yaml").read_text())
        assert (config["task"], config["seed"]) == (row["task"], int(row["seed"]))
        with Archive.read(folder / row["folder"] / FILE) as archive:
            records = archive.records()
        assert int(row["control_steps"]) == 8 * 8
        trained = [record.fitness for record in records if record.reused is None]
        curve = [line for line in table(folder, CURVES) if (line["task"], line["seed"]) == (row["task"], row["seed"])]
        for line in curve:
            spent = int(line["evaluations"])
            assert float(line["best"]) == max(trained[:spent])
            assert int(line["control_steps"]) == 8 * spent
        assert int(curve[-1]["evaluations"]) == 8
        assert curve[-1]["best"] == row["best_fitness"] == str(max(trained))
    assert "4 members" in outcome.out
    assert "best fitness, mean" in outcome.out
    # the folder is in use, and complete
    quick("name=first", fails="exists already")
    assert "4 done already" in quick("resume=latest").out


def test_a_suite_that_could_not_begin_is_begun_by_the_same_words(quick: Callable, monkeypatch) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("os.replace", refuse)
        quick("name=first", fails="config.yaml cannot be written: no space is left")
    folder = Path("outputs/suite/first")
    (folder / f"{MARK}config-1.yaml").touch()  # as of a process that was killed here
    begun = Mock()
    monkeypatch.setattr(making, "make_members", begun)
    quick("name=first", code=2)
    assert begun.call_args.args[0].folder == folder
    assert {file.name for file in folder.iterdir()} >= {"config.yaml", MEMBERS}


@pytest.mark.parametrize(
    ("words", "phrase"),
    [
        ("training.inherit=true", "auto: training.inherit does not go with evaluation=gaits"),
        ("evaluation=few_shot", "evaluation=few_shot needs evaluation.pretrained"),
    ],
)
def test_what_does_not_go_with_a_recipe_is_refused_before_anything_is_made(quick, words: str, phrase: str) -> None:
    quick("searches=[ga,auto]", words, fails=phrase)
    quick("suite=paper", "config=kept.yaml", fails="config=kept.yaml and suite both say where to start:")
    assert not Path("outputs").exists()


def test_members_on_ray_are_searches_in_one_process_on_other_machines() -> None:
    found = members("tasks=[Walker-v0]", "searches=[ga]", "seeds=[0]", "evaluation=shared", "device=cuda:99")
    for executor in "ray", "local":
        with nullcontext() if executor == "ray" else pytest.raises(WarpvoxError, match="cuda:99"):
            suite._check(suite.Job(load("suite", [f"executor={executor}"]), found))


def test_a_suite_counts_environments_as_its_members_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """With device=auto: 16 environments for each training, and of gaits 32 designs x 8 gaits x 4 episodes."""
    asked = []
    monkeypatch.setattr(making, "resolve_device", lambda device, envs: asked.append(envs) or "cpu")
    words = "tasks=[Catcher-v0]", "searches=[ga,auto]", "search.population=32"
    found = [member.settings for member in members(*words)]
    making._pool(load("suite", ["workers=1"]), found)[0].close()
    assert asked == [32 * 8 * 4]


def test_more_members_than_anyone_wants_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"10,000 members at most: tasks x searches x seeds are 12,000"):
        members("tasks=[Walker-v0,Jumper-v0]", "searches=[ga,bo,random]", "seeds=2000")


def test_more_members_join_and_none_may_leave(quick: Callable) -> None:
    quick("seeds=1", "tasks=[Walker-v0]")
    (folder,) = Path("outputs/suite").iterdir()
    before = digests(folder)
    assert len(before) == 1
    quick("resume=latest", "seeds=2", "tasks=[Walker-v0,Jumper-v0]")
    assert states(folder) == ["done"] * 4
    assert digests(folder).items() >= before.items()
    for words, phrase in {
        "tasks=[Jumper-v0]": "tasks may only grow",
        "evaluations=9": "evaluations cannot change",
    }.items():
        quick("resume=latest", words, fails=phrase)
    assert states(folder) == ["done"] * 4


def test_a_member_that_fails_is_told_and_the_others_go_on(quick: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    calls, errors = [], {"Walker-v0": DivergenceError("it\n diverged"), "Thrower-v0": ValueError("a defect")}

    def fails(config: Any) -> Exception | None:
        calls.append(config.seed)
        return errors.get(config.task) if config.seed == 0 else None

    failing(monkeypatch, fails)
    last = quick(code=2).err.splitlines()[-1]
    (folder,) = Path("outputs/suite").iterdir()
    assert last.startswith("warpvox: 2 of 4 members failed, the first of them (Walker-v0, ga, seed 0) with:")
    assert states(folder) == ["failed", "done"] * 2
    assert [row["error"] for row in table(folder)] == ["it diverged", "", "ValueError: a defect", ""]
    # failed members are reported again, and run again only when asked for
    quick("resume=latest", code=2)
    assert len(calls) == 4
    errors.clear()
    quick("resume=latest", "retry=true")
    assert len(calls) == 6
    assert states(folder) == ["done"] * 4
    assert yaml.safe_load((folder / "config.yaml").read_text())["retry"] is False


def test_an_interrupt_saves_what_there_is(quick: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(config: Any) -> None:
        if (config.task, config.seed) == ("Thrower-v0", 0):
            signal.raise_signal(signal.SIGTERM)
            raise Terminated

    failing(monkeypatch, stop)
    outcome = quick(code=128 + signal.SIGTERM)
    (folder,) = Path("outputs/suite").iterdir()
    assert states(folder) == ["done", "waiting", "waiting", "waiting"]
    assert f"resume={folder}" in outcome.out
    monkeypatch.undo()


def test_a_full_disk_stops_a_suite_which_goes_on_when_there_is_room(quick: Callable, monkeypatch) -> None:
    full = [StorageError("x.pt cannot be written: no space is left.", OSError(errno.ENOSPC, ""))]
    failing(monkeypatch, lambda config: full[0] if full and config.task == "Thrower-v0" else None)
    quick(fails="x.pt cannot be written: no space is left.")
    (folder,) = Path("outputs/suite").iterdir()
    assert states(folder) == ["done", "waiting", "waiting", "waiting"]
    full.clear()
    quick("resume=latest")
    assert states(folder) == ["done"] * 4


def test_a_member_that_others_end_is_no_failure(quick: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    failing(monkeypatch, lambda config: Terminated() if (config.task, config.seed) == ("Thrower-v0", 0) else None)
    assert "1 of 4 members were asked to end" in quick(code=2).err
    (folder,) = Path("outputs/suite").iterdir()
    assert states(folder) == ["done", "done", "waiting", "done"]


def test_members_that_are_ended_while_their_winner_is_judged_judge_it_when_they_go_on(
    quick: Callable, monkeypatch
) -> None:
    judged = {"mean": 1.5, "low": 1.0, "high": 2.0, "episodes": 64, "seed": 1000}
    with monkeypatch.context() as patched:
        patched.setattr(search_run, "evaluate_winner", Mock(side_effect=Terminated()))
        quick(code=2)
    monkeypatch.setattr(search_run, "evaluate_winner", lambda *_: judged)
    quick("resume=latest")
    (folder,) = Path("outputs/suite").iterdir()
    assert [read_summary(folder / row["folder"]).get("fresh_seeds") for row in table(folder)] == [judged] * 4


def test_report_again(quick: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    quick("seeds=1", "tasks=[Walker-v0]")
    (folder,) = Path("outputs/suite").iterdir()
    before = (folder / CURVES).read_text()
    for file in (CURVES, "report.html"):
        (folder / file).unlink()
    quick(f"report={folder}")
    assert (folder / CURVES).read_text() == before
    assert "1 done" in (folder / "report.html").read_text()
    members = folder / MEMBERS
    members.write_text(members.read_text().replace(",done,", ",running,"))
    with claimed(folder):
        quick(f"report={folder}")
        assert "1 running" in (folder / "report.html").read_text()
    running, made = members.read_text(), benchmark.write_benchmark

    def late(*given: Any) -> Path:
        members.write_text(running.replace(",running,", ",done,"))
        return made(*given)

    with monkeypatch.context() as patch, claimed(folder):
        patch.setattr(benchmark, "write_benchmark", late)
        quick(f"report={folder}")  # which takes so long that the suite ends meanwhile, with a page of its own
    assert "1 done" in (folder / "report.html").read_text()
    members.write_text(running)
    quick(f"report={folder}")  # nobody is making it any more: it was killed
    assert "1 waiting" in (folder / "report.html").read_text()
    for damaged in ("task,search\nWalker-v0", running[:-40]):  # without columns; cut short in its last line
        members.write_text(damaged)
        quick(f"report={folder}", fails="members.csv cannot be read; suite resume=")
        assert (folder / CURVES).read_text() == before
    quick(f"resume={folder}")
    assert states(folder) == ["done"]


def test_a_suite_that_another_process_extended_meanwhile_loses_nothing(tmp_path: Path) -> None:
    words = tiny("suite", *SIZES)[1:]
    own, typed = suite.split(words)
    config = load("suite", own)
    stored = {**vars(config), "codesign": merged([], typed, "outputs")}
    known = [yaml.safe_dump({**stored, "seeds": seeds}) + "...\n" for seeds in (2, 3)]
    file = tmp_path / "config.yaml"
    file.write_text(known[0])
    resume = f"resume={tmp_path}"
    job = suite._prepare([], load("suite", [resume]), [resume], None)
    file.write_text(known[1])
    with pytest.raises(ConfigError, match="seeds may only grow when a suite is resumed; 2 would be left out"):
        suite.suite(job, Console())
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]
    assert file.read_text() == known[1]


def test_the_command_that_goes_on_names_the_code_of_the_suite(quick: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("own.py").write_text(
        "from dataclasses import replace\nfrom warpvox.envs.registry import get_task\n"
        "MINE = replace(get_task('Walker-v0'), id='Mine-v0')\n"
    )
    with monkeypatch.context() as patch:
        failing(patch, lambda settings: DivergenceError("it diverged"))
        outcome = quick("tasks=[Walker-v0,own.py:MINE]", "seeds=1", fails="seed 0) with: it diverged")
    (command,) = re.findall("go on: warpvox suite (.*)", outcome.out)
    quick(*shlex.split(command))


# ----------------------------------------------------------------------------------------------------- processes


@pytest.fixture
def pool() -> Iterator[LocalPool]:
    pool = LocalPool(act, 2)
    yield pool
    pool.close()


def ended(pool: LocalPool, count: int) -> dict[int, dict[str, Any]]:
    found: dict[int, dict[str, Any]] = {}
    while len(found) < count:
        found |= dict(pool.wait(60))
    return found


def test_a_process_that_dies_takes_no_other_with_it(pool: LocalPool, tmp_path: Path) -> None:
    for number, job in enumerate(("die", "work")):
        (tmp_path / job).mkdir()
        pool.begin(number, job, tmp_path / job)
    outcomes = ended(pool, 2)
    assert outcomes[1] == {"status": "done", "error": ""}
    assert (outcomes[0]["status"], "SIGKILL" in outcomes[0]["error"]) == ("failed", True)
    assert (tmp_path / "work" / LOG).read_text() == "this is work\n"
    (tmp_path / "wait").mkdir()
    pool.begin(2, "wait", tmp_path / "wait")
    deadline = time.monotonic() + 60
    while not (tmp_path / "wait" / LOG).exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    pool.stop()
    assert ended(pool, 1)[2]["status"] == "interrupted"


def test_a_process_that_is_asked_to_end_while_it_starts_has_not_failed(pool: LocalPool, tmp_path: Path) -> None:
    pool.begin(0, "work", tmp_path)
    pool._workers[0].process.terminate()  # as one of a group, before this process knows of it
    assert ended(pool, 1)[0]["status"] == "interrupted"


@pytest.mark.parametrize("job", ["early", "late"])
def test_a_process_that_is_asked_to_end_beside_the_work_has_not_failed(pool: LocalPool, tmp_path: Path, job) -> None:
    pool.begin(0, job, tmp_path)
    assert ended(pool, 1)[0] == {"status": "interrupted"}


@pytest.mark.slow
def test_a_suite_that_is_ended_again_and_again_comes_to_the_same_end(tmp_path: Path) -> None:
    words = tiny("suite", *SIZES, "training.iterations=30", "training.eval_interval=2", "workers=2", "name=x")
    line = [sys.executable, "-m", "warpvox"]
    for name in ("whole", "ended"):
        (tmp_path / name).mkdir()
    subprocess.run([*line, *words], cwd=tmp_path / "whole", check=True)
    place, folder = tmp_path / "ended", tmp_path / "ended" / "outputs" / "suite" / "x"
    for end in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT):
        began = time.time()
        with subprocess.Popen([*line, *(["suite", "resume=latest"] if folder.exists() else words)], cwd=place,
                              start_new_session=True) as process:  # fmt: skip
            while not any(log.stat().st_mtime > began for log in folder.glob(f"members/*/*/*/{LOG}")):
                assert process.poll() is None
                time.sleep(0.05)
            time.sleep(1)
            if end == signal.SIGINT:
                os.killpg(process.pid, end)  # as a terminal does it
            else:
                process.send_signal(end)
            assert process.wait(300) == (-end if end == signal.SIGKILL else 128 + end)
        assert ("running" in states(folder)) == (end == signal.SIGKILL)
        assert "failed" not in states(folder)
    subprocess.run([*line, "suite", "resume=latest"], cwd=place, check=True)
    assert states(folder) == ["done"] * 4
    whole = tmp_path / "whole" / "outputs" / "suite" / "x"
    assert digests(folder) == digests(whole)
    assert (folder / CURVES).read_text() == (whole / CURVES).read_text()


@pytest.mark.slow
def test_ray_makes_the_same_members(warpvox: Callable) -> None:
    pytest.importorskip("ray", reason="Ray is not installed")
    with parallel.turn("ray"):
        warpvox(*tiny("suite", *SIZES, "executor=ray", "workers=2", "name=ray"))
    warpvox(*tiny("suite", *SIZES, "workers=2", "name=here"))
    assert digests(Path("outputs/suite/ray")) == digests(Path("outputs/suite/here"))
