"""The documentation as a whole: every link leads somewhere, every command is described, pictures stay small."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import key_tables
import pytest
from page_order import PARTS

import warpvox
from warpvox.algos.robots import zoo_tasks
from warpvox.configs.schema import COMMANDS as WITH_KEYS
from warpvox.envs.registry import task_ids

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
MEGABYTES = 5  # of which up to 3 are the animation of the zoo
"""Of all pictures together: everybody who clones the repository gets them."""


WORDS, ALL_WORDS, PAGES = 1500, 17_000, 22
"""Words of a page, words of all and number of pages at most; those that are made from tables do not count."""
MADE = {"commands", "figures", "results"}
ENTRIES = 8
"""Pages of the part How to at most: what the left column shows at a glance."""


def own_pages() -> list[Path]:
    return [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


@pytest.mark.parametrize("page", own_pages(), ids=lambda path: str(path.relative_to(ROOT)))
def test_links_to_files_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in LINK.findall(text):
        if not re.match(r"[a-z]+:|#", target):
            assert (page.parent / target.split("#")[0]).exists(), f"{page.name}: {target}"


def test_pages_are_few_and_short() -> None:
    pages = {page.stem: page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md")}
    words = {name: len(text.split()) for name, text in pages.items() if name not in MADE}
    assert len(words) <= PAGES
    assert max(words.values()) <= WORDS
    assert sum(words.values()) <= ALL_WORDS
    without = {name for name, text in pages.items() if not re.match(r"# .+\?\n", text)}
    assert without == {"index", "faq"}, "the title of a page is its question"


def test_every_page_is_named_in_the_left_column() -> None:
    named = [name for pages in PARTS.values() for name in pages]
    assert sorted([*named, "index"]) == sorted(page.stem for page in (ROOT / "docs").glob("*.md"))
    assert len(PARTS["How to"]) <= ENTRIES


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


def test_no_table_is_cut(site: Path, open_page) -> None:
    cut = "[...document.querySelectorAll('.md-typeset__scrollwrap')].some(e => e.scrollWidth > e.clientWidth + 1)"
    pages = [page for page in sorted(site.rglob("*.html")) if page.parent.name not in ("api", "tasks")]
    for path in [*pages, site / "api" / "index.html", site / "tasks" / "UpStepper-v0.html"]:
        page = open_page(path.as_uri(), size=(1400, 900))
        assert not page.evaluate(cut), path
