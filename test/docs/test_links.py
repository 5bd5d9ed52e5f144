"""Every link of the documentation leads somewhere, and the site builds strictly where its tools are installed."""

from __future__ import annotations

import os
import pkgutil
import re
import runpy
import subprocess
import sys
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


PLACE = ROOT / "docs"


def test_every_page_is_in_the_navigation() -> None:
    navigation = runpy.run_path(str(PLACE / "conf.py"))["NAVIGATION"]
    listed = [f"{page}.md" for part in navigation.values() for page in part]
    there = [page.relative_to(PLACE).as_posix() for page in pages.PAGES if PLACE in page.parents]
    assert sorted([*listed, "index.md"]) == sorted(there)


def test_every_name_of_the_python_api_exists() -> None:
    names = re.findall(r"^\.\. auto\w+:: ([\w.]+)$", pages.read(PLACE / "reference" / "api.md"), re.MULTILINE)
    assert len(names) > 20
    for name in names:
        pkgutil.resolve_name(name)


@pytest.mark.slow
def test_it_builds_strictly(tmp_path: Path) -> None:
    for name in ("sphinx", "furo", "myst_parser", "latex2mathml"):
        pytest.importorskip(name, reason="the extra [docs] is not installed")
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(PLACE), str(tmp_path / "site")],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    model = (tmp_path / "site" / "explanation" / "model.html").read_text(encoding="utf-8")
    assert "<math" in model and "\\dot" not in model, "equations are MathML"
    assert "flow.py" in {path.name for path in (tmp_path / "site" / "_downloads").rglob("*.py")}, "sources are there"
    first = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert not re.findall(r'<(?:script|link)[^>]+(?:src|href)="https?:', first), "nothing is loaded from other hosts"
