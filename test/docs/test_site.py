"""The site builds strictly, where its tools are installed (``pip install .[docs]``)."""

from __future__ import annotations

import os
import pkgutil
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pages
import pytest

ROOT = pages.ROOT
DOCS = ROOT / "docs"


def test_every_page_is_in_the_navigation() -> None:
    navigation = runpy.run_path(str(DOCS / "conf.py"))["NAVIGATION"]
    listed = [f"{page}.md" for part in navigation.values() for page in part]
    there = [page.relative_to(DOCS).as_posix() for page in pages.PAGES if DOCS in page.parents]
    assert sorted([*listed, "index.md"]) == sorted(there)


def test_every_name_of_the_python_api_exists() -> None:
    names = re.findall(r"^\.\. auto\w+:: ([\w.]+)$", pages.read(DOCS / "reference" / "api.md"), re.MULTILINE)
    assert len(names) > 20
    for name in names:
        pkgutil.resolve_name(name)


@pytest.mark.slow
def test_it_builds_strictly(tmp_path: Path) -> None:
    for name in ("sphinx", "furo", "myst_parser", "latex2mathml"):
        pytest.importorskip(name, reason="the extra [docs] is not installed")
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(DOCS), str(tmp_path / "site")],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    model = (tmp_path / "site" / "explanation" / "model.html").read_text(encoding="utf-8")
    assert "<math" in model and "\\dot" not in model, "equations are MathML"
    assert "flow.py" in {path.name for path in (tmp_path / "site" / "_downloads").rglob("*.py")}, "sources are there"
    first = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert not re.findall(r'<(?:script|link)[^>]+(?:src|href)="https?:', first), "nothing is loaded from other hosts"
