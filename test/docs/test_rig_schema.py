"""The JSON schema of rig files is that of the code, and fits the rigs of the package."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pages
import pydantic
import pytest

from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig.learned import LAWS

ROOT = pages.ROOT
SCHEMA = ROOT / "config" / "rig.schema.json"
RIGS = sorted((ROOT / "config" / "rigs").glob("*.yaml"))


@pytest.mark.skipif(pydantic.VERSION.startswith("1."), reason="pydantic 2 makes the schema")
def test_the_file_is_what_the_code_makes() -> None:
    schema = runpy.run_path(str(ROOT / "docs" / "rig_schema.py"))["rig_json_schema"]()
    assert json.loads(SCHEMA.read_text(encoding="utf-8")) == schema, "run ./run python docs/generate.py"


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_every_rig_file_names_it(path: Path) -> None:
    first = path.read_text(encoding="utf-8").splitlines()[0]
    assert first == "# yaml-language-server: $schema=../rig.schema.json"
    assert (path.parent / first.split("=")[1]).resolve() == SCHEMA


def test_it_knows_every_effect_and_parameter() -> None:
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    for name, effect in CATALOGUE.items():
        known = schema["properties"]["effects"]["properties"][name]["properties"]
        if effect.of_tables:
            assert list(known) == list(LAWS)
            continue
        for item in effect.parameters:
            assert (known[item.name]["minimum"], known[item.name]["maximum"]) == (item.low, item.high)
