"""Fixtures: a rig of made-up samples, and the recordings of rig A."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

# pytest's importlib mode puts no folder on the path: csv_files.py and fake_bags.py stand beside the tests.
sys.path.insert(0, str(Path(__file__).parent))

from csv_files import Lab
from fake_bags import FakeRig


@pytest.fixture
def rig() -> FakeRig:
    return FakeRig()


@pytest.fixture(scope="session")
def rig_a() -> Path:
    """Recordings of rig A, which lie beside the project where somebody put them there."""
    folder = Path(__file__).parents[3] / "shared" / "data" / "rig_a"
    if not folder.is_dir():
        pytest.skip(f"the recordings of rig A are not at {folder}")
    return folder


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    """A folder with a CSV file and its map."""
    return Lab(tmp_path)
