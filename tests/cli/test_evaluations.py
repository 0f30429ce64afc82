"""Design searches with each evaluation, from end to end."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from episodes import short_episodes
from tiny import tiny

from warpvox.algos.archive import FILE, Archive, Record
from warpvox.algos.candidate import FINALIST, START, Candidate, Outcome
from warpvox.algos.codesign.robots import read_start, robots_of
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.robots import judge, save_robot
from warpvox.algos.training.bodies import draw_bodies
from warpvox.cli.config import load
from warpvox.design import example_design, load_design, save_design
from warpvox.runs import read_summary

pytestmark = pytest.mark.usefixtures("narrow_packs")
OF = {
    "specialist": [],
    "gaits": ["fitness.finalists=2"],
}
ROUNDING = 1e-6
ROUNDS = "fitness.final_passes=0"  # finalists of fitness=gaits have rounds alone


def tiny_search(*words: str) -> list[str]:
    """A search with the usual sizes of its fitness."""
    fitness = dict(word.split("=", 1) for word in words).get("fitness", "specialist")
    return tiny("codesign", *OF[fitness], *words)


def search(warpvox: Callable, *words: str) -> Path:
    before = set(Path("outputs").glob("codesign/*/*"))
    outcome = warpvox(*tiny_search(*words))
    assert "generation 0: 3 designs to evaluate" in outcome.out
    (folder,) = set(Path("outputs").glob("codesign/*/*")) - before
    return folder


def settings(*words: str) -> Codesign:
    return Codesign.of(vars(load("codesign", list(words))))


def records_of(folder: Path) -> list[Record]:
    with Archive.read(folder / FILE) as archive:
        return archive.records()


def played(warpvox: Callable, run: Path | str, episodes: int = 2) -> float:
    before = set(Path("outputs").glob("play/*/*"))
    warpvox("play", f"run={run}", f"num_envs={episodes}", "export=[]", "device=cpu")
    (folder,) = set(Path("outputs").glob("play/*/*")) - before
    return read_summary(folder)["mean_return"]


def test_a_search_by_gaits(warpvox: Callable) -> None:
    folder = search(warpvox, "fitness=gaits", "fitness.gaits=8", "fitness.rounds=1", ROUNDS, "fitness.final_rounds=2")
    records, figures = records_of(folder), read_summary(folder)
    assert [record.candidate.origin == FINALIST for record in records] == [False] * 5 + [True] * 2
    assert figures["screened_fitness"] == max(record.fitness for record in records[:5])
    for record in records[5:]:
        (parent,) = record.candidate.parents
        assert record.fitness >= records[parent].fitness  # its gait is the first that is tried
        assert record.steps == 2 * 8 * 50 + 8 * 4
    # both kinds of policies are played
    for record in records[0], max(records[5:], key=lambda one: one.fitness):
        assert played(warpvox, folder / "designs" / str(record.id)) == pytest.approx(record.fitness, abs=ROUNDING)
    warpvox("play", f"run={folder}/designs/0", "stochastic=true", "export=[]", "device=cpu", fails="open-loop gait")
    warpvox("export", f"run={folder}/designs/0", "format=[jit]")


def test_designs_of_a_random_task_play_the_same_episodes_which_play_repeats(warpvox: Callable) -> None:
    words = f"fitness=gaits fitness.gaits=4 fitness.rounds=2 fitness.final_rounds=1 {ROUNDS}"
    with short_episodes("BidirectionalWalker-v0"):
        warpvox(*tiny_search("task=BidirectionalWalker-v0", "seed=3", *words.split()))
        (folder,) = Path("outputs/codesign/BidirectionalWalker-v0").iterdir()
        for record in records_of(folder)[1::5]:  # one that is compared, one that is trained
            run = folder / "designs" / str(record.id)
            config = yaml.safe_load((run / "config.yaml").read_text())
            assert config["seed"] == 3
            assert played(warpvox, run, config["episodes"]) == pytest.approx(record.fitness, abs=ROUNDING)


def test_a_search_that_starts_with_a_known_robot(warpvox: Callable) -> None:
    gaits = "fitness=gaits fitness.gaits=8 fitness.rounds=1 fitness.final_rounds=2 dtype=float64".split()
    first = search(warpvox, *gaits, ROUNDS)
    (robot,) = robots_of(first)
    bodies = {record.candidate.body.tobytes() for record in records_of(first) if record.policy_file is not None}
    assert len(robots_of(first, top=99)) == len(bodies)  # of a finalist and the design that it was: the better one
    file = save_robot("mine/Walker-v0.npz", robot)
    value = judge(robot).mean_return
    passes = "fitness.passes=1", "fitness.beam=8", "fitness.final_passes=1", "fitness.final_beam=16"
    folder = search(warpvox, *gaits, *passes, f"start=[zoo:{file}]", "fitness.stages=6", "seed=1", "name=on")
    records = records_of(folder)
    assert [record.candidate.origin for record in records[:3]] == [START, "random", "random"]
    assert (records[0].candidate.body == robot.body).all()
    assert records[0].fitness >= value - ROUNDING
    file.unlink()  # the search has a copy
    (folder / "summary.json").unlink()
    warpvox("codesign", f"resume={folder}")
    (better,) = robots_of(folder)
    assert judge(better).mean_return >= value
    save_robot(file, better)
    # a design of a search, which need not be its best
    words = f"start=[{folder}/designs/{records[1].id},{first}]", "fitness.stages=6", "search.max_designs=3"
    again = search(warpvox, *gaits, ROUNDS, *words, "name=again")
    known = records_of(again)[:2]
    assert [record.candidate.origin for record in known] == [START] * 2
    assert (known[0].candidate.body == records[1].candidate.body).all()
    assert known[0].fitness >= records[1].fitness - ROUNDING
    assert (known[1].candidate.body == robot.body).all()
    (design,) = robots_of(again / "designs" / "0")
    assert (design.body == known[0].candidate.body).all()
    # with trainings a body is one like any other
    folder = search(warpvox, f"start=[zoo:{file}]", "search.max_designs=3", "name=trained")
    assert records_of(folder)[0].candidate.origin == START


def test_a_search_that_starts_with_many_bodies(warpvox: Callable, tmp_path: Path) -> None:
    folder = search(warpvox, "start=[random:3:3x3]", "search.max_designs=3", "seed=5")
    records = records_of(folder)
    drawn = draw_bodies(3, (3, 3), np.random.default_rng(5))  # as for `warpvox evaluate designs=random:3:3x3 seed=5`
    assert [record.candidate.origin for record in records] == [START] * 3
    assert all(np.array_equal(record.candidate.body, body) for record, body in zip(records, drawn, strict=True))
    (folder / "training" / "start" / "0 copy.npz").write_bytes(b"somebody's")
    kept = read_start(settings(), folder)
    assert all(np.array_equal(robot.body, body) for robot, body in zip(kept, drawn, strict=True))
    for number, body in enumerate(drawn[::-1]):
        save_design(tmp_path / "robots" / f"{number}.json", body)
    bodies = [robot.body for robot in read_start(settings(f"start=[{tmp_path / 'robots'},walker]"))]
    assert all(np.array_equal(*pair) for pair in zip(bodies, [*drawn[::-1], load_design("walker")], strict=True))


@pytest.mark.parametrize(
    ("words", "count"),
    [
        ("", 1),
        ("task=Catcher-v0", 4),
        ("protocol=noise", 4),
        ("protocol=noise fitness.episodes=6", 6),
        ("protocol=noise training.episodes=2", 2),
    ],
)
def test_a_training_is_compared_with_a_gait_by_as_many_episodes(words: str, count: int) -> None:
    job = settings(*tiny_search("fitness=gaits", *words.split())[1:])
    training = job.fitness.build(job, {}).training
    assert training.factory.episodes(training.settings.episodes) == count
    finalist = Candidate(0, example_design("walker"), (), FINALIST)
    assert job.fitness.run_of(job, finalist, Outcome(1.0))["episodes"] == count
