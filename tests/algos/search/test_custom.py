"""Searches of the user, and the examples of docs/search.md, which have to work as they stand."""

import re
from pathlib import Path

import numpy as np
import pytest

from warpvox.algos.search import BaseSearch, CustomSearch, Proposal, make_search, settings_from
from warpvox.code import Code
from warpvox.errors import ConfigError, SearchError


@pytest.fixture(scope="module")
def examples(repository: Path) -> list[str]:
    text = (repository / "docs" / "search.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


@pytest.fixture
def mine(examples: list[str], tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(examples[-1], encoding="utf-8")
    return path


def test_the_documentation_names_every_search(repository: Path) -> None:
    text = (repository / "docs" / "search.md").read_text(encoding="utf-8")
    for file in (repository / "configs" / "search").glob("*.yaml"):
        assert f"`{file.stem}`" in text, file


def test_a_file_with_a_search(mine: Path) -> None:
    settings = CustomSearch(make=Code(f"{mine}:BestAndMutants"), population=10, max_evaluations=40)
    search = make_search(settings, (4, 5), seed=3)
    assert isinstance(search, BaseSearch)
    while asked := search.ask():
        assert [candidate.origin for candidate in asked].count("mutation") == (5 if asked[0].generation else 0)
        search.tell([float((candidate.body == 3).sum()) for candidate in asked])
    assert len({body.tobytes() for body in search.bodies}) == 40
    assert {body.shape for body in search.bodies} == {(4, 5)}


def test_a_module_with_a_search() -> None:
    settings = CustomSearch(make=Code("warpvox.algos.search.base:RandomSearch"), population=4, max_evaluations=4)
    custom, own = (make_search(s, seed=1) for s in (settings, settings_from({"algorithm": "random", "population": 4})))
    assert np.array_equal(custom.ask()[0].body, own.ask()[0].body)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (None, "'custom' needs make=FILE.py:NAME"),
        ("nowhere.py:Mine", "no file nowhere.py"),
        ("no.such.module:Mine", "no module 'no.such.module'"),
        ("mine.py:BestAndMutant", r"'BestAndMutant' does not exist in mine\.py\. Did you mean 'BestAndMutants'\?"),
    ],
)
def test_mistakes(mine: Path, monkeypatch: pytest.MonkeyPatch, make: str | None, words: str) -> None:
    monkeypatch.chdir(mine.parent)
    with pytest.raises(ConfigError, match=words):
        make_search(CustomSearch(make=make and Code(make)))


def test_what_does_not_ask_is_no_search(tmp_path: Path) -> None:
    path = tmp_path / "half.py"
    path.write_text(
        "class Half:\n    def __init__(self, *args): pass\n    def ask(self): return []\n", encoding="utf-8"
    )
    with pytest.raises(ConfigError, match="makes a Half, which cannot tell, replay"):
        make_search(CustomSearch(make=Code(f"{path}:Half")))


def test_an_error_within_the_module_is_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "lacking.py").write_text("import not_there_at_all\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"ModuleNotFoundError: .*not_there_at_all"):
        make_search(CustomSearch(make=Code("lacking:Mine")))


class Careless(BaseSearch):
    """Proposes whatever it was given."""

    def __init__(self, proposals: list) -> None:
        super().__init__(CustomSearch(make="here:Careless", population=4, max_evaluations=8))
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
        ([Proposal(cut)], r"proposed a body that is not valid\. The body is not connected"),
        ([Proposal(good[:4])], r"proposed a body of shape \(4, 5\)"),
        ([Proposal(good), Proposal(good)], "proposed a body twice"),
        ([Proposal(good, parents=(3,))], "parents"),
    ):
        with pytest.raises(SearchError, match=words):
            Careless(proposals).ask()
