"""Every block of Python and YAML in the documentation works; a block that needs more than a clone is marked as text."""

from __future__ import annotations

from pathlib import Path

import pages
import pytest
import yaml

from pam_antagonist.rig import load_rig

PYTHON = [page for page in pages.PAGES if any(block.language == "python" for block in pages.blocks(page))]
YAML = [page for page in pages.PAGES if any(block.language == "yaml" for block in pages.blocks(page))]


@pytest.mark.parametrize("page", PYTHON, ids=pages.name)
@pytest.mark.filterwarnings("error")
def test_python(page: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "examples").symlink_to(pages.ROOT / "examples")
    code = tmp_path / "code.py"
    code.write_text("\n".join(block.text for block in pages.blocks(page) if block.language == "python"))
    for line in pages.printed(code, tmp_path, capsys).splitlines():
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
