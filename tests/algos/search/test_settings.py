"""Settings: the paper's values, the choices of the command line, and mistakes."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.search import (
    ALGORITHMS,
    BO,
    GA,
    BaseSearch,
    CppnNeat,
    CustomSearch,
    MapElites,
    Proposal,
    make_search,
)
from warpvox.cli.config import load
from warpvox.code import Code
from warpvox.errors import ConfigError, SearchError


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        (["search=paper"], GA(population=25, max_designs=250)),
        (["search=bo_paper"], BO(acquisition="paper")),
        (["search=bo_lbfgs"], BO(acquisition="lbfgs")),
        (["preset=paper", "search=cppn_neat", "search.max_designs=750"], CppnNeat(max_designs=750)),
    ],
)
@pytest.mark.parametrize(("task", "shape"), [("Walker-v0", [5, 5]), ("Lifter-v0", [5, 7])])
def test_the_papers_searches_have_its_settings_shape_and_training(words, settings, task: str, shape: list[int]) -> None:
    """Tables 2 to 6: an algorithm of the paper is named, and nothing of it need be said besides."""
    config = load("codesign", [*words, f"task={task}"])
    assert config.search == settings
    assert config.shape == shape
    assert config.training == load("codesign", ["training=paper"]).training


@pytest.mark.parametrize("algorithm", [name for name in ALGORITHMS if name != "custom"])
def test_defaults_are_those_of_table_2(algorithm: str) -> None:
    settings = ALGORITHMS[algorithm]()
    assert (settings.population, settings.max_designs) == (25, 250)


def test_ga_defaults_are_those_of_table_3() -> None:
    settings = GA()
    assert settings.mutation_rate == 0.10
    assert (settings.final_survivor_rate, settings.survivor_rate) == (0.0, 0.6)
    assert settings.min_survivors == 2


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "None"),
        ({"algorithm": "random", "mutation_rate": 0.2}, "'mutation_rate'"),
        ({"algorithm": "ga", "population": 2.5}, "population must be an integer, got 2.5"),
        ({"algorithm": "ga", "survivor_rate": float("nan")}, "survivor_rate must be a finite number"),
        (
            {"algorithm": "ga", "population": 5, "min_survivors": 5},
            "search.min_survivors must be less than search.population (5)",
        ),
    ],
)
def test_mistakes_are_told_in_words(given: dict[str, Any], words: str) -> None:
    with refused(ConfigError, words):
        Codesign(search=given)


@pytest.mark.parametrize("settings", [{"algorithm": "ga"}, GA])
def test_settings_of_no_search_are_refused(settings: Any) -> None:
    with refused(ConfigError, f"no search for the settings {settings!r}"):
        make_search(settings)


def test_without_pyribs_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "warpvox.algos.search.map_elites", raising=False)
    monkeypatch.setitem(sys.modules, "ribs.archives", None)
    with refused(ConfigError, "map_elites needs the package ribs: pip install 'warpvox[search]'"):
        make_search(MapElites())


def test_settings_alone_load_no_library(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom warpvox.algos.search import ALGORITHMS, RandomDesigns, make_search\n"
        "make_search(RandomDesigns()).ask()\n"
        "print(*{'torch', 'botorch', 'gpytorch', 'neat', 'ribs', 'scipy'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert (run.stderr, run.stdout) == ("", "\n")


@pytest.fixture
def mine(repository: Path, tmp_path: Path) -> Path:
    page = (repository / "docs" / "own_search.md").read_text(encoding="utf-8")
    path = tmp_path / "mine.py"
    path.write_text(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], encoding="utf-8")
    return path


def test_a_file_with_a_search(mine: Path) -> None:
    settings = CustomSearch(make=Code(f"{mine}:BestAndMutants"), population=10, max_designs=40)
    search = make_search(settings, (4, 5), seed=3)
    assert isinstance(search, BaseSearch)
    while asked := search.ask():
        assert [candidate.origin for candidate in asked].count("mutation") == (5 if asked[0].generation else 0)
        search.tell([float((candidate.body == 3).sum()) for candidate in asked])
    assert len({body.tobytes() for body in search.bodies}) == 40
    assert {body.shape for body in search.bodies} == {(4, 5)}


def test_what_does_not_ask_is_no_search(tmp_path: Path) -> None:
    path = tmp_path / "half.py"
    path.write_text(
        "class Half:\n    def __init__(self, *args): pass\n    def ask(self): return []\n", encoding="utf-8"
    )
    with pytest.raises(ConfigError):
        make_search(CustomSearch(make=None))
    with refused(ConfigError, "makes a Half, which cannot tell, replay"):
        make_search(CustomSearch(make=Code(f"{path}:Half")))


class Careless(BaseSearch):
    """Proposes whatever it was given."""

    def __init__(self, proposals: list) -> None:
        super().__init__(CustomSearch(make="here:Careless", population=4, max_designs=8))
        self.proposals = proposals

    def propose(self, rng: np.random.Generator, count: int) -> list:
        return self.proposals


def test_a_careless_search_is_told_what_is_wrong() -> None:
    good = np.full((5, 5), 3, np.int8)
    cut = good.copy()
    cut[2] = 0
    for proposals, words in (
        ([], "proposed no body"),
        ([Proposal(good)] * 5, "proposed 5 bodies where 4 were wanted"),
        ([Proposal(cut)], "The body is not connected"),
        ([Proposal(good[:4])], "proposed a body of shape (4, 5)"),
        ([Proposal(good), Proposal(good)], "proposed a body twice"),
        ([Proposal(good, parents=(3,))], "parents"),
    ):
        with refused(SearchError, words):
            Careless(proposals).ask()


def test_what_was_proposed_is_known_though_nobody_claimed_it() -> None:
    body = np.full((5, 5), 3, np.int8)
    search = Careless([Proposal(body)])
    search.ask()
    assert not search.claim(body)
