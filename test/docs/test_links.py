"""Every link of the documentation leads somewhere."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote

import pages
import pytest

ROOT = pages.ROOT
DOCS = {ROOT / "docs"}
TEXTS = (
    path
    for folder in ("pam_antagonist", "test", "config", "launch", "examples")
    for path in (ROOT / folder).rglob("*")
    if path.suffix in {".py", ".yaml", ".xml", ".j2"}
)


@pytest.mark.parametrize("page", pages.PAGES, ids=pages.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in pages.links(page):
        path, _, anchor = target.partition("#")
        file = (page.parent / unquote(path)).resolve() if path else page
        assert file.is_file() or not DOCS & set(page.parents), f"{pages.name(page)}: {target}: no such file"
        assert file.exists(), f"{pages.name(page)}: {target}: no such file"
        if DOCS & set(page.parents) and file.suffix == ".md":
            assert DOCS & set(file.parents), f"{pages.name(page)}: {target}: the site has no such page"
        if anchor and file.suffix == ".md":
            assert unquote(anchor) in pages.anchors(file), f"{pages.name(page)}: {target}: no such heading"


def test_pages_that_the_code_names_exist() -> None:
    for path in (*TEXTS, ROOT / "run", ROOT / "CHANGELOG.md"):
        for page in re.findall(r"\bdocs/[\w/-]+\.md\b", path.read_text(encoding="utf-8")):
            assert (ROOT / page).is_file(), f"{pages.name(path)} names {page}"


def test_every_page_can_be_reached_from_the_first() -> None:
    seen, todo = set(), [ROOT / "docs" / "index.md"]
    while todo:
        page = todo.pop()
        if page in seen:
            continue
        seen.add(page)
        todo += [
            (page.parent / target.partition("#")[0]).resolve()
            for target in pages.links(page)
            if target.partition("#")[0].endswith(".md")
        ]
    missing = {pages.name(page) for page in pages.PAGES} - {pages.name(page) for page in seen if page.exists()}
    assert not missing - {"README.md", "CONTRIBUTING.md", "CHANGELOG.md", "examples/README.md"}
