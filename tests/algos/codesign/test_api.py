"""Design search from Python: from objects, with parts of one's own, and as the command makes it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from codesign_toys import Judge, ToySearch
from episodes import short_episodes
from fault_cases import digest
from refusals import refused
from tiny import tiny

import warpvox as wv
from warpvox.algos.archive import FILE, Archive
from warpvox.algos.candidate import START, Candidate, Outcome, Parents
from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.codesign.fitness.custom import Custom
from warpvox.algos.codesign.loop import LocalExecutor, Loop
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.listener import Listener
from warpvox.algos.search.base import RandomSearch
from warpvox.algos.settings import sim_of
from warpvox.cli.config import load
from warpvox.design_search import _without_names
from warpvox.types import Physics

SMALL = dict(shape=(3, 3), device="cpu", threads=1, progress=False)
TRAINING = {"envs": 8, "iterations": 1, "eval_interval": 1, "ppo": {"steps": 4, "hidden": [8], "epochs": 1}}
GA = dict(population=3, max_designs=5)


@pytest.fixture(scope="module", autouse=True)
def short_walks() -> Iterator[None]:
    with short_episodes("Walker-v0"):
        yield


class Ear(Listener):
    """Hears what happens."""

    def __init__(self) -> None:
        self.heard: list[str] = []

    def begun(self, run: Any) -> None:
        self.heard.append(f"begun {run.total}")

    def told(self, generation: int, fresh: bool) -> None:
        self.heard.append(f"told {generation}")

    def ended(self, summary: Mapping[str, Any]) -> None:
        self.heard.append(f"ended {summary.get('status')}")


@pytest.mark.usefixtures("narrow_packs")
def test_objects_make_the_search_that_the_command_makes(warpvox: Callable, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(7)
    state, threads, ear = torch.get_rng_state(), torch.get_num_threads(), Ear()
    found = wv.codesign(
        "Walker-v0", search=wv.GA(**GA), training=TRAINING, folder=None, listeners=[ear], seed=3, batch=2, **SMALL
    )
    assert not list(tmp_path.iterdir())
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.get_num_threads() == threads
    assert ear.heard[0] == "begun 5"
    assert ear.heard[-1] == "ended done"
    assert len(found.designs) == 5
    origin, fitness = found.best.candidate.origin, f"{found.best.fitness:.2f}"
    assert repr(found.best).startswith(f"Record(#{found.best.id}, 3x3, {origin}")
    assert repr(found.best).endswith(f", fitness {fitness})")
    assert np.array_equal(found.best.body, found.design)
    assert found.best.fitness == found.summary["best_fitness"] == found.curve["best"][-1]
    env = wv.make_vec("Walker-v0", found.best.candidate.body, 2, device="cpu")
    obs = env.reset()[0]
    assert torch.equal(found.best.policy(obs), found.policy(obs))
    assert found.policy(obs).shape == (2, env.num_actions)
    assert f"{found.best.fitness:.3f}" in found._repr_html_()
    assert len(wv.evaluate(found, episodes=1, device="cpu")) == 1
    warpvox(*tiny("codesign", "seed=3", "batch=2"))
    (folder,) = Path("outputs/codesign/Walker-v0").iterdir()
    assert digest(folder) == digest(found.folder)
    # nothing is left; the batch, which may have been a worker's share, is that of the archive
    again = wv.codesign(search=wv.GA(**GA), training=TRAINING, folder=folder, seed=3, **SMALL)
    assert (again.summary["evaluations"], digest(folder)) == (5, digest(found.folder))


def test_a_search_and_an_evaluation_of_ones_own(tmp_path: Path) -> None:
    task = "BidirectionalWalker-v0"  # draws at random: a winner with a policy would be judged again
    search = ToySearch()
    search.max_designs = []  # a name of its own, and no budget
    found = wv.codesign(task, search=search, fitness=Judge(), folder=tmp_path / "run", **SMALL)
    assert len(found.designs) == found.summary["evaluations"] > 20
    assert found.summary["search"] == "custom"
    with pytest.raises(wv.ConfigError):
        wv.codesign(task, start=[str(found.folder)], **SMALL)
    # the same by a loop of one's own
    with Archive.create(tmp_path / FILE, {}) as archive:
        Loop(ToySearch(), LocalExecutor(Judge()), archive, seed=0).run()
        known = {record.id: record.fitness for record in archive.records()}
    assert {record.id: known[record.id] for record in found.designs} == {one.id: one.fitness for one in found.designs}
    # budget, population, shape and seed are those of the search; a class of the same name goes on, wherever it lies
    Own, few = type("Own", (RandomSearch,), {}), wv.RandomDesigns(population=4, max_designs=8)
    how = dict(fitness=Judge(), folder=tmp_path / "own", start=["random:2:3x3"]) | SMALL
    del how["shape"]
    for module in ("__main__", "codesign_toys"):
        Own.__module__ = module
        again = wv.codesign(search=Own(few, (3, 3), seed=2), **how)
        assert (again.settings.shape, again.settings.seed) == ([3, 3], 2)
        assert sorted(one.id for one in again.designs if one.candidate.origin == START) == [0, 1]
        assert (again.settings.search.population, again.settings.search.max_designs) == (4, 8)
        assert again.settings.search.make == f"{module}:Own"
    for wrong, says in [
        ({"search": Own(few, (3, 4))}, "made with shape=[3, 4] and seed=0, asked for [3, 3] and 0"),
        ({"search": Own(few, (3, 3)), "seed": 1}, "and seed=0, asked for [3, 3] and 1"),
        ({"search": ToySearch(), "start": ["random:2:3x3"]}, "ToySearch has no start_with(bodies)"),
    ]:
        with refused(wv.ConfigError, says):
            wv.codesign(**{**SMALL, **wrong})


def test_who_has_heard_the_beginning_of_a_search_hears_its_end(tmp_path: Path, monkeypatch) -> None:
    class Deaf(Ear):
        def begun(self, run: Any) -> None:
            raise ValueError("deaf")

    def heard(error: type[BaseException], *others: Ear) -> list[str]:
        ears = [Ear(), *others]
        with pytest.raises(error):
            wv.codesign(search=ToySearch(), fitness=Judge(), folder=tmp_path / "run", listeners=ears, **SMALL)
        return [ear.heard[-1] if ear.heard else "" for ear in ears]

    assert heard(ValueError, Deaf(), Ear()) == ["ended failed", "", ""]
    for where, error, end in (
        ("evaluate_winner", KeyboardInterrupt, "ended interrupted"),
        ("Results.write", wv.StorageError, "ended None"),
    ):
        monkeypatch.setattr(f"warpvox.algos.codesign.run.{where}", Mock(side_effect=error("no")))
        assert heard(error) == [end]


OWN = '''
import numpy as np
from warpvox.algos.candidate import Outcome

class Actuators:
    """Fitness is the number of actuators."""

    def __init__(self, search, weight=1):
        self.weight, self.task = weight, search.task

    def evaluate(self, candidates, parents, report=None):
        return [Outcome(float(self.weight * np.isin(one.body, (3, 4)).sum()), steps=1) for one in candidates]
'''


@pytest.mark.usefixtures("narrow_packs")
def test_an_evaluation_in_a_file(warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(OWN)
    words = ["fitness=custom", "fitness.make=mine.py:Actuators", "fitness.settings={weight:2}"]
    warpvox(*tiny("codesign", *words))
    (folder,) = Path("outputs/codesign/Walker-v0").iterdir()
    with Archive.read(folder / FILE) as archive:
        for record in archive.records():
            assert record.fitness == 2 * np.isin(record.candidate.body, (3, 4)).sum()
    (folder / "summary.json").unlink()
    warpvox("codesign", f"resume={folder}", fails="imported only if you name it")
    warpvox("codesign", f"resume={folder}", "fitness.make=mine.py:Actuators")
    for wrong, says in [
        ("fitness.make=mine.py:Actuator", "Actuator"),
        ("fitness.make=null", "fitness=custom needs fitness.make"),
        ("fitness.settings={wait:2}", "does not take these settings"),
    ]:
        warpvox(*tiny("codesign", *words, wrong), fails=says)


@pytest.mark.parametrize("on_grid", [False, True])
def test_a_policy_for_voxels_of_an_evaluation_of_ones_own_is_played(on_grid: bool, tmp_path: Path) -> None:
    class Trains:
        """Each design gets a training of its own, by a network that sees voxels."""

        def evaluate(self, candidates: Sequence[Candidate], parents: Parents, report: Any = None) -> list[Outcome]:
            outcomes = []
            for one in candidates:
                place = tmp_path / "trained" / str(one.id)
                options = {"num_envs": 4, "max_iterations": 1, "eval_interval": 1, "ppo": wv.Ppo(steps=4, epochs=1)}
                how = {"device": "cpu", "threads": 1, "progress": False}
                body = one.body.tolist()
                bodies = {"designs": {"bodies": [body], "refresh": "none"}} if on_grid else {"design": body}
                run = wv.train(policy="grid", network={"width": 8}, folder=place, **bodies, **options, **how)
                content = load_checkpoint(place / "model_best.pt")
                best = run.summary["best_return"]
                outcomes.append(Outcome(best, steps=16, policy=content["actor_state_dict"], spec=content["policy"]))
            return outcomes

    search = wv.GA(population=2, max_designs=2, min_survivors=1)
    found = wv.codesign(search=search, fitness=Trains(), folder=tmp_path / "search", **SMALL)
    (row,) = wv.evaluate(found, episodes=1, device="cpu")
    assert row.mean == pytest.approx(found.best.fitness, abs=1e-6)


def test_a_type_error_within_an_evaluation_of_ones_own_is_not_taken_for_a_wrong_setting(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def make(search):\n    return 1 + 'a'\n")
    evaluation = Custom(make=wv.Code(f"{tmp_path / 'mine.py'}:make"))
    with pytest.raises(TypeError):
        evaluation.build(Codesign(), None)


def test_names_of_sets_are_those_of_the_command() -> None:
    for given, words in (
        ({"search": "auto", "task": "Walker-v0"}, ["search=auto"]),
        ({"search": "quick", "task": "Lifter-v0", "training": {"envs": 8}}, ["search=quick", "training.envs=8"]),
        ({"search": "paper", "task": "Lifter-v0"}, ["search=paper"]),
    ):
        commanded = load("codesign", [*words, f"task={given['task']}"])
        assert Codesign(**_without_names(given)) == Codesign.of(vars(commanded))


def test_physics_are_a_preset_by_name_or_constants() -> None:
    chosen = Physics.preset("paper", gravity=80.0)
    for given in (chosen, {"preset": "paper", "gravity": 80.0}):
        assert sim_of(Codesign(physics=given)).physics == chosen
    assert sim_of(Codesign(physics="paper")).physics == Physics.preset("paper")
