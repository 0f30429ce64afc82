"""Settings: the paper's values, the choices of the command line, and mistakes."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from warpvox.algos.search import ALGORITHMS, BO, GA, CppnNeat, MapElites, RandomDesigns, make_search, settings_from
from warpvox.cli.config import load
from warpvox.errors import ConfigError


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        (["search=paper"], GA(population=25, max_evaluations=250)),
        (["search=bo_paper"], BO(acquisition="paper")),
        (["search=bo_lbfgs"], BO(acquisition="lbfgs")),
        (["preset=paper", "search=cppn_neat", "search.max_evaluations=750"], CppnNeat(max_evaluations=750)),
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
    assert (settings.population, settings.max_evaluations) == (25, 250)


def test_ga_defaults_are_those_of_table_3() -> None:
    settings = GA()
    assert settings.mutation_rate == 0.10
    assert (settings.final_survivor_rate, settings.survivor_rate) == (0.0, 0.6)
    assert settings.min_survivors == 2


def test_none_stands_for_the_default() -> None:
    assert settings_from({"algorithm": "ga", "population": None}) == GA()
    assert settings_from({"algorithm": "random", "population": 7}) == RandomDesigns(population=7)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "one of ga, .*None"),
        ({"algorithm": "random", "mutation_rate": 0.2}, "'random' has no setting 'mutation_rate'.*a setting of ga"),
        ({"algorithm": "ga", "population": 2.5}, "population must be an integer, got 2.5"),
        ({"algorithm": "ga", "max_evaluations": 0}, "max_evaluations must be at least 1"),
        ({"algorithm": "ga", "mutation_rate": 0.0}, "mutation_rate must be greater than 0"),
        ({"algorithm": "ga", "survivor_rate": float("nan")}, "survivor_rate must be a finite number"),
        ({"algorithm": "ga", "population": 5, "min_survivors": 5}, r"min_survivors must be less than population \(5\)"),
    ],
)
def test_mistakes_are_told_in_words(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        settings_from(given)


def test_settings_of_no_search_are_refused() -> None:
    with pytest.raises(ConfigError, match="no search for settings of type dict"):
        make_search({"algorithm": "ga"})  # type: ignore[arg-type]


def test_without_pyribs_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "warpvox.algos.search.map_elites", raising=False)
    monkeypatch.setitem(sys.modules, "ribs.archives", None)
    with pytest.raises(ConfigError, match=r"map_elites needs the package ribs: pip install 'warpvox\[search\]'"):
        make_search(MapElites())


def test_settings_alone_load_no_library(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom warpvox.algos.search import ALGORITHMS, RandomDesigns, make_search\n"
        "make_search(RandomDesigns()).ask()\n"
        "print(*{'torch', 'botorch', 'gpytorch', 'neat', 'ribs', 'scipy'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert (run.stderr, run.stdout) == ("", "\n")
