"""The documentation as a whole: every link leads somewhere, every command is described, pictures stay small."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import key_tables
import pytest

import warpvox
from warpvox.configs.schema import COMMANDS as WITH_KEYS
from warpvox.envs.registry import task_ids
from warpvox.robots import zoo_tasks

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
MEGABYTES = 5  # of which up to 3 are the animation of the zoo
"""Of all pictures together: everybody who clones the repository gets them."""


def own_pages() -> list[Path]:
    return [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


@pytest.mark.parametrize("page", own_pages(), ids=lambda path: str(path.relative_to(ROOT)))
def test_links_to_files_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in LINK.findall(text):
        if not re.match(r"[a-z]+:|#", target):
            assert (page.parent / target.split("#")[0]).exists(), f"{page.name}: {target}"


def test_every_picture_is_used_and_all_are_small() -> None:
    folder = ROOT / "docs" / "images"
    pictures = [path for path in folder.rglob("*") if path.is_file()]
    texts = "\n".join(page.read_text(encoding="utf-8") for page in own_pages())
    shown = {f"tasks/{task}.webp" for task in zoo_tasks()}  # by pages that the site makes
    names = {path.relative_to(folder).as_posix() for path in pictures}
    assert shown <= names
    assert not [name for name in names - shown if f"images/{name}" not in texts]
    assert sum(picture.stat().st_size for picture in pictures) < MEGABYTES * 1e6


@pytest.mark.parametrize("page", key_tables.pages(), ids=lambda path: path.name)
def test_the_tables_of_keys_are_current(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert key_tables.with_tables(text) == text, "the keys of a command have changed: run `make tables`"


@pytest.fixture
def site() -> Path:
    """The built site."""
    if (folder := os.environ.get("WARPVOX_SITE")) is None:
        pytest.skip("`make docs` builds it and runs this")
    return ROOT / folder


def test_the_site_has_commands_tasks_and_public_names(site: Path) -> None:
    page = (site / "commands.html").read_text(encoding="utf-8")
    for name in WITH_KEYS:
        assert f'<h2 id="{name}"' in page
        assert f"usage: warpvox {name}" in page
    assert "<!-- help" not in page
    assert not list(site.rglob("*.py"))
    addresses = set(re.findall(r'(?:src|href)="(https?://[^"]+)"', page))
    known = ("https://squidfunk.github.io", "https://warpvox.github.io/warpvox/", "https://github.com/warpvox/warpvox")
    assert not [address for address in addresses if not address.startswith(known)]
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    headings = {entry["title"].split("<")[0].strip() for entry in index["docs"]}
    assert not set(warpvox.__all__) - headings, "the reference of the Python interface lacks public names"
    settings = (site / "api" / "design_search.html").read_text(encoding="utf-8")
    assert "key(" not in settings, "signatures have values, not the calls that hold them"
    assert "rows and columns of the bodies; in the paper" in settings
    in_sentences = [entry["location"] for entry in index["docs"] if re.search(r"\. \w+Error: ", entry["text"])]
    assert not in_sentences, "list these errors under Raises"
    for task in task_ids():
        assert "<h2" in (site / "tasks" / f"{task}.html").read_text(encoding="utf-8")


def test_the_site_is_searched_from_disk(site: Path, open_page, wait_for: Callable[..., None]) -> None:
    page = open_page((site / "index.html").as_uri())
    page.click("[data-md-component=search-query]")
    page.keyboard.type("load_policy")
    wait_for(page, "[...document.querySelectorAll('.md-search-result h2')].some(h => h.innerText == 'load_policy')")
    assert not page.problems
