"""The documentation as a whole: every link leads somewhere, every command is described, pictures stay small."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from dataclasses import is_dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest

from warpvox.cli.help import flat_keys
from warpvox.configs.schema import COMMANDS as SCHEMAS

ROOT = Path(__file__).resolve().parents[2]
SPEC = importlib.util.spec_from_file_location("key_tables", ROOT / "docs" / "key_tables.py")
key_tables = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(key_tables)
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
    pictures = list((ROOT / "docs" / "images").iterdir())
    texts = "\n".join(page.read_text(encoding="utf-8") for page in own_pages())
    assert not [picture.name for picture in pictures if f"images/{picture.name}" not in texts]
    assert sum(picture.stat().st_size for picture in pictures) < MEGABYTES * 1e6


@pytest.mark.parametrize("page", key_tables.pages(), ids=lambda path: path.name)
def test_the_tables_of_keys_are_current(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert key_tables.with_tables(text) == text, "the keys of a command have changed: run `make tables`"


def test_every_key_is_in_the_repository() -> None:
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for command, schema in SCHEMAS.items():
        section = text.split(f"\n## {command}\n")[1].split("\n## ")[0]
        for name, key in flat_keys(schema):
            assert is_dataclass(key.default) or f"| `{name}` |" in section, f"{command} {name}"


@pytest.mark.skipif(find_spec("mkdocs") is None or find_spec("material") is None, reason="the extra docs is missing")
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    page = (tmp_path / "site" / "commands" / "index.html").read_text(encoding="utf-8")
    for name in SCHEMAS:
        assert f'<h2 id="{name}"' in page
        assert f"usage: warpvox {name}" in page
    assert "<!-- help" not in page
    assert not list((tmp_path / "site").rglob("*.py"))
    addresses = set(re.findall(r'(?:src|href)="(https?://[^"]+)"', page))
    assert not [address for address in addresses if not address.startswith("https://squidfunk.github.io")]
