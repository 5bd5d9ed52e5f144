"""Every block of Python and YAML in the documentation works; a block that needs more than a clone is marked as text."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pages
import pytest
import yaml

from pam_antagonist.rig import load_rig

PYTHON = [page for page in pages.PAGES if any(block.language == "python" for block in pages.blocks(page))]
YAML = [page for page in pages.PAGES if any(block.language == "yaml" for block in pages.blocks(page))]


@pytest.mark.parametrize("page", PYTHON, ids=pages.name)
def test_python(page: Path, tmp_path: Path) -> None:
    (tmp_path / "examples").symlink_to(pages.ROOT / "examples")
    code = "\n".join(block.text for block in pages.blocks(page) if block.language == "python")
    environment = {**os.environ, "PYTHONPATH": f"{pages.ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True,
        check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, f"{pages.name(page)}\n{done.stderr}"
    for line in done.stdout.splitlines():
        assert line in pages.read(page), f"{pages.name(page)} does not show what its code prints: {line}"


@pytest.mark.parametrize("page", YAML, ids=pages.name)
def test_yaml(page: Path, tmp_path: Path) -> None:
    for block in pages.blocks(page):
        content = yaml.safe_load(block.text) if block.language == "yaml" else None
        if content is None or "model:" not in block.text and "effects:" not in block.text:
            continue
        rig = tmp_path / "rig.yaml"
        rig.write_text(yaml.safe_dump({"based_on": "shin2022", **content}), encoding="utf-8")
        load_rig(rig, regulators=True)
